"""Posteriors in the making: nobody waits for one that is not theirs, and none that was ended changes a number."""

from __future__ import annotations

import http.client
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import httpx
import pytest

from app.sessions import long_read_out
from pmpnbp.readout import mixture
from tests.app import small_sessions as small
from tests.app.held_read_outs import Held, holding
from tests.app.small_sessions import history, problem

# Calls that are answered while others wait.
AT_ONCE = 4


@pytest.fixture(scope="module")
def ids(client: httpx.Client) -> dict[str, str]:
    return {"model_id": small.upload_model(client), "scan_id": small.upload_scan(client)}


@pytest.fixture(scope="module")
def whole(client: httpx.Client, ids: dict[str, str]) -> str:
    """A session that came to rest without anybody asking anything of it."""
    path = small.create(client, **ids)
    client.post(f"{path}/run", json={"iterations": 1000, "until": "converged"})
    assert small.at_rest(client, path)["converged"]
    return path


@pytest.fixture
def path(client: httpx.Client, whole: str, ids: dict[str, str]) -> Iterator[str]:
    """A session like it, at the start; `whole` was read out before anything holds read-outs up."""
    made = small.create(client, **ids)
    yield made
    client.delete(made)


@pytest.fixture
def held() -> Iterator[Held]:
    with holding() as found:
        yield found


@pytest.fixture
def beside() -> Iterator[ThreadPoolExecutor]:
    """For calls that wait for their answer."""
    with ThreadPoolExecutor(AT_ONCE) as found:
        yield found


def test_a_pause_does_not_wait_for_a_read_out_and_changes_no_number(
    client: httpx.Client, path: str, whole: str, held: Held
) -> None:
    last = client.get(whole).json()["iteration"]
    client.post(f"{path}/run", json={"iterations": 1000, "until": "converged"})
    held.until(lambda: bool(held.begun))
    found = client.post(f"{path}/pause").json()
    assert (found["state"], found["iteration"], found["converged"], found["fit"]) == ("paused", last - 1, False, None)
    assert (held.begun, held.ended) == ([last], 1)
    held.release()
    client.post(f"{path}/run", json={"iterations": 1000, "until": "converged"})
    assert small.at_rest(client, path)["iteration"] == last
    assert history(client, path, last) == history(client, whole, last)
    assert client.get(f"{path}/estimate").json()["posterior_iteration"] == last


def test_a_change_does_not_wait_for_a_read_out_either(client: httpx.Client, path: str, whole: str, held: Held) -> None:
    last = client.get(whole).json()["iteration"]
    client.post(f"{path}/run", json={"iterations": 1000, "until": "converged"})
    held.until(lambda: bool(held.begun))
    assert client.patch(path, json={"config": {"joint_draws": 3}}).json()["state"] == "running"
    held.until(lambda: len(held.begun) == 2)
    assert held.begun[1] > last  # whether it is at rest was decided anew
    assert client.get(f"{path}/trace").json()["changes"][0]["after_iteration"] == last - 1


def test_who_deletes_a_session_does_not_wait_for_its_read_out(client: httpx.Client, ids: Any, held: Held) -> None:
    path = small.create(client, **ids)
    client.post(f"{path}/run", json={"iterations": 1000, "until": "converged"})
    held.until(lambda: bool(held.begun))
    assert client.delete(path).status_code == 204
    assert held.ended == 1 and client.get(path).status_code == 404


def test_who_asks_again_and_again_does_not_keep_a_read_out_from_its_end() -> None:
    """Something always waits; after a few times the read-out goes on, and the next one gives way again."""
    made = long_read_out.LongReadOut(lambda: True, lambda: None)
    for _ in range(2):
        for _ in range(long_read_out.GIVES_WAY):
            with pytest.raises(long_read_out.GaveWay), made.begun() as checkpoint:
                checkpoint()
        with made.begun() as checkpoint:
            checkpoint()
            checkpoint()


def test_a_long_read_out_is_told_of(
    client: httpx.Client, path: str, held: Held, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(long_read_out, "SOON", 0.0)
    assert not client.get(path).json()["reading_out"]
    client.post(f"{path}/run", json={"iterations": 1000, "until": "converged"})
    told = []
    with client.stream("GET", f"{path}/events") as answer:
        for line in answer.iter_lines():
            told += ['"reading_out":true' in line] if line.startswith("data:") and '"state"' in line else []
            if told and told[-1]:
                break
    assert client.get(path).json()["reading_out"]
    held.release()
    assert not small.at_rest(client, path)["reading_out"]


def test_a_posterior_that_is_asked_for_twice_is_read_out_once_while_the_session_iterates(
    shared: Any, client: httpx.Client, whole: str, path: str, beside: ThreadPoolExecutor, held: Held
) -> None:
    asked_of = client.get(whole).json()["iteration"] - 4  # of a session that is not at rest, where it would be read out
    small.step(client, path, asked_of + 1)
    calls = [f"{call}iteration={asked_of}" for call in ("estimate?posterior=true&", "posterior/frame?", "decision?")]
    asked = [beside.submit(client.get, f"{path}/{call}") for call in calls]
    read_outs = shared.app.state.sessions.get(path.rpartition("/")[2]).read_outs
    while sum(len(waiting) for waiting in read_outs._waiting.values()) < len(calls):
        time.sleep(small.PATIENCE)
    other = beside.submit(client.get, f"{path}/posterior?iteration={asked_of + 1}")
    assert small.step(client, path, 2)["iteration"] == asked_of + 3
    assert held.begun == [asked_of] and not any(answer.done() for answer in (*asked, other))
    held.release()
    told, draws, decided = (answer.result().json() for answer in asked)
    assert told["posterior_iteration"] == draws["posterior_iteration"] == decided["iteration"] == asked_of
    assert other.result().json()["posterior_iteration"] == asked_of + 1
    again = client.get(f"{path}/{calls[0]}").json()
    assert {**again, "state": told["state"]} == told and held.begun == [asked_of, asked_of + 1]


def test_a_read_out_ends_when_the_last_client_that_waits_for_it_has_gone(
    shared: Any, client: httpx.Client, path: str, held: Held
) -> None:
    small.step(client, path, 6)
    clients = [http.client.HTTPConnection(*shared.url.removeprefix("http://").split(":")) for _ in range(2)]
    read_outs = shared.app.state.sessions.get(path.rpartition("/")[2]).read_outs
    for number, one in enumerate(clients, 1):
        one.request("GET", f"{path}/decision?iteration=5")
        while sum(len(waiting) for waiting in read_outs._waiting.values()) < number:
            time.sleep(small.PATIENCE)
    (waiting,) = read_outs._waiting.values()
    clients[0].close()
    while not waiting[0].cancelled():
        time.sleep(small.PATIENCE)
    assert held.ended == 0
    clients[1].close()
    held.until(lambda: held.ended == 1)
    # who asks now does not join those who left
    held.release()
    assert client.get(f"{path}/decision?iteration=5").status_code == 200 and held.begun == [5, 5]


def test_a_link_that_is_not_there_is_told_of_before_anything_is_read_out(
    client: httpx.Client, path: str, held: Held
) -> None:
    small.step(client, path, 6)
    text = "link 'door' is not in the model"
    for call in ("posterior/door", "posterior?links=frame,door", "decision?links=door"):
        problem(client.get(f"{path}/{call}"), 404, text)
    problem(client.post(f"{path}/decision", json={"links": ["door"]}), 404, text)
    problem(client.get(f"{path}/posterior/frame?iteration=7"), 404, "it has 0 to 6")
    assert held.begun == []


def test_a_deleted_session_ends_what_was_asked_of_it(
    client: httpx.Client, ids: Any, beside: ThreadPoolExecutor, held: Held
) -> None:
    path = small.after(client, 6, **ids)
    asked: Future[httpx.Response] = beside.submit(client.get, f"{path}/estimate?iteration=5&posterior=true")
    held.until(lambda: bool(held.begun))
    assert client.delete(path).status_code == 204
    problem(asked.result(), 409, f"session '{path.rpartition('/')[2]}' is closed")
    assert held.ended == 1


def test_a_read_out_that_fails_is_told_to_who_asked_and_tried_again(
    client: httpx.Client, path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*arguments: object) -> None:
        raise MemoryError("no room for 3 draws")

    small.step(client, path, 6)
    with monkeypatch.context() as patch:
        patch.setattr(mixture, "of_estimate", fail)
        problem(client.get(f"{path}/posterior/frame"), 500, "internal error")
    assert client.get(f"{path}/posterior/frame").json()["posterior_iteration"] == 6
