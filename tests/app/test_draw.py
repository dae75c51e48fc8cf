"""Does viser get what a scene frame says, and of it only what differs from the one before?"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from app.viewer.draw import Drawing
from app.viewer.frames import frame
from app.viewer.gizmos import LOW
from app.viewer.scene_frame import Points
from app.viewer.view_state import LAYERS, Layers, ViewState, merged
from app.viewer.viser_server import open_server
from tests.app.scenes import only, scene, shown, views

EVERYTHING = only(*LAYERS, part="drawer2", particle=3, edge=["frame", "drawer2"], region=[-1, -1, 0, 1, 1, 2])


@pytest.fixture
def server() -> Iterator[Any]:
    server, _ = open_server()
    yield server
    server.stop()


def draw(drawing: Drawing, state: ViewState, iteration: int = -1) -> None:
    whole = scene()
    drawing.draw(frame(whole.snapshots[iteration], state, whole.stage, next_views=views()))


def kept(server: Any) -> dict[int, Any]:
    """What a browser that came now would be sent, by number."""
    return dict(server._websock_server._broadcast_buffer.message_from_id)


def nothing(*_: object) -> None:
    pass


def test_what_is_in_the_frame_is_in_viser(server: Any) -> None:
    drawing, state = Drawing(server, nothing), EVERYTHING
    draw(drawing, state)
    whole = scene()
    wanted = {node.name for node in frame(whole.snapshots[-1], state, whole.stage, next_views=views()).nodes}
    there = {message.name for message in kept(server).values() if hasattr(message, "props")}
    assert wanted <= there
    draw(drawing, only())
    server._run_garbage_collector(force=True)
    left = {message.name for message in kept(server).values() if hasattr(message, "props")}
    assert not left & wanted


def test_candidates_are_changed_in_place_while_there_are_as_many(server: Any) -> None:
    drawing = Drawing(server, nothing)
    searched = next(n for n, made in enumerate(scene().snapshots) if made.report.stage == "search")
    draw(drawing, only("candidates"), searched)
    before = set(kept(server))
    draw(drawing, only("candidates", theme="dark"), searched)
    sent = [message for number, message in kept(server).items() if number not in before]
    assert sent
    assert not [message for message in sent if "Mesh" in type(message).__name__]
    draw(drawing, only("candidates"))
    server._run_garbage_collector(force=True)
    assert not [message for message in kept(server).values() if getattr(message, "name", "").startswith("/candidates/")]


def test_another_iteration_sends_no_mesh_again(server: Any) -> None:
    drawing = Drawing(server, nothing)
    # the last one alone has a posterior, of which these two layers tell
    without = ViewState(show=Layers(ellipsoids=False, draws=False))
    draw(drawing, without, 1)
    before = kept(server)
    draw(drawing, without, 5)
    fresh = [message for number, message in kept(server).items() if number not in before]
    assert fresh and not [message for message in fresh if hasattr(message, "props")]
    kinds = {type(message).__name__ for message in fresh}
    assert {"SetPositionMessage", "SetOrientationMessage", "SceneNodeUpdateMessage"} <= kinds
    # the scan and the meshes are many times larger than 4 × 40 particles
    sent = sum(array.nbytes for message in fresh for array in updates(message))
    assert 0 < sent < 8000


def updates(message: Any) -> list[np.ndarray]:
    found = getattr(message, "updates", {})
    return [value for value in found.values() if isinstance(value, np.ndarray)]


def test_the_same_frame_sends_nothing(server: Any) -> None:
    drawing, state = Drawing(server, nothing), EVERYTHING
    draw(drawing, state)
    before = set(kept(server))
    draw(drawing, state)
    assert set(kept(server)) == before


@pytest.mark.parametrize(
    "change",
    [
        {"theme": "dark"},
        {"colour_scan": "explained"},
        {"colour_particles": "weight"},
        {"confidence": 0.99},
        {"show": {"image": False}},
        {"part": "frame"},
        {"particle": 5},
        {"next_view": 1},
        {"edge": ["frame", "drawer1"]},
    ],
)
def test_what_is_changed_ends_like_what_is_drawn_anew(change: dict[str, Any]) -> None:
    changed_state = merged(EVERYTHING, ViewState.model_validate(change))
    scenes = []
    for steps in ([EVERYTHING, changed_state], [changed_state]):
        server, _ = open_server()
        try:
            drawing = Drawing(server, nothing)
            for step in steps:
                draw(drawing, step)
            scenes.append({name: properties(handle) for name, (_, handle) in drawing._nodes.items()})
        finally:
            server.stop()
    changed, anew = scenes
    assert set(changed) == set(anew)
    for name, properties_anew in anew.items():
        for member, value in properties_anew.items():
            np.testing.assert_array_equal(changed[name][member], value, err_msg=f"{name} {member}")


def properties(handle: Any) -> dict[str, Any]:
    """What viser has of a node."""
    found = vars(handle._impl.props) | {"position": handle.position, "wxyz": handle.wxyz}
    found.pop("_format", None)  # of an image, also where there is none any more
    return found


def test_a_handle_that_is_held_is_not_pulled_away(server: Any) -> None:
    drawing, state = Drawing(server, nothing), EVERYTHING
    draw(drawing, state)
    drawing._held.add(LOW)
    further = merged(state, ViewState(region=(-3, -1, 0, 1, 1, 2)))
    draw(drawing, further)
    handle = drawing._nodes[LOW][1]
    assert handle.position[0] == -1  # viser's copy of where the hand has it
    drawing._held.discard(LOW)
    draw(drawing, further)
    assert handle.position[0] == -3


def test_a_failure_leaves_the_scene_usable(server: Any) -> None:
    drawing, whole = Drawing(server, nothing), scene()
    draw(drawing, ViewState(), 2)
    broken = frame(whole.snapshots[3], ViewState(), whole.stage)
    bad = next(node for node in broken.nodes if node.name == "/particles/0/0")
    object.__setattr__(bad, "colours", None)
    with pytest.raises(TypeError, match="NoneType"):
        drawing.draw(broken)
    draw(drawing, ViewState(), 4)
    for place in range(3):
        wanted = shown(Points, frame(whole.snapshots[4], ViewState(), whole.stage), f"/particles/0/{place}")
        np.testing.assert_array_equal(drawing._nodes[wanted.name][1].points, wanted.points)
