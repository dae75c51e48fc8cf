"""A chain of joint axes: where its end is, how it moves with each free motion, and what it lacks to a pose. Compiled.

`Edge.pose_parent_child` is the specification.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pmpnbp.potentials.kernels.compiling import inner
from pmpnbp.potentials.kernels.pose_algebra import IDENTITY, product, rotated, seven, shifted, store


class Chain(NamedTuple):
    """A chain of K axes and the F free motions that move them. Its end is before_0 * motion_0 … before_K-1 *
    motion_K-1, with axis k moved by entry k of matrix @ free + offset.

    before : (K, 7) poses x y z qw qx qy qz; revolute : (K,) bool; axes : (K, 3) unit vectors
    matrix : (K, F); offset : (K,); lower, upper, wraps : (F,), a free motion that wraps is an angle without bounds
    length : metres that count as much as one radian
    """

    before: NDArray[np.float64]
    revolute: NDArray[np.bool_]
    axes: NDArray[np.float64]
    matrix: NDArray[np.float64]
    offset: NDArray[np.float64]
    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    wraps: NDArray[np.bool_]
    length: float


@inner
def forward(before, revolute, axes, matrix, offset, q, end, along, origin):  # type: ignore[no-untyped-def]
    """Fills the chain's end (7,) at free motions q, and each axis's direction and place (K, 3)."""
    pose = IDENTITY
    for k in range(len(before)):
        pose = product(pose, seven(before[k]))
        position = offset[k]
        for f in range(len(q)):
            position += matrix[k, f] * q[f]
        ax, ay, az = shifted((0.0, 0.0, 0.0) + pose[3:], axes[k, 0], axes[k, 1], axes[k, 2])
        along[k, 0], along[k, 1], along[k, 2] = ax, ay, az
        origin[k, 0], origin[k, 1], origin[k, 2] = pose[0], pose[1], pose[2]
        if revolute[k]:
            pose = rotated(pose, np.sin(position / 2), np.cos(position / 2), axes[k])
        else:
            pose = (pose[0] + position * ax, pose[1] + position * ay, pose[2] + position * az) + pose[3:]
    store(pose, end)


@inner
def pose_error(end, target, length, error):  # type: ignore[no-untyped-def]
    """(6,) what is missing from the end to the target: metres, and radians times length; returns its square."""
    w, x, y, z = target[3], target[4], target[5], target[6]
    ew, ex, ey, ez = end[3], end[4], end[5], end[6]
    rw = w * ew + x * ex + y * ey + z * ez
    rx = -w * ex + x * ew - y * ez + z * ey
    ry = -w * ey + x * ez + y * ew - z * ex
    rz = -w * ez - x * ey + y * ex + z * ew
    sine = np.sqrt(rx * rx + ry * ry + rz * rz)
    scale = 2.0 if sine < 1e-12 else 2 * np.arctan2(sine, abs(rw)) / sine
    scale = -length * scale if rw < 0 else length * scale
    error[0], error[1], error[2] = target[0] - end[0], target[1] - end[1], target[2] - end[2]
    error[3], error[4], error[5] = scale * rx, scale * ry, scale * rz
    square = 0.0
    for d in range(6):
        square += error[d] * error[d]
    return square


@inner
def slopes(revolute, matrix, end, along, origin, length, jacobian):  # type: ignore[no-untyped-def]
    """(6, F): how the end moves with each free motion."""
    for d in range(6):
        for f in range(matrix.shape[1]):
            jacobian[d, f] = 0.0
    for k in range(len(along)):
        ax, ay, az = along[k, 0], along[k, 1], along[k, 2]
        if revolute[k]:
            x, y, z = end[0] - origin[k, 0], end[1] - origin[k, 1], end[2] - origin[k, 2]
            column = (ay * z - az * y, az * x - ax * z, ax * y - ay * x, length * ax, length * ay, length * az)
        else:
            column = (ax, ay, az, 0.0, 0.0, 0.0)
        for f in range(matrix.shape[1]):
            if matrix[k, f] != 0:
                for d in range(6):
                    jacobian[d, f] += matrix[k, f] * column[d]
