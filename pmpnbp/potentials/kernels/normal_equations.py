"""How do the depth residuals of many whole objects change with small moves? Normal equations of articulated
registration, from one render of each object.

A pixel shows a point p of a face, whose plane is m · p = 1, both in the camera's frame. Where the face moves so that
its points at p have the velocity v, the pixel's depth z changes by z m · v. A part moves as a linear map, v = E p + e,
which makes this a sum of twelve products of the pixel's, z m by p and 1, with twelve numbers of the part's. So the sums
over pixels are of a face's points, then of a part's faces, and how many parameters there are does not matter to them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import get_num_threads, prange
from numpy.typing import NDArray

from pmpnbp.potentials.kernels.compiling import borrowed, inner, kernel
from pmpnbp.potentials.kernels.continuation import patch_room, weigh_patches
from pmpnbp.potentials.kernels.pixel_scores import CATEGORY_BITS, depth_of, pixel_reward, score_terms
from pmpnbp.potentials.kernels.projection import placed_in_camera
from pmpnbp.potentials.kernels.rasteriser import draw_object, part_of, scratch

_ZERO, _ONE = np.float32(0), np.float32(1)
# Of a pixel: m along x, y and z, each by its point's x, y, z and 1.
FEATURES = 12
# Numbers of the products of two of m's axes, and of two of a point's x, y, z and 1.
_OF_AXES = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
_OF_POINTS = np.array([[0, 1, 2, 3], [1, 4, 5, 6], [2, 5, 7, 8], [3, 6, 8, 9]])


@inner
def _plane(mesh: Any, node: int, face: int, m: Any) -> Any:
    """The plane of a face in the camera's frame, in which `m` is its part's map: three numbers whose product with any
    of its points is 1."""
    vertices, faces, _, vertex_offsets, _ = mesh
    a = vertex_offsets[node] + faces[0, face]
    b, c = vertex_offsets[node] + faces[1, face], vertex_offsets[node] + faces[2, face]
    a0, a1, a2 = float(vertices[0, a]), float(vertices[1, a]), float(vertices[2, a])
    b0, b1, b2 = vertices[0, b] - a0, vertices[1, b] - a1, vertices[2, b] - a2
    c0, c1, c2 = vertices[0, c] - a0, vertices[1, c] - a1, vertices[2, c] - a2
    bx, cx = m[0] * b0 + m[1] * b1 + m[2] * b2, m[0] * c0 + m[1] * c1 + m[2] * c2
    by, cy = m[3] * b0 + m[4] * b1 + m[5] * b2, m[3] * c0 + m[4] * c1 + m[5] * c2
    bz, cz = m[6] * b0 + m[7] * b1 + m[8] * b2, m[6] * c0 + m[7] * c1 + m[8] * c2
    x, y, z = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    distance = x * (m[0] * a0 + m[1] * a1 + m[2] * a2 + m[9])
    distance += y * (m[3] * a0 + m[4] * a1 + m[5] * a2 + m[10]) + z * (m[6] * a0 + m[7] * a1 + m[8] * a2 + m[11])
    return x / distance, y / distance, z / distance


@inner
def _add_face(plane: Any, node: int, own: Any, sums: Any) -> None:
    """Add the sums over a face's pixels (G, 14) to its part's, and set them to zero. sums : see `_add_pixels`"""
    x, y, z = plane
    for gate in range(len(own)):
        if own[gate, 9] == 0.0:
            continue
        products, pulls, here = sums[0][gate, node], sums[1][gate, node], own[gate]
        for k in range(10):
            products[0, k] += x * x * here[k]
            products[1, k] += x * y * here[k]
            products[2, k] += x * z * here[k]
            products[3, k] += y * y * here[k]
            products[4, k] += y * z * here[k]
            products[5, k] += z * z * here[k]
        for k in range(4):
            pulls[k] += x * here[10 + k]
            pulls[4 + k] += y * here[10 + k]
            pulls[8 + k] += z * here[10 + k]
        here[:] = 0.0


@inner
def _add_pixels(
    room: Any,
    drawn: Any,
    image: Any,
    mesh: Any,
    poses: Any,
    terms: Any,
    patch_counts: Any,
    gates: Any,
    steepest: float,
    own: Any,
    sums: Any,
) -> None:
    """Sum what the pixels of an object at `poses` (N, 7) tell that can be explained, each into the narrowest gate that
    lets it through: products of features into sums (G, N, 6, 10), numbered as _OF_AXES and _OF_POINTS have them, and
    of features and residuals into (G, N, FEATURES). drawn : the box and the stride that `draw_object` returned; own :
    (G, 14) zeros, room for a face's sums"""
    packed, lens, pose_camera_world, patches, patch_count = image
    (left, right, top, bottom), stride = drawn
    weights = patch_counts[2]
    weighed = patch_count > 1 and terms[4] < _ONE
    if weighed:
        weigh_patches(room[5], stride, (left, right, top, bottom), packed, patches, terms, patch_counts)
    last, node, plane, most = np.int64(-1), np.int64(0), (0.0, 0.0, 0.0), 0.0
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            place = (row - top) * stride + column - left
            w = room[5][place]
            if w <= _ZERO:
                continue
            word = packed[row + 1, column + 1]
            reward = pixel_reward(word & CATEGORY_BITS, terms[3], _ONE)
            if weighed:
                reward *= weights[patches[row + 1, column + 1]]
            if reward <= _ZERO:
                continue
            z = 1.0 / w
            residual = depth_of(word) - z
            gate = np.int64(-1)
            for k in range(len(gates)):
                if abs(residual) < gates[k] and (gate < 0 or gates[k] < gates[gate]):
                    gate = np.int64(k)
            if gate < 0:
                continue
            face = np.int64(room[6][place])
            if face != last:
                _add_face(plane, node, own, sums)
                last, node = face, part_of(face, mesh[4])
                plane = _plane(mesh, node, face, placed_in_camera(pose_camera_world, poses[node]))
                most = steepest / np.sqrt(plane[0] ** 2 + plane[1] ** 2 + plane[2] ** 2)
            if not z < most:
                continue
            x, y = (column - lens[2]) / lens[0] * z, (row - lens[3]) / lens[1] * z
            here, weight = own[gate], float(reward) * (z / terms[5]) ** 2 * z
            pull, weight = weight * residual, weight * z
            here[0] += weight * x * x
            here[1] += weight * x * y
            here[2] += weight * x * z
            here[3] += weight * x
            here[4] += weight * y * y
            here[5] += weight * y * z
            here[6] += weight * y
            here[7] += weight * z * z
            here[8] += weight * z
            here[9] += weight
            here[10] += pull * x
            here[11] += pull * y
            here[12] += pull * z
            here[13] += pull
    _add_face(plane, node, own, sums)


@inner
def _motion(pose_camera_world: Any, before: Any, after: Any, probe: float, motion: Any) -> bool:
    """Velocity of a part's points by their place, in the camera's frame: E row by row, each row with its number of e
    (FEATURES,), of a move by `probe` from a pose or map `before` to the one `after`. Returns whether it moves."""
    moves = False
    for k in range(len(before)):
        moves |= after[k] != before[k]
    if not moves:
        return False
    m, n = placed_in_camera(pose_camera_world, before), placed_in_camera(pose_camera_world, after)
    # the inverse of the map's matrix, by its cofactors
    i0, i1, i2 = m[4] * m[8] - m[5] * m[7], m[2] * m[7] - m[1] * m[8], m[1] * m[5] - m[2] * m[4]
    i3, i4, i5 = m[5] * m[6] - m[3] * m[8], m[0] * m[8] - m[2] * m[6], m[2] * m[3] - m[0] * m[5]
    i6, i7, i8 = m[3] * m[7] - m[4] * m[6], m[1] * m[6] - m[0] * m[7], m[0] * m[4] - m[1] * m[3]
    scale = 1.0 / ((m[0] * i0 + m[1] * i3 + m[2] * i6) * probe)
    for axis in range(3):
        d0, d1, d2 = n[3 * axis] - m[3 * axis], n[3 * axis + 1] - m[3 * axis + 1], n[3 * axis + 2] - m[3 * axis + 2]
        e0 = (d0 * i0 + d1 * i3 + d2 * i6) * scale
        e1 = (d0 * i1 + d1 * i4 + d2 * i7) * scale
        e2 = (d0 * i2 + d1 * i5 + d2 * i8) * scale
        motion[4 * axis], motion[4 * axis + 1], motion[4 * axis + 2] = e0, e1, e2
        motion[4 * axis + 3] = (n[9 + axis] - m[9 + axis]) / probe - e0 * m[9] - e1 * m[10] - e2 * m[11]
    return True


@inner
def _add_part(products: Any, pull: Any, motions: Any, moving: Any, count: int, information: Any, gradient: Any) -> None:
    """Add a part's sums (6, 10), (FEATURES,) to information (P, P) and gradient (P,), by its motions (count, FEATURES)
    in the parameters numbered `moving` (count,)."""
    turned = np.empty(FEATURES)
    for a in range(count):
        total = 0.0
        for i in range(FEATURES):
            total += motions[a, i] * pull[i]
            turned[i] = 0.0
            for j in range(FEATURES):
                turned[i] += motions[a, j] * products[_OF_AXES[i // 4, j // 4], _OF_POINTS[i % 4, j % 4]]
        gradient[moving[a]] += total
        for b in range(a + 1):
            total = 0.0
            for i in range(FEATURES):
                total += turned[i] * motions[b, i]
            information[moving[a], moving[b]] += total
            if b < a:
                information[moving[b], moving[a]] += total


@kernel
def _add_range(start: int, step: int, image: Any, mesh: Any, work: Any) -> None:
    """`add_normal_equations` of every `step`th object from the one numbered `start` on. work : all that it takes beside
    image and mesh"""
    poses, probes, _, gates, _, _, _ = work
    width, nodes = image[0].shape[1] - 2, poses.shape[2]
    room, patch_counts = scratch(mesh, width, image[0].shape[0] - 2), patch_room(image[4], width)
    sums = np.empty((len(gates), nodes, 6, 10)), np.empty((len(gates), nodes, FEATURES))
    motions, moving = np.empty((probes.shape[1], FEATURES)), np.empty(probes.shape[1], dtype=np.int64)
    own = np.zeros((len(gates), 14))
    _add_objects(start, step, (image, mesh, room, patch_counts, sums, own, motions, moving), work)


@inner
def _add_objects(start: int, step: int, held: Any, work: Any) -> None:
    image, mesh, room, patch_counts, sums, own, motions, moving = borrowed(held)
    poses, probes, terms, gates, steepest, information, gradient = borrowed(work)
    packed, lens, pose_camera_world, _, _ = image
    view = (lens, pose_camera_world, packed.shape[1] - 2, packed.shape[0] - 2)
    terms32 = score_terms(terms, terms[4])
    nodes, size = poses.shape[2], probes.shape[1]
    for h in range(start, len(poses), step):
        sums[0][:] = 0.0
        sums[1][:] = 0.0
        drawn = draw_object(poses[h, 0], view, mesh, room, room[6])
        _add_pixels(room, drawn, image, mesh, poses[h, 0], terms32, patch_counts, gates, steepest, own, sums)
        for node in range(nodes):
            count = 0
            for k in range(size):
                before, after = poses[h, 0, node], poses[h, 1 + k, node]
                if _motion(pose_camera_world, before, after, probes[h, k], motions[count]):
                    moving[count] = k
                    count += 1
            for gate in range(len(gates)):
                for narrower in range(len(gates)):
                    if gates[narrower] <= gates[gate]:
                        products, pull = sums[0][narrower, node], sums[1][narrower, node]
                        _add_part(products, pull, motions, moving, count, information[h, gate], gradient[h, gate])


@kernel(parallel=True)
def _add_parallel(blocks: int, image: Any, mesh: Any, work: Any) -> None:
    for block in prange(blocks):
        _add_range(np.int64(block), blocks, image, mesh, work)


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
        for a metre that its surface moves
    information : (H, G, P, P) gets the sum over pixels of weight times slope by slope, gradient : (H, G, P) of weight
        times slope times residual; a pixel's weight is the most that it can add to the object's score
    """
    work = poses, probes, terms, gates, steepest, information, gradient
    if len(poses) == 1 or get_num_threads() == 1:
        _add_range(0, 1, image, mesh, work)
    else:
        _add_parallel(min(len(poses), 4 * get_num_threads()), image, mesh, work)
