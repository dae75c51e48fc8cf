"""Does a surface go on where the object ends? Counts along the rendered outline, and what they leave of the reward.

What confirms a pose is a surface that ends where the object does. Of every smooth patch of the scan (see
`scene/patches.py`) the pixels are counted that the object explains, and those of it beyond the object's outline, up to
AHEAD pixels on along rows and columns. A patch of which much lies beyond is as well explained without the object.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

# Pixels beyond the outline that are looked at.
AHEAD = 8
# Of a patch's counted pixels the share beyond up to which its reward is whole, and from which on it is the least.
ENDS, GOES_ON = 0.1, 0.2

_ZERO, _ONE = np.float32(0), np.float32(1)


@njit(nogil=True, cache=True, error_model="numpy", inline="always")
def _count_beyond(
    buffer: Any, stride: int, box: Any, patches: Any, row: int, column: int, down: int, across: int, beyond: Any
) -> None:
    """Count the patches' pixels from one at the outline's far side on, one step down and across at a time, up to where
    the image ends or something is drawn again."""
    left, right, top, bottom = box
    height, width = patches.shape[0] - 2, patches.shape[1] - 2
    for _ in range(AHEAD):
        if row < 0 or row >= height or column < 0 or column >= width:
            break
        inside = left <= column <= right and top <= row <= bottom
        if inside and buffer[(row - top) * stride + column - left] > _ZERO:
            break
        number = patches[row + 1, column + 1]
        if number > 0:
            beyond[number] += 1
        row += down
        column += across


@njit(nogil=True, cache=True, error_model="numpy")
def patch_room(count: int) -> Any:
    """Memory for `weigh_patches`, for one thread and patches 0 to count - 1: int32 twice to count in, and float32
    weights, all 1."""
    return np.empty(count, dtype=np.int32), np.empty(count, dtype=np.int32), np.ones(count, dtype=np.float32)


@njit(nogil=True, cache=True, error_model="numpy")
def weigh_patches(buffer: Any, stride: int, box: Any, packed: Any, patches: Any, terms: Any, room: Any) -> None:
    """Fill the weights of `room`: the share of its reward that each patch is left with.

    buffer, stride, box : what is drawn, as from `rasteriser.draw_object`; packed, patches : of the image, as from
    `pack_view` and `pack_patches`; terms : as `robust_pixel` has them; room : what `patch_room` returned
    """
    explained, beyond, weights = room
    left, right, top, bottom = box
    tolerance, least = terms[0], terms[4]
    explained[:], beyond[:] = 0, 0
    for row in range(top, bottom + 2):
        before: Any = False
        # one patch fills a row for long: what it counts is put down only where another begins
        patch, run = 0, 0
        here, above = (row - top) * stride - left, (row - top - 1) * stride - left
        for column in range(left, right + 2):
            inside = row <= bottom and column <= right
            w = buffer[here + column] if inside else _ZERO
            covered = w > _ZERO
            if covered:
                number = np.int64(patches[row + 1, column + 1])
                if number != patch:
                    explained[patch] += run
                    patch, run = number, 0
                seen = np.int32(packed[row + 1, column + 1]).view(np.float32)
                run += abs(seen * w - _ONE) < tolerance * w
            if covered != before:
                # back from where it begins, on from where it ends
                if covered:
                    _count_beyond(buffer, stride, box, patches, row, column - 1, 0, -1, beyond)
                else:
                    _count_beyond(buffer, stride, box, patches, row, column, 0, 1, beyond)
            before = covered
            covered_above = row > top and column <= right and buffer[above + column] > _ZERO
            if covered != covered_above:
                if covered:
                    _count_beyond(buffer, stride, box, patches, row - 1, column, -1, 0, beyond)
                else:
                    _count_beyond(buffer, stride, box, patches, row, column, 1, 0, beyond)
        explained[patch] += run
    weights[0] = _ONE
    for number in range(1, len(weights)):
        counted = 2 * explained[number] + beyond[number]  # along its row and its column, as what lies beyond
        share = beyond[number] / max(counted, 1)
        going_on = min(max((share - ENDS) / (GOES_ON - ENDS), 0.0), 1.0)
        weights[number] = np.float32(1.0 - going_on * (1.0 - least))
