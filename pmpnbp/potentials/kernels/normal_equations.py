"""How do the depth residuals of many whole objects change with small moves? Normal equations of articulated
registration, from one render of each object.

A pixel shows a point p of a face with the normal n, both in the camera's frame, along a ray r = p / z. Where the face
moves so that its points at p have the velocity v, the pixel's depth changes by n · v / n · r. A part moves as a linear
map, v = E p + e, which makes this a sum of twelve products of the pixel's, its features, with twelve numbers of the
part's. The sums over pixels are of features, part by part, and how many parameters there are does not matter to them.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import get_num_threads, prange
from numpy.typing import NDArray

from pmpnbp.potentials.kernels.compiling import inner, kernel
from pmpnbp.potentials.kernels.continuation import patch_room, weigh_patches
from pmpnbp.potentials.kernels.pixel_scores import CATEGORY_BITS, depth_of, pixel_reward, score_terms
from pmpnbp.potentials.kernels.projection import placed_in_camera
from pmpnbp.potentials.kernels.rasteriser import draw_object, part_of, scratch

_ZERO, _ONE = np.float32(0), np.float32(1)
# A pixel's slant along x, y and z, by its point's x, y, z and 1.
FEATURES = 12


@inner(error_model="numpy")
def _normal(mesh: Any, node: int, face: int, m: Any, normal: Any) -> None:
    """Normal (3,), of any length, in the camera's frame, of a face of a part whose map in it is `m`."""
    vertices, faces, _, vertex_offsets, _ = mesh
    a = vertex_offsets[node] + faces[0, face]
    b, c = vertex_offsets[node] + faces[1, face], vertex_offsets[node] + faces[2, face]
    b0, b1, b2 = vertices[0, b] - vertices[0, a], vertices[1, b] - vertices[1, a], vertices[2, b] - vertices[2, a]
    c0, c1, c2 = vertices[0, c] - vertices[0, a], vertices[1, c] - vertices[1, a], vertices[2, c] - vertices[2, a]
    bx, cx = m[0] * b0 + m[1] * b1 + m[2] * b2, m[0] * c0 + m[1] * c1 + m[2] * c2
    by, cy = m[3] * b0 + m[4] * b1 + m[5] * b2, m[3] * c0 + m[4] * c1 + m[5] * c2
    bz, cz = m[6] * b0 + m[7] * b1 + m[8] * b2, m[6] * c0 + m[7] * c1 + m[8] * c2
    normal[0], normal[1], normal[2] = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx


@inner(error_model="numpy")
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
    sums: Any,
) -> None:
    """Sum what the pixels of an object at `poses` (N, 7) tell that can be explained, each into the narrowest gate that
    lets it through: products of features into sums (G, N, FEATURES, FEATURES), of features and residuals into (G, N,
    FEATURES). drawn : the box and the stride that `draw_object` returned"""
    packed, lens, pose_camera_world, patches, patch_count = image
    (left, right, top, bottom), stride = drawn
    products, pulls = sums
    weights = patch_counts[2]
    weighed = patch_count > 1 and terms[4] < _ONE
    if weighed:
        weigh_patches(room[5], stride, (left, right, top, bottom), packed, patches, terms, patch_counts)
    last, node = np.int64(-1), np.int64(0)
    normal, feature, weighted = np.empty(3), np.empty(FEATURES), np.empty(FEATURES)
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
            depth = 1.0 / w
            residual = depth_of(word) - depth
            gate = np.int64(-1)
            for k in range(len(gates)):
                if abs(residual) < gates[k] and (gate < 0 or gates[k] < gates[gate]):
                    gate = np.int64(k)
            if gate < 0:
                continue
            face = np.int64(room[6][place])
            if face != last:
                last, node = face, part_of(face, mesh[4])
                _normal(mesh, node, face, placed_in_camera(pose_camera_world, poses[node]), normal)
            x, y = (column - lens[2]) / lens[0], (row - lens[3]) / lens[1]
            towards = normal[0] * x + normal[1] * y + normal[2]
            slant = normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2
            if slant >= (steepest * towards) ** 2:
                continue
            for axis in range(3):
                slope = normal[axis] / towards
                feature[4 * axis], feature[4 * axis + 1] = slope * depth * x, slope * depth * y
                feature[4 * axis + 2], feature[4 * axis + 3] = slope * depth, slope
            weight = float(reward) * (depth / terms[5]) ** 2
            for i in range(FEATURES):
                weighted[i] = weight * feature[i]
                pulls[gate, node, i] += weighted[i] * residual
            for i in range(FEATURES):
                for j in range(FEATURES):
                    products[gate, node, i, j] += weighted[i] * feature[j]


@inner(error_model="numpy")
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


@inner(error_model="numpy")
def _add_part(products: Any, pull: Any, motions: Any, moving: Any, count: int, information: Any, gradient: Any) -> None:
    """Add a part's sums (FEATURES, FEATURES), (FEATURES,) to information (P, P) and gradient (P,), by its motions
    (count, FEATURES) in the parameters numbered `moving` (count,)."""
    turned = np.empty(FEATURES)
    for a in range(count):
        total = 0.0
        for i in range(FEATURES):
            total += motions[a, i] * pull[i]
            turned[i] = 0.0
        gradient[moving[a]] += total
        for i in range(FEATURES):
            for j in range(FEATURES):
                turned[j] += motions[a, i] * products[i, j]
        for b in range(a + 1):
            total = 0.0
            for i in range(FEATURES):
                total += turned[i] * motions[b, i]
            information[moving[a], moving[b]] += total
            if b < a:
                information[moving[b], moving[a]] += total


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
    view = (lens, pose_camera_world, packed.shape[1] - 2, packed.shape[0] - 2)
    room = scratch(mesh, view[2], view[3])
    terms32 = score_terms(terms, terms[4])
    patch_counts = patch_room(patch_count, view[2])
    nodes, size = poses.shape[2], probes.shape[1]
    sums = np.empty((len(gates), nodes, FEATURES, FEATURES)), np.empty((len(gates), nodes, FEATURES))
    motions, moving = np.empty((size, FEATURES)), np.empty(size, dtype=np.int64)
    for h in range(start, len(poses), step):
        sums[0][:] = 0.0
        sums[1][:] = 0.0
        drawn = draw_object(poses[h, 0], view, mesh, room, room[6])
        _add_pixels(room, drawn, image, mesh, poses[h, 0], terms32, patch_counts, gates, steepest, sums)
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
        for a metre that its surface moves
    information : (H, G, P, P) gets the sum over pixels of weight times slope by slope, gradient : (H, G, P) of weight
        times slope times residual; a pixel's weight is the most that it can add to the object's score
    """
    if len(poses) == 1 or get_num_threads() == 1:
        _add_range(0, 1, image, mesh, poses, probes, terms, gates, steepest, information, gradient)
    else:
        blocks = min(len(poses), 4 * get_num_threads())
        _add_parallel(blocks, image, mesh, poses, probes, terms, gates, steepest, information, gradient)
