"""What one covered pixel is worth, and the image form in which the kernels look it up.

A pixel's depth and category are read together for every covered pixel of every hypothesis, so they are packed in one
32-bit word: the depth's float32 bits with the category in the three lowest. That costs depth a relative 8e-7, a
micrometre at a metre; the sign says that the pixel is firm (`scene/firm_pixels.py`). The packed image has a border of
one pixel without depth, so that what falls outside the image can be looked up like any other pixel and scores nothing.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmpnbp.potentials.kernels.compiling import inner, kernel

# The categories of `scene/observation.py`; a test holds the two lists together.
NO_DEPTH, OBJECT, SUPPORT, OUTSIDE, CONTINUED = 0, 1, 2, 3, 4

# Pixels in a vector register: rows of buffers are read and written in multiples of it.
LANES = 8

_ZERO, _ONE = np.float32(0), np.float32(1)
CATEGORY_BITS, DEPTH_BITS, FIRM_BIT = np.int32(7), np.int32(2**31 - 1), np.int32(-(2**31))


@kernel
def pack_view(depth: NDArray[np.float32], category: NDArray[np.uint8]) -> NDArray[np.int32]:
    """Depth (h, w) in metres and category (h, w) as one image (h + 2, w + 2) with a border without depth; no pixel is
    firm."""
    height, width = depth.shape
    # the rasteriser reads whole vectors of a row, the last of which may reach beyond it
    room = np.zeros((height + 2) * (width + 2) + LANES, dtype=np.int32)
    packed = room[: (height + 2) * (width + 2)].reshape(height + 2, width + 2)
    bits = depth.view(np.int32)
    for row in range(height):
        for column in range(width):
            kind = np.int32(category[row, column])
            if kind != NO_DEPTH:
                packed[row + 1, column + 1] = (bits[row, column] & ~CATEGORY_BITS) | kind
    return packed


@kernel
def pack_patches(patches: NDArray[np.int16]) -> NDArray[np.int16]:
    """Numbers of patches (h, w) with the border of `pack_view`, of patch 0."""
    height, width = patches.shape
    room = np.zeros((height + 2) * (width + 2) + LANES, dtype=np.int16)
    packed = room[: (height + 2) * (width + 2)].reshape(height + 2, width + 2)
    for row in range(height):
        for column in range(width):
            packed[row + 1, column + 1] = patches[row, column]
    return packed


@inner
def depth_of(word: Any) -> Any:
    """The depth that a word holds, metres, float32."""
    return np.int32(word & DEPTH_BITS).view(np.float32)


@inner
def pixel_reward(category: Any, support_reward: Any, continued_reward: Any) -> Any:
    """The most that a covered pixel of a category can earn, float32."""
    beside = support_reward if category == SUPPORT else (continued_reward if category == CONTINUED else _ZERO)
    return _ONE if category == OBJECT else beside


@inner
def score_terms(terms: Any, continued_reward: Any) -> Any:
    """The terms that `robust_pixel` takes, from an array, with another continued reward: of the whole object a surface
    counts by whether it goes on beyond the outline, known there and not pixel by pixel."""
    costs = terms[0], terms[1], terms[2], terms[3]
    return (*costs, continued_reward, terms[5], terms[6], terms[7], terms[8], terms[9])


@kernel(fastmath={"nsz", "contract"})
def robust_pixel(word: Any, rendered: Any, terms: Any) -> Any:
    """Score of a covered pixel whose packed observation is `word` and whose rendered depth is `rendered`, float32.

    terms : those of `PixelScore.terms`, float32
    A pixel counts by what it covers of a surface that faces it: 1 at the unit distance. Where it is explained that is
    what was measured: by the rendered depth all the object would be worth more the farther off it is.
    """
    tolerance, free_space_cost, occlusion_cost, support_reward, continued_reward = terms[:5]
    unit_distance, firm_cost, firm_step, from_on, edge_weight = terms[5:]
    category = word & CATEGORY_BITS
    observed = depth_of(word)
    difference = observed - rendered
    ratio = difference / tolerance
    square = ratio * ratio
    explained = square < _ONE
    reward = pixel_reward(category, support_reward, continued_reward)
    firm = word < 0
    farther = difference / max(tolerance, firm_step * observed)
    through = free_space_cost * (min(max(farther * farther - _ONE, _ONE), firm_cost) if firm else _ONE)
    behind = through if square >= from_on else _ZERO
    beyond = behind if difference > _ZERO else (through if category == SUPPORT else occlusion_cost)
    score = (reward * (_ONE - square) if explained else -beyond) * (_ONE if firm else edge_weight)
    nearness = (observed if explained else rendered) / unit_distance
    return score * nearness * nearness if category != NO_DEPTH else _ZERO


@kernel(fastmath={"nsz", "contract"})
def distance_pixel(word: Any, rendered: Any, ray_length: Any) -> Any:
    """Minus the distance in metres between observed and rendered point of a covered pixel (eq. 10), float32."""
    category = word & CATEGORY_BITS
    distance = abs(depth_of(word) - rendered) * ray_length
    return _ZERO if (category == NO_DEPTH) | (category == OUTSIDE) else -distance
