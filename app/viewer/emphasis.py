"""What stands out in a view? The selected part is bright and the others are faded; without one all are alike."""

from __future__ import annotations

from collections.abc import Mapping

from app.viewer.stage import Stage
from app.viewer.view_state import Theme, ViewState
from pmpnbp.pictures import palette
from pmpnbp.pictures.palette import DARK_PAPER, PAPER, Colour, rgb

BACKGROUND: Mapping[Theme, Colour] = {"light": rgb(PAPER), "dark": rgb(DARK_PAPER)}
INK: Mapping[Theme, Colour] = {"light": rgb(palette.INK), "dark": rgb("#e8ebef")}
QUIET: Mapping[Theme, Colour] = {"light": rgb("#7b8694"), "dark": rgb("#8b97a6")}

# Of a part that is not selected while another one is: its opacity as a share, and its colour's way to the background.
FADED, PALED = 0.75, 0.6


def faded(stage: Stage, state: ViewState) -> tuple[bool, ...]:
    """Of each part, whether another one is selected; of an edge whose messages are shown both parts stand out."""
    chosen = {state.part} if state.part is not None else set(state.edge or ()) if state.show.messages else set()
    names = [part.name for part in stage.model.parts]
    return tuple(bool(chosen.intersection(names)) and name not in chosen for name in names)


def paled(colour: Colour, theme: Theme, share: float = PALED) -> Colour:
    """The colour on its way to the background."""
    return mixed(colour, BACKGROUND[theme], share)


def mixed(one: Colour, other: Colour, share: float) -> Colour:
    """`share` of the way from one colour to the other."""
    red, green, blue = (round(a + (b - a) * share) for a, b in zip(one, other, strict=True))
    return red, green, blue
