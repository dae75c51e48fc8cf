"""Does a view's state take what it should, and say what is wrong with the rest?"""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from app.viewer.view_state import LAYERS, ViewState, ViewStateError, members, merged

PRIOR = {
    "kind": "gaussian",
    "link": "frame",
    "std_xyz": [0.1, 0.1, 0.1],
    "std_rpy": [0.1, 0.1, 0.1],
    "pose": {"position": {"x": 0, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}},
}
ALL = {
    "iteration": 7,
    "show": {"truth": True, "scan": False},
    "colour_scan": "explained",
    "colour_particles": "weight",
    "confidence": 0.9,
    "part": "drawer2",
    "edge": ["frame", "drawer2"],
    "particle": 3,
    "compare": {"session_id": "abc", "iteration": None},
    "theme": "dark",
    "camera": {"position": [1, 2, 3], "look_at": [0, 0, 0.5], "up": [0, 0, 1]},
    "region": [-1, -1, 0, 1, 1, 2],
    "prior": PRIOR,
    "hidden": True,
    "economy": True,
}


def test_a_new_view_shows_the_newest_with_five_layers() -> None:
    state = members(ViewState())
    shown = {layer for layer in LAYERS if state["show"][layer]}
    assert shown == {"scan", "camera", "particles", "estimate", "ellipsoids"}
    assert state["iteration"] is None and state["confidence"] == 0.75 and state["theme"] == "light"


def test_what_is_merged_comes_back() -> None:
    state = members(merged(ViewState(), ALL))
    shown = state.pop("show")
    assert shown == members(ViewState())["show"] | {"truth": True, "scan": False}
    found = json.loads(json.dumps(state))
    assert found == {name: value for name, value in ALL.items() if name != "show"}
    assert merged(ViewState(), json.loads(json.dumps(members(merged(ViewState(), ALL))))) == merged(ViewState(), ALL)


def test_members_that_are_not_named_stay() -> None:
    first = merged(ViewState(), ALL)
    second = merged(first, {"show": {"axes": True}})
    assert second.show.axes and second.show.truth and not second.show.scan
    assert members(second) | {"show": None} == members(first) | {"show": None}
    assert merged(first, {}) == first


def test_another_part_forgets_the_particle() -> None:
    state = merged(ViewState(), {"part": "a", "particle": 3})
    assert merged(state, {"part": "a"}).particle == 3
    assert merged(state, {"part": "b"}).particle is None
    assert merged(state, {"part": "b", "particle": 4}).particle == 4


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"colour": "red"}, "no member 'colour'; it has iteration, show"),
        ({"show": {"grid": True}}, "layer 'grid' is not in a view; it has scan, camera"),
        ({"show": {"scan": 1}}, "'scan' is 1; expected true or false"),
        ({"show": True}, "expected an object of layers"),
        ({"iteration": -1}, "expected a whole number"),
        ({"iteration": True}, "expected a whole number"),
        ({"colour_scan": "red"}, "expected depth or explained or plain"),
        ({"theme": None}, "expected light or dark"),
        ({"confidence": 1}, "expected a share above 0 and below 1"),
        ({"confidence": float("nan")}, "expected a share"),
        ({"part": 3}, "expected the name of a part"),
        ({"particle": 3}, "particle 3 is of no part"),
        ({"edge": "ab"}, "expected the names of two parts"),
        ({"edge": ["a", None]}, "expected the names of two parts"),
        ({"edge": ["a"]}, "expected the names of two parts"),
        ({"compare": {"iteration": 3}}, "expected {session_id, iteration}"),
        ({"compare": {"session_id": "a", "colour": "red"}}, "expected session_id and iteration"),
        ({"camera": {"position": [0, 0, 0], "look_at": [0, 0, 0], "up": [0, 0, 1]}}, "looks nowhere"),
        ({"camera": {"position": [0, 0, 0], "look_at": [0, 0, 1], "up": [0, 0, 0]}}, "looks nowhere"),
        ({"camera": {"position": [0, 0, 0]}}, "expected {position, look_at, up}"),
        ({"camera": {"position": [0, 0], "look_at": [0, 0, 0], "up": [0, 0, 1]}}, "expected 3 numbers"),
        ({"region": [0, 0, 0, 1, 1]}, "expected 6 numbers"),
        ({"region": [0, 0, 0, 1, 1, 0]}, "expected x0 < x1"),
        ({"region": [0, 0, 0, 1, 1, float("inf")]}, "expected a finite number"),
        ({"prior": {"kind": "uniform"}}, "expected a gaussian prior"),
        ({"hidden": "yes"}, "expected true or false"),
    ],
)
def test_what_cannot_be_shown_is_refused_in_a_sentence(change: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ViewStateError, match=f"^[^\n]*{re.escape(sentence)}[^\n]*$"):
        merged(ViewState(), change)
