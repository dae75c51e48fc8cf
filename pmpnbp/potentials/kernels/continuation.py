"""Does a surface go on where the object ends? Counts along the rendered outline, and what they leave of the reward.

What confirms a pose is a surface that ends where the object does. Where a row or a column of the image leaves the
object, the pixels of every smooth patch of the scan (see `scene/patches.py`) are counted on both sides of the outline,
up to AHEAD of them: those that the object explains, and those beyond. A patch of which much lies beyond is as well
explained without the object. The counts stay near the outline, so that a large object is asked no less than a small
one; where the image ends with the object nothing is known and nothing counted.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pmpnbp.potentials.kernels.compiling import inner

# Pixels on either side of the outline that are looked at.
AHEAD = 8
# Of a patch's counted pixels the share beyond up to which its reward is whole, and from which on it is the least.
ENDS, GOES_ON = 0.1, 0.2

_ZERO, _ONE = np.float32(0), np.float32(1)


@inner(error_model="numpy")
def _count_across(drawn: Any, scan: Any, row: int, column: int, down: int, across: int, room: Any) -> None:
    """Count what a line along a row or column meets where it leaves the object: AHEAD pixels back and as many on.

    drawn : buffer, stride and box; scan : packed image, patches and tolerance; row, column : the last covered pixel;
    down, across : one step on. Nothing is counted where the image ends with the object.
    """
    buffer, stride, box = drawn
    packed, patches, tolerance = scan
    explained, beyond, _ = room
    left, right, top, bottom = box
    if not (0 <= row + down < patches.shape[0] - 2 and 0 <= column + across < patches.shape[1] - 2):
        return
    y, x = row, column
    for _ in range(AHEAD):
        if not (left <= x <= right and top <= y <= bottom):
            break
        w = buffer[(y - top) * stride + x - left]
        if not w > _ZERO:
            break
        number = patches[y + 1, x + 1]
        if number > 0:
            seen = np.int32(packed[y + 1, x + 1]).view(np.float32)
            explained[number] += abs(seen * w - _ONE) < tolerance * w
        y -= down
        x -= across
    y, x = row + down, column + across
    for _ in range(AHEAD):
        inside = left <= x <= right and top <= y <= bottom
        if inside and buffer[(y - top) * stride + x - left] > _ZERO:
            break
        number = patches[y + 1, x + 1]
        if number > 0:
            beyond[number] += 1
        y += down
        x += across
        if not (0 <= y < patches.shape[0] - 2 and 0 <= x < patches.shape[1] - 2):
            break


@inner(error_model="numpy")
def patch_room(count: int) -> Any:
    """Memory for `weigh_patches`, for one thread and patches 0 to count - 1: int32 twice to count in, and float32
    weights, all 1."""
    return np.empty(count, dtype=np.int32), np.empty(count, dtype=np.int32), np.ones(count, dtype=np.float32)


@inner(error_model="numpy")
def weigh_patches(buffer: Any, stride: int, box: Any, packed: Any, patches: Any, terms: Any, room: Any) -> None:
    """Fill the weights of `room`: the share of its reward that each patch is left with.

    buffer, stride, box : what is drawn, as from `rasteriser.draw_object`; packed, patches : of the image, as from
    `pack_view` and `pack_patches`; terms : as `robust_pixel` has them; room : what `patch_room` returned
    """
    explained, beyond, weights = room
    left, right, top, bottom = box
    drawn, scan = (buffer, stride, box), (packed, patches, terms[0])
    still, on, back = np.int64(0), np.int64(1), np.int64(-1)
    explained[:], beyond[:] = 0, 0
    for row in range(top, bottom + 2):
        before: Any = False
        here, above = (row - top) * stride - left, (row - top - 1) * stride - left
        for column in range(left, right + 2):
            covered = row <= bottom and column <= right and buffer[here + column] > _ZERO
            if covered != before:
                # back from where it begins, on from where it ends
                if covered:
                    _count_across(drawn, scan, row, column, still, back, room)
                else:
                    _count_across(drawn, scan, row, column - 1, still, on, room)
            before = covered
            covered_above = row > top and column <= right and buffer[above + column] > _ZERO
            if covered != covered_above:
                if covered:
                    _count_across(drawn, scan, row, column, back, still, room)
                else:
                    _count_across(drawn, scan, row - 1, column, on, still, room)
    weights[0] = _ONE
    for number in range(1, len(weights)):
        share = beyond[number] / max(explained[number] + beyond[number], 1)
        going_on = min(max((share - ENDS) / (GOES_ON - ENDS), 0.0), 1.0)
        weights[number] = np.float32(1.0 - going_on * (1.0 - terms[4]))
