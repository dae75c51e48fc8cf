"""Sessions over REST: what they are told to do, what they refuse, and that a restart changes no number."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import numpy as np
import pytest

from app.sessions.run_queue import RunQueue
from pmpnbp.inference import run as engine
from tests.app import small_sessions as small
from tests.app.small_sessions import history, ids_of, problem


@pytest.fixture(scope="module")
def shared(serve_for_module: Callable[..., Any]) -> Any:
    """One server for all tests that leave it as it is."""
    return serve_for_module(max_running=1, max_sessions=40).ready()


@pytest.fixture(scope="module")
def model_id(client: httpx.Client) -> str:
    return small.upload_model(client)


@pytest.fixture(scope="module")
def scan_id(client: httpx.Client) -> str:
    return small.upload_scan(client)


@pytest.fixture
def path(client: httpx.Client, model_id: str, scan_id: str) -> Iterator[str]:
    made = small.create(client, model_id=model_id, scan_id=scan_id)
    yield made
    client.delete(made)


def test_a_session_begins_paused_at_the_start(client: httpx.Client, path: str, model_id: str, scan_id: str) -> None:
    found = client.get(path).json()
    id = path.rpartition("/")[2]
    assert found["view_url"] == f"/sessions/{id}/"
    assert (found["state"], found["iteration"], found["iterations"], found["error"]) == ("paused", 0, 100, None)
    assert (found["model_id"], found["scan_ids"], found["config"]) == (model_id, [scan_id], small.QUICK)
    assert (found["seed"], found["particles"], found["method"], found["roi"]) == (11, 40, "pmpnbp", small.ROI)
    assert found in client.get("/api/v1/sessions").json()
    assert client.get(f"{path}/estimate").json()["iteration"] == 0


def test_run_step_pause_reset(client: httpx.Client, path: str) -> None:
    assert small.step(client, path, 2)["iteration"] == 2
    answer = client.post(f"{path}/run", json={"iterations": 3})
    assert answer.status_code == 202
    assert (answer.json()["state"], answer.json()["iterations"]) == ("running", 5)
    assert small.at_rest(client, path)["iteration"] == 5
    assert client.post(f"{path}/pause").json()["state"] == "paused"
    reset = client.post(f"{path}/reset").json()
    assert (reset["state"], reset["iteration"]) == ("paused", 0)
    assert len(client.get(f"{path}/trace").json()["iterations"]) == 1


def test_run_without_a_number_goes_to_the_sessions_own_and_then_on(
    client: httpx.Client, model_id: str, scan_id: str
) -> None:
    path = small.create(client, model_id=model_id, scan_id=scan_id, iterations=4)
    small.step(client, path)
    for last in (4, 8):
        assert client.post(f"{path}/run").json()["iterations"] == last
        assert small.at_rest(client, path)["iteration"] == last


def test_run_until_converged_stops_there(client: httpx.Client, path: str) -> None:
    client.post(f"{path}/run", json={"iterations": 1000, "until": "converged"})
    found = small.at_rest(client, path)
    rows = client.get(f"{path}/trace").json()["iterations"]
    assert found["converged"] and found["iteration"] < 1000
    assert [row["converged"] for row in rows].index(True) == len(rows) - 1
    # at rest already: nothing is left to do
    client.post(f"{path}/run", json={"until": "converged"})
    assert small.at_rest(client, path)["iteration"] == found["iteration"]


def test_after_a_change_a_session_is_not_at_rest_until_iterations_have_shown_it(
    client: httpx.Client, path: str
) -> None:
    client.post(f"{path}/run", json={"iterations": 1000, "until": "converged"})
    before = small.at_rest(client, path)["iteration"]
    changed = client.patch(path, json={"config": {"joint_draws": 3, "converged_iterations": 3}}).json()
    assert not changed["converged"]
    client.post(f"{path}/run", json={"iterations": 1000, "until": "converged"})
    found = small.at_rest(client, path)
    assert found["converged"] and found["iteration"] >= before + 3
    told = [row["converged"] for row in client.get(f"{path}/trace").json()["iterations"]]
    assert told[before] and not any(told[before + 1 : before + 3])


def test_pause_stops_a_run_and_what_a_run_does_not_allow_is_refused(client: httpx.Client, path: str) -> None:
    client.post(f"{path}/run", json={"iterations": 100_000})
    problem(client.post(f"{path}/run"), 409, "is running; pause it first")
    problem(client.post(f"{path}/step"), 409, "is running; pause it first")
    found = client.post(f"{path}/pause").json()
    assert found["state"] == "paused"
    time.sleep(0.1)
    assert client.get(path).json() == found
    assert small.step(client, path)["iteration"] == found["iteration"] + 1


def test_one_that_finds_too_many_running_waits_and_says_so(client: httpx.Client, model_id: str, scan_id: str) -> None:
    paths = [small.create(client, model_id=model_id, scan_id=scan_id) for _ in range(3)]
    states = [client.post(f"{path}/run", json={"iterations": 60}).json() for path in paths]
    assert [found["state"] for found in states] == ["running", "waiting", "waiting"]
    assert [found["position"] for found in states] == [None, 1, 2]
    # fair: none is done before the last has begun
    assert client.get(f"{paths[0]}/estimate?wait=idle&timeout=600").json()["iteration"] == 60
    assert client.get(paths[2]).json()["iteration"] > 0
    for path in paths[1:]:
        assert small.at_rest(client, path)["iteration"] == 60
    # taking turns changes no number
    assert small.numbers(client, paths[0]) == small.numbers(client, paths[1]) == small.numbers(client, paths[2])
    for path in paths:
        client.delete(path)


def test_a_waiting_one_hears_what_it_is_told(client: httpx.Client, model_id: str, scan_id: str) -> None:
    first, second = (small.create(client, model_id=model_id, scan_id=scan_id) for _ in range(2))
    client.post(f"{first}/run", json={"iterations": 100_000})
    client.post(f"{second}/run", json={"iterations": 100_000})
    changed = client.patch(second, json={"config": {"joint_draws": 3}}).json()
    assert changed["config"]["joint_draws"] == 3
    assert client.post(f"{second}/pause").json()["state"] == "paused"
    assert client.delete(first).status_code == 204
    assert client.delete(second).status_code == 204


@pytest.mark.parametrize(
    ("members", "status", "text"),
    [
        ({"model_id": "0" * 16}, 404, "model '0000000000000000' is not here"),
        ({"scan_ids": ["0" * 16]}, 404, "scan '0000000000000000' is not here"),
        ({"scan_ids": []}, 422, "scan_ids in the body"),
        ({"config": {"sharpness": 3}}, 422, "setting 'sharpness' does not exist"),
        ({"config": {"joint_draws": 0}}, 422, "setting 'joint_draws' is 0"),
        ({"config": {"search_proposals": 10**9}}, 422, "it must be at most 200000"),
        ({"config": {"image_width": 16}}, 422, "work image's width is 16"),
        ({"roi": [0, 0, 0, 0, 1, 1]}, 422, "is empty"),
        ({"roi": [50, 50, 50, 51, 51, 51]}, 422, "no measured point lies in the region"),
        ({"prior": {"kind": "gaussian", "link": "door"}}, 422, "link 'door' of the prior is not in the model"),
        ({"method": "guess"}, 422, "input should be 'pmpnbp' or 'particle_filter', not 'guess'"),
        ({"particles": 0}, 422, "particles in the body"),
        ({"seed": True}, 422, "seed in the body: input should be a whole number, not True"),
        ({"seed": "1"}, 422, "seed in the body: input should be a whole number, not '1'"),
        ({"max_std": True}, 422, "max_std in the body: input should be a valid number, not True"),
        ({"roi": [0, 0, 0, 1, 1, "1"]}, 422, "roi[5] in the body: input should be a valid number, not '1'"),
        ({"name": "two\r\nlines"}, 422, "name in the body: it has the character U+000D"),
        ({"truth": {"links": {"frame": [1, 2]}}}, 422, "link 'frame' of the truth has no 4x4 matrix"),
        ({"truth": {"links": {"frme": np.eye(4).tolist()}}}, 422, "link 'frme' of the truth is not in the model"),
        ({"truth": {"links": {}, "joints": {"slide9": 0.1}}}, 422, "joint 'slide9' of the truth is not in the model"),
        ({"colour": "red"}, 422, "colour in the body"),
    ],
)
def test_what_does_not_fit_makes_no_session(
    client: httpx.Client, model_id: str, scan_id: str, members: dict[str, Any], status: int, text: str
) -> None:
    before = client.get("/api/v1/sessions").json()
    problem(client.post("/api/v1/sessions", json=small.body(model_id, scan_id) | members), status, text)
    assert client.get("/api/v1/sessions").json() == before


def test_numbers_that_json_does_not_have_are_refused(client: httpx.Client, model_id: str, scan_id: str) -> None:
    for text in ('"prior": {"kind": "uniform", "x": NaN}', '"roi": [0,0,0,1,1,Infinity]', '"config": {"a": -Infinity}'):
        content = f'{{"model_id": "{model_id}", "scan_ids": ["{scan_id}"], {text}}}'
        answer = client.post("/api/v1/sessions", content=content, headers={"Content-Type": "application/json"})
        assert answer.status_code == 422, answer.text


def test_a_change_that_does_not_fit_changes_nothing(client: httpx.Client, path: str, scan_id: str) -> None:
    small.step(client, path, 3)
    before, numbers = client.get(path).json(), small.numbers(client, path)
    problem(client.patch(path, json={"config": {"sharpness": 3}}), 422, "setting 'sharpness' does not exist")
    problem(client.patch(path, json={"config": {"image_width": 20}}), 422, "work image's width is 20")
    problem(client.post(f"{path}/scans", json={"scan_id": "0" * 16}), 404, "is not here")
    problem(client.post(f"{path}/scans", json={"scan_id": scan_id}), 409, "already")
    assert (client.get(path).json(), small.numbers(client, path)) == (before, numbers)


@pytest.mark.parametrize("mode", ["", "replace", "JOINS", 1, None])
def test_a_mode_that_there_is_none_of_is_refused(client: httpx.Client, path: str, mode: Any) -> None:
    before = client.get(path).json()
    scan = small.upload_scan(client, "second_view")
    problem(client.post(f"{path}/scans", json={"scan_id": scan, "mode": mode}), 422, "mode")
    assert client.get(path).json() == before


def test_a_scan_replaces_those_before(client: httpx.Client, path: str, scan_id: str) -> None:
    """From the next iteration on, also for a reset; one that is gone may come back."""
    small.step(client, path, 4)
    second, third = (small.upload_scan(client, scene) for scene in ("second_view", "arm"))
    client.post(f"{path}/scans", json={"scan_id": second}).raise_for_status()
    found = client.post(f"{path}/scans", json={"scan_id": third, "mode": "replaces"}).json()
    assert found["scan_ids"] == [third] and not found["converged"]
    problem(client.post(f"{path}/scans", json={"scan_id": third, "mode": "replaces"}), 409, "already")
    small.step(client, path)
    told = client.get(f"{path}/trace").json()
    assert told["changes"] == [
        {"after_iteration": 4, "scan_id": second, "mode": "joins"},
        {"after_iteration": 4, "scan_id": third, "mode": "replaces"},
    ]
    (note,) = told["iterations"][5]["notes"]
    assert note.startswith("the scene has changed")
    assert told["iterations"][5]["std_xyz"] is None
    back = client.post(f"{path}/scans", json={"scan_id": scan_id, "mode": "replaces"}).json()
    assert back["scan_ids"] == [scan_id]
    assert client.delete(f"/api/v1/scans/{third}").status_code == 409  # iterations were made with it
    client.post(f"{path}/reset").raise_for_status()
    assert client.get(path).json()["scan_ids"] == [scan_id]
    small.step(client, path, 4)
    whole = small.after(client, 4, model_id=client.get(path).json()["model_id"], scan_id=scan_id)
    assert small.numbers(client, path) == small.numbers(client, whole)


def test_unknown_sessions(client: httpx.Client) -> None:
    for method, end in (("GET", ""), ("DELETE", ""), ("POST", "/run"), ("GET", "/estimate"), ("GET", "/events")):
        problem(client.request(method, f"/api/v1/sessions/none{end}"), 404, "session 'none' is not here; there")


def test_the_same_key_makes_one_session(client: httpx.Client, model_id: str, scan_id: str) -> None:
    asked, key = small.body(model_id, scan_id), {"Idempotency-Key": "once"}
    first, second = (client.post("/api/v1/sessions", json=asked, headers=key) for _ in range(2))
    assert first.status_code == second.status_code == 201
    assert first.json() == second.json() and first.headers["Location"] == second.headers["Location"]
    assert client.get(first.headers["Location"]).status_code == 200
    problem(client.post("/api/v1/sessions", json=asked | {"seed": 1}, headers=key), 422, "other content")


def test_a_failing_iteration_is_kept_and_may_be_tried_again(
    client: httpx.Client, path: str, monkeypatch: pytest.MonkeyPatch
) -> None:

    small.step(client, path, 2)

    def fail(*arguments: object) -> None:
        raise MemoryError("no room for 3 particles")

    with monkeypatch.context() as patch:
        patch.setattr(engine, "following", fail)
        problem(client.post(f"{path}/step"), 409, "is failed: iteration 3 could not be made: MemoryError: no room")
    found = client.get(path).json()
    assert (found["state"], found["iteration"]) == ("failed", 2)
    assert found["error"] == "iteration 3 could not be made: MemoryError: no room for 3 particles"
    found = small.step(client, path)
    assert (found["state"], found["iteration"], found["error"]) == ("paused", 3, None)


def test_deleting_a_running_session_stops_it(client: httpx.Client, model_id: str, scan_id: str) -> None:
    path = small.create(client, model_id=model_id, scan_id=scan_id)
    client.post(f"{path}/run", json={"iterations": 100_000})
    name = f"session-{path.rpartition('/')[2]}"
    assert name in [thread.name for thread in threading.enumerate()]
    assert client.delete(path).status_code == 204
    assert name not in [thread.name for thread in threading.enumerate()]
    assert client.get(path).status_code == 404


def test_no_more_sessions_than_the_limit(serve: Callable[..., Any]) -> None:
    client = serve(max_sessions=2).client
    model_id, scan_id = small.upload_model(client), small.upload_scan(client)
    paths = [small.create(client, model_id=model_id, scan_id=scan_id) for _ in range(2)]
    answer = client.post("/api/v1/sessions", json=small.body(model_id, scan_id))
    problem(answer, 429, "there are 2 sessions, which is the most that is kept (max_sessions)")
    assert "retry-after" in answer.headers
    client.delete(paths[0])
    small.create(client, model_id=model_id, scan_id=scan_id)


def test_a_full_data_directory_stops_sessions_with_a_sentence(serve: Callable[..., Any]) -> None:
    served = serve()
    client = served.client
    path = small.after(client, 5)
    served.app.state.store._room._max_bytes = 1000
    problem(client.post("/api/v1/sessions", json=small.body(*ids_of(client, path))), 507, "is full")
    problem(client.post(f"{path}/step", json={"iterations": 20}), 409, "is failed: the data directory may hold")
    problem(client.post(f"{path}/reset"), 507, "is full")
    problem(client.patch(path, json={"config": {"joint_draws": 3}}), 507, "is full")
    found = client.get(path).json()
    assert (found["state"], found["iteration"], found["config"]) == ("failed", 10, small.QUICK)
    served.app.state.store._room._max_bytes = 1 << 30
    assert small.step(client, path, 2)["iteration"] == 12


def test_reset_begins_with_what_is_in_force(client: httpx.Client, path: str, model_id: str, scan_id: str) -> None:
    small.step(client, path, 3)
    client.patch(path, json={"config": {"joint_draws": 3}})
    client.post(f"{path}/reset")
    small.step(client, path, 4)
    other = small.after(client, 4, model_id=model_id, scan_id=scan_id, config=small.QUICK | {"joint_draws": 3})
    assert history(client, path, 4) == history(client, other, 4)
    assert client.get(path).json()["config"] == client.get(other).json()["config"]


def test_the_sample_session_is_made_once_and_runs(serve: Callable[..., Any]) -> None:
    served = serve()
    state = served.ready().app.state
    session = state.sessions.demo()
    session.pause().result()
    assert state.sessions.demo() is session
    session.pause().result()
    (found,) = served.client.get("/api/v1/sessions").json()
    assert found["name"].startswith("Sample") and found["iteration"] >= 0
    assert session.archive.read().row["add"].keys() == {"frame", "drawer1", "drawer2", "drawer3"}


def test_slots_are_taken_in_the_order_of_asking() -> None:
    slots = RunQueue(1)
    a, b, c = object(), object(), object()
    assert slots.take(a) and not slots.take(b) and not slots.take(c)
    assert slots.take(a)  # has it already
    assert (slots.position(a), slots.position(b), slots.position(c)) == (None, 1, 2)
    slots.leave(a)
    assert not slots.take(c)
    assert slots.take(b) and slots.others_wait()  # c does
    assert not slots.take(a)
    slots.leave(c)
    assert slots.position(a) == 1
    slots.leave(b)
    assert slots.take(a) and not slots.others_wait()


def test_a_nudge_before_the_wait_is_not_lost() -> None:
    slots = RunQueue(1)
    holder, waiting = object(), object()
    assert slots.take(holder) and not slots.take(waiting)
    slots.nudge(waiting)
    slots.wait(waiting)  # else it would not come back
    woken = threading.Thread(target=slots.wait, args=(waiting,))
    woken.start()
    slots.leave(holder)
    woken.join()
    assert slots.take(waiting)
