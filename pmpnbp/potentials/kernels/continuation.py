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
# Pixels whose coverage is held in one word.
BITS = 32

_ZERO, _ONE = np.float32(0), np.float32(1)


@inner
def _count_across(drawn: Any, scan: Any, place: Any, spot: Any, ends: Any, counts: Any) -> None:
    """Count what a line along a row or column meets where it leaves the object: AHEAD pixels back and as many on.

    drawn : buffer; scan : packed image and patches, flat, and tolerance; place, spot : of the last covered pixel in
    buffer and image, and the way to the next one; ends : how many pixels there are back to the end of the buffer, on to
    that, and on to the end of the image, where nothing is counted if there are none; counts : explained and beyond
    """
    words, numbers, tolerance = scan
    explained, beyond = counts
    back, inside, on = ends
    if on == 0:
        return
    # most of a line lies on one patch, whose count stays in a register
    at, pixel, patch, count = place[0], spot[0], np.int64(0), np.int32(0)
    for _ in range(min(back, AHEAD)):
        w = drawn[at]
        if not w > _ZERO:
            break
        number = np.int64(numbers[pixel])
        if number != patch:
            explained[patch] += count
            patch, count = number, np.int32(0)
        count += np.int32(abs(abs(words[pixel]) * w - _ONE) < tolerance * w)
        at -= place[1]
        pixel -= spot[1]
    explained[patch] += count
    at, pixel, patch, count = place[0] + place[1], spot[0] + spot[1], np.int64(0), np.int32(0)
    for k in range(min(on, AHEAD)):
        if k < inside and drawn[at] > _ZERO:
            break
        number = np.int64(numbers[pixel])
        if number != patch:
            beyond[patch] += count
            patch, count = number, np.int32(0)
        count += np.int32(1)
        at += place[1]
        pixel += spot[1]
    beyond[patch] += count


@inner
def patch_room(count: int, width: int) -> Any:
    """Memory for `weigh_patches`, for one thread, patches 0 to count - 1 and images of a width: int32 twice to count
    in, float32 weights, all 1, and which pixels of a row are covered, a bit each."""
    counts = np.empty((2, count), dtype=np.int32)
    return counts[0], counts[1], np.ones(count, dtype=np.float32), np.empty(width // BITS + 1, dtype=np.uint32)


@inner(fastmath={"nnan", "nsz"})
def _covered(values: Any, count: Any) -> Any:
    """Which of the first `count` values, at most BITS, are drawn: a bit each. A sum of bits becomes vectors."""
    bits: Any = np.int32(0)
    for k in range(np.int32(count)):
        bits |= np.int32(np.int32(values[k] > _ZERO) << np.int32(k))
    return np.uint32(bits)


@inner
def _lowest(bits: Any) -> Any:
    """Number of the lowest bit that is set: the exponent of a float that holds it alone."""
    alone = np.uint32(bits & (~bits + np.uint32(1)))
    return (np.int64(np.float32(alone).view(np.int32)) >> 23) - 127


@inner
def weigh_patches(buffer: Any, stride: int, box: Any, packed: Any, patches: Any, terms: Any, room: Any) -> None:
    """Fill the weights of `room`: the share of its reward that each patch is left with.

    buffer, stride, box : what is drawn, as from `rasteriser.draw_object`; packed, patches : of the image, as from
    `pack_view` and `pack_patches`; terms : as `robust_pixel` has them; room : what `patch_room` returned
    """
    explained, beyond, weights, above = room
    left, right, top, bottom = box
    wide, one, forth, back = packed.shape[1], np.uint32(1), np.int64(1), np.int64(-1)
    last_row, last_column = packed.shape[0] - 3, wide - 3
    scan, counts = (packed.ravel().view(np.float32), patches.ravel(), terms[0]), (explained, beyond)
    explained[:], beyond[:], above[:] = 0, 0, 0
    for row in range(top, bottom + 2):
        before = np.uint32(0)
        # the last block holds a column beyond the box at least, where every row of the object has ended
        for block in range((right - left + 1) // BITS + 1):
            here, first = np.uint32(0), block * BITS
            if row <= bottom:
                here = _covered(buffer[(row - top) * stride + first :], min(BITS, max(stride - first, 0)))
            along, down = here ^ np.uint32((here << one) | before), here ^ above[block]
            before, above[block] = np.uint32(here >> np.uint32(BITS - 1)), here
            place, spot = (row - top) * stride + first, (row + 1) * wide + left + first + 1
            # back from where it begins, on from where it ends
            while along:
                k = _lowest(along)
                column, along = left + first + k, np.uint32(along & (along - one))
                if (here >> np.uint32(k)) & one:
                    ends = (right - column + 1, column - left, column)
                    _count_across(buffer, scan, (place + k, back), (spot + k, back), ends, counts)
                else:
                    ends = (column - left, right - column + 1, last_column - column + 1)
                    _count_across(buffer, scan, (place + k - forth, forth), (spot + k - forth, forth), ends, counts)
            while down:
                k = _lowest(down)
                down = np.uint32(down & (down - one))
                if (here >> np.uint32(k)) & one:
                    ends = (bottom - row + 1, row - top, row)
                    _count_across(buffer, scan, (place + k, -stride), (spot + k, -wide), ends, counts)
                else:
                    ends = (row - top, bottom - row + 1, last_row - row + 1)
                    _count_across(buffer, scan, (place + k - stride, stride), (spot + k - wide, wide), ends, counts)
    weights[0] = _ONE
    for number in range(1, len(weights)):
        share = beyond[number] / max(explained[number] + beyond[number], 1)
        going_on = min(max((share - ENDS) / (GOES_ON - ENDS), 0.0), 1.0)
        weights[number] = np.float32(1.0 - going_on * (1.0 - terms[4]))
