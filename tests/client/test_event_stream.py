"""Does a listener hear everything once, in order, whatever becomes of its connection?"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from itertools import islice

import pytest

from pmpnbp.client import calls
from pmpnbp.client.client import Client
from pmpnbp.client.event_stream import Event, _Reader
from pmpnbp.client.session import RemoteSession
from pmpnbp.errors import ServerError
from tests.app import small_sessions as small
from tests.client.failing_servers import LOST, Answer, Relay, Scripted, refused, told
from tests.servers import Served

Servers = Callable[..., Scripted]
SESSION = {"id": "0123456789abcdef", "name": None, "view_url": "/sessions/0123456789abcdef/"}
GONE = refused(404, "session '0123456789abcdef' is not here")


def stream(*texts: str) -> Answer:
    return Answer(200, "".join(texts).encode(), {"Content-Type": "text/event-stream"})


def event(id: int, **data: object) -> str:
    return f"event: iteration\ndata: {json.dumps(data)}\nid: {id}\n\n"


def heard(server: Scripted, last: int | None = None) -> list[Event]:
    with Client(server.url) as client:
        return list(RemoteSession(client._calls, SESSION).events(last))


@pytest.fixture(scope="module")
def path(served: Served) -> str:
    """That of a session with a history."""
    return small.after(served.client, 6)


@pytest.fixture(scope="module")
def everything(client: Client, path: str) -> list[Event]:
    """All that has happened in it."""
    return up_to_rest(client.open_session(path.rsplit("/", 1)[1]).events(0))


def up_to_rest(events: Iterator[Event]) -> list[Event]:
    found = []
    for one in events:
        found.append(one)
        if one.kind == "state" and (one.data["state"], one.data["iteration"]) == ("paused", 6):
            return found
    raise AssertionError("it ended before")


def test_a_listener_hears_what_happened(client: Client, path: str, everything: list[Event]) -> None:
    rows = client.open_session(path.rsplit("/", 1)[1]).trace()
    assert [one.data for one in everything if one.kind == "iteration"] == rows
    assert [one.id for one in everything if one.kind == "iteration"] == [row["event"] for row in rows]
    assert [one.data["state"] for one in everything if one.kind == "state"] == ["running", "paused"]


def test_a_listener_hears_how_things_stand(client: Client, path: str) -> None:
    first, second = islice(client.open_session(path.rsplit("/", 1)[1]).events(), 2)
    assert (first.kind, first.data["iteration"]) == ("iteration", 6)
    assert (second.kind, second.data["state"]) == ("state", "paused")


@pytest.mark.parametrize("length", [1, 700, 1500, 2600, 4000])
def test_nothing_is_lost_or_doubled_where_connections_break(
    served: Served, relay: Callable[..., Relay], path: str, everything: list[Event], at_once: None, length: int
) -> None:
    """Wherever they do: after an event, in one, before any, or in the answer's headers."""
    broken = relay(length, length + 900, length + 1800, 10)
    with Client(broken.url) as client:
        session = RemoteSession(client._calls, served.client.get(path).json())
        assert up_to_rest(session.events(0)) == everything
    assert broken.connections > 2


def test_a_listener_is_told_what_happens(client: Client, served: Served) -> None:
    session = client.open_session(small.create(served.client).rsplit("/", 1)[1])
    events = session.events()
    assert [next(events).kind, next(events).kind] == ["iteration", "state"]
    session.step(2)
    told = list(islice(events, 4))
    assert [one.data.get("state", one.data["iteration"]) for one in told] == ["running", 1, 2, "paused"]


def test_the_stream_of_a_deleted_session_ends(client: Client, served: Served) -> None:
    session = client.open_session(small.after(served.client, 1).rsplit("/", 1)[1])
    events = session.events(0)
    first = next(events)
    session.delete()
    assert all(one.id > first.id for one in events)
    assert list(session.events()) == []


def test_a_listener_that_comes_back_names_what_it_heard_last(scripted: Servers) -> None:
    server = scripted(stream("retry: 0\n\n", event(7, a=1), event(9, a=2)), stream(event(12, a=3)), stream(), GONE)
    assert [(one.id, one.data["a"]) for one in heard(server, 5)] == [(7, 1), (9, 2), (12, 3)]
    assert [request.headers["Last-Event-ID"] for request in server.requests] == ["5", "9", "12", "12"]


def test_half_an_event_is_none(scripted: Servers) -> None:
    server = scripted(stream(event(1, a=1), event(2, a=2)[:-1]), stream(event(2, a=3)), GONE)
    assert [(one.id, one.data["a"]) for one in heard(server)] == [(1, 1), (2, 3)]
    assert "Last-Event-ID" not in server.requests[0].headers


def test_a_server_that_is_busy_or_away_is_asked_again(scripted: Servers, at_once: None) -> None:
    server = scripted(LOST, refused(429, retry_after="0"), LOST, stream(event(1)), LOST, LOST, LOST, LOST, GONE)
    assert [one.id for one in heard(server)] == [1]


def test_a_stream_ends_with_the_refusal_of_the_server(scripted: Servers) -> None:
    with pytest.raises(ServerError, match=r"^a token is needed$"):
        heard(scripted(refused(401, "a token is needed")))


def test_a_stream_ends_where_no_server_is_any_more(scripted: Servers, at_once: None) -> None:
    with pytest.raises(ServerError, match="broke off"):
        heard(scripted(stream(event(1)), *[LOST] * 5))


def test_an_event_that_is_none_is_told(scripted: Servers) -> None:
    with pytest.raises(ServerError, match="the server's answer is not an event"):
        heard(scripted(stream("event: iteration\ndata: {\nid: 1\n\n")))


def test_a_stream_that_ends_empty_is_not_opened_again_at_once(
    scripted: Servers, monkeypatch: pytest.MonkeyPatch
) -> None:
    waits: list[float] = []
    monkeypatch.setattr(calls.time, "sleep", waits.append)
    assert heard(scripted(stream("retry: 2500\n\n"), stream(event(1)), stream(), told([]), GONE)) == [
        Event(1, "iteration", {})
    ]
    assert waits == [2.5, 2.5, 2.5]


@pytest.mark.parametrize("length", [1, 2, 3, 1000])
def test_events_are_read_wherever_they_are_cut(length: int) -> None:
    """With the ends of lines that the standard allows and servers write, and without those that only Python knows."""
    text = (
        ': ping\n\nretry: 5\n\nevent: state\r\ndata: {"name": "a\u2028b\x85c"}\r\nid: 3\r\n\r\n'
        "event:error\ndata:{}\nid:4\n\n"
    ).encode()
    reader = _Reader()
    found = list(reader.read(text[start : start + length] for start in range(0, len(text), length)))
    assert found == [Event(3, "state", {"name": "a\u2028b\x85c"}), Event(4, "error", {})]
    assert reader.retry_milliseconds == 5
