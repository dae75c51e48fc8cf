"""The unary potential of many part poses by splats: each part's visible surface as a few hundred points per view
direction, projected and looked up in the depth image without a z-buffer.

A part's points were sampled uniformly over its projected area, seen along one of a grid of directions; in the image
each stands for the same share of that area. The direction is chosen per pose, from the camera to the part's centre.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import get_num_threads, prange
from numpy.typing import NDArray

from pmpnbp.potentials.kernels.compiling import inner, kernel
from pmpnbp.potentials.kernels.pixel_scores import distance_pixel, robust_pixel, score_terms
from pmpnbp.potentials.kernels.projection import map_in_camera, pose_in_camera, single

# Points nearer than this to the camera's plane are not seen; sensors of this kind measure nothing there.
NEAREST = np.float32(0.05)

# Below this many poses a parallel launch costs more than it saves; poses are dealt to the threads in blocks.
PARALLEL_FROM, BLOCK = 256, 64

_ZERO, _ONE, _INDEX_BITS = np.float32(0), np.float32(1), np.int32(0xFFFFFF)


@kernel
def direction_cell(x: float, y: float, z: float, size: int) -> int:
    """Index of the cell of the octahedral grid (size * size cells) that the direction x y z falls into."""
    scale = abs(x) + abs(y) + abs(z)
    if not scale > 0.0:
        return 0
    u, v = x / scale, y / scale
    if z < 0.0:
        u, v = (1.0 - abs(v)) * (1.0 if u >= 0 else -1.0), (1.0 - abs(u)) * (1.0 if v >= 0 else -1.0)
    column = min(int((u + 1.0) * 0.5 * size), size - 1)
    row = min(int((v + 1.0) * 0.5 * size), size - 1)
    return row * size + column


@inner(fastmath={"reassoc", "nsz", "contract"})
def _sum_points(
    points: Any, start: Any, apart: Any, used: int, m: Any, lens: Any, image: Any, size: Any, terms: Any, robust: bool
) -> Any:
    """Sum over the points of the pixel scores, each times 1/z². m, lens, size in float32.

    points : flat, x of the first point at `start`, y and z `apart` and twice `apart` further on, unsigned: a signed
        index would be asked for each point whether it counts from the end
    """
    m00, m01, m02, m10, m11, m12, m20, m21, m22, tx, ty, tz = m
    fx, fy, cx, cy = lens
    columns, rows = size
    last_column, last_row = columns - _ONE, rows - _ONE
    total: Any = _ZERO
    for k in range(used):
        at = start + np.uint64(k)
        x, y, z = points[at], points[at + apart], points[at + apart + apart]
        depth = m20 * x + m21 * y + m22 * z + tz
        seen = depth > NEAREST
        inverse = _ONE / (depth if seen else _ONE)
        ray_x = (m00 * x + m01 * y + m02 * z + tx) * inverse
        ray_y = (m10 * x + m11 * y + m12 * z + ty) * inverse
        column = min(max(np.floor(ray_x * fx + cx), _ZERO), last_column)
        row = min(max(np.floor(ray_y * fy + cy), _ZERO), last_row)
        # a float holds every index of an image below 16 million pixels; by the mask the compiler sees that the sign
        # plays no part, and gathers by 32-bit indices
        word = image[np.uint32(np.int32(row * columns + column) & _INDEX_BITS)]
        if robust:
            score = robust_pixel(word, depth, terms)
        else:
            score = distance_pixel(word, depth, np.sqrt(ray_x * ray_x + ray_y * ray_y + _ONE))
        total += score * inverse * inverse if seen else _ZERO
    return total


@inner
def _seen_along(m: Any, x: float, y: float, z: float) -> Any:
    """A direction in the camera as it is in the part's frame: that which the inverse of `m` maps it to, times the
    determinant. As many times longer it is, as much more a surface seen along it covers once it is mapped."""
    return (
        (m[4] * m[8] - m[5] * m[7]) * x + (m[7] * m[2] - m[8] * m[1]) * y + (m[1] * m[5] - m[2] * m[4]) * z,
        (m[5] * m[6] - m[3] * m[8]) * x + (m[8] * m[0] - m[6] * m[2]) * y + (m[2] * m[3] - m[0] * m[5]) * z,
        (m[3] * m[7] - m[4] * m[6]) * x + (m[6] * m[1] - m[7] * m[0]) * y + (m[0] * m[4] - m[1] * m[3]) * z,
    )


@kernel
def _add_range(
    start: int, stop: int, image: Any, splats: Any, part: Any, poses: Any, terms: Any, robust: bool, used: int, out: Any
) -> None:
    packed, lens, q, _, _ = image
    points, areas, centres = splats
    size = (np.float32(packed.shape[1]), np.float32(packed.shape[0]))
    # in the loop no array is sliced: threads would count the references to it in memory they share
    pixels, flat = packed.ravel(), points.ravel()
    apart, camera = np.uint64(points.shape[3]), (q[0], q[1], q[2], q[3], q[4], q[5], q[6])
    grid = int(round(np.sqrt(areas.shape[1])))
    # half a pixel to round by floor, one for the packed image's border
    lens32 = (np.float32(lens[0]), np.float32(lens[1]), np.float32(lens[2] + 1.5), np.float32(lens[3] + 1.5))
    terms32 = score_terms(terms, terms[4])
    for i in range(start, stop):
        node = part[i]
        pose = poses[i, 0], poses[i, 1], poses[i, 2], poses[i, 3], poses[i, 4], poses[i, 5], poses[i, 6]
        if poses.shape[1] == 7:
            m = pose_in_camera(camera, pose)
        else:
            m = map_in_camera(camera, (*pose, poses[i, 7], poses[i, 8], poses[i, 9], poses[i, 10], poses[i, 11]))
        a, b, c = centres[node, 0], centres[node, 1], centres[node, 2]
        x = m[0] * a + m[1] * b + m[2] * c + m[9]
        y = m[3] * a + m[4] * b + m[5] * c + m[10]
        z = m[6] * a + m[7] * b + m[8] * c + m[11]
        # the ray from the camera to the centre, in the part's frame
        a, b, c = _seen_along(m, x, y, z)
        cell = direction_cell(a, b, c, grid)
        area = areas[node, cell]
        if area > 0.0:
            first = np.uint64(node * areas.shape[1] + cell) * np.uint64(3) * apart
            if robust:
                total = _sum_points(flat, first, apart, used, single(m), lens32, pixels, size, terms32, True)
            else:
                total = _sum_points(flat, first, apart, used, single(m), lens32, pixels, size, terms32, False)
            area *= np.sqrt((a * a + b * b + c * c) / (x * x + y * y + z * z))
            out[i] += float(total) * area * lens[0] * lens[1] / used


@kernel(parallel=True)
def _add_parallel(
    block: int, image: Any, splats: Any, part: Any, poses: Any, terms: Any, robust: bool, used: int, out: Any
) -> None:
    for b in prange((len(part) + block - 1) // block):
        stop = min(len(part), (b + 1) * block)
        _add_range(b * block, stop, image, splats, part, poses, terms, robust, used, out)


def add_scores(
    image: Any,
    splats: Any,
    part: NDArray[np.int32],
    poses: NDArray[np.float64],
    terms: NDArray[np.float32],
    robust: bool,
    used: int,
    out: NDArray[np.float64],
) -> None:
    """Add to `out` (B,) the score of each part pose in one view, in pixels (robust) or metre pixels (distance).

    image : (packed (h + 2, w + 2), see `pack_view`; lens fx fy cx cy; pose_camera_world (7,); patches (h, w))
    splats : (points (N, D, 3, P), metres in the part's frame; areas (N, D), m²; centres (N, 3))
    part : (B,); poses : (B, 7), part in world; used : how many of the P points are used, the first ones
    terms : those of `PixelScore.terms`
    """
    if len(part) < PARALLEL_FROM or get_num_threads() == 1:
        _add_range(0, len(part), image, splats, part, poses, terms, robust, used, out)
    else:
        _add_parallel(BLOCK, image, splats, part, poses, terms, robust, used, out)
