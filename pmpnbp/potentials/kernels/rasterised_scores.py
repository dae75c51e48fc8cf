"""The unary potential of many part poses, or whole objects, by the rasteriser: every covered pixel is scored."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import get_num_threads, prange
from numpy.typing import NDArray

from pmpnbp.potentials.kernels.compiling import borrowed, inner, kernel
from pmpnbp.potentials.kernels.continuation import patch_room, weigh_patches
from pmpnbp.potentials.kernels.pixel_scores import distance_pixel, robust_pixel, score_terms
from pmpnbp.potentials.kernels.rasteriser import draw_object, draw_part, scratch

# Below this many poses a parallel launch costs more than it saves.
PARALLEL_FROM = 16

_ZERO, _ONE = np.float32(0), np.float32(1)


@inner(fastmath={"reassoc", "nsz", "contract"})
def _sum_robust(buffer: Any, stride: int, box: Any, packed: Any, terms: Any) -> float:
    """Sum over the buffer's pixels. Rows are read to the end of their stride, where nothing is drawn: whole vectors."""
    left, _, top, bottom = box
    image, width = packed.ravel(), packed.shape[1]
    total = 0.0
    for row in range(top, bottom + 1):
        drawn, words = buffer[(row - top) * stride :], image[(row + 1) * width + left + 1 :]
        row_total: Any = _ZERO
        for k in range(np.int32(stride)):
            w = drawn[k]
            score = robust_pixel(words[k], _ONE / (w if w > _ZERO else _ONE), terms)
            row_total += score if w > _ZERO else _ZERO
        total += row_total
    return total


@inner(fastmath={"reassoc", "nsz", "contract"})
def _sum_distance(buffer: Any, stride: int, box: Any, packed: Any, lens: Any) -> float:
    left, _, top, bottom = box
    image, width = packed.ravel(), packed.shape[1]
    total = 0.0
    step, first = np.float32(1.0 / lens[0]), np.float32((left - lens[2]) / lens[0])
    for row in range(top, bottom + 1):
        drawn, words = buffer[(row - top) * stride :], image[(row + 1) * width + left + 1 :]
        y = np.float32((row - lens[3]) / lens[1])
        row_total: Any = _ZERO
        for k in range(np.int32(stride)):
            w, x = drawn[k], first + np.float32(k) * step
            score = distance_pixel(words[k], _ONE / (w if w > _ZERO else _ONE), np.sqrt(x * x + y * y + _ONE))
            row_total += score if w > _ZERO else _ZERO
        total += row_total
    return total


@kernel
def _add_part_range(
    start: int, step: int, image: Any, mesh: Any, part: Any, poses: Any, terms: Any, robust: bool, out: Any
) -> None:
    room = scratch(mesh, image[0].shape[1] - 2, image[0].shape[0] - 2)
    _add_parts(start, step, (image, mesh, room), part, poses, terms, robust, out)


@inner
def _add_parts(start: int, step: int, held: Any, part: Any, poses: Any, terms: Any, robust: bool, out: Any) -> None:
    (image, mesh, room), poses = borrowed((held, poses))
    packed, lens, pose_camera_world, _, _ = image
    view = (lens, pose_camera_world, packed.shape[1] - 2, packed.shape[0] - 2)
    terms32 = score_terms(terms, terms[4])
    for i in range(start, len(part), step):
        box, stride = draw_part(np.int64(part[i]), poses[i], view, mesh, room)
        if robust:
            out[i] += _sum_robust(room[5], stride, box, packed, terms32)
        else:
            out[i] += _sum_distance(room[5], stride, box, packed, lens)


@inner(fastmath={"reassoc", "nsz", "contract"})
def _sum_weighed(buffer: Any, stride: int, box: Any, packed: Any, patches: Any, weights: Any, terms: Any) -> float:
    """As `_sum_robust`, of what each patch's weight leaves of its pixels' rewards."""
    left, _, top, bottom = box
    image, numbers, width = packed.ravel(), patches.ravel(), packed.shape[1]
    total = 0.0
    for row in range(top, bottom + 1):
        begin = (row + 1) * width + left + 1
        drawn, words, patch = buffer[(row - top) * stride :], image[begin:], numbers[begin:]
        row_total: Any = _ZERO
        for k in range(np.int32(stride)):
            w = drawn[k]
            score = robust_pixel(words[k], _ONE / (w if w > _ZERO else _ONE), terms)
            # a reward is weighed, a cost stays whole: weights are 1 at most
            kept = min(score, score * weights[np.uint32(patch[k])])
            row_total += kept if w > _ZERO else _ZERO
        total += row_total
    return total


@kernel
def _add_object_range(
    start: int, step: int, image: Any, mesh: Any, poses: Any, terms: Any, robust: bool, out: Any
) -> None:
    width, height = image[0].shape[1] - 2, image[0].shape[0] - 2
    room, patch_counts = scratch(mesh, width, height), patch_room(image[4], width)
    _add_objects(start, step, (image, mesh, room, patch_counts), poses, terms, robust, out)


@inner
def _add_objects(start: int, step: int, held: Any, poses: Any, terms: Any, robust: bool, out: Any) -> None:
    (image, mesh, room, patch_counts), poses, terms = borrowed((held, poses, terms))
    packed, lens, pose_camera_world, patches, count = image
    view = (lens, pose_camera_world, packed.shape[1] - 2, packed.shape[0] - 2)
    for i in range(start, len(poses), step):
        box, stride = draw_object(poses[i], view, mesh, room, None)
        for k in range(len(terms)):
            one = terms[k]
            if robust and count > 1 and one[4] < _ONE:
                weigh_patches(room[5], stride, box, packed, patches, score_terms(one, one[4]), patch_counts)
                weights = patch_counts[2]
                out[i, k] += _sum_weighed(room[5], stride, box, packed, patches, weights, score_terms(one, _ONE))
            elif robust:
                out[i, k] += _sum_robust(room[5], stride, box, packed, score_terms(one, _ONE))
            else:
                out[i, k] += _sum_distance(room[5], stride, box, packed, lens)


@kernel(parallel=True)
def _add_parts_parallel(
    blocks: int, image: Any, mesh: Any, part: Any, poses: Any, terms: Any, robust: bool, out: Any
) -> None:
    for block in prange(blocks):
        _add_part_range(np.int64(block), blocks, image, mesh, part, poses, terms, robust, out)


@kernel(parallel=True)
def _add_objects_parallel(blocks: int, image: Any, mesh: Any, poses: Any, terms: Any, robust: bool, out: Any) -> None:
    for block in prange(blocks):
        _add_object_range(np.int64(block), blocks, image, mesh, poses, terms, robust, out)


def add_part_scores(
    image: Any,
    mesh: Any,
    part: NDArray[np.int32],
    poses: NDArray[np.float64],
    terms: NDArray[np.float32],
    robust: bool,
    out: NDArray[np.float64],
) -> None:
    """Add to `out` (B,) the score of each part pose, drawn alone, in one view, in pixels (robust) or metre pixels.

    image : (packed (h + 2, w + 2), see `pack_view`; lens fx fy cx cy; pose_camera_world (7,); patches (h + 2,
        w + 2), see `pack_patches`; one more than the largest number among them)
    mesh : see `rasteriser`; part : (B,); poses : (B, 7), part in world
    terms : those of `PixelScore.terms`
    """
    if len(part) < PARALLEL_FROM or get_num_threads() == 1:
        _add_part_range(0, 1, image, mesh, part, poses, terms, robust, out)
    else:
        _add_parts_parallel(_blocks(len(part)), image, mesh, part, poses, terms, robust, out)


def add_object_scores(
    image: Any,
    mesh: Any,
    poses: NDArray[np.float64],
    terms: NDArray[np.float32],
    robust: bool,
    out: NDArray[np.float64],
) -> None:
    """As `add_part_scores` for whole objects at poses (B, N, 7), all parts drawn into one z-buffer, and by each of T
    `terms` (T, 10): `out` is (B, T). What goes on beyond the outline counts less, see `continuation`."""
    if len(poses) * len(mesh[3]) < PARALLEL_FROM or get_num_threads() == 1:
        _add_object_range(0, 1, image, mesh, poses, terms, robust, out)
    else:
        _add_objects_parallel(_blocks(len(poses)), image, mesh, poses, terms, robust, out)


def _blocks(count: int) -> int:
    """A few blocks for each thread, so that one with slower poses does not keep the others waiting."""
    return min(count, 4 * get_num_threads())
