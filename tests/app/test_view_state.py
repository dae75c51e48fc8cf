"""Does a view's state take what it should, and say what is wrong with the rest?"""

from __future__ import annotations

import json
import re
from types import SimpleNamespace
from typing import Any

import pytest
from pydantic import ValidationError

from app.viewer.view_state import LAYERS, MAX_COORDINATE, Layers, ViewState, ViewStateError, merged
from app.viewer.views import _own_handles
from pmpnbp.pictures.palette import KIND_COLOURS, KIND_NAMES
from pmpnbp.potentials.pixel_kinds import PixelKind

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
    "next_view": 2,
    "compare": {"session_id": "abc", "iteration": None},
    "theme": "dark",
    "camera": {"position": [1, 2, 3], "look_at": [0, 0, 0.5], "up": [0, 0, 1], "field_of_view": 0.8},
    "look": "top",
    "region": [-1, -1, 0, 1, 1, 2],
    "proposals": [[-1, -1, 0, 1, 1, 2], [2, 2, 0, 3, 3, 1]],
    "prior": PRIOR,
    "hidden": True,
    "economy": True,
}


def change(**members: Any) -> ViewState:
    return ViewState.model_validate(members)


def test_a_new_view_shows_the_newest_with_eight_layers() -> None:
    state = ViewState()
    assert {layer for layer in LAYERS if getattr(state.show, layer)} == {
        "scan",
        "camera",
        "particles",
        "estimate",
        "ellipsoids",
        "draws",
        "candidates",
        "next_views",
        "ruler",
    }
    assert state.iteration is None and state.confidence == 0.75 and state.theme == "light"


def test_what_is_merged_comes_back() -> None:
    state = merged(ViewState(), change(**ALL))
    found = json.loads(state.model_dump_json())
    assert found == ALL | {"show": Layers().model_dump() | {"truth": True, "scan": False}}
    assert merged(ViewState(), change(**found)) == state


def test_members_that_are_not_named_stay() -> None:
    first = merged(ViewState(), change(**ALL))
    second = merged(first, change(show={"axes": True}))
    assert second.show.axes and second.show.truth and not second.show.scan
    assert second.model_copy(update={"show": first.show}) == first
    assert merged(first, change()) == first


def test_another_part_forgets_the_particle() -> None:
    state = merged(ViewState(), change(part="a", particle=3))
    assert merged(state, change(part="a")).particle == 3
    assert merged(state, change(part="b")).particle is None
    assert merged(state, change(part="b", particle=4)).particle == 4
    with pytest.raises(ViewStateError, match="particle 3 is of no part"):
        merged(ViewState(), change(particle=3))


@pytest.mark.parametrize(("roi", "region"), [([0, 0, 0, 1, 1, 1], (0, 0, 0, 1, 1, 1)), ([-1e6, 0, 0, 1, 1, 1], None)])
def test_a_new_view_has_a_handle_on_the_sessions_region_where_it_can_be_seen(roi: list[float], region: Any) -> None:
    source: Any = SimpleNamespace(status=lambda: {"roi": roi, "prior": {"kind": "uniform"}})
    assert _own_handles(source) == ViewState(region=region)


def test_every_member_says_what_it_is_and_every_layer_has_a_switch() -> None:
    for declared in (ViewState.model_fields, Layers.model_fields):
        assert all(entry.description for entry in declared.values())
    layers = ViewState.model_json_schema()["$defs"]["Layers"]["properties"]
    assert {name for name, entry in layers.items() if entry["title"] and entry["group"]} == set(LAYERS)


def test_the_legend_of_the_scans_colours_is_that_of_the_particles_picture() -> None:
    """The page makes its legend of this; a measured point is of any kind but without depth,
    and a surface is known to go on in the working image only."""
    legend = ViewState.model_json_schema()["properties"]["colour_scan"]["legend"]
    never = PixelKind.NO_DEPTH, PixelKind.GOES_ON
    shown = [[KIND_NAMES[kind], colour] for kind, colour in KIND_COLOURS.items() if kind not in never]
    assert legend == [*shown, ["not covered", ""]]


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"colour": "red"}, "colour\n  Extra inputs are not permitted"),
        ({"show": {"grid": True}}, "show.grid\n  Extra inputs are not permitted"),
        ({"show": {"scan": 1}}, "show.scan\n  Input should be a valid boolean"),
        ({"show": True}, "Input should be a valid dictionary or instance of Layers"),
        ({"iteration": -1}, "greater than or equal to 0"),
        ({"iteration": 2.5}, "valid integer"),
        ({"colour_scan": "red"}, "'depth', 'explained' or 'plain'"),
        ({"theme": None}, "'light' or 'dark'"),
        ({"confidence": 1}, "less than 1"),
        ({"confidence": 0}, "greater than 0"),
        ({"confidence": float("nan")}, "less than 1"),
        ({"part": 3}, "valid string"),
        ({"edge": "ab"}, "valid tuple"),
        ({"edge": ["a", None]}, "valid string"),
        ({"edge": ["a"]}, "at least 2 items"),
        ({"compare": {"iteration": 3}}, "compare.session_id\n  Field required"),
        ({"compare": {"session_id": "a", "colour": "red"}}, "compare.colour\n  Extra inputs are not permitted"),
        ({"camera": {"position": [0, 0, 0], "look_at": [0, 0, 0], "up": [0, 0, 1]}}, "looks nowhere"),
        ({"camera": {"position": [0, 0, 0], "look_at": [0, 0, 1], "up": [0, 0, 0]}}, "looks nowhere"),
        ({"camera": {"position": [0, 0, 0]}}, "camera.look_at\n  Field required"),
        ({"camera": {"position": [0, 0], "look_at": [0, 0, 0], "up": [0, 0, 1]}}, "at least 3 items"),
        ({"region": [0, 0, 0, 1, 1]}, "at least 6 items"),
        ({"region": [0, 0, 0, 1, 1, 0]}, "expected x0 < x1"),
        ({"region": [0, 0, 0, 1, 1, float("inf")]}, "less than or equal to 10000"),
        ({"region": [0, 0, 0, 1, 1, 2 * MAX_COORDINATE]}, "less than or equal to 10000"),
        ({"prior": {"kind": "uniform"}}, "expected a gaussian prior"),
        ({"hidden": "perhaps"}, "valid boolean"),
    ],
)
def test_what_cannot_be_shown_is_refused_in_a_sentence(given: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValidationError, match=re.escape(sentence)):
        change(**given)
