"""Dual quaternions, the paper's own language for poses: products, conjugates, distances and screw motions.

A dual quaternion `q_r + eps q_d` is an array `[q_r][q_d]`, each part w x y z (the paper's section 3). A pose is
`dq_pos * dq_ori` with `dq_pos = [1,0,0,0][0,x/2,y/2,z/2]` and `dq_ori = [qw,qx,qy,qz][0,0,0,0]`, so that
`q_r = ori` and `q_d = (0,x,y,z)/2 * ori`. Frames compose as poses do: `multiply(dq_a_b, dq_b_c)` is `dq_a_c`. All
functions broadcast over leading axes, and a dual quaternion and its negative are the same pose.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array

IDENTITY: Array = np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
IDENTITY.setflags(write=False)

# Below this sine of half the turn a motion is a slide: its screw axis is at infinity.
_NO_TURN = 1e-9


def from_pose(pose: Array) -> Array:
    """Unit dual quaternions (..., 8), [q_r][q_d], of poses (..., 7), x y z qw qx qy qz, metres."""
    position = np.concatenate([np.zeros_like(pose[..., :1]), pose[..., :3]], axis=-1)
    return np.concatenate([pose[..., 3:], 0.5 * poses.quaternion_multiply(position, pose[..., 3:])], axis=-1)


def to_pose(dq: Array) -> Array:
    """Poses (..., 7), x y z qw qx qy qz, metres, of unit dual quaternions (..., 8): the inverse of `from_pose`."""
    return np.concatenate([position_of(dq), dq[..., :4]], axis=-1)


def position_of(dq: Array) -> Array:
    """Translations (..., 3), metres, of unit dual quaternions (..., 8): the vector part of 2 q_d q_r*."""
    return 2.0 * poses.quaternion_multiply(dq[..., 4:], poses.quaternion_conjugate(dq[..., :4]))[..., 1:]


def multiply(a: Array, b: Array) -> Array:
    """Product of dual quaternions (..., 8): `multiply(dq_a_b, dq_b_c)` is `dq_a_c`."""
    real = poses.quaternion_multiply(a[..., :4], b[..., :4])
    dual = poses.quaternion_multiply(a[..., :4], b[..., 4:]) + poses.quaternion_multiply(a[..., 4:], b[..., :4])
    return np.concatenate([real, dual], axis=-1)


def conjugate(dq: Array) -> Array:
    """Quaternion conjugate [q_r*][q_d*] of `dq` (..., 8): the inverse of a unit dual quaternion."""
    return np.concatenate([poses.quaternion_conjugate(dq[..., :4]), poses.quaternion_conjugate(dq[..., 4:])], axis=-1)


def dual_conjugate(dq: Array) -> Array:
    """Dual-number conjugate [q_r][-q_d] of `dq` (..., 8)."""
    return np.concatenate([dq[..., :4], -dq[..., 4:]], axis=-1)


def point_conjugate(dq: Array) -> Array:
    """Both conjugates at once, [q_r*][-q_d*], of `dq` (..., 8): the `dq_c` that transforms points in eq. 12."""
    return dual_conjugate(conjugate(dq))


def transform_points(dq: Array, points: Array) -> Array:
    """Points (..., 3) of frame b in frame a by `dq_a_b` (..., 8): dq * p * dq_c of eq. 12, p = [1,0,0,0][0,x,y,z]."""
    one = np.broadcast_to(IDENTITY[:5], (*points.shape[:-1], 5))
    moved = multiply(multiply(dq, np.concatenate([one, points], axis=-1)), point_conjugate(dq))
    return moved[..., 5:]


def normalise(dq: ArrayLike) -> Array:
    """The unit dual quaternion (..., 8) next to `dq`: q_r at unit length and q_d at right angles to it.

    Raises ValueError where the real part has no direction or a number is not finite.
    """
    dq = np.asarray(dq, dtype=np.float64)
    length = np.linalg.norm(dq[..., :4], axis=-1, keepdims=True)
    if not np.all(np.isfinite(dq)) or np.any(length < 1e-9):
        raise ValueError("a dual quaternion needs eight finite numbers and a real part that is not zero")
    real, dual = dq[..., :4] / length, dq[..., 4:] / length
    return np.concatenate([real, dual - np.sum(real * dual, axis=-1, keepdims=True) * real], axis=-1)


def distance(a: Array, b: Array) -> tuple[Array, Array]:
    """d(a, b) of eq. 11 between unit dual quaternions (..., 8) in one frame: metres (...) and radians 0 to pi (...).

    The position part is the length between the two origins, the orientation part the angle of the turn between them.
    """
    position = np.linalg.norm(position_of(a) - position_of(b), axis=-1)
    return position, poses.rotation_angle(a[..., :4], b[..., :4])


def power(dq: Array, exponent: Array | float) -> Array:
    """Unit dual quaternions (..., 8) to a real power (...): the same screw by a fraction of its turn and its slide.

    The turn is taken the short way round, so that `dq` and `-dq` have the same powers.
    """
    dq = np.where(dq[..., :1] < 0, -dq, dq)
    exponent = np.asarray(exponent, dtype=np.float64)[..., None]
    sine = np.linalg.norm(dq[..., 1:4], axis=-1, keepdims=True)
    turns = sine > _NO_TURN
    half = np.arctan2(sine, dq[..., :1])
    safe = np.where(turns, sine, 1.0)
    direction = dq[..., 1:4] / safe
    half_slide = np.where(turns, -dq[..., 4:5] / safe, 0.0)
    moment = (dq[..., 5:8] - half_slide * direction * dq[..., :1]) / safe
    # A dual angle (half + eps half_slide) about the line (direction, moment): Kavan et al. 2006.
    cos, sin = np.cos(exponent * half), np.sin(exponent * half)
    slide = exponent * half_slide
    screw = np.concatenate([cos, sin * direction, -slide * sin, sin * moment + slide * cos * direction], axis=-1)
    straight = np.concatenate(
        [np.ones_like(cos), exponent * dq[..., 1:4], np.zeros_like(cos), exponent * dq[..., 5:8]], axis=-1
    )
    return np.where(turns, screw, straight)


def interpolate(a: Array, b: Array, fraction: Array | float) -> Array:
    """Screw motion from `a` (..., 8) at fraction 0 to `b` at 1, the short way round: a * (a^-1 * b) ** fraction."""
    return multiply(a, power(multiply(conjugate(a), b), fraction))
