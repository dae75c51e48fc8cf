"""Does the legend tell of all that is drawn and of nothing else, in the colours it was drawn in?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.viewer.caption import captioned
from app.viewer.frames import colours, frame
from app.viewer.legend import NAMED, LegendEntry, legend
from app.viewer.ruler import LENGTHS, ruler
from app.viewer.view_state import LAYERS, ViewState
from pmpnbp.pictures.palette import PART_COLOURS
from tests.app.scenes import drawn, only, scene, views

UP, AHEAD = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])


def told(state: ViewState, iteration: int = -1) -> list[LegendEntry]:
    whole = scene()
    found = frame(whole.snapshots[iteration], state, whole.stage, next_views=views())
    return legend(found, state, colours(whole.stage, state.theme))


def texts(state: ViewState, iteration: int = -1) -> list[str]:
    return [entry.text for entry in told(state, iteration)]


def test_every_layer_has_its_line_where_it_is_drawn() -> None:
    region, edge = (-1.0, -1.0, 0.0, 1.0, 1.0, 1.0), ("frame", "drawer2")
    lines = {layer: texts(only(layer, part="drawer1", edge=edge, region=region)) for layer in LAYERS}
    # the image is the camera's; the prior says nothing yet; the search is over
    assert {layer for layer, found in lines.items() if not found} == {"image", "prior", "candidates"}
    searching = next(n for n, made in enumerate(scene().snapshots) if made.report.stage == "search")
    assert texts(only("candidates"), searching)[-1] == "candidate of the search, fainter where lighter"
    assert lines["estimate"] == ["frame", "drawer1", "drawer2", "drawer3"]
    assert lines["ellipsoids"][-1] == "covariance ellipsoid, 75 % inside"
    assert texts(only("ellipsoids"), -2) == []  # none before it is at rest
    assert lines["axes"] == lines["frames"]
    assert texts(only("axes", "frames", part="drawer1")) == lines["axes"]


def test_the_lines_have_the_colours_of_the_scene() -> None:
    for theme in ("light", "dark"):
        state = only("estimate", "scan", theme=theme)
        entries = told(state)
        assert len({entry.colours[0] for entry in entries[:4]}) == 4
        depth = entries[4:]
        assert [len(entry.colours) for entry in depth] == [2, 2]
    assert [entry.colours for entry in told(only("estimate"))] == [[colour] for colour in PART_COLOURS[:4]]
    explained = told(only("scan", colour_scan="explained"))
    assert explained[0].text == "scan: explained" and all(entry.colours for entry in explained)
    assert texts(only("scan", colour_scan="plain")) == ["the scan"]


def test_many_parts_are_counted() -> None:
    found = drawn(only("estimate"))
    many = replace(found, targets=replace(found.targets, parts=tuple(f"link {n}" for n in range(29))))
    lines = [entry.text for entry in legend(many, only("estimate"), [(0, 0, 0)] * 29)]
    assert len(lines) == NAMED + 1 and lines[-1] == "and 21 more parts"


def test_an_exported_scene_says_what_it_shows_and_no_name_becomes_markup() -> None:
    hostile = "</title><script>alert(1)</script> & \\1"
    result = scene().snapshots[-1].result
    bad = {**result, "model": hostile, "joints": {hostile: result["joints"]["slide1"]}}
    entries = [LegendEntry(text=hostile, sign="surface", colours=["#123456"])]
    page = "<html><head><title>Viser</title></head><body><div></div></body></html>"
    text = captioned(page, "dark", hostile, bad, entries)
    assert "<script>alert" not in text and text.count("<script") == 1  # its own, which folds it on a phone
    assert text.count("</title>") == 1 and text.endswith("</script></body></html>")
    assert text.count("&lt;script&gt;alert(1)&lt;/script&gt; &amp; \\1") == 5
    assert "color-scheme:dark" in text and "#123456" in text
    told_of = captioned(page, "light", "mine", result, told(ViewState()))
    assert "<title>mine, iteration 5</title>" in told_of and "joint slide1" in told_of and " cm" in told_of
    assert ">particle, larger where heavier<" in told_of


@pytest.mark.parametrize("size", [0.03, 0.3, 1.1, 7.0])
def test_a_ruler_is_as_long_as_it_says_and_stands_before_the_object_on_its_floor(size: float) -> None:
    rng = np.random.default_rng(2)
    points = size * rng.uniform([-0.4, 1.0, 0.0], [0.4, 1.6, 0.9], size=(2000, 3))
    floor = np.array([[0.0, 0.0, -1.0, -0.02]])  # z = -2 cm
    found = ruler(points, floor, UP, np.array([0.0, 0.9, -0.3]), size)
    assert found is not None
    line, *marks = found.segments.astype(float)
    assert np.linalg.norm(line[1] - line[0]) == pytest.approx(found.length) and found.length in dict(LENGTHS)
    assert found.length <= max(size, LENGTHS[0][0])
    at = np.array([mark[0] for mark in marks])
    np.testing.assert_allclose(np.linalg.norm(np.diff(at, axis=0), axis=1), found.step, rtol=1e-4)
    np.testing.assert_allclose(np.array(marks)[:, 1] - at, np.outer((np.array(marks)[:, 1] - at) @ UP, UP), atol=1e-6)
    assert (at[:, 1] < points[:, 1].min()).all() and np.ptp(at[:, 2]) < 1e-6
    assert at[0, 2] == pytest.approx(-0.02, abs=0.03 * found.length)
    assert found.text in ("5 cm", "20 cm", "1 m", "5 m")


def test_there_is_no_ruler_where_there_is_nothing_to_measure() -> None:
    assert ruler(np.zeros((0, 3)), np.zeros((0, 4)), UP, AHEAD, 1.0) is None
    assert ruler(np.ones((5, 3)), np.zeros((0, 4)), UP, -UP, 1.0) is None
