"""Does a surface go on where the object ends? Counts along the rendered outline, and what they leave of the reward.

What confirms a pose is a surface that ends where the object does. Of every smooth patch of the scan (see
`scene/patches.py`) the pixels are counted that the object explains, and those of it beyond the object's outline, up to
AHEAD pixels on along rows and columns. A patch of which much lies beyond is as well explained without the object.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

# Pixels beyond the outline that are looked at.
AHEAD = 8
# Of a patch's counted pixels the share beyond up to which its reward is whole, and from which on it is the least.
ENDS, GOES_ON = 0.1, 0.2

_ZERO, _ONE = np.float32(0), np.float32(1)


@njit(nogil=True, cache=True, error_model="numpy")
def _count_line(
    buffer: Any, first: int, step: int, length: int, word: int, patch: int, across: Any, room: Any, view: Any
) -> None:
    """One row or column of the buffer, from index `first` in steps of `step` over `length` pixels; `word` and `patch`
    are the indices of its first pixel in the image and in the patches, which go on in steps of `across[0]` and
    `across[1]`; there are room[0] pixels of the image before it, room[1] behind it."""
    image, patches, tolerance, explained, beyond = view
    before: Any = False
    for k in range(length + 1):
        w = buffer[first + k * step] if k < length else _ZERO
        covered = w > _ZERO
        if covered:
            number = patches[patch + k * across[1]]
            if number > 0:
                difference = np.int32(image[word + k * across[0]]).view(np.float32) - _ONE / w
                if abs(difference) < tolerance:
                    explained[number] += 1
        if covered != before:
            # backwards from where it begins, onwards from where it ends, up to where it is covered again
            way = -1 if covered else 1
            place = k - 1 if covered else k
            for _ in range(AHEAD):
                if place < -room[0] or place >= length + room[1]:
                    break
                if 0 <= place < length and buffer[first + place * step] > _ZERO:
                    break
                number = patches[patch + place * across[1]]
                if number > 0:
                    beyond[number] += 1
                place += way
        before = covered


@njit(nogil=True, cache=True, error_model="numpy")
def weigh_patches(
    buffer: Any, stride: int, box: Any, packed: Any, patches: Any, terms: Any, explained: Any, beyond: Any, weights: Any
) -> None:
    """Fill `weights` (K + 1,), float32: the share of its reward that each patch 0 to K is left with.

    buffer, stride, box : what is drawn, as from `rasteriser.draw_object`; packed : the image, as from `pack_view`
    patches : (h, w); terms : as `robust_pixel` has them; explained, beyond : (K + 1,) int32, to count in
    """
    left, right, top, bottom = box
    height, width = patches.shape
    explained[:], beyond[:] = 0, 0
    view = (packed.ravel(), patches.ravel(), terms[0], explained, beyond)
    across, down = right - left + 1, bottom - top + 1
    for row in range(down):
        _count_line(
            buffer,
            row * stride,
            1,
            across,
            (top + row + 1) * (width + 2) + left + 1,
            (top + row) * width + left,
            (1, 1),
            (left, width - 1 - right),
            view,
        )
    for column in range(across):
        _count_line(
            buffer,
            column,
            stride,
            down,
            (top + 1) * (width + 2) + left + column + 1,
            top * width + left + column,
            (width + 2, width),
            (top, height - 1 - bottom),
            view,
        )
    least = terms[4]
    weights[0] = _ONE
    for number in range(1, len(weights)):
        share = beyond[number] / max(explained[number] + beyond[number], 1)
        going_on = min(max((share - ENDS) / (GOES_ON - ENDS), 0.0), 1.0)
        weights[number] = np.float32(1.0 - going_on * (1.0 - least))
