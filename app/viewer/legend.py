"""What do the marks in the scene mean? A line for each kind of node that is drawn just now, and none for others.

The words are declared with the layers (`view_state`), the colours are those that were drawn, so that page and exported
scene tell the same.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Literal

from pydantic import BaseModel, Field

from app.viewer.emphasis import INK, QUIET
from app.viewer.gizmos import ACCENT
from app.viewer.scan_points import AROUND, NEAR_FAR, PLAIN
from app.viewer.scene_frame import SceneFrame
from app.viewer.view_state import LAYERS, SCAN_KINDS, Layers, Theme, ViewState
from pmpnbp.pictures.palette import Colour, hexadecimal

Sign = Literal["surface", "points", "line", "ellipsoid", "camera", "axes"]

# Parts that are named; further ones are counted.
NAMED = 8
# What each layer is drawn as, but for the scan and the estimate, of which there is more to tell.
_SIGNS: dict[str, Sign] = {
    "camera": "camera",
    "planes": "surface",
    "ruler": "line",
    "truth": "line",
    "frames": "axes",
    "ellipsoids": "ellipsoid",
    "draws": "line",
    "next_views": "camera",
    "particles": "points",
    "particle_ellipsoids": "ellipsoid",
    "axes": "axes",
    "candidates": "surface",
    "messages": "points",
    "region": "line",
    "prior": "line",
}
# Drawn in each part's own colour; in the colours of the axes; in that of what can be dragged or pressed.
_BY_PART = {"candidates", "estimate", "ellipsoids", "particle_ellipsoids", "draws", "particles", "messages"}
_BY_AXIS = {"frames", "axes"}
_TO_USE = {"next_views", "region", "prior"}


class LegendEntry(BaseModel):
    """A line of the legend."""

    text: str = Field(description="what it means")
    sign: Sign = Field(description="what it looks like")
    colours: list[str] = Field(description="#rrggbb: one, or from near to far; none: in the parts' colours")


def legend(scene: SceneFrame, state: ViewState, part_colours: Sequence[Colour]) -> list[LegendEntry]:
    """The lines for a scene that was drawn in `state`. part_colours : each part's, in the order of its targets"""
    drawn = {node.name.split("/")[1] for node in scene.nodes}
    entries = list(_parts(scene.targets.parts, part_colours)) if drawn & _BY_PART else []
    for layer in LAYERS:
        if layer == "scan" and layer in drawn:
            entries += _scan(state)
        elif layer in drawn and layer != "estimate":
            text = _declared(layer).format(confidence=f"{100 * state.confidence:.0f} %")
            entries.append(LegendEntry(text=text, sign=_SIGNS[layer], colours=_colours(layer, state.theme)))
    if "compare" in drawn:
        entries.append(_entry("what it is compared with", "surface", QUIET[state.theme]))
    if "selected" in drawn:
        entries.append(_entry("the selected particle", "line", INK[state.theme]))
    # axes of frames and of particles are told once
    return [entry for place, entry in enumerate(entries) if entry not in entries[:place]]


def _parts(names: Sequence[str], colours: Sequence[Colour]) -> Iterator[LegendEntry]:
    for name, colour in list(zip(names, colours, strict=True))[:NAMED]:
        yield _entry(name, "surface", colour)
    if len(names) > NAMED:
        yield LegendEntry(text=f"and {len(names) - NAMED} more parts", sign="surface", colours=[])


def _scan(state: ViewState) -> Iterator[LegendEntry]:
    plain = PLAIN[state.theme]
    if state.colour_scan == "depth":
        for text, ends in (("the scan, near to far", NEAR_FAR), ("around what may be the object", AROUND)):
            yield LegendEntry(text=text, sign="points", colours=list(ends[state.theme]))
    elif state.colour_scan == "plain":
        yield LegendEntry(text=_declared("scan"), sign="points", colours=[plain])
    else:
        for text, colour in SCAN_KINDS:
            yield LegendEntry(text=f"scan: {text}", sign="points", colours=[colour or plain])


def _declared(layer: str) -> str:
    extra = Layers.model_fields[layer].json_schema_extra
    return str(extra["legend"]) if isinstance(extra, dict) else ""


def _colours(layer: str, theme: Theme) -> list[str]:
    if layer in _BY_PART or layer in _BY_AXIS:
        return []
    of: Mapping[Theme, Colour] = ACCENT if layer in _TO_USE else QUIET if layer in ("camera", "planes") else INK
    return [hexadecimal(of[theme])]


def _entry(text: str, sign: Sign, colour: Colour) -> LegendEntry:
    return LegendEntry(text=text, sign=sign, colours=[hexadecimal(colour)])
