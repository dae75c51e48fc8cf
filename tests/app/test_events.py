"""Events: every listener hears everything in order, and after a break what it has missed."""

from __future__ import annotations

import asyncio
import json
import re
import threading
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import httpx
import pytest

from app.routes import events as routes
from app.routes.events import _news, get_events
from app.schemas import Progress
from app.schemas_results import TraceRow
from app.sessions.events import BLOCK, KEPT, Event, Events
from app.sessions.sessions import Sessions
from pmpnbp.inference import run as engine
from tests.app import small_sessions as small
from tests.servers import NO_AUTHORITIES

Heard = tuple[int, str, dict[str, Any]]


def listen(url: str, path: str, last: int | None = None, until: Callable[[Heard], bool] | None = None) -> list[Heard]:
    """What a listener hears up to the first event that `until` holds for, or to the end of the stream."""
    heard: list[Heard] = []
    headers = {} if last is None else {"Last-Event-ID": str(last)}
    address = f"{url}{path}/events"
    with httpx.stream("GET", address, headers=headers, timeout=None, verify=NO_AUTHORITIES) as answer:
        assert answer.status_code == 200 and answer.headers["content-type"].startswith("text/event-stream")
        members: dict[str, str] = {}
        for line in answer.iter_lines():
            name, _, value = line.partition(": ")
            if line:
                members[name] = value
            elif "data" in members:
                heard.append((int(members["id"]), members["event"], json.loads(members["data"])))
                members = {}
                if until is not None and until(heard[-1]):
                    break
    return heard


def paused_at(iteration: int) -> Callable[[Heard], bool]:
    return lambda heard: heard[1] == "state" and (heard[2]["state"], heard[2]["iteration"]) == ("paused", iteration)


def iterations(heard: list[Heard]) -> list[int]:
    return [data["iteration"] for _, kind, data in heard if kind == "iteration"]


def assert_rising(heard: list[Heard]) -> None:
    ids = [number for number, _, _ in heard]
    assert ids == sorted(ids) and len(set(ids)) == len(ids)


def test_a_listener_hears_how_things_stand_and_then_everything(shared: Any, client: httpx.Client) -> None:
    path = small.after(client, 2)
    heard: list[Heard] = []
    listener = threading.Thread(target=lambda: heard.extend(listen(shared.url, path, None, paused_at(7))))
    listener.start()
    while not session_of(shared, path).events._listeners:
        pass
    client.post(f"{path}/run", json={"iterations": 5})
    listener.join()
    assert [kind for _, kind, _ in heard[:2]] == ["iteration", "state"] and heard[1][2]["state"] == "paused"
    assert iterations(heard) == [2, 3, 4, 5, 6, 7]
    assert [data["state"] for _, kind, data in heard if kind == "state"] == ["paused", "running", "paused"]
    assert_rising(heard[2:])
    rows = client.get(f"{path}/trace?after=1").json()["iterations"]
    assert [data for _, kind, data in heard if kind == "iteration"] == rows
    assert [number for number, kind, _ in heard if kind == "iteration"] == [row["event"] for row in rows]
    for _, kind, data in heard:
        (TraceRow if kind == "iteration" else Progress).model_validate(data)


def test_a_stream_is_kept_alive_and_never_stored(
    shared: Any, client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(routes, "IDLE_SECONDS", 0.05)
    with httpx.stream("GET", f"{shared.url}{small.create(client)}/events", timeout=None) as answer:
        assert "no-store" in answer.headers["cache-control"] and answer.headers["x-accel-buffering"] == "no"
        lines = answer.iter_lines()
        assert next(lines) == "retry: 1000"
        assert any(line.startswith(":") for line in lines)


def test_iterations_are_gathered_where_they_are_not_waited_for() -> None:
    """They come with the next state or error, and after as long as was asked for."""
    events = Events(limit=1000)

    def publish(kind: str) -> None:
        events.publish(Event(events.number(), kind, b"{}"))

    async def heard(every: float) -> tuple[list[str], list[str]]:
        archive = SimpleNamespace(iteration=0, rows=lambda after: [])
        session: Any = SimpleNamespace(
            events=events, progress=lambda: {"state": "running", "iteration": 0}, archive=archive
        )
        kinds: list[str] = []

        async def follow() -> None:
            async for fresh in _news(session, every):
                stream = await get_events(session, fresh, None, every)
                async for text in stream.body_iterator:
                    kinds.extend(re.findall(r"^event: (\w+)$", bytes(text).decode(), re.MULTILINE))

        following = asyncio.create_task(follow())
        while kinds != ["state"]:  # how things stand
            await asyncio.sleep(0.01)
        for _ in range(3):
            publish("iteration")
        if every > 5:
            await asyncio.sleep(0.2)
            early = list(kinds)
            publish("state")
        else:
            early = []
        while len(kinds) < (5 if every > 5 else 4):
            await asyncio.sleep(0.01)
        following.cancel()
        return early[1:], kinds[1:]

    assert asyncio.run(heard(10.0)) == ([], ["iteration"] * 3 + ["state"])
    assert asyncio.run(heard(0.3)) == ([], ["iteration"] * 3)
    assert asyncio.run(heard(0.0)) == ([], ["iteration"] * 3)


def test_fifty_listeners_hear_every_iteration_in_order(shared: Any, client: httpx.Client) -> None:
    path = small.create(client)
    heard: list[list[Heard]] = [[] for _ in range(50)]
    threads = [
        threading.Thread(target=lambda mine=mine: mine.extend(listen(shared.url, path, None, paused_at(30))))
        for mine in heard
    ]
    for thread in threads:
        thread.start()
    while len(session_of(shared, path).events._listeners) < 50:
        pass
    client.post(f"{path}/run", json={"iterations": 30})
    for thread in threads:
        thread.join()
    assert all(iterations(mine) == [*range(31)] for mine in heard)


@pytest.mark.parametrize("restarted", [False, True])
def test_what_was_missed_is_heard_after_a_break(serve: Callable[..., Any], restarted: bool) -> None:
    """Also after a restart, when only the recording knows it; and the numbers go on rising."""
    served = serve()
    client = served.client
    path = small.after(client, 4)
    before = listen(served.url, path, 0, paused_at(4))
    seen = next(number for number, kind, data in before if kind == "iteration" and data["iteration"] == 2)
    if restarted:
        served.app.state.sessions.close()
        served.app.state.sessions = Sessions(served.app.state.store, served.config)
        served.app.state.sessions.restore()
    missed = listen(served.url, path, seen, paused_at(4))
    assert iterations(missed) == [3, 4]
    assert_rising(missed)
    last = missed[-1][0]
    assert last >= before[-1][0] and (not restarted or last == BLOCK)
    small.step(client, path, 2)
    after = listen(served.url, path, last, paused_at(6))
    assert iterations(after) == [5, 6] and after[0][0] > last
    client.post(f"{path}/reset")
    anew = listen(served.url, path, after[-1][0], paused_at(0))
    assert iterations(anew) == [0]
    assert_rising(before + after + anew)


def test_another_name_is_heard_at_rest_and_between_iterations(
    shared: Any, client: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = small.after(client, 1, name="before")
    last, _, state = listen(shared.url, path, until=lambda heard: heard[1] == "state")[-1]
    assert state["name"] == "before"
    client.patch(path, json={"name": "at rest"}).raise_for_status()
    ((last, kind, state),) = listen(shared.url, path, last, until=lambda heard: True)
    assert (kind, state["name"], state["state"]) == ("state", "at rest", "paused")
    # while an iteration is made it waits for that, and nothing comes out of turn
    following = engine.following

    def renaming(*given: Any, **named: Any) -> Any:
        if client.get(path).json()["name"] == "at rest":
            client.patch(path, json={"name": "running"}).raise_for_status()
        return following(*given, **named)

    monkeypatch.setattr(engine, "following", renaming)
    client.post(f"{path}/run", json={"iterations": 2}).raise_for_status()
    heard = listen(shared.url, path, last, until=paused_at(3))
    assert [number for number, *_ in heard] == sorted(number for number, *_ in heard)
    assert [row["iteration"] for _, kind, row in heard if kind == "iteration"] == [2, 3]
    names = [state["name"] for _, kind, state in heard if kind == "state"]
    assert names == ["at rest", "running", "running"]


def test_a_failure_is_an_event(shared: Any, client: httpx.Client, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*arguments: object) -> None:
        raise MemoryError("no room")

    path = small.create(client)
    with monkeypatch.context() as patch:
        patch.setattr(engine, "following", fail)
        client.post(f"{path}/step")
    heard = listen(shared.url, path, 0, lambda heard: heard[1] == "error")
    assert heard[-1][2] == {"error": "iteration 1 could not be made: MemoryError: no room", "iteration": 0}
    assert heard[-2][2]["state"] == "failed"


def test_the_stream_ends_with_the_session(shared: Any, client: httpx.Client) -> None:
    path = small.create(client)
    begun = threading.Event()

    def begins(heard: Heard) -> bool:
        begun.set()
        return False

    heard: list[Heard] = []
    listener = threading.Thread(target=lambda: heard.extend(listen(shared.url, path, until=begins)))
    listener.start()
    session = session_of(shared, path)
    begun.wait()
    client.delete(path)
    listener.join()
    assert iterations(heard) == [0]
    while session.events._listeners:
        pass


def test_a_last_event_id_that_is_no_number_is_refused(shared: Any, client: httpx.Client) -> None:
    path = small.create(client)
    answer = client.get(f"{path}/events", headers={"Last-Event-ID": "yesterday"})
    assert answer.status_code == 422 and answer.headers["content-type"] == "application/problem+json"


def test_numbers_are_set_aside_before_they_are_used() -> None:
    reserved: list[int] = []
    events = Events(1, 1, reserved.append)
    assert [events.number() for _ in range(BLOCK + 1)] == [*range(1, BLOCK + 2)]
    assert reserved == [1 + BLOCK, 1 + 2 * BLOCK]
    again = Events(reserved[-1], reserved[-1], reserved.append)
    assert again.last == 2 * BLOCK and again.number() == 1 + 2 * BLOCK


def test_a_slow_listener_gets_the_newest_and_holds_nobody_up() -> None:
    events = Events()
    woken: list[int] = []
    end = events.listen(lambda: woken.append(1))
    for number in range(1, KEPT + 101):
        events.publish(Event(number, "iteration", b"{}"))
    found = [event.number for event in events.since(0)]
    assert found == [*range(101, KEPT + 101)] and len(woken) == KEPT + 100
    end()
    events.publish(Event(KEPT + 101, "iteration", b"{}"))
    assert len(woken) == KEPT + 100


def session_of(shared: Any, path: str) -> Any:
    return shared.app.state.sessions.get(path.rpartition("/")[2])


@pytest.fixture(autouse=True)
def fresh(shared: Any) -> Iterator[None]:
    """No session of one test runs on into the next."""
    yield
    for session in shared.app.state.sessions.list():
        shared.client.delete(f"/api/v1/sessions/{session['id']}")
