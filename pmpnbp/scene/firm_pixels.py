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
    measured = depth > 0
    inverse = np.divide(1.0, depth, out=np.full(depth.shape, np.nan), where=measured)
    height, width = depth.shape
    firm: NDArray[np.bool_] = measured.copy()
    for down, across in OPPOSITE:
        rows, columns = slice(down, height - down), slice(abs(across), width - abs(across))
        here = inverse[rows, columns]
        one = inverse[2 * down :, abs(across) + across : width - abs(across) + across]
        other = inverse[: height - 2 * down, abs(across) - across : width - abs(across) - across]
        # where a neighbour was not measured the comparison is False
        firm[rows, columns] &= np.abs(2.0 * here - one - other) < STEP * here
    return firm
