"""Which configuration of a joint comes closest to a given pose of the child in the parent, and what is left over?

For one axis the answer is a formula: the position along a slide, the twist about a hinge. For a chain of axes it is
a small least-squares problem with bounds, solved by a few damped Gauss-Newton steps from the best of several starts
(`kernels/chain_projection.py`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.potentials.kernels.chain_kinematics import Chain
from pmpnbp.potentials.kernels.chain_projection import nearest_on_chain
from pmpnbp.scene.articulated_object import Edge

# In a chain, a turn by one radian left over counts as much as this many metres.
LENGTH_PER_RADIAN = 0.3

_STARTS_PER_TURN = 8


@dataclass(frozen=True)
class Gearing:
    """The free motions of an edge: axes that follow the same joint are one. axes = matrix @ free + offset.

    matrix : (K, F); offset : (K,); lower, upper, wraps : (F,) bounds of the free motions
    """

    matrix: Array
    offset: Array
    lower: Array
    upper: Array
    wraps: NDArray[np.bool_]


def gearing(edge: Edge) -> Gearing:
    """The free motions of `edge`: each is the first moving one of the axes that follow one joint, in its own units."""
    columns: list[Array] = []
    offset = np.zeros(len(edge.axes))
    leaders: list[int] = []
    for coordinate in dict.fromkeys(edge.coordinates.tolist()):
        followers = np.flatnonzero(edge.coordinates == coordinate)
        moving = followers[edge.multiplier[followers] != 0]
        leader = int(moving[0]) if len(moving) else int(followers[0])
        column = np.zeros(len(edge.axes))
        column[leader] = 1.0
        for k in followers[followers != leader]:
            # leader = m_l q + o_l and this axis = m_k q + o_k, so it moves by m_k / m_l for each of the leader's.
            column[k] = edge.multiplier[k] / edge.multiplier[leader] if edge.multiplier[leader] else 0.0
            offset[k] = edge.offset[k] - column[k] * edge.offset[leader]
        columns.append(column)
        leaders.append(leader)
    return Gearing(np.stack(columns, axis=-1), offset, edge.lower[leaders], edge.upper[leaders], edge.wraps[leaders])


def limit_axes(edge: Edge) -> tuple[Array, Array]:
    """Axis positions (K,), (K,) with every free motion at its lower, and at its upper limit."""
    free = gearing(edge)
    return free.matrix @ free.lower + free.offset, free.matrix @ free.upper + free.offset


def project(
    edge: Edge, pose_parent_child: Array, *, length_per_radian: float = LENGTH_PER_RADIAN
) -> tuple[Array, Array, Array]:
    """The closest configuration of the joint to poses (..., 7) of the child in the parent.

    Returns axis positions (..., K) as `closest_axes` has them, and the residual of `residual` there: translation
    (..., 3), metres, and rotation vector (..., 3), radians.
    """
    axes = closest_axes(edge, pose_parent_child, length_per_radian=length_per_radian)
    return axes, *residual(edge, pose_parent_child, axes)


def closest_axes(edge: Edge, pose_parent_child: Array, *, length_per_radian: float = LENGTH_PER_RADIAN) -> Array:
    """Axis positions (..., K), within the limits, that bring the child closest to poses (..., 7) of it in the parent.

    One axis: the slide that leaves the least translation; the turn that leaves the least rotation, of the equal ones
    (whole turns apart) that nearest to the middle of the range; the nearer limit where the range ends before. Several
    axes: the least of |translation|² + (length_per_radian * |rotation|)² that was found, in metres².
    """
    if len(edge.axes) == 1:
        return _single(edge, pose_parent_child)
    flat = _chain(edge, pose_parent_child.reshape(-1, 7), length_per_radian)
    return flat.reshape(*pose_parent_child.shape[:-1], len(edge.axes))


def residual(edge: Edge, pose_parent_child: Array, axis_positions: Array) -> tuple[Array, Array]:
    """What is left of poses (..., 7) of the child in the parent after the joint has moved to `axis_positions` (..., K).

    With moved = before_0 motion_0 … before_K-1 motion_K-1, it is the pose E in pose_parent_child = moved * E * after:
    translation (..., 3) in metres and rotation vector (..., 3) in radians, in the frame of the last axis as moved. Not
    in the child's own frame, because a hinge's child may have its origin far from the hinge; for most URDF joints
    (nothing fixed between the joint and the part) the two are the same.
    """
    end = _end_of_chain(edge, axis_positions)
    left = poses.multiply(poses.multiply(poses.inverse(end), pose_parent_child), poses.inverse(edge.pose_after))
    return left[..., :3], poses.to_rotation_vector(left[..., 3:])


def _end_of_chain(edge: Edge, axis_positions: Array) -> Array:
    return poses.multiply(edge.pose_parent_child(axis_positions), poses.inverse(edge.pose_after))


def _single(edge: Edge, pose_parent_child: Array) -> Array:
    """Of an edge with one axis. The turn is the twist of the swing-twist decomposition: of the rotation q, split into a
    turn about the axis and one about an axis across it, the first is by 2 atan2(vector part · axis, scalar part); it
    leaves the least rotation of all turns about the axis (Dobrowolski 2015, arXiv:1506.05481)."""
    moved = poses.multiply(
        poses.multiply(poses.inverse(edge.poses_before[0]), pose_parent_child), poses.inverse(edge.pose_after)
    )
    lower, upper = edge.lower[0], edge.upper[0]
    if not edge.revolute[0]:
        return np.clip(moved[..., :3] @ edge.axes[0], lower, upper)[..., None]
    middle = (lower + upper) / 2
    twist = 2.0 * np.arctan2(moved[..., 4:] @ edge.axes[0], moved[..., 3])
    return np.clip(middle + _wrap(twist - middle), lower, upper)[..., None]


def _wrap(angle: Array) -> Array:
    return angle - 2 * np.pi * np.round(angle / (2 * np.pi))


def _chain(edge: Edge, pose_parent_child: Array, length: float) -> Array:
    free = gearing(edge)
    turning = int((free.matrix[edge.revolute] != 0).any(axis=0).sum())
    target = poses.multiply(pose_parent_child, poses.inverse(edge.pose_after))
    chain = Chain(
        before=_writeable(edge.poses_before),
        revolute=np.require(edge.revolute, np.bool_, ["C", "W"]),
        axes=_writeable(edge.axes),
        matrix=_writeable(free.matrix),
        offset=_writeable(free.offset),
        lower=_writeable(free.lower),
        upper=_writeable(free.upper),
        wraps=np.require(free.wraps, np.bool_, ["C", "W"]),
        length=length,
    )
    q = nearest_on_chain(chain, _spread(1 + _STARTS_PER_TURN * turning, free), target)
    return q @ free.matrix.T + free.offset


def _writeable(array: Array) -> Array:
    # a kernel would be compiled once more for read-only arrays
    return np.require(array, np.float64, ["C", "W"])


def _spread(count: int, free: Gearing) -> Array:
    # An additive recurrence fills a box evenly in any number of dimensions; the middle comes first.
    size = len(free.lower)
    root = 2.0
    for _ in range(30):
        root = (1 + root) ** (1 / (size + 1))
    fraction = (0.5 + np.arange(count)[:, None] * root ** -np.arange(1, size + 1)) % 1.0
    return free.lower + fraction * (free.upper - free.lower)
