"""Which surfaces go on? A depth image cut into connected smooth patches.

Where an object ends, the measured depth steps or bends. A table top, a wall or a board goes on past the outline of
whatever is laid onto it, and is as well explained without that. So it matters how far the surface that a pixel lies on
reaches: a patch is a connected piece of the image over which inverse depth, linear on planes, has no second
difference to speak of.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pmpnbp.geometry.poses import Array

# Pixels to either side that a second difference is taken over: steps and bends lie between patches, this wide.
REACH = 2
# A second difference, as depth, up to which a surface is smooth: metres, and metres per metre of depth.
BEND, BEND_GROWTH = 0.004, 0.003
# Pixels of the smallest patch that is told apart.
FEWEST = 30


def smooth_patches(depth: NDArray[np.float32]) -> NDArray[np.int16]:
    """The patch (h, w) that each pixel of `depth` (h, w), metres, 0 where nothing was measured, lies on: 1, 2, ..., and
    0 where the surface steps, bends or was not measured, or the patch is small."""
    measured = depth > 0
    inverse = np.where(measured, 1.0 / np.where(measured, depth, 1.0), np.nan).astype(np.float32)
    limit = BEND + BEND_GROWTH * depth
    smooth = measured.copy()
    for values, result in ((inverse, smooth), (inverse.T, smooth.T)):
        bend = np.full(values.shape, np.nan, dtype=np.float32)
        bend[REACH:-REACH] = values[2 * REACH :] - 2.0 * values[REACH:-REACH] + values[: -2 * REACH]
        square, most = (depth**2, limit) if values is inverse else (depth.T**2, limit.T)
        result &= np.abs(bend) * square < most  # False where anything is not measured
    labels, count = ndimage.label(smooth)
    large = np.bincount(labels.ravel(), minlength=count + 1) >= FEWEST
    large[0] = False
    patches: NDArray[np.int16] = np.where(large, np.cumsum(large), 0).astype(np.int16)[labels]
    return patches


def patch_lengths(patches: NDArray[np.int16], points: NDArray[np.floating]) -> Array:
    """Lengths (K + 1,), metres, of patches 0 to K (0 has none) of `patches` (h, w), whose pixels lie at `points`
    (h, w, 3): see `length`."""
    lengths = np.zeros(int(patches.max(initial=0)) + 1)
    for number in range(1, len(lengths)):
        lengths[number] = length(points[patches == number].astype(np.float64))
    return lengths


def length(points: Array) -> float:
    """Metres from one end of `points` (P, 3), at least one, to the other, along the direction of their greatest
    variance."""
    offset = points - points.mean(axis=0)
    _, axes = np.linalg.eigh(offset.T @ offset)
    return float(np.ptp(offset @ axes[:, -1]))
