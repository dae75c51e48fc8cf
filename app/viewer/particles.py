"""Which particles of a part are seen, how large and in which colour? As much as they weigh: the larger, the heavier.

viser's points have one size per cloud, so that each part has a cloud for each of three sizes. What weighs nothing is
not drawn, and cannot be clicked.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from app.viewer.emphasis import BACKGROUND, paled
from app.viewer.scene_frame import Bytes, Points, PointShape
from app.viewer.view_state import Theme, ViewState
from pmpnbp.geometry.poses import Array
from pmpnbp.pictures.palette import Colour

# The palest a particle of little weight gets: share of the way to the background.
PALEST = 0.75
# Nats below the heaviest from which on a particle is as pale as can be.
FAINTEST = 12.0
# Nats below the heaviest from which on a particle weighs nothing: a thousand of them weigh less than a hundredth of it.
WEIGHTLESS = FAINTEST
# Nats below the heaviest up to which a particle has a size, and the size, as a share of the heaviest's: of a fifth of
# its weight, of a hundredth, of less.
SIZES = ((1.6, 1.0), (4.6, 0.68), (WEIGHTLESS, 0.44))


def below_heaviest(log_weights: Array) -> Array:
    """(T,) nats, 0 or less; all 0 where nothing has a weight."""
    top = log_weights.max()
    return log_weights - top if np.isfinite(top) else np.zeros(len(log_weights))


def weighs(log_weights: Array) -> NDArray[np.bool_]:
    """(..., T) bool: which particles weigh anything beside their part's heaviest, and are drawn."""
    below: Array = np.apply_along_axis(below_heaviest, -1, log_weights)
    return below >= -WEIGHTLESS


def particles(
    name: str,
    poses: Array,
    log_weights: Array,
    colour: Colour,
    size: float,
    state: ViewState,
    *,
    by_weight: bool,
    faded: bool = False,
    shape: PointShape = "circle",
) -> Iterator[Points]:
    """The particles of one part, or of a message.

    poses : (T, 7); log_weights : (T,); size : metres, of the heaviest; by_weight : paler the less they weigh
    """
    below = below_heaviest(log_weights)
    colour = paled(colour, state.theme) if faded else colour
    shown = _by_weight(colour, below, state.theme)
    lightest = np.inf
    for place, (nats, share) in enumerate(SIZES):
        chosen = (below >= -nats) & (below < lightest)
        lightest = -nats
        # also where there is none: viser's node stays, and is there for the next iteration
        points = poses[chosen, :3].astype(np.float32)
        # viser takes no list of colours for no points
        painted = shown[chosen] if by_weight and chosen.any() else np.array(colour, dtype=np.uint8)
        yield Points(f"{name}/{place}", points, painted, share * size, shape)


def _by_weight(colour: Colour, below: Array, theme: Theme) -> Bytes:
    """(T, 3): the colour for the heaviest particle, the paler the lighter a particle is."""
    # in the log domain: of equal steps of the weight itself only the first few would be seen
    share = np.clip(1 + below / FAINTEST, 0, 1)
    pale = PALEST * (1 - share[:, None])
    shown = (1 - pale) * np.array(colour) + pale * np.array(BACKGROUND[theme])
    return shown.round().astype(np.uint8)
