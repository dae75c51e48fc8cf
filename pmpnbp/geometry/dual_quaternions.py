"""Dual quaternions, the paper's own language for poses: products and distances.

A dual quaternion `q_r + eps q_d` is an array `[q_r][q_d]`, each part w x y z (the paper's section 3). A pose is
`dq_pos * dq_ori` with `dq_pos = [1,0,0,0][0,x/2,y/2,z/2]` and `dq_ori = [qw,qx,qy,qz][0,0,0,0]`, so that
`q_r = ori` and `q_d = (0,x,y,z)/2 * ori`. Frames compose as poses do: `multiply(dq_a_b, dq_b_c)` is `dq_a_c`. All
functions broadcast over leading axes, and a dual quaternion and its negative are the same pose.
"""

from __future__ import annotations

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array


def from_pose(pose: Array) -> Array:
    """Unit dual quaternions (..., 8), [q_r][q_d], of poses (..., 7), x y z qw qx qy qz, metres."""
    position = np.concatenate([np.zeros_like(pose[..., :1]), pose[..., :3]], axis=-1)
    return np.concatenate([pose[..., 3:], 0.5 * poses.quaternion_multiply(position, pose[..., 3:])], axis=-1)


def position_of(dq: Array) -> Array:
    """Translations (..., 3), metres, of unit dual quaternions (..., 8): the vector part of 2 q_d q_r*."""
    return 2.0 * poses.quaternion_multiply(dq[..., 4:], poses.quaternion_conjugate(dq[..., :4]))[..., 1:]


def multiply(a: Array, b: Array) -> Array:
    """Product of dual quaternions (..., 8): `multiply(dq_a_b, dq_b_c)` is `dq_a_c`."""
    real = poses.quaternion_multiply(a[..., :4], b[..., :4])
    dual = poses.quaternion_multiply(a[..., :4], b[..., 4:]) + poses.quaternion_multiply(a[..., 4:], b[..., :4])
    return np.concatenate([real, dual], axis=-1)


def distance(a: Array, b: Array) -> tuple[Array, Array]:
    """d(a, b) of eq. 11 between unit dual quaternions (..., 8) in one frame: metres (...) and radians 0 to pi (...).

    The position part is the length between the two origins, the orientation part the angle of the turn between them.
    """
    position = np.linalg.norm(position_of(a) - position_of(b), axis=-1)
    return position, poses.rotation_angle(a[..., :4], b[..., :4])
