"""Poses as the matrices that the kernels multiply by."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit


@njit(nogil=True, cache=True, error_model="numpy")
def rotation_rows(w: float, x: float, y: float, z: float) -> Any:
    """The nine elements, row by row, of the rotation matrix of a unit quaternion."""
    return (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        1.0 - 2.0 * (x * x + y * y),
    )


@njit(nogil=True, cache=True, error_model="numpy")
def pose_in_camera(pose_camera_world: Any, pose_world_part: Any) -> Any:
    """Rotation (nine elements, row by row) and translation (three) of pose_camera_part, from two poses (7,)."""
    px, py, pz, aw, ax, ay, az = pose_camera_world
    x, y, z, bw, bx, by, bz = pose_world_part
    r = rotation_rows(
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )
    c = rotation_rows(aw, ax, ay, az)
    return (
        r[0],
        r[1],
        r[2],
        r[3],
        r[4],
        r[5],
        r[6],
        r[7],
        r[8],
        c[0] * x + c[1] * y + c[2] * z + px,
        c[3] * x + c[4] * y + c[5] * z + py,
        c[6] * x + c[7] * y + c[8] * z + pz,
    )


@njit(nogil=True, cache=True, error_model="numpy")
def single(m: Any) -> Any:
    """What `pose_in_camera` returns, in single precision."""
    return (
        np.float32(m[0]),
        np.float32(m[1]),
        np.float32(m[2]),
        np.float32(m[3]),
        np.float32(m[4]),
        np.float32(m[5]),
        np.float32(m[6]),
        np.float32(m[7]),
        np.float32(m[8]),
        np.float32(m[9]),
        np.float32(m[10]),
        np.float32(m[11]),
    )
