"""A tree of parts: where joints put all of them, and which joints bring them nearest to where they are asked to be.

`ArticulatedObject.part_poses` and `tree_estimate.assemble` in plain NumPy are the specification. Single-threaded on
purpose: a call is of a few thousand configurations at most, and takes less than a thread's start.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmpnbp.potentials.kernels.compiling import inner, kernel
from pmpnbp.potentials.kernels.pose_algebra import IDENTITY, difference, inverse, product, rotated, seven, slid, store


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
def _advanced(tree: Any, edge: int, axis: int, position: float, pose: Any) -> Any:
    """pose * before * the axis's motion"""
    pose = product(pose, seven(tree.before[edge, axis]))
    if tree.revolute[edge, axis]:
        return rotated(pose, np.sin(0.5 * position), np.cos(0.5 * position), tree.axes[edge, axis])
    return slid(pose, position, tree.axes[edge, axis])


@kernel
def place(tree: Tree, roots: NDArray[np.float64], joints: NDArray[np.float64], part_poses: NDArray[np.float64]) -> None:
    """Fill part poses (C, N, 7) from root poses (C, 7) and joint vectors (C, D)."""
    for row in range(len(roots)):
        part_poses[row, 0] = roots[row]
        for edge in range(len(tree.child)):
            pose = seven(part_poses[row, tree.parent[edge]])
            for axis in range(tree.axis_count[edge]):
                position = tree.multiplier[edge, axis] * joints[row, tree.coordinates[edge, axis]]
                pose = _advanced(tree, edge, axis, position + tree.offset[edge, axis], pose)
            store(product(pose, seven(tree.after[edge])), part_poses[row, tree.child[edge]])


@inner
def _nearest(tree: Any, edge: int, parent: Any, child: Any) -> float:
    """Where an edge brings its child nearest by its one axis, see `closest_axes`."""
    asked = difference(seven(tree.before[edge, 0]), difference(parent, child))
    asked = product(asked, inverse(seven(tree.after[edge])))
    axis, lower, upper = tree.axes[edge, 0], tree.lower[edge, 0], tree.upper[edge, 0]
    if tree.revolute[edge, 0]:
        middle = (lower + upper) / 2
        twist = 2.0 * np.arctan2(asked[4] * axis[0] + asked[5] * axis[1] + asked[6] * axis[2], asked[3])
        position = twist - 2.0 * np.pi * np.round((twist - middle) / (2.0 * np.pi))
    else:
        position = asked[0] * axis[0] + asked[1] * axis[1] + asked[2] * axis[2]
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
    placed, only = np.empty(asked.shape[1:]), np.int64(0)
    for row in range(len(asked)):
        start = anchor[row]
        placed[start] = asked[row, start]
        for step in range(len(tree.child)):
            edge, outward = tree.order[start, step], tree.outward[start, step]
            parent, child = tree.parent[edge], tree.child[edge]
            here = seven(placed[parent if outward else child])
            there = seven(asked[row, child if outward else parent])
            position = _nearest(tree, edge, here if outward else there, there if outward else here)
            across = _advanced(tree, edge, only, position, here if outward else IDENTITY)
            across = product(across, seven(tree.after[edge]))
            if outward:
                store(across, placed[child])
            else:
                store(product(here, inverse(across)), placed[parent])
            if tree.multiplier[edge, 0] != 0.0:
                joints[row, tree.coordinates[edge, 0]] = (position - tree.offset[edge, 0]) / tree.multiplier[edge, 0]
        roots[row] = placed[0]
