"""What `joint_sums.py` computes, in plain NumPy and float64, one sample at a time: slow, obvious, the specification."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmpnbp.potentials.kernels.joint_sums import PRISMATIC, REVOLUTE, Jobs

Array = NDArray[np.float64]


def joint_sums_reference(jobs: Jobs, sigma_position: float, sigma_orientation: float) -> Array:
    """(Q, M), as `joint_sums` with the same arguments."""
    result = np.full(jobs.poses_s.shape[:2], -np.inf)
    for q, i in np.ndindex(*result.shape):
        meets = slice(int(jobs.start[q, i]), int(jobs.stop[q, i]))
        if meets.stop <= meets.start:
            continue
        s, t = jobs.poses_s[q, i], jobs.poses_t[q, meets]
        ends = (s, jobs.frames_s[q]), (t, jobs.frames_t[q])
        (parent, frame_parent), (child, frame_child) = ends if jobs.s_is_parent[q] else ends[::-1]
        joint_parent, joint_child = _compose(parent, frame_parent), _compose(child, frame_child)
        if jobs.kind[q] == PRISMATIC:
            position, orientation = _off_slide(joint_parent, joint_child, jobs.shape[q].astype(np.float64))
        elif jobs.kind[q] == REVOLUTE:
            position, orientation = _off_hinge(joint_parent, joint_child, jobs.shape[q].astype(np.float64))
        else:
            position, orientation = _beyond_limits(joint_parent, _compose(parent, jobs.second_limits[q]), child)
        log_psi = -(position**2) / (2 * sigma_position**2) - orientation**2 / (2 * sigma_orientation**2)
        result[q, i] = np.logaddexp.reduce(jobs.log_weights[q, meets] + log_psi)
    return result


def _beyond_limits(lower: Array, upper: Array, child: Array) -> tuple[Array, Array]:
    """A + B - C of eq. 11, metres and radians."""
    position = (
        np.linalg.norm(child[..., :3] - lower[..., :3], axis=-1)
        + np.linalg.norm(child[..., :3] - upper[..., :3], axis=-1)
        - np.linalg.norm(lower[..., :3] - upper[..., :3], axis=-1)
    )
    orientation = _angle(_relative(lower, child)) + _angle(_relative(upper, child)) - _angle(_relative(lower, upper))
    return position, orientation


def _off_slide(parent: Array, child: Array, limits: Array) -> tuple[Array, Array]:
    """Distance to the stretch of the parent's z axis between the limits, and the angle between the frames."""
    local = _turn(_conjugate(parent[..., 3:]), child[..., :3] - parent[..., :3])
    local[..., 2] -= np.clip(local[..., 2], limits[0], limits[1])
    return np.linalg.norm(local, axis=-1), _angle(_relative(parent, child))


def _off_hinge(parent: Array, child: Array, quarter: Array) -> tuple[Array, Array]:
    """Distance between the origins, and the angle that no turn about z within the range takes away."""
    half = 2 * np.arctan2(quarter[1], quarter[0])
    relative = _relative(parent, child)
    twist = 2 * np.arctan2(relative[..., 3], relative[..., 0])
    twist = np.clip(twist - 2 * np.pi * np.round(twist / (2 * np.pi)), -half, half)
    untwisted = _product(np.stack([np.cos(twist / 2), 0 * twist, 0 * twist, -np.sin(twist / 2)], axis=-1), relative)
    return np.linalg.norm(child[..., :3] - parent[..., :3], axis=-1), _angle(untwisted)


def _conjugate(q: Array) -> Array:
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def _product(a: Array, b: Array) -> Array:
    real = a[..., :1] * b[..., :1] - np.sum(a[..., 1:] * b[..., 1:], axis=-1, keepdims=True)
    vector = a[..., :1] * b[..., 1:] + b[..., :1] * a[..., 1:] + np.cross(a[..., 1:], b[..., 1:])
    return np.concatenate([real, vector], axis=-1)


def _turn(q: Array, vector: Array) -> Array:
    pure = np.concatenate([np.zeros_like(vector[..., :1]), vector], axis=-1)
    return _product(_product(q, pure), _conjugate(q))[..., 1:]


def _compose(a: Array, b: Array) -> Array:
    return np.concatenate([a[..., :3] + _turn(a[..., 3:], b[..., :3]), _product(a[..., 3:], b[..., 3:])], axis=-1)


def _relative(a: Array, b: Array) -> Array:
    return _product(_conjugate(a[..., 3:]), b[..., 3:])


def _angle(q: Array) -> Array:
    return 2 * np.arctan2(np.linalg.norm(q[..., 1:], axis=-1), np.abs(q[..., 0]))
