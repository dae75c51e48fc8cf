"""A tree of parts: where joints put all of them, and which joints bring them nearest to where they are asked to be.

`ArticulatedObject.part_poses` and `tree_estimate.assemble` in plain NumPy are the specification. Single-threaded on
purpose: a call is of a few thousand configurations at most, and takes less than a thread's start.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmpnbp.potentials.kernels.compiling import inner, kernel


class Tree(NamedTuple):
    """The T edges that reach all parts but the first, each after the one that reaches its parent, with K axes at most.

    parent, child : (T,) parts; axis_count : (T,) axes of each
    before, revolute, axes, after : (T, K, 7), (T, K), (T, K, 3), (T, 7), see `Edge`
    lower, upper : (T, K) metres or radians; coordinates, multiplier, offset : (T, K), see `Edge`
    order : (N, T) the edges as they are reached from each part; outward : (N, T) whether from their parent
    """

    parent: NDArray[np.int64]
    child: NDArray[np.int64]
    axis_count: NDArray[np.int64]
    before: NDArray[np.float64]
    revolute: NDArray[np.bool_]
    axes: NDArray[np.float64]
    after: NDArray[np.float64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    coordinates: NDArray[np.int64]
    multiplier: NDArray[np.float64]
    offset: NDArray[np.float64]
    order: NDArray[np.int64]
    outward: NDArray[np.bool_]


@inner
def _compose(a: Any, b: Any, out: Any) -> None:
    """out = a * b, poses of seven numbers; out may be a or b."""
    w, x, y, z = a[3], a[4], a[5], a[6]
    px, py, pz, bw, bx, by, bz = b[0], b[1], b[2], b[3], b[4], b[5], b[6]
    cx, cy, cz = y * pz - z * py + w * px, z * px - x * pz + w * py, x * py - y * px + w * pz
    out[0] = a[0] + px + 2.0 * (y * cz - z * cy)
    out[1] = a[1] + py + 2.0 * (z * cx - x * cz)
    out[2] = a[2] + pz + 2.0 * (x * cy - y * cx)
    out[3] = w * bw - x * bx - y * by - z * bz
    out[4] = w * bx + x * bw + y * bz - z * by
    out[5] = w * by - x * bz + y * bw + z * bx
    out[6] = w * bz + x * by - y * bx + z * bw


@inner
def _compose_inverse(a: Any, b: Any, out: Any) -> None:
    """out = a^-1 * b; out may be a or b."""
    w, x, y, z = a[3], -a[4], -a[5], -a[6]
    px, py, pz, bw, bx, by, bz = b[0] - a[0], b[1] - a[1], b[2] - a[2], b[3], b[4], b[5], b[6]
    cx, cy, cz = y * pz - z * py + w * px, z * px - x * pz + w * py, x * py - y * px + w * pz
    out[0] = px + 2.0 * (y * cz - z * cy)
    out[1] = py + 2.0 * (z * cx - x * cz)
    out[2] = pz + 2.0 * (x * cy - y * cx)
    out[3] = w * bw - x * bx - y * by - z * bz
    out[4] = w * bx + x * bw + y * bz - z * by
    out[5] = w * by - x * bz + y * bw + z * bx
    out[6] = w * bz + x * by - y * bx + z * bw


@inner
def _invert(pose: Any, out: Any) -> None:
    """out = pose^-1; out may not be pose."""
    for d in range(7):
        out[d] = 1.0 if d == 3 else 0.0
    _compose_inverse(pose, out, out)


@inner
def _advance(tree: Any, edge: int, axis: int, position: float, motion: Any, pose: Any) -> None:
    """pose <- pose * before * the axis's motion. motion : scratch (7,)"""
    _compose(pose, tree.before[edge, axis], pose)
    turns = tree.revolute[edge, axis]
    sine = np.sin(0.5 * position) if turns else 0.0
    motion[3] = np.cos(0.5 * position) if turns else 1.0
    slide = 0.0 if turns else position
    for d in range(3):
        motion[d] = slide * tree.axes[edge, axis, d]
        motion[4 + d] = sine * tree.axes[edge, axis, d]
    _compose(pose, motion, pose)


@kernel
def place(tree: Tree, roots: NDArray[np.float64], joints: NDArray[np.float64], part_poses: NDArray[np.float64]) -> None:
    """Fill part poses (C, N, 7) from root poses (C, 7) and joint vectors (C, D)."""
    motion = np.empty(7)
    for row in range(len(roots)):
        part_poses[row, 0] = roots[row]
        for edge in range(len(tree.child)):
            pose = part_poses[row, tree.child[edge]]
            pose[:] = part_poses[row, tree.parent[edge]]
            for axis in range(tree.axis_count[edge]):
                position = tree.multiplier[edge, axis] * joints[row, tree.coordinates[edge, axis]]
                _advance(tree, edge, axis, position + tree.offset[edge, axis], motion, pose)
            _compose(pose, tree.after[edge], pose)


@inner
def _nearest(tree: Any, edge: int, parent: Any, child: Any, scratch: Any, inverse: Any) -> float:
    """Where an edge brings its child nearest by its one axis, see `closest_axes`. scratch, inverse : (7,)"""
    _compose_inverse(parent, child, scratch)
    _compose_inverse(tree.before[edge, 0], scratch, scratch)
    _invert(tree.after[edge], inverse)
    _compose(scratch, inverse, scratch)
    axis, lower, upper = tree.axes[edge, 0], tree.lower[edge, 0], tree.upper[edge, 0]
    if tree.revolute[edge, 0]:
        middle = (lower + upper) / 2
        twist = 2.0 * np.arctan2(scratch[4] * axis[0] + scratch[5] * axis[1] + scratch[6] * axis[2], scratch[3])
        position = twist - 2.0 * np.pi * np.round((twist - middle) / (2.0 * np.pi))
    else:
        position = scratch[0] * axis[0] + scratch[1] * axis[1] + scratch[2] * axis[2]
    return min(max(position, lower), upper)


@kernel
def assemble(
    tree: Tree,
    asked: NDArray[np.float64],
    anchor: NDArray[np.int64],
    roots: NDArray[np.float64],
    joints: NDArray[np.float64],
) -> None:
    """Fill root poses (C, 7) and the joint vectors (C, D) that keep part `anchor` (C,) where `asked` (C, N, 7) has it
    and bring every other part, outwards from it, as near to its asked pose as its joint allows. Every edge has one
    axis; joints that move no axis stay as they are."""
    placed = np.empty(asked.shape[1:])
    motion, scratch = np.empty(7), np.empty(7)
    for row in range(len(asked)):
        start = anchor[row]
        placed[start] = asked[row, start]
        for step in range(len(tree.child)):
            edge, outward = tree.order[start, step], tree.outward[start, step]
            parent, child = tree.parent[edge], tree.child[edge]
            above = placed[parent] if outward else asked[row, parent]
            below = asked[row, child] if outward else placed[child]
            position = _nearest(tree, edge, above, below, scratch, motion)
            pose = placed[child] if outward else placed[parent]
            for d in range(7):
                pose[d] = placed[parent, d] if outward else 1.0 * (d == 3)
            _advance(tree, edge, 0, position, motion, pose)
            _compose(pose, tree.after[edge], pose)
            if not outward:
                _invert(pose, scratch)
                _compose(placed[child], scratch, pose)
            if tree.multiplier[edge, 0] != 0.0:
                moved = (position - tree.offset[edge, 0]) / tree.multiplier[edge, 0]
                joints[row, tree.coordinates[edge, 0]] = moved
        roots[row] = placed[0]
