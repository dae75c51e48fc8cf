"""Which measurements hold for all of their pixel? Beside a step in the depth a pixel sees one surface or the other, and
the object's outline, off by part of a pixel, makes it see through what is there. Amid a smooth surface it does not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# What a pixel differs by from the middle of two opposite neighbours up to which the three are on one surface: a share
# of its depth.
STEP = 0.01
# Rows and columns to one of each two opposite neighbours.
OPPOSITE = ((0, 1), (1, 0), (1, 1), (1, -1))


def firm_pixels(depth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Which pixels of `depth` (h, w), metres, 0 where nothing was measured, are firm: with none of the four
    pairs of opposite neighbours does inverse depth, linear on planes, step, bend or lack. Pairs that reach beyond the
    picture say nothing."""
    firm, (height, width) = depth > 0, depth.shape
    inverse = np.divide(1.0, depth, out=np.full(depth.shape, np.inf), where=firm)
    padded = np.pad(inverse, 1, constant_values=np.nan)
    with np.errstate(invalid="ignore"):
        for down, across in OPPOSITE:
            one = padded[1 + down :, 1 + across :][:height, :width]
            other = padded[1 - down :, 1 - across :][:height, :width]
            # beyond the picture the comparison is False, and infinite where a neighbour was not measured it is True
            firm &= ~(np.abs(2.0 * inverse - one - other) >= STEP * inverse)
    return firm
