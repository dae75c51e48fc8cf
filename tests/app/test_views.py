"""Does a view show over REST, in events and in the scene what was asked of it, and only while somebody looks?"""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable
from typing import Any

import httpx
import pytest

from app.viewer import painter as painter_module
from tests.app import small_sessions as small
from tests.app.open_views import drawn, looking, painter, state, until


@pytest.fixture(scope="module")
def path(shared: Any) -> str:
    """A session after a few iterations, which no test takes further."""
    return small.after(shared.client, 5)


def test_a_new_view_has_what_the_session_has(shared: Any, path: str) -> None:
    found = state(shared, f"{path}/views/new")
    assert found["region"] == small.ROI and found["prior"] is None and found["iteration"] is None
    assert found["drawn"] is None and found["clients"] == 0 and found["error"] is None
    prior = {
        "kind": "gaussian",
        "link": "frame",
        "std_xyz": [0.1] * 3,
        "std_rpy": [0.1] * 3,
        "pose": shared.client.get(f"{path}/estimate").json()["links"]["frame"]["pose"],
    }
    given = small.create(shared.client, prior=prior)
    assert state(shared, f"{given}/views/new")["prior"] == prior


def test_a_change_is_merged_and_kept(shared: Any, path: str) -> None:
    view = f"{path}/views/kept"
    changed = state(shared, view, iteration=3, show={"axes": True}, part="drawer2", particle=7, theme="dark")
    assert changed["show"]["axes"] and changed["show"]["scan"] and changed["particle"] == 7
    again = state(shared, view, confidence=0.5)
    assert again == changed | {"confidence": 0.5, "revision": 2} == state(shared, view)
    assert state(shared, f"{path}/views/other")["iteration"] is None  # each view has its own
    assert state(shared, view, iteration=None)["iteration"] is None


@pytest.mark.parametrize(
    ("change", "status", "sentence"),
    [
        ({"colour": "red"}, 422, "colour in the body"),
        ({"show": {"grid": True}}, 422, "show.grid"),
        ({"show": {"scan": None}}, 422, "show.scan"),
        ({"part": "lid"}, 422, "part 'lid' is not in the model; it has frame, drawer1, drawer2, drawer3"),
        ({"edge": ["drawer1", "drawer2"]}, 422, "no joint connects 'drawer1' and 'drawer2'; there are frame-drawer1"),
        ({"particle": 3}, 422, "particle 3 is of no part"),
        ({"region": [0, 0, 0, 1, 1, 0]}, 422, "x0 < x1"),
        ({"prior": {"kind": "gaussian", "link": "lid"}}, 422, "link 'lid' of the prior is not in the model"),
        ({"compare": {"session_id": "fedcba9876543210"}}, 404, "fedcba9876543210"),
        ({"camera": {"position": [1, 1, 1], "look_at": [1, 1, 1], "up": [0, 0, 1]}}, 422, "looks nowhere"),
    ],
)
def test_what_cannot_be_shown_is_refused(
    shared: Any, path: str, change: dict[str, Any], status: int, sentence: str
) -> None:
    view = f"{path}/views/refused"
    before = state(shared, view)
    answer = shared.client.patch(view, json=change)
    assert answer.status_code == status and sentence in answer.json()["detail"]
    assert answer.headers["content-type"] == "application/problem+json"
    assert state(shared, view) == before


def test_what_is_not_here_is_404(shared: Any, path: str) -> None:
    for kind in ("", "/events", "/scene.html"):
        answer = shared.client.get(f"/api/v1/sessions/fedcba9876543210/views/a{kind}")
        assert answer.status_code == 404 and "fedcba9876543210" in answer.json()["detail"]
        assert shared.client.get(f"{path}/views/a.b{kind}").status_code == 404


def test_nothing_is_drawn_while_nobody_looks(shared: Any) -> None:
    path = small.create(shared.client)
    view = f"{path}/views/unseen"
    state(shared, view, confidence=0.5)
    small.step(shared.client, path, 2)
    assert state(shared, view)["drawn"] is None
    with looking(shared, view):
        particles = drawn(shared, view, 2)["particles"]
        assert set(particles) == {"frame", "drawer1", "drawer2", "drawer3"}
        assert all(0 < count <= 40 for count in particles.values())  # those that weigh something
        small.step(shared.client, path)
        serial = drawn(shared, view, 3)["serial"]
        state(shared, view, hidden=True)
        small.step(shared.client, path)
        time.sleep(3 / painter_module.RATE)
        assert state(shared, view)["drawn"]["serial"] == serial
        state(shared, view, hidden=False)
        drawn(shared, view, 4)
    until(lambda: state(shared, view)["clients"] == 0)
    small.step(shared.client, path)
    time.sleep(3 / painter_module.RATE)
    assert state(shared, view)["drawn"]["iteration"] == 4


def test_a_view_stays_at_its_iteration_and_others_at_theirs(shared: Any) -> None:
    path = small.after(shared.client, 4)
    old, live = f"{path}/views/old", f"{path}/views/live"
    state(shared, old, iteration=2)
    with looking(shared, old), looking(shared, live):
        drawn(shared, old, 2)
        drawn(shared, live, 4)
        small.step(shared.client, path)
        drawn(shared, live, 5)
        assert state(shared, old)["drawn"]["iteration"] == 2
        state(shared, old, iteration=1)
        drawn(shared, old, 1)
        state(shared, old, iteration=None, show={"particles": False})
        assert drawn(shared, old, 5)["particles"] == {}
        # iterations that are no more: the newest there is
        state(shared, live, iteration=5)
        shared.client.post(f"{path}/reset")
        drawn(shared, live, 0)


def test_a_client_that_reads_nothing_delays_nobody(shared: Any) -> None:
    path = small.create(shared.client)
    slow, quick = f"{path}/views/slow", f"{path}/views/quick"
    with looking(shared, slow, reads=False), looking(shared, quick):
        for iteration in range(1, 7):
            small.step(shared.client, path)
            drawn(shared, quick, iteration)
        drawn(shared, slow, 6)  # in viser, ready for when it reads


def test_events_tell_of_changes_and_of_what_is_drawn(shared: Any, path: str) -> None:
    view = f"{path}/views/told"
    events: list[tuple[str, Any]] = []
    with httpx.Client(base_url=shared.url, timeout=None) as client, client.stream("GET", f"{view}/events") as stream:
        assert stream.headers["content-type"].startswith("text/event-stream")
        thread = threading.Thread(target=gather, args=(stream, events, 4))
        thread.start()
        until(lambda: events)
        assert events[0] == ("view", state(shared, view))
        state(shared, view, part="drawer1")
        until(lambda: len(events) > 1)
        assert events[1][0] == "view" and events[1][1]["part"] == "drawer1"
        with looking(shared, view):
            until(lambda: [kind for kind, _ in events if kind == "drawn"])
            thread.join()
    assert next(data for kind, data in events if kind == "drawn")["iteration"] == 5


def gather(stream: Any, events: list[tuple[str, Any]], least: int) -> None:
    """Add (kind, data) of each event until there are `least`, and one of them tells of what was drawn."""
    kind = ""
    for line in stream.iter_lines():
        name, _, value = line.partition(": ")
        if name == "event":
            kind = value
        elif name == "data":
            events.append((kind, json.loads(value)))
            if len(events) >= least and any(kind == "drawn" for kind, _ in events):
                return


def test_a_deleted_session_ends_its_views(shared: Any) -> None:
    path = small.create(shared.client)
    view = f"{path}/views/doomed"
    with looking(shared, view):
        drawn(shared, view, 0)
        thread = painter(shared, view)._thread
        assert shared.client.delete(path).status_code == 204
        thread.join()
    assert shared.client.get(view).status_code == 404


def test_views_that_nobody_keeps_make_room(serve: Callable[..., Any]) -> None:
    served = serve(max_views=4).ready()
    path = small.create(served.client)
    for number in range(9):
        state(served, f"{path}/views/v{number}")
    assert len(served.app.state.views) == 4


def test_a_view_too_many_is_refused_until_one_closes(serve: Callable[..., Any]) -> None:
    served = serve(max_views=2)
    served.app.state.views._linger = 0.0
    path = small.create(served.client)
    views = [f"{path}/views/v{number}" for number in range(3)]
    with looking(served, views[0]):
        with looking(served, views[1]):
            for method in ("GET", "PATCH"):
                answer = served.client.request(method, views[2], json={} if method == "PATCH" else None)
                small.problem(
                    answer, 429, "2 3D views are open, the most that this server draws (its setting max_views)"
                )
                assert answer.headers["retry-after"]
            answer = upgrade(served, views[2])
            small.problem(answer, 429, "2 3D views are open")
        until(lambda: served.client.get(views[2]).status_code == 200)


def upgrade(shared: Any, view: str) -> httpx.Response:
    """What a browser's websocket on a view is answered."""
    session_id, view_id = view.split("/")[4], view.split("/")[6]
    headers = {
        "Connection": "Upgrade",
        "Upgrade": "websocket",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
        "Origin": shared.url,
    }
    found: httpx.Response = shared.client.get(f"/sessions/{session_id}/view/{view_id}/", headers=headers)
    return found


def test_views_beyond_those_at_the_full_rate_are_told_so(serve: Callable[..., Any]) -> None:
    served = serve(max_views_full_rate=1).ready()
    path = small.create(served.client)
    first, second = f"{path}/views/first", f"{path}/views/second"
    with looking(served, second):
        assert state(served, second)["slowed"] is None
        with looking(served, first):
            # not who was looked at first, but what was opened first
            assert state(served, second)["slowed"] is None
            told = state(served, first)["slowed"]
            assert told.startswith("1 view was opened before this one")
            state(served, second, hidden=True)
            assert state(served, first)["slowed"] is None
            state(served, second, hidden=False)
            assert state(served, first)["slowed"] == told
            # slowed or not, what rests is drawn at once
            small.step(served.client, path)
            drawn(served, first, 1)
        with looking(served, first):
            assert state(served, first)["slowed"] == told
    with looking(served, first):
        until(lambda: state(served, first)["slowed"] is None)
