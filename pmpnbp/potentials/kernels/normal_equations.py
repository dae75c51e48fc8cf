"""How do the depth residuals of many whole objects change with small moves? Normal equations of articulated
registration, from differences of renders."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import get_num_threads, prange
from numpy.typing import NDArray

from pmpnbp.potentials.kernels.compiling import inner, kernel
from pmpnbp.potentials.kernels.continuation import patch_room, weigh_patches
from pmpnbp.potentials.kernels.pixel_scores import CATEGORY_BITS, depth_of, pixel_reward, score_terms
from pmpnbp.potentials.kernels.rasteriser import draw_object, scratch

_ZERO, _ONE = np.float32(0), np.float32(1)


@inner(error_model="numpy")
def _compared(room: Any, box: Any, stride: int, image: Any, terms: Any, patch_counts: Any, pixels: Any) -> int:
    """List the pixels of what is drawn that can be explained, and return how many: their places in the image and parts
    (2, …), and depths, residuals and weights (3, …), into `pixels`."""
    packed, _, _, patches, patch_count = image
    weights = patch_counts[2]
    places, lengths = pixels
    weighed = patch_count > 1 and terms[4] < _ONE
    if weighed:
        weigh_patches(room[5], stride, box, packed, patches, terms, patch_counts)
    left, right, top, bottom = box
    count = 0
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            place = (row - top) * stride + column - left
            w = room[5][place]
            if w > _ZERO:
                word = packed[row + 1, column + 1]
                reward = pixel_reward(word & CATEGORY_BITS, terms[3], _ONE)
                if weighed:
                    reward *= weights[patches[row + 1, column + 1]]
                if reward > _ZERO:
                    depth = 1.0 / w
                    reward *= np.float32((depth / terms[5]) ** 2)
                    places[0, count], places[1, count] = row * (packed.shape[1] - 2) + column, room[6][place]
                    lengths[0, count], lengths[1, count] = depth, depth_of(word) - depth
                    lengths[2, count] = reward
                    count += 1
    return count


@inner(error_model="numpy")
def _moved_parts(before: Any, after: Any, moved: Any) -> None:
    """Which of the parts are elsewhere at poses (N, 7) or maps (N, 12) `after` than `before`."""
    for node in range(len(before)):
        moved[node] = False
        for k in range(before.shape[1]):
            moved[node] |= after[node, k] != before[node, k]


@inner(error_model="numpy")
def _slopes(
    room: Any,
    box: Any,
    stride: int,
    width: int,
    moved: Any,
    pixels: Any,
    count: int,
    probe: float,
    steepest: float,
    out: Any,
    sloping: Any,
) -> int:
    """Change of each listed pixel's depth per unit of one parameter, from the render of the parts that a move by
    `probe` moved; 0 where another part comes into view, or another surface of the same, `steepest` metres away. Lists
    in `sloping` the pixels where it is not 0, and returns how many."""
    left, right, top, bottom = box
    places, lengths = pixels
    found = 0
    for k in range(count):
        out[k] = 0.0
        if not moved[places[1, k]]:
            continue
        row, column = places[0, k] // width, places[0, k] % width
        if top <= row <= bottom and left <= column <= right:
            place = (row - top) * stride + column - left
            w = room[5][place]
            if w > _ZERO and room[6][place] == places[1, k]:
                change = 1.0 / w - lengths[0, k]
                if change != 0.0 and abs(change) < steepest:
                    out[k] = change / probe
                    sloping[found] = k
                    found += 1
    return found


@kernel(error_model="numpy")
def _add_range(
    start: int,
    step: int,
    image: Any,
    mesh: Any,
    poses: Any,
    probes: Any,
    terms: Any,
    gates: Any,
    steepest: float,
    information: Any,
    gradient: Any,
) -> None:
    packed, lens, pose_camera_world, _, patch_count = image
    height, width = packed.shape[0] - 2, packed.shape[1] - 2
    view = (lens, pose_camera_world, width, height)
    room = scratch(mesh, width, height)
    terms32 = score_terms(terms, terms[4])
    patch_counts = patch_room(patch_count, width)
    pixels = (np.empty((2, height * width), dtype=np.int32), np.empty((3, height * width)))
    size = probes.shape[1]
    slopes = np.empty((size, height * width))
    # a joint moves few parts, and has a slope in their pixels only
    moved = np.empty(poses.shape[2], dtype=np.bool_)
    sloping, many = np.empty((size, height * width), dtype=np.int32), np.empty(size, dtype=np.int64)
    for h in range(start, len(poses), step):
        box, stride = draw_object(poses[h, 0], view, mesh, room, room[6], None)
        count = _compared(room, box, stride, image, terms32, patch_counts, pixels)
        for k in range(size):
            _moved_parts(poses[h, 0], poses[h, 1 + k], moved)
            box, stride = draw_object(poses[h, 1 + k], view, mesh, room, room[6], moved)
            many[k] = _slopes(
                room, box, stride, width, moved, pixels, count, probes[h, k], steepest, slopes[k], sloping[k]
            )
        residuals, rewards = pixels[1][1], pixels[1][2]
        for gate in range(len(gates)):
            used = np.empty(count)
            for pixel in range(count):
                used[pixel] = rewards[pixel] if abs(residuals[pixel]) < gates[gate] else 0.0
            for i in range(size):
                for n in range(many[i]):
                    pixel = sloping[i, n]
                    gradient[h, gate, i] += used[pixel] * slopes[i, pixel] * residuals[pixel]
                for j in range(i + 1):
                    fewer = i if many[i] < many[j] else j
                    total = 0.0
                    for n in range(many[fewer]):
                        pixel = sloping[fewer, n]
                        total += used[pixel] * slopes[i, pixel] * slopes[j, pixel]
                    information[h, gate, i, j] += total
                    if j < i:
                        information[h, gate, j, i] += total


@kernel(error_model="numpy", parallel=True)
def _add_parallel(
    blocks: int,
    image: Any,
    mesh: Any,
    poses: Any,
    probes: Any,
    terms: Any,
    gates: Any,
    steepest: float,
    information: Any,
    gradient: Any,
) -> None:
    for block in prange(blocks):
        _add_range(np.int64(block), blocks, image, mesh, poses, probes, terms, gates, steepest, information, gradient)


def add_normal_equations(
    image: Any,
    mesh: Any,
    poses: NDArray[np.float64],
    probes: NDArray[np.float64],
    terms: NDArray[np.float32],
    gates: NDArray[np.float64],
    steepest: float,
    information: NDArray[np.float64],
    gradient: NDArray[np.float64],
) -> None:
    """Add one view's part of the normal equations of H objects in P parameters, for each of G gates.

    image, mesh, terms : as `rasterised_scores.add_object_scores` takes them
    poses : (H, 1 + P, N, 7), the object where it is, then with each parameter moved by its probe; probes : (H, P)
    gates : (G,) metres: pixels take part whose residual is smaller; steepest : metres that a depth changes by at most
    information : (H, G, P, P) gets the sum over pixels of weight times slope by slope, gradient : (H, G, P) of weight
        times slope times residual; a pixel's weight is the most that it can add to the object's score
    """
    if len(poses) == 1 or get_num_threads() == 1:
        _add_range(0, 1, image, mesh, poses, probes, terms, gates, steepest, information, gradient)
    else:
        blocks = min(len(poses), 4 * get_num_threads())
        _add_parallel(blocks, image, mesh, poses, probes, terms, gates, steepest, information, gradient)
