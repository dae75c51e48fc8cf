"""A command that is told twice with the same Idempotency-Key is done once, and its first answer given again."""

from __future__ import annotations

import threading
from typing import Any

import httpx
import pytest

from app.sessions.session import Session
from tests.app import small_sessions as small
from tests.app.small_sessions import problem


@pytest.fixture(scope="module")
def path(client: httpx.Client) -> str:
    return small.create(client)


def told(client: httpx.Client, path: str, key: str, json: Any = None, method: str = "POST") -> httpx.Response:
    return client.request(method, path, json=json, headers={"Idempotency-Key": key})


def test_a_step_told_twice_is_one_step(client: httpx.Client, path: str) -> None:
    before = client.get(path).json()["iteration"]
    first, again = (told(client, f"{path}/step", "step", {"iterations": 2}) for _ in range(2))
    assert (first.status_code, first.json()) == (again.status_code, again.json())
    assert first.json()["iteration"] == client.get(path).json()["iteration"] == before + 2
    problem(told(client, f"{path}/step", "step", {"iterations": 1}), 422, "was used for a call with other content")
    problem(told(client, f"{path}/step", "x" * 256), 422, "1 to 255 printable characters")
    assert told(client, f"{path}/step", "another").json()["iteration"] == before + 3


def test_the_first_answer_is_given_whatever_has_happened_since(client: httpx.Client, path: str) -> None:
    scan = small.upload_scan(client, "arm")
    commands: list[tuple[str, str, Any]] = [
        ("POST", "/run", {"iterations": 1}),
        ("POST", "/pause", None),
        ("PATCH", "", {"config": {"triangles": 50}}),
        ("PATCH", "", {"name": "kitchen"}),
        ("POST", "/scans", {"scan_id": scan}),
        ("POST", "/reset", None),
    ]
    answers = []
    for number, (method, end, body) in enumerate(commands):
        small.at_rest(client, path)
        answers.append(told(client, path + end, f"key {number}", body, method))
        assert answers[-1].is_success, answers[-1].text
    before = client.get(path).json(), client.get(f"{path}/trace").json()
    for number, (method, end, body) in enumerate(commands):
        again = told(client, path + end, f"key {number}", body, method)
        assert (again.status_code, again.json()) == (answers[number].status_code, answers[number].json())
    assert (client.get(path).json(), client.get(f"{path}/trace").json()) == before


def test_a_sample_asked_for_twice_is_one_session(client: httpx.Client) -> None:
    before = client.get("/api/v1/sessions").json()
    first, again = (told(client, "/api/v1/sessions/sample", "sample", {"scene": "open", "run": True}) for _ in range(2))
    assert (first.status_code, first.json(), first.headers["location"]) == (
        again.status_code,
        again.json(),
        again.headers["location"],
    )
    assert len(client.get("/api/v1/sessions").json()) == len(before) + 1
    assert small.at_rest(client, f"/api/v1/sessions/{first.json()['id']}")["iteration"] > 0
    problem(told(client, "/api/v1/sessions/sample", "sample", {"scene": "door"}), 422, "other content")


def test_what_was_named_is_told_from_what_was_left_out(client: httpx.Client, path: str) -> None:
    assert told(client, f"{path}/reset", "named", {"roi": small.ROI}).is_success
    problem(told(client, f"{path}/reset", "named", {}), 422, "other content")


def test_a_command_that_was_refused_may_be_told_again(client: httpx.Client, path: str) -> None:
    client.post(f"{path}/run", json={"iterations": 100_000})
    problem(told(client, f"{path}/step", "refused"), 409, "pause it first")
    client.post(f"{path}/pause")
    assert told(client, f"{path}/step", "refused").is_success


def test_a_command_that_is_at_work_is_not_begun_again(
    client: httpx.Client, path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, go_on = threading.Event(), threading.Event()
    pause = Session.pause

    def slow(session: Session) -> Any:
        begun.set()
        go_on.wait()
        return pause(session)

    monkeypatch.setattr(Session, "pause", slow)
    answers: list[httpx.Response] = []
    first = threading.Thread(target=lambda: answers.append(told(client, f"{path}/pause", "slow")))
    first.start()
    begun.wait()
    again = told(client, f"{path}/pause", "slow")
    problem(again, 409, "is still at work; ask again when it is done")
    assert again.headers["Retry-After"] == "1"
    go_on.set()
    first.join()
    assert told(client, f"{path}/pause", "slow").json() == answers[0].json()
