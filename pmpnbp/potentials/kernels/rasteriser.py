"""Depth images of part poses, drawn triangle by triangle into a z-buffer no larger than what is drawn.

A pixel is covered where the ray through its centre meets a triangle, edges included, from either side. Triangles are
drawn by rows: the ends of a row's span are computed from each edge's two vertices in an order that does not depend on
the triangle, so neighbours agree on them to the bit and leave no crack. The buffer holds 1/z, which is affine in the
image; a zero is a pixel where nothing was drawn. Only what is nearer than `NEAR` is cut off.

A mesh whose surface is closed hides its own inner side, so triangles seen from behind are left out where the caller
says so (`one_sided`), but for a camera that may be inside.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import get_num_threads, njit, prange
from numpy.typing import NDArray

from pmpnbp.potentials.kernels.pixel_scores import distance_pixel, robust_pixel
from pmpnbp.potentials.kernels.projection import pose_in_camera, single

# The near plane, metres.
NEAR = 0.01

# Buffer rows are drawn in blocks of this many pixels, one vector register, and padded to a multiple of it.
LANES = 8

_ZERO, _ONE, _FAR = np.float32(0), np.float32(1), np.float32(1e9)
_NEAR = np.float32(NEAR)
# Added to a column, it takes a bound out of the image on the side where it does not bound.
_BEYOND = 1e12


@njit(nogil=True, cache=True, error_model="numpy")
def _edge(u0: float, v0: float, u1: float, v1: float, right_way: bool) -> Any:
    """The line u = v * slope + shift through an edge, and what to add to u so that it bounds a span's begin or end.

    Every term only changes its sign where the vertices are swapped, so both neighbours of an edge get the same line
    to the bit. A horizontal edge bounds no span: the triangle's rows end there.
    """
    rise = v1 - v0
    flat = rise == 0.0
    inverse = 1.0 / (1.0 if flat else rise)
    end = (rise > 0.0) == right_way
    slope = 0.0 if flat else (u1 - u0) * inverse
    shift = 0.0 if flat else (u0 * v1 - u1 * v0) * inverse
    return slope, shift, (-_BEYOND if flat or end else 0.0), (_BEYOND if flat or not end else 0.0)


@njit(nogil=True, cache=True, error_model="numpy")
def scan_triangle(
    buffer: NDArray[np.float32],
    owner: Any,
    number: int,
    stride: int,
    width: int,
    height: int,
    u0: float,
    v0: float,
    w0: float,
    u1: float,
    v1: float,
    w1: float,
    u2: float,
    v2: float,
    w2: float,
) -> None:
    """Draw one triangle: vertices u v in pixels of the buffer, w affine in the image, the larger w in front.

    buffer : (height * stride,), rows of `stride` values of which `width` are the image
    owner : as buffer, int16, set to `number` where the triangle is in front; or None
    """
    top = max(np.ceil(min(v0, v1, v2)), 0.0)
    bottom = min(np.floor(max(v0, v1, v2)), height - 1.0)
    leftmost = max(np.ceil(min(u0, u1, u2)), 0.0)
    rightmost = min(np.floor(max(u0, u1, u2)), width - 1.0)
    if top > bottom or leftmost > rightmost:
        return
    determinant = (u1 - u0) * (v2 - v0) - (u2 - u0) * (v1 - v0)
    if determinant == 0.0:
        return
    along_u = ((w1 - w0) * (v2 - v0) - (w2 - w0) * (v1 - v0)) / determinant
    along_v = ((u1 - u0) * (w2 - w0) - (u2 - u0) * (w1 - w0)) / determinant
    at_origin = w0 - along_u * u0 - along_v * v0
    right_way = determinant > 0.0
    slope_a, shift_a, low_a, high_a = _edge(u0, v0, u1, v1, right_way)
    slope_b, shift_b, low_b, high_b = _edge(u1, v1, u2, v2, right_way)
    slope_c, shift_c, low_c, high_c = _edge(u2, v2, u0, v0, right_way)
    step, left, columns = np.float32(along_u), int(leftmost), int(rightmost) - int(leftmost) + 1
    for row in range(int(top), int(bottom) + 1):
        y = float(row)
        a, b, c = y * slope_a + shift_a, y * slope_b + shift_b, y * slope_c + shift_c
        first = max(max(a + low_a, b + low_b), max(c + low_c, leftmost))
        last = min(min(a + high_a, b + high_b), min(c + high_c, rightmost))
        value = np.float32(at_origin + along_v * y + along_u * first)
        _fill_span(
            buffer, owner, number, row * stride + left, columns, np.float32(first - leftmost),
            np.float32(last - leftmost), value, step,
        )  # fmt: skip


@njit(nogil=True, cache=True, error_model="numpy")
def _fill_span(
    buffer: Any, owner: Any, number: int, begin: int, columns: int, first: Any, last: Any, value: Any, step: Any
) -> None:
    """Draw a row's span, from `first` to `first + length` of the `columns` from `begin` on.

    All of the triangle's columns are visited in every row, in whole vectors, and those outside the span are written
    with what they held: a loop over the span alone has a length that changes by the row, and costs more in
    mispredicted branches and scalar remainders than it saves.
    """
    start = np.uint64(begin)
    for k in range(np.int32((columns + LANES - 1) & -LANES)):
        place = start + np.uint64(k)
        column = np.float32(k)
        w, held = value + step * (column - first), buffer[place]
        front = (column >= first) & (column <= last) & (w > held)
        if owner is not None:
            owner[place] = number if front else owner[place]
        buffer[place] = w if front else held


@njit(nogil=True, cache=True, error_model="numpy")
def _scan_clipped(
    buffer: Any, owner: Any, number: int, stride: int, width: int, height: int, lens: Any, left: float, top: float,
    corners: Any, clipped: Any,
) -> None:  # fmt: skip
    """As scan_triangle, for corners (3, 3) in camera coordinates of which some lie before the near plane."""
    count = 0
    for k in range(3):
        a, b = corners[k], corners[(k + 1) % 3]
        if a[2] >= NEAR:
            clipped[count] = a
            count += 1
        if (a[2] >= NEAR) != (b[2] >= NEAR):
            # from the far end to the near one, whichever triangle asks
            far, near = (a, b) if a[2] >= NEAR else (b, a)
            share = (far[2] - NEAR) / (far[2] - near[2])
            for axis in range(2):
                clipped[count, axis] = far[axis] + share * (near[axis] - far[axis])
            clipped[count, 2] = NEAR
            count += 1
    for k in range(count):
        w = 1.0 / clipped[k, 2]
        clipped[k, 0] = clipped[k, 0] * w * lens[0] + lens[2] - left
        clipped[k, 1] = clipped[k, 1] * w * lens[1] + lens[3] - top
        clipped[k, 2] = w
    for k in range(1, count - 1):
        scan_triangle(
            buffer, owner, number, stride, width, height,
            clipped[0, 0], clipped[0, 1], clipped[0, 2],
            clipped[k, 0], clipped[k, 1], clipped[k, 2],
            clipped[k + 1, 0], clipped[k + 1, 1], clipped[k + 1, 2],
        )  # fmt: skip


@njit(nogil=True, cache=True, error_model="numpy", fastmath={"nnan", "nsz", "contract"})
def project(vertices: Any, begin: int, end: int, m: Any, lens: Any, size: Any, us: Any, vs: Any, ws: Any) -> Any:
    """Project vertices[:, begin:end] into us, vs (pixels) and ws (1/z).

    Returns the first and last column and row of the image of `size` (width, height) whose centres the projections
    enclose, the last before the first where there is none; and whether a vertex lies before the near plane: then its
    projection means nothing, and all of the image is returned.
    """
    m00, m01, m02, m10, m11, m12, m20, m21, m22, tx, ty, tz = single(m)
    fx, fy, cx, cy = np.float32(lens[0]), np.float32(lens[1]), np.float32(lens[2]), np.float32(lens[3])
    xs, ys, zs = vertices[0, begin:end], vertices[1, begin:end], vertices[2, begin:end]
    before = np.int32(0)
    for k in range(end - begin):
        depth = m20 * xs[k] + m21 * ys[k] + m22 * zs[k] + tz
        before |= np.int32(depth < _NEAR)
        ws[k] = _ONE / (depth if depth > _NEAR else _NEAR)
    left, right = _project_axis(xs, ys, zs, m00, m01, m02, tx, fx, cx, ws, us)
    top, bottom = _project_axis(xs, ys, zs, m10, m11, m12, ty, fy, cy, ws, vs)
    width, height = size
    if before:
        return (0, width - 1, 0, height - 1), True
    return (max(int(left), 0), min(int(right), width - 1), max(int(top), 0), min(int(bottom), height - 1)), False


@njit(nogil=True, cache=True, error_model="numpy", fastmath={"nnan", "nsz", "contract"})
def _project_axis(
    xs: Any, ys: Any, zs: Any, mx: Any, my: Any, mz: Any, t: Any, focal: Any, centre: Any, ws: Any, out: Any
) -> Any:
    """One image coordinate of all vertices, and the first and last pixel between the smallest and the largest.

    Written for the compiler's sake: with more arrays written in a loop there are too many pairs that could overlap,
    and the smallest of floats is no sum that it takes apart; either leaves the loop scalar, six times slower.
    """
    first, last = np.int32(2**30), np.int32(-(2**30))
    for k in range(len(xs)):
        value = (mx * xs[k] + my * ys[k] + mz * zs[k] + t) * ws[k] * focal + centre
        out[k] = value
        value = value if value < _FAR else _FAR
        value = value if value > -_FAR else -_FAR
        first, last = min(first, np.int32(np.ceil(value))), max(last, np.int32(np.floor(value)))
    return first, last


@njit(nogil=True, cache=True, error_model="numpy", fastmath={"nnan", "nsz"})
def _choose_faces(
    faces: Any, one_sided: Any, begin: int, end: int, box: Any, us: Any, vs: Any, chosen: Any
) -> int:
    """List in `chosen` the faces begin:end that may cover a pixel of the box, and return how many. Most of a fine
    mesh's faces fall between pixel centres or turn away; all are asked at once, in vectors, before any is drawn."""
    left, right, top, bottom = np.float32(box[0]), np.float32(box[1]), np.float32(box[2]), np.float32(box[3])
    count = 0
    for block in range(begin, end, 32):
        length = min(32, end - block)
        first, second, third = faces[0, block:], faces[1, block:], faces[2, block:]
        closed = one_sided[block:]
        # one bit for each of 32 faces: a sum of bits becomes vectors, while a store might alias what is read
        bits = np.int32(0)
        for f in range(np.int32(length)):
            i, j, k = np.uint32(first[f]), np.uint32(second[f]), np.uint32(third[f])
            u0, u1, u2, v0, v1, v2 = us[i], us[j], us[k], vs[i], vs[j], vs[k]
            # the image's v points down: an outward face turns clockwise in it, and has a negative area here, seen
            # from its front
            behind = (u1 - u0) * (v2 - v0) - (u2 - u0) * (v1 - v0) > _ZERO
            no_column = np.ceil(max(min(u0, min(u1, u2)), left)) > np.floor(min(max(u0, max(u1, u2)), right))
            no_row = np.ceil(max(min(v0, min(v1, v2)), top)) > np.floor(min(max(v0, max(v1, v2)), bottom))
            out = np.int32(no_column) | np.int32(no_row) | (np.int32(behind) & closed[f])
            bits |= np.int32((np.int32(1) - out) << np.int32(f))
        for f in range(length):
            chosen[count] = block + f
            count += (bits >> f) & 1
    return count


@njit(nogil=True, cache=True, error_model="numpy")
def draw_part(
    buffer: Any, owner: Any, number: int, stride: int, box: Any, lens: Any, m: Any, vertices: Any, faces: Any,
    one_sided: Any, vertex_begin: int, face_begin: int, face_end: int, near: bool, us: Any, vs: Any, ws: Any,
    chosen: Any,
) -> None:  # fmt: skip
    """Draw a part's projected triangles into a buffer whose first pixel is the first of `box`; `near` where some of
    it may lie before the near plane."""
    left, right, top, bottom = box
    width, height = right - left + 1, bottom - top + 1
    du, dv = float(left), float(top)
    if not near:
        count = _choose_faces(faces, one_sided, face_begin, face_end, box, us, vs, chosen)
        for n in range(count):
            f = np.uint32(chosen[n])
            i, j, k = np.uint32(faces[0, f]), np.uint32(faces[1, f]), np.uint32(faces[2, f])
            scan_triangle(
                buffer, owner, number, stride, width, height, us[i] - du, vs[i] - dv, float(ws[i]),
                us[j] - du, vs[j] - dv, float(ws[j]), us[k] - du, vs[k] - dv, float(ws[k]),
            )  # fmt: skip
        return
    m00, m01, m02, m10, m11, m12, m20, m21, m22, tx, ty, tz = m
    corners, clipped = np.empty((3, 3)), np.empty((4, 3))
    for f in range(face_begin, face_end):
        for c in range(3):
            k = vertex_begin + faces[c, f]
            x, y, z = float(vertices[0, k]), float(vertices[1, k]), float(vertices[2, k])
            corners[c, 0] = m00 * x + m01 * y + m02 * z + tx
            corners[c, 1] = m10 * x + m11 * y + m12 * z + ty
            corners[c, 2] = m20 * x + m21 * y + m22 * z + tz
        _scan_clipped(buffer, owner, number, stride, width, height, lens, du, dv, corners, clipped)


@njit(nogil=True, cache=True, error_model="numpy", fastmath={"reassoc", "nsz", "contract"})
def _sum_robust(buffer: Any, stride: int, box: Any, packed: Any, terms: Any) -> float:
    left, right, top, bottom = box
    tolerance, free_space_cost, occlusion_cost, support_reward = terms
    total = 0.0
    for row in range(top, bottom + 1):
        drawn = buffer[(row - top) * stride : (row - top) * stride + right - left + 1]
        words = packed[row + 1, left + 1 : right + 2]
        row_total = _ZERO
        for k in range(right - left + 1):
            w = drawn[k]
            depth = _ONE / (w if w > _ZERO else _ONE)
            score = robust_pixel(words[k], depth, tolerance, free_space_cost, occlusion_cost, support_reward)
            row_total += score if w > _ZERO else _ZERO
        total += row_total
    return total


@njit(nogil=True, cache=True, error_model="numpy", fastmath={"reassoc", "nsz", "contract"})
def _sum_distance(buffer: Any, stride: int, box: Any, packed: Any, lens: Any) -> float:
    left, right, top, bottom = box
    total = 0.0
    inverse_fx, first = np.float32(1.0 / lens[0]), np.float32((left - lens[2]) / lens[0])
    for row in range(top, bottom + 1):
        drawn = buffer[(row - top) * stride : (row - top) * stride + right - left + 1]
        words = packed[row + 1, left + 1 : right + 2]
        y = np.float32((row - lens[3]) / lens[1])
        row_total = _ZERO
        for k in range(right - left + 1):
            w = drawn[k]
            x = first + np.float32(k) * inverse_fx
            score = distance_pixel(words[k], _ONE / (w if w > _ZERO else _ONE), np.sqrt(x * x + y * y + _ONE))
            row_total += score if w > _ZERO else _ZERO
        total += row_total
    return total


@njit(nogil=True, cache=True, error_model="numpy")
def _add_part_scores(
    start: int, stop: int, step: int, packed: Any, lens: Any, pose_camera_world: Any, mesh: Any, part: Any, poses: Any,
    terms: Any, robust: bool, out: Any,
) -> None:  # fmt: skip
    vertices, faces, one_sided, vertex_offsets, face_offsets = mesh
    height, width = packed.shape[0] - 2, packed.shape[1] - 2
    most = 1
    for node in range(len(vertex_offsets) - 1):
        most = max(most, vertex_offsets[node + 1] - vertex_offsets[node])
    us, vs, ws = np.empty(most, dtype=np.float32), np.empty(most, dtype=np.float32), np.empty(most, dtype=np.float32)
    chosen = np.empty(faces.shape[1] + 1, dtype=np.int32)
    buffer = np.empty(height * (width + LANES) + LANES, dtype=np.float32)
    terms32 = (terms[0], terms[1], terms[2], terms[3])
    for i in range(start, stop, step):
        node = part[i]
        begin, end = vertex_offsets[node], vertex_offsets[node + 1]
        if begin == end:
            continue
        m = pose_in_camera(pose_camera_world, poses[i])
        box, near = project(vertices, begin, end, m, lens, (width, height), us, vs, ws)
        left, right, top, bottom = box
        if left > right or top > bottom:
            continue
        stride = (right - left + LANES) // LANES * LANES
        buffer[: (bottom - top + 1) * stride] = _ZERO
        draw_part(
            buffer, None, 0, stride, box, lens, m, vertices, faces, one_sided, begin,
            face_offsets[node], face_offsets[node + 1], near, us, vs, ws, chosen,
        )  # fmt: skip
        if robust:
            out[i] += _sum_robust(buffer, stride, box, packed, terms32)
        else:
            out[i] += _sum_distance(buffer, stride, box, packed, lens)


@njit(nogil=True, cache=True, error_model="numpy")
def _add_part_scores_serial(packed, lens, pose_camera_world, mesh, part, poses, terms, robust, out):  # type: ignore[no-untyped-def]
    _add_part_scores(0, len(part), 1, packed, lens, pose_camera_world, mesh, part, poses, terms, robust, out)


@njit(nogil=True, cache=True, error_model="numpy", parallel=True)
def _add_part_scores_parallel(packed, lens, pose_camera_world, mesh, part, poses, terms, robust, out, blocks):  # type: ignore[no-untyped-def]  # noqa: E501
    for b in prange(blocks):
        _add_part_scores(b, len(part), blocks, packed, lens, pose_camera_world, mesh, part, poses, terms, robust, out)


@njit(nogil=True, cache=True, error_model="numpy")
def _object_room(mesh: Any, width: int, height: int) -> Any:
    """Scratch memory of `_draw_object`."""
    vertices, faces, parts = mesh[0].shape[1], mesh[1].shape[1], len(mesh[3]) - 1
    return (
        np.empty(vertices, dtype=np.float32),
        np.empty(vertices, dtype=np.float32),
        np.empty(vertices, dtype=np.float32),
        np.empty((parts, 5), dtype=np.int64),
        np.empty(faces + 1, dtype=np.int32),
        np.empty(height * (width + LANES) + LANES, dtype=np.float32),
        np.empty(height * (width + LANES) + LANES, dtype=np.int16),
    )


@njit(nogil=True, cache=True, error_model="numpy")
def _draw_object(
    poses: Any, only: int, lens: Any, pose_camera_world: Any, mesh: Any, width: int, height: int, room: Any
) -> Any:
    """Draw all parts (or part `only`) into one buffer; return the box it covers and the buffer's stride."""
    us, vs, ws, boxes, chosen, buffer, owner = room
    vertices, faces, one_sided, vertex_offsets, face_offsets = mesh
    left, right, top, bottom = width, -1, height, -1
    parts = len(vertex_offsets) - 1
    for node in range(parts):
        begin, end = vertex_offsets[node], vertex_offsets[node + 1]
        boxes[node, 1] = -1
        boxes[node, 0] = 0
        if begin == end or (only >= 0 and node != only):
            continue
        m = pose_in_camera(pose_camera_world, poses[node])
        box, near = project(vertices, begin, end, m, lens, (width, height), us[begin:], vs[begin:], ws[begin:])
        boxes[node, 0], boxes[node, 1], boxes[node, 2], boxes[node, 3] = box
        boxes[node, 4] = 1 if near else 0
        if box[0] <= box[1] and box[2] <= box[3]:
            left, right = min(left, box[0]), max(right, box[1])
            top, bottom = min(top, box[2]), max(bottom, box[3])
    if left > right:
        return (0, -1, 0, -1), LANES
    whole = (left, right, top, bottom)
    stride = (right - left + LANES) // LANES * LANES
    buffer[: (bottom - top + 1) * stride] = _ZERO
    for node in range(parts):
        if boxes[node, 0] > boxes[node, 1] or boxes[node, 2] > boxes[node, 3]:
            continue
        begin = vertex_offsets[node]
        m = pose_in_camera(pose_camera_world, poses[node])
        draw_part(
            buffer, owner, node, stride, whole, lens, m, vertices, faces, one_sided, begin,
            face_offsets[node], face_offsets[node + 1], boxes[node, 4] == 1, us[begin:], vs[begin:], ws[begin:],
            chosen,
        )  # fmt: skip
    return whole, stride


@njit(nogil=True, cache=True, error_model="numpy")
def _add_object_scores(
    start: int, stop: int, step: int, packed: Any, lens: Any, pose_camera_world: Any, mesh: Any, poses: Any,
    terms: Any, robust: bool, out: Any,
) -> None:  # fmt: skip
    height, width = packed.shape[0] - 2, packed.shape[1] - 2
    room = _object_room(mesh, width, height)
    buffer, owner = room[5], room[6]
    tolerance, free_space_cost, occlusion_cost, support_reward = terms[0], terms[1], terms[2], terms[3]
    for i in range(start, stop, step):
        box, stride = _draw_object(
            poses[i], -1, lens, pose_camera_world, mesh, width, height, room
        )
        left, right, top, bottom = box
        for row in range(top, bottom + 1):
            y = (row - lens[3]) / lens[1]
            for column in range(left, right + 1):
                place = np.uint64((row - top) * stride + column - left)
                w = buffer[place]
                if w > _ZERO:
                    word = packed[row + 1, column + 1]
                    if robust:
                        score = robust_pixel(
                            word, _ONE / w, tolerance, free_space_cost, occlusion_cost, support_reward
                        )
                    else:
                        x = (column - lens[2]) / lens[0]
                        score = distance_pixel(word, _ONE / w, np.float32(np.sqrt(x * x + y * y + 1.0)))
                    out[i, owner[place]] += score


@njit(nogil=True, cache=True, error_model="numpy", parallel=True)
def _add_object_scores_parallel(packed, lens, pose_camera_world, mesh, poses, terms, robust, out, blocks):  # type: ignore[no-untyped-def]  # noqa: E501
    for b in prange(blocks):
        _add_object_scores(b, len(poses), blocks, packed, lens, pose_camera_world, mesh, poses, terms, robust, out)


@njit(nogil=True, cache=True, error_model="numpy")
def _draw(poses, only, lens, pose_camera_world, mesh, width, height):  # type: ignore[no-untyped-def]
    room = _object_room(mesh, width, height)
    buffer, owner = room[5], room[6]
    box, stride = _draw_object(
        poses, only, lens, pose_camera_world, mesh, width, height, room
    )
    depth = np.zeros((height, width), dtype=np.float32)
    number = np.full((height, width), -1, dtype=np.int16)
    left, right, top, bottom = box
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            place = (row - top) * stride + column - left
            if buffer[place] > _ZERO:
                depth[row, column] = _ONE / buffer[place]
                number[row, column] = owner[place]
    return depth, number


# Below this many poses a parallel launch costs more than it saves.
PARALLEL_FROM = 32


def add_part_scores(packed, lens, pose_camera_world, mesh, part, poses, terms, robust, out):  # type: ignore[no-untyped-def]
    """Add to `out` (B,) the score of each part pose, drawn alone, in one view. Arguments as `splatting.add_scores`;
    mesh : what `Surfaces.mesh` holds."""
    if len(part) < PARALLEL_FROM or get_num_threads() == 1:
        _add_part_scores_serial(packed, lens, pose_camera_world, mesh, part, poses, terms, robust, out)
    else:
        blocks = min(len(part), 4 * get_num_threads())
        _add_part_scores_parallel(packed, lens, pose_camera_world, mesh, part, poses, terms, robust, out, blocks)


def add_object_scores(packed, lens, pose_camera_world, mesh, poses, terms, robust, out):  # type: ignore[no-untyped-def]
    """Add to `out` (B, N) each part's share of the score of whole objects, poses (B, N, 7), in one view."""
    blocks = max(1, min(len(poses), 4 * get_num_threads()))
    _add_object_scores_parallel(packed, lens, pose_camera_world, mesh, poses, terms, robust, out, blocks)


def draw(poses, only, lens, pose_camera_world, mesh, width, height):  # type: ignore[no-untyped-def]
    """Depth (height, width) float32, 0 where nothing is, and part number int16, -1 where nothing is, of parts at
    poses (N, 7), or of part `only` alone where that is not negative."""
    return _draw(poses, only, lens, pose_camera_world, mesh, width, height)
