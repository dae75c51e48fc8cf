"""Does the scene of a view show what was asked of it, take clicks and drags, and survive what fails?"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from app.viewer import painter as painter_module
from app.viewer.gizmos import LOW, PRIOR
from tests.app import small_sessions as small
from tests.app.open_views import drawn, looking, painter, state, until


@pytest.fixture(scope="module")
def path(shared: Any) -> str:
    """A session after a few iterations, which no test takes further."""
    return small.after(shared.client, 5)


def test_in_economy_a_running_session_is_drawn_less_often_and_a_step_at_once(
    shared: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(painter_module, "ECONOMY_RATE", 1e-3)
    path = small.create(shared.client)
    view = f"{path}/views/economy"
    state(shared, view, economy=True)
    with looking(shared, view):
        for iteration in (1, 2):
            small.step(shared.client, path)
            first = drawn(shared, view, iteration)["serial"]
        shared.client.post(f"{path}/run", json={"iterations": 40})
        shared.client.get(f"{path}/estimate", params={"wait": "idle", "timeout": 600})
        # not while it ran, but for what was being drawn when it began; and when it had come to rest
        assert drawn(shared, view, 42)["serial"] <= first + 2


def test_a_failure_is_told_and_ends_nothing(
    shared: Any, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    path = small.create(shared.client)
    view = f"{path}/views/failing"
    real = painter_module.frame

    def failing(made: Any, *arguments: Any, **options: Any) -> Any:
        if made.iteration == 2:
            raise RuntimeError("no ink")
        return real(made, *arguments, **options)

    monkeypatch.setattr(painter_module, "frame", failing)
    with looking(shared, view):
        small.step(shared.client, path)
        drawn(shared, view, 1)
        assert small.step(shared.client, path)["state"] == "paused"
        error = until(lambda: state(shared, view)["error"])
        assert error == "the scene could not be drawn: RuntimeError: no ink"
        assert state(shared, view)["drawn"]["iteration"] == 1
        small.step(shared.client, path)
        drawn(shared, view, 3)
        assert until(lambda: state(shared, view)["error"] is None)
    assert "cannot be drawn" in caplog.text


def test_the_scene_is_a_page_that_needs_nothing(shared: Any, path: str) -> None:
    view = f"{path}/views/exported"
    state(shared, view, iteration=3)
    answer = shared.client.get(f"{view}/scene.html")
    assert answer.status_code == 200 and answer.headers["content-type"].startswith("text/html")
    assert 'filename="' in answer.headers["content-disposition"] and "-3.html" in answer.headers["content-disposition"]
    assert answer.text.count("</html>") == 1 and len(answer.text) > 900_000  # viser's page, and the scene in it
    assert state(shared, view)["drawn"]["iteration"] == 3
    # it says whose it is and what it shows, and asks for nothing
    name = shared.client.get(path).json()["name"] or path.rsplit("/", 1)[1]
    assert f"<title>{name}, iteration 3</title>" in answer.text
    assert "joint slide1" in answer.text and all(
        entry["text"] in answer.text for entry in state(shared, view)["legend"]
    )


def test_a_place_is_looked_from_by_its_name(shared: Any, path: str) -> None:
    view = f"{path}/views/named"
    assert state(shared, view)["legend"] == []  # nothing is drawn yet
    eyes = [state(shared, view, look=look)["camera"] for look in ("fit", "sensor", "top")]
    assert len({tuple(eye["position"]) for eye in eyes}) == 3
    assert state(shared, view)["look"] == "top" and eyes[1]["field_of_view"] is not None
    # the browser's hand, or a program, looks from elsewhere
    assert state(shared, view, camera=eyes[0])["look"] is None
    answer = shared.client.patch(view, json={"look": "behind"})
    small.problem(answer, 422, "look")
    assert state(shared, view)["camera"] == eyes[0]


def test_another_session_lies_over_it(shared: Any, path: str) -> None:
    other = small.create(shared.client, seed=12)
    view, id = f"{path}/views/both", other.rsplit("/", 1)[1]
    with looking(shared, view):
        serial = drawn(shared, view, 5)["serial"]
        state(shared, view, compare={"session_id": id, "iteration": None})
        until(lambda: state(shared, view)["drawn"]["serial"] > serial)
        assert "/compare/0" in nodes(shared, view)
        state(shared, view, compare={"session_id": path.rsplit("/", 1)[1], "iteration": 2})
        until(lambda: state(shared, view)["drawn"]["serial"] > serial + 1)
        state(shared, view, compare=None)
        until(lambda: "/compare/0" not in nodes(shared, view))


def nodes(shared: Any, view: str) -> dict[str, Any]:
    return dict(painter(shared, view)._drawing._nodes)


def test_a_click_in_the_scene_selects(shared: Any, path: str) -> None:
    """As viser calls us: with the ray of the click."""
    view = f"{path}/views/clicked"
    with looking(shared, view):
        drawn(shared, view, 5)
        eye = np.array([3.0, 2.0, 2.0])
        belief = shared.client.get(f"{path}/beliefs/drawer2").json()["particles"]
        aim = np.array(belief[13][:3]) - eye
        painter(shared, view)._clicked(SimpleNamespace(ray_origin=tuple(eye), ray_direction=tuple(aim)))
        found = state(shared, view)
        chosen = np.array(
            shared.client.get(f"{path}/beliefs/{found['part']}").json()["particles"][found["particle"]][:3]
        )
        np.testing.assert_allclose(np.cross(chosen - eye, aim) / np.linalg.norm(aim) ** 2, 0, atol=1e-6)
        painter(shared, view)._clicked(SimpleNamespace(ray_origin=tuple(eye), ray_direction=tuple(-aim)))
        assert state(shared, view)["particle"] == found["particle"]  # nothing is there: what was selected stays


def test_handles_that_are_dragged_change_the_state(shared: Any, path: str) -> None:
    view = f"{path}/views/dragged"
    with looking(shared, view):
        first = state(shared, view, show={"region": True, "prior": True})
        assert first["prior"]["link"] == "frame"
        until(lambda: (found := state(shared, view)["drawn"]) and found["serial"] and PRIOR in nodes(shared, view))
        pose = np.array([-0.5, -0.4, -0.3, 1, 0, 0, 0])
        painter(shared, view)._dragged(LOW, pose, True)
        assert state(shared, view)["region"] == [-0.5, -0.4, -0.3, *small.ROI[3:]]
        painter(shared, view)._dragged(PRIOR, pose, True)
        moved = state(shared, view)["prior"]
        assert moved["pose"]["position"] == {"x": -0.5, "y": -0.4, "z": -0.3}
        assert moved["pose"]["orientation"] == {"x": 0, "y": 0, "z": 0, "w": 1}
        # and it is a prior that a session takes
        small.create(shared.client, prior=moved)
