"""The unary potential of many part poses by splats: each part's visible surface as a few hundred points per view
direction, projected and looked up in the depth image without a z-buffer.

A part's points were sampled uniformly over its projected area, seen along one of a grid of directions; in the image
each stands for the same share of that area. The direction is chosen per pose, from the camera to the part's centre.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from pmpnbp.potentials.kernels.pixel_scores import distance_pixel, robust_pixel
from pmpnbp.potentials.kernels.projection import pose_in_camera, single

# Points nearer than this to the camera's plane are not seen; sensors of this kind measure nothing there.
NEAREST = np.float32(0.05)

_ZERO, _ONE = np.float32(0), np.float32(1)


@njit(nogil=True, cache=True, error_model="numpy")
def direction_cell(x: float, y: float, z: float, size: int) -> int:
    """Index of the cell of the octahedral grid (size * size cells) that the direction x y z falls into."""
    scale = abs(x) + abs(y) + abs(z)
    u, v = x / scale, y / scale
    if z < 0.0:
        u, v = (1.0 - abs(v)) * (1.0 if u >= 0 else -1.0), (1.0 - abs(u)) * (1.0 if v >= 0 else -1.0)
    column = min(int((u + 1.0) * 0.5 * size), size - 1)
    row = min(int((v + 1.0) * 0.5 * size), size - 1)
    return row * size + column


@njit(nogil=True, cache=True, error_model="numpy", fastmath={"reassoc", "nsz", "contract"})
def _sum_robust(
    xs: Any, ys: Any, zs: Any, m: Any, lens: Any, image: Any, columns: Any, rows: Any, terms: Any, points: int
) -> Any:
    m00, m01, m02, m10, m11, m12, m20, m21, m22, tx, ty, tz = m
    fx, fy, cx, cy = lens
    tolerance, free_space_cost, occlusion_cost, support_reward = terms
    last_column, last_row = columns - _ONE, rows - _ONE
    total = _ZERO
    for k in range(points):
        x, y, z = xs[k], ys[k], zs[k]
        depth = m20 * x + m21 * y + m22 * z + tz
        seen = depth > NEAREST
        inverse = _ONE / (depth if seen else _ONE)
        column = np.floor((m00 * x + m01 * y + m02 * z + tx) * inverse * fx + cx)
        row = np.floor((m10 * x + m11 * y + m12 * z + ty) * inverse * fy + cy)
        column = min(max(column, _ZERO), last_column)
        row = min(max(row, _ZERO), last_row)
        # a float holds every index of an image below 16 million pixels
        word = image[np.uint32(np.int32(row * columns + column))]
        score = robust_pixel(word, depth, tolerance, free_space_cost, occlusion_cost, support_reward)
        total += score * inverse * inverse if seen else _ZERO
    return total


@njit(nogil=True, cache=True, error_model="numpy", fastmath={"reassoc", "nsz", "contract"})
def _sum_distance(
    xs: Any, ys: Any, zs: Any, m: Any, lens: Any, image: Any, columns: Any, rows: Any, points: int
) -> Any:
    m00, m01, m02, m10, m11, m12, m20, m21, m22, tx, ty, tz = m
    fx, fy, cx, cy = lens
    last_column, last_row = columns - _ONE, rows - _ONE
    total = _ZERO
    for k in range(points):
        x, y, z = xs[k], ys[k], zs[k]
        depth = m20 * x + m21 * y + m22 * z + tz
        seen = depth > NEAREST
        inverse = _ONE / (depth if seen else _ONE)
        ray_x = (m00 * x + m01 * y + m02 * z + tx) * inverse
        ray_y = (m10 * x + m11 * y + m12 * z + ty) * inverse
        column = min(max(np.floor(ray_x * fx + cx), _ZERO), last_column)
        row = min(max(np.floor(ray_y * fy + cy), _ZERO), last_row)
        word = image[np.uint32(np.int32(row * columns + column))]
        score = distance_pixel(word, depth, np.sqrt(ray_x * ray_x + ray_y * ray_y + _ONE))
        total += score * inverse * inverse if seen else _ZERO
    return total


@njit(nogil=True, cache=True, error_model="numpy")
def _add_scores(
    start: int,
    stop: int,
    packed: NDArray[np.int32],
    lens: NDArray[np.float64],
    pose_camera_world: NDArray[np.float64],
    points: NDArray[np.float32],
    areas: NDArray[np.float32],
    centres: NDArray[np.float64],
    part: NDArray[np.int32],
    poses: NDArray[np.float64],
    terms: NDArray[np.float32],
    robust: bool,
    used: int,
    out: NDArray[np.float64],
) -> None:
    rows, columns = np.float32(packed.shape[0]), np.float32(packed.shape[1])
    image = packed.ravel()
    size = int(round(np.sqrt(areas.shape[1])))
    # half a pixel to round by floor, one for the packed image's border
    lens32 = (np.float32(lens[0]), np.float32(lens[1]), np.float32(lens[2] + 1.5), np.float32(lens[3] + 1.5))
    terms32 = (terms[0], terms[1], terms[2], terms[3])
    for i in range(start, stop):
        node = part[i]
        if areas[node, 0] == 0.0:
            continue
        m = pose_in_camera(pose_camera_world, poses[i])
        c0, c1, c2 = centres[node, 0], centres[node, 1], centres[node, 2]
        x = m[0] * c0 + m[1] * c1 + m[2] * c2 + m[9]
        y = m[3] * c0 + m[4] * c1 + m[5] * c2 + m[10]
        z = m[6] * c0 + m[7] * c1 + m[8] * c2 + m[11]
        cell = direction_cell(
            m[0] * x + m[3] * y + m[6] * z, m[1] * x + m[4] * y + m[7] * z, m[2] * x + m[5] * y + m[8] * z, size
        )
        m32 = single(m)
        xs, ys, zs = points[node, cell, 0], points[node, cell, 1], points[node, cell, 2]
        if robust:
            total = _sum_robust(xs, ys, zs, m32, lens32, image, columns, rows, terms32, used)
        else:
            total = _sum_distance(xs, ys, zs, m32, lens32, image, columns, rows, used)
        out[i] += float(total) * areas[node, cell] * lens[0] * lens[1] / used


@njit(nogil=True, cache=True, error_model="numpy")
def _add_scores_serial(packed, lens, pose_camera_world, points, areas, centres, part, poses, terms, robust, used, out):  # type: ignore[no-untyped-def]  # noqa: E501
    _add_scores(
        0, len(part), packed, lens, pose_camera_world, points, areas, centres, part, poses, terms, robust, used, out
    )


@njit(nogil=True, cache=True, error_model="numpy", parallel=True)
def _add_scores_parallel(
    packed, lens, pose_camera_world, points, areas, centres, part, poses, terms, robust, used, out, block
):  # type: ignore[no-untyped-def]
    blocks = (len(part) + block - 1) // block
    for b in prange(blocks):
        _add_scores(
            b * block,
            min(len(part), (b + 1) * block),
            packed,
            lens,
            pose_camera_world,
            points,
            areas,
            centres,
            part,
            poses,
            terms,
            robust,
            used,
            out,
        )


# Below this many poses a parallel launch costs more than it saves.
PARALLEL_FROM = 1000
BLOCK = 128


def add_scores(
    packed: NDArray[np.int32],
    lens: NDArray[np.float64],
    pose_camera_world: NDArray[np.float64],
    points: NDArray[np.float32],
    areas: NDArray[np.float32],
    centres: NDArray[np.float64],
    part: NDArray[np.int32],
    poses: NDArray[np.float64],
    terms: NDArray[np.float32],
    robust: bool,
    used: int,
    out: NDArray[np.float64],
) -> None:
    """Add to `out` (B,) the score of each part pose in one view, in pixels (robust) or metre pixels (distance).

    packed : (h + 2, w + 2), see `pack_view`; lens : fx fy cx cy; pose_camera_world : (7,)
    points : (N, D, 3, P), metres in the part's frame; areas : (N, D), m²; centres : (N, 3)
    part : (B,) int32; poses : (B, 7), part in world; used : how many of the P points are used, the first ones
    terms : tolerance, free space cost, occlusion cost, support reward
    """
    arguments = (packed, lens, pose_camera_world, points, areas, centres, part, poses, terms, robust, used, out)
    if len(part) < PARALLEL_FROM:
        _add_scores_serial(*arguments)
    else:
        _add_scores_parallel(*arguments, BLOCK)
