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
# Pixels that a plane patch grows by at most: twice what a second difference of smoothed depths loses of it.
GROWTH = 6
# The share of a patch's pixels that are as near to one plane as a surface is smooth, if it is plane.
PLANE = 0.9


def smooth_patches(depth: NDArray[np.float32]) -> NDArray[np.int16]:
    """The patch (h, w) that each pixel of `depth` (h, w), metres, 0 where nothing was measured, lies on: 1, 2, ..., and
    0 where the surface steps, bends or was not measured, or the patch is small."""
    measured = depth > 0
    # pixels average over their neighbours first: a third of the noise, and steps stay
    depth_or_one = np.where(measured, depth, 1.0)
    sums = ndimage.uniform_filter(np.where(measured, 1.0 / depth_or_one, 0.0), 3)
    inverse = np.where(measured, sums / np.maximum(ndimage.uniform_filter(measured.astype(float), 3), 1e-3), np.nan)
    limit = BEND + BEND_GROWTH * depth
    # where anything is not measured the comparison is False
    smooth = (np.abs(_second_difference(inverse)) * depth**2 < limit) & (
        np.abs(_second_difference(inverse.T).T) * depth**2 < limit
    )
    labels, count = ndimage.label(smooth)
    large = np.bincount(labels.ravel(), minlength=count + 1) >= FEWEST
    large[0] = False
    patches: NDArray[np.int16] = np.where(large, np.cumsum(large), 0).astype(np.int16)[labels]
    inverse, limit = np.where(measured, 1.0 / depth_or_one, np.nan), limit / depth_or_one**2
    return _grown(_parted(patches, inverse, limit), inverse, limit)


def _parted(patches: NDArray[np.int16], inverse: Array, limit: Array) -> NDArray[np.int16]:
    """Patches (h, w) that are not plane cut where they hang together by less than three pixels: a door stands a few
    centimetres before its wall, and of a step as low as that noise hides a pixel here and there.

    Each pixel goes to the nearest of the pieces that are left without the patch's outermost pixels, where there are
    several of FEWEST at least. inverse, limit : (h, w), as `_grown` has them
    """
    parted = patches.copy()
    count = int(patches.max(initial=0))
    for number, box in enumerate(ndimage.find_objects(patches) if patches.size else (), start=1):
        own = patches[box] == number
        if _is_plane(own, _off_plane(own, inverse[box], limit[box])):
            continue
        cores, pieces = ndimage.label(ndimage.binary_erosion(own, np.ones((3, 3))))
        sizes = np.bincount(cores.ravel(), minlength=pieces + 1)
        kept = np.flatnonzero(sizes[1:] >= FEWEST) + 1
        if len(kept) < 2:
            continue
        numbers = np.zeros(pieces + 1, dtype=np.int16)
        numbers[kept] = [number, *range(count + 1, count + len(kept))]
        count += len(kept) - 1
        nearest = ndimage.distance_transform_edt(numbers[cores] == 0, return_distances=False, return_indices=True)
        parted[box][own] = numbers[cores][tuple(nearest)][own]
    return parted


def _is_plane(own: NDArray[np.bool_], off: Array) -> bool:
    """Whether a patch's `own` pixels (h, w) are near to their plane, which they are `off` (h, w), in limits."""
    return bool(np.mean(off[own] < 1.0) >= PLANE)


def _off_plane(own: NDArray[np.bool_], inverse: Array, limit: Array) -> Array:
    """How far `inverse` depths (h, w) are off the plane of a patch's `own` (h, w) pixels, in limits."""
    off: Array = np.abs(inverse - plane_through(own, inverse)) / limit
    return off


def plane_through(own: NDArray[np.bool_], inverse: Array) -> Array:
    """Inverse depths (h, w) of the plane through those of `own` (h, w) pixels, by least squares."""
    rows, columns = np.nonzero(own)
    middle, values = (rows.mean(), columns.mean()), inverse[own]
    about = np.stack([rows - middle[0], columns - middle[1]])
    # normal equations about the middle; einsum adds in one order whatever the number of threads
    squares, products = np.einsum("ip,jp->ij", about, about), np.einsum("ip,p->i", about, values - values.mean())
    down, across = np.linalg.lstsq(squares, products, rcond=None)[0]
    plane: Array = values.mean() + down * (np.arange(own.shape[0]) - middle[0])[:, None]
    return plane + across * (np.arange(own.shape[1]) - middle[1])


def _grown(patches: NDArray[np.int16], inverse: Array, limit: Array) -> NDArray[np.int16]:
    """Patches (h, w) up to where their planes end: a second difference is not told near a step, so that a table's rim
    would be no table.

    Plane patches take the pixels of no patch, up to GROWTH away, whose `inverse` depth (h, w) is within `limit` (h, w)
    of their plane's; of several the nearest plane's.
    """
    grown, nearest = patches.copy(), np.where(patches > 0, 0.0, np.inf)
    for number, box in enumerate(ndimage.find_objects(patches) if patches.size else (), start=1):
        # no pixel farther away is asked
        near = tuple(slice(max(side.start - GROWTH, 0), side.stop + GROWTH) for side in box)
        own, free = patches[near] == number, patches[near] == 0
        off = _off_plane(own, inverse[near], limit[near])
        if not _is_plane(own, off):
            continue
        reached = ndimage.binary_dilation(own, iterations=GROWTH, mask=own | (free & (off < 1.0)))
        taken = reached & (off < nearest[near])
        grown[near][taken], nearest[near][taken] = number, off[taken]
    return grown


def _second_difference(values: Array) -> Array:
    """Along the first axis, REACH pixels to either side; not a number nearer to its ends."""
    found = np.full(values.shape, np.nan)
    found[REACH:-REACH] = values[2 * REACH :] - 2.0 * values[REACH:-REACH] + values[: -2 * REACH]
    return found


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
