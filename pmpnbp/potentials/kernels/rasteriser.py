"""Depth images of parts at given poses, in a z-buffer no larger than what is drawn.

Both sides of a triangle are drawn, but where a mesh is closed its inner side is hidden by its outer one, and triangles
of it that turn away (`one_sided`) are left out. A camera inside such a mesh sees it from within: then some of it lies
before the near plane, and all of it is drawn.

A mesh is the tuple (vertices (3, V) float32 in the parts' frames, faces (3, F) int32 counted from the part's first
vertex, one_sided (F,) int32, vertex_offsets (N + 1,), face_offsets (N + 1,)), all parts one after the other.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmpnbp.potentials.kernels.compiling import inner, kernel
from pmpnbp.potentials.kernels.pixel_scores import LANES
from pmpnbp.potentials.kernels.projection import placed_in_camera, project
from pmpnbp.potentials.kernels.triangles import SINGLE, row_stride, scan_clipped, scan_triangle

_ZERO, _ONE = np.float32(0), np.float32(1)


@inner
def scratch(mesh: Any, width: int, height: int) -> Any:
    """Memory to draw into, for one thread: the vertices' u, v and w; chosen faces; each part's box; the z-buffer and
    each pixel's face."""
    vertices, faces, parts = mesh[0].shape[1], mesh[1].shape[1], len(mesh[3]) - 1
    pixels = height * row_stride(width)
    return (
        np.empty(vertices, dtype=np.float32),
        np.empty(vertices, dtype=np.float32),
        np.empty(vertices, dtype=np.float32),
        np.empty(faces + 1, dtype=np.int32),
        np.empty((parts, 5), dtype=np.int64),
        np.empty(pixels, dtype=np.float32),
        np.empty(pixels, dtype=np.int32),
    )


@inner
def _rows(table: Any, begin: int, end: int) -> Any:
    """Columns begin to end of a table (3, …) as three arrays: a slice of all rows at once is not contiguous to the
    compiler, which then makes no vectors."""
    return table[0, begin:end], table[1, begin:end], table[2, begin:end]


@inner(fastmath={"nnan", "nsz"})
def _choose_faces(faces: Any, one_sided: Any, box: Any, us: Any, vs: Any, chosen: Any) -> int:
    """List in `chosen` the faces that may cover a pixel of the box, and return how many. Most of a fine mesh's faces
    fall between pixel centres or turn away; all are asked at once, in vectors, before any is drawn."""
    left, right, top, bottom = np.float32(box[0]), np.float32(box[1]), np.float32(box[2]), np.float32(box[3])
    count: Any = 0
    faces_left = len(faces[0])
    for block in range(0, len(faces[0]), 32):
        first, second, third, closed = faces[0][block:], faces[1][block:], faces[2][block:], one_sided[block:]
        # one bit for each of 32 faces: a sum of bits becomes vectors, while a store might alias what is read
        bits: Any = np.int32(0)
        for f in range(np.int32(min(32, faces_left))):
            i, j, k = np.uint32(first[f]), np.uint32(second[f]), np.uint32(third[f])
            u0, u1, u2, v0, v1, v2 = us[i], us[j], us[k], vs[i], vs[j], vs[k]
            # the image's v points down: an outward face has a negative area in it, seen from its front
            behind = (u1 - u0) * (v2 - v0) - (u2 - u0) * (v1 - v0) > _ZERO
            no_column = np.ceil(max(min(u0, min(u1, u2)), left)) > np.floor(min(max(u0, max(u1, u2)), right))
            no_row = np.ceil(max(min(v0, min(v1, v2)), top)) > np.floor(min(max(v0, max(v1, v2)), bottom))
            out = np.int32(no_column) | np.int32(no_row) | (np.int32(behind) & closed[f])
            bits |= np.int32((np.int32(1) - out) << np.int32(f))
        here, rest = np.int32(block), np.uint32(bits)
        for _ in range(min(32, faces_left)):
            chosen[np.uint64(count)] = here
            count += np.int64(rest & np.uint32(1))
            here, rest = np.int32(here + np.int32(1)), np.uint32(rest >> np.uint32(1))
        faces_left -= 32
    return count


@inner
def _draw_projected(target: Any, box: Any, vertices: Any, faces: Any, one_sided: Any, chosen: Any) -> None:
    """Draw a part's triangles into a buffer whose first pixel is the first of `box`. target : as of `scan_triangle`,
    with the number of the part's first face; vertices : us, vs, ws; faces : three arrays, as from `_rows`."""
    us, vs, ws = vertices
    buffer, owner, first, stride, width, height = target
    left, top = np.float32(box[0]), np.float32(box[2])
    for n in range(_choose_faces(faces, one_sided, box, us, vs, chosen)):
        f = np.uint32(chosen[n])
        i, j, k = np.uint32(faces[0][f]), np.uint32(faces[1][f]), np.uint32(faces[2][f])
        a = (us[i] - left, vs[i] - top, ws[i])
        b = (us[j] - left, vs[j] - top, ws[j])
        c = (us[k] - left, vs[k] - top, ws[k])
        scan_triangle((buffer, owner, first + np.int64(f), stride, width, height), a, b, c, SINGLE)


@inner
def _draw_near(target: Any, box: Any, lens: Any, m: Any, vertices: Any, faces: Any) -> None:
    """As _draw_projected, from the vertices xs, ys, zs at pose m of a part that is partly before the near plane."""
    m00, m01, m02, m10, m11, m12, m20, m21, m22, tx, ty, tz = m
    xs, ys, zs = vertices
    buffer, owner, first, stride, width, height = target
    corners, clipped = np.empty((3, 3)), np.empty((4, 3))
    for f in range(len(faces[0])):
        for corner in range(3):
            k = faces[corner][f]
            x, y, z = float(xs[k]), float(ys[k]), float(zs[k])
            corners[corner, 0] = m00 * x + m01 * y + m02 * z + tx
            corners[corner, 1] = m10 * x + m11 * y + m12 * z + ty
            corners[corner, 2] = m20 * x + m21 * y + m22 * z + tz
        numbered = (buffer, owner, first + np.int64(f), stride, width, height)
        scan_clipped(numbered, lens, float(box[0]), float(box[2]), corners, clipped)


@inner
def draw_part(node: int, pose: Any, view: Any, mesh: Any, room: Any) -> Any:
    """Draw one part alone into the z-buffer of `room`.

    view : (lens, pose_camera_world, width, height); room : what `scratch` returned
    Returns the box (left, right, top, bottom), last columns and rows included, of which the buffer holds the pixels,
    and the length of its rows; an empty box has right < left or bottom < top.
    """
    vertices, faces, one_sided, vertex_offsets, face_offsets = mesh
    us, vs, ws, chosen, _, buffer, _ = room
    lens, pose_camera_world, width, height = view
    own_vertices = _rows(vertices, vertex_offsets[node], vertex_offsets[node + 1])
    own_faces = _rows(faces, face_offsets[node], face_offsets[node + 1])
    if len(own_vertices[0]) == 0:
        return (0, -1, 0, -1), LANES
    m = placed_in_camera(pose_camera_world, pose)
    box, near = project(own_vertices, m, lens, width, height, us, vs, ws)
    left, right, top, bottom = box
    if left > right or top > bottom:
        return (0, -1, 0, -1), LANES
    stride = row_stride(right - left + 1)
    buffer[: (bottom - top + 1) * stride] = _ZERO
    target = (buffer, None, np.int64(0), stride, right - left + 1, bottom - top + 1)
    if near:
        _draw_near(target, box, lens, m, own_vertices, own_faces)
    else:
        _draw_projected(target, box, (us, vs, ws), own_faces, one_sided[face_offsets[node] :], chosen)
    return box, stride


@inner
def draw_object(poses: Any, view: Any, mesh: Any, room: Any, owner: Any) -> Any:
    """As `draw_part`, all parts at poses (N, 7) into one z-buffer. owner : that of `room`, to have the number of the
    face that each pixel shows beside it, see `part_of`, or None"""
    vertices, faces, one_sided, vertex_offsets, face_offsets = mesh
    us, vs, ws, chosen, boxes, buffer, _ = room
    lens, pose_camera_world, width, height = view
    left, right, top, bottom = width, np.int64(-1), height, np.int64(-1)
    for node in range(len(poses)):
        begin, end = vertex_offsets[node], vertex_offsets[node + 1]
        boxes[node, 0], boxes[node, 1] = 0, -1
        if begin == end:
            continue
        m = placed_in_camera(pose_camera_world, poses[node])
        box, near = project(_rows(vertices, begin, end), m, lens, width, height, us[begin:], vs[begin:], ws[begin:])
        if box[0] <= box[1] and box[2] <= box[3]:
            boxes[node, 0], boxes[node, 1], boxes[node, 2], boxes[node, 3] = box
            boxes[node, 4] = near
            left, right, top, bottom = min(left, box[0]), max(right, box[1]), min(top, box[2]), max(bottom, box[3])
    if left > right:
        return (0, -1, 0, -1), LANES
    whole = (left, right, top, bottom)
    stride = row_stride(right - left + 1)
    buffer[: (bottom - top + 1) * stride] = _ZERO
    for node in range(len(poses)):
        if boxes[node, 0] > boxes[node, 1]:
            continue
        begin, end = vertex_offsets[node], vertex_offsets[node + 1]
        own_faces = _rows(faces, face_offsets[node], face_offsets[node + 1])
        target = (buffer, owner, np.int64(face_offsets[node]), stride, right - left + 1, bottom - top + 1)
        if boxes[node, 4]:
            m = placed_in_camera(pose_camera_world, poses[node])
            _draw_near(target, whole, lens, m, _rows(vertices, begin, end), own_faces)
        else:
            projected = (us[begin:], vs[begin:], ws[begin:])
            _draw_projected(target, whole, projected, own_faces, one_sided[face_offsets[node] :], chosen)
    return whole, stride


@inner
def part_of(face: int, face_offsets: Any) -> Any:
    """Which part a face is of, by its number among those of all parts."""
    return np.searchsorted(face_offsets, face, side="right") - 1


@inner
def _depth_image(box: Any, stride: int, buffer: Any, width: int, height: int) -> Any:
    depth = np.zeros((height, width), dtype=np.float32)
    left, right, top, bottom = box
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            w = buffer[(row - top) * stride + column - left]
            if w > _ZERO:
                depth[row, column] = _ONE / w
    return depth


@kernel
def part_depth(node: int, pose: NDArray[np.float64], view: Any, mesh: Any) -> NDArray[np.float32]:
    """Depth (height, width) float32, metres, 0 where nothing is, of one part alone at pose (7,).

    view : (lens fx fy cx cy, pose_camera_world (7,), width, height)
    """
    room = scratch(mesh, view[2], view[3])
    box, stride = draw_part(node, pose, view, mesh, room)
    return _depth_image(box, stride, room[5], view[2], view[3])


@kernel
def object_depth(poses: NDArray[np.float64], view: Any, mesh: Any) -> Any:
    """As `part_depth` for all parts at poses (N, 7), and the part number (height, width) int16, -1 where nothing is."""
    width, height = view[2], view[3]
    room = scratch(mesh, width, height)
    box, stride = draw_object(poses, view, mesh, room, room[6])
    depth = _depth_image(box, stride, room[5], width, height)
    number = np.full((height, width), -1, dtype=np.int16)
    left, right, top, bottom = box
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            if depth[row, column] > _ZERO:
                number[row, column] = part_of(room[6][(row - top) * stride + column - left], mesh[4])
    return depth, number
