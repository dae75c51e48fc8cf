"""From a pose to the image: the pose as matrix elements, and many vertices as pixel coordinates."""

from __future__ import annotations

from typing import Any

import numpy as np

from pmpnbp.potentials.kernels.compiling import inner
from pmpnbp.potentials.kernels.pose_algebra import turned

# The near plane, metres. What lies before it is cut off.
NEAR = 0.01

# So many pixels beside the image single precision still has the edges of a triangle to a hundredth of a pixel.
BESIDE = 1024

_ONE, _NEAR, _FAR = np.float32(1), np.float32(NEAR), np.float32(1e9)


@inner
def rotation_rows(w: float, x: float, y: float, z: float) -> Any:
    """The nine elements, row by row, of the rotation matrix of a quaternion, times its squared length."""
    return (
        w * w + x * x - y * y - z * z,
        2.0 * (x * y - w * z),
        2.0 * (x * z + w * y),
        2.0 * (x * y + w * z),
        w * w - x * x + y * y - z * z,
        2.0 * (y * z - w * x),
        2.0 * (x * z - w * y),
        2.0 * (y * z + w * x),
        w * w - x * x - y * y + z * z,
    )


@inner
def pose_in_camera(pose_camera_world: Any, pose_world_part: Any) -> Any:
    """Rotation (nine elements, row by row) and translation (three) of pose_camera_part, from two poses (7,)."""
    px, py, pz, aw, ax, ay, az = pose_camera_world
    x, y, z, bw, bx, by, bz = pose_world_part
    rw, rx, ry, rz = turned(pose_camera_world, bw, bx, by, bz)
    r = rotation_rows(rw, rx, ry, rz)
    c = rotation_rows(aw, ax, ay, az)
    return (
        *r,
        c[0] * x + c[1] * y + c[2] * z + px,
        c[3] * x + c[4] * y + c[5] * z + py,
        c[6] * x + c[7] * y + c[8] * z + pz,
    )


@inner
def map_in_camera(pose_camera_world: Any, map_world_part: Any) -> Any:
    """As `pose_in_camera`, of a linear map of the part: (12,), nine elements row by row and where its origin goes."""
    px, py, pz, w, x, y, z = pose_camera_world
    a0, a1, a2, a3, a4, a5, a6, a7, a8, tx, ty, tz = map_world_part
    c0, c1, c2, c3, c4, c5, c6, c7, c8 = rotation_rows(w, x, y, z)
    return (
        c0 * a0 + c1 * a3 + c2 * a6,
        c0 * a1 + c1 * a4 + c2 * a7,
        c0 * a2 + c1 * a5 + c2 * a8,
        c3 * a0 + c4 * a3 + c5 * a6,
        c3 * a1 + c4 * a4 + c5 * a7,
        c3 * a2 + c4 * a5 + c5 * a8,
        c6 * a0 + c7 * a3 + c8 * a6,
        c6 * a1 + c7 * a4 + c8 * a7,
        c6 * a2 + c7 * a5 + c8 * a8,
        c0 * tx + c1 * ty + c2 * tz + px,
        c3 * tx + c4 * ty + c5 * tz + py,
        c6 * tx + c7 * ty + c8 * tz + pz,
    )


@inner
def placed_in_camera(pose_camera_world: Any, placed: Any) -> Any:
    """As `pose_in_camera`, of an array that is a pose (7,) or a map (12,)."""
    if len(placed) == 7:
        return pose_in_camera(pose_camera_world, placed)
    return map_in_camera(pose_camera_world, placed)


@inner
def single(m: Any) -> Any:
    """What `pose_in_camera` returns, in single precision."""
    r0, r1, r2 = np.float32(m[0]), np.float32(m[1]), np.float32(m[2])
    r3, r4, r5 = np.float32(m[3]), np.float32(m[4]), np.float32(m[5])
    r6, r7, r8 = np.float32(m[6]), np.float32(m[7]), np.float32(m[8])
    return r0, r1, r2, r3, r4, r5, r6, r7, r8, np.float32(m[9]), np.float32(m[10]), np.float32(m[11])


@inner(fastmath={"nnan", "nsz", "contract"})
def project(vertices: Any, m: Any, lens: Any, width: int, height: int, us: Any, vs: Any, ws: Any) -> Any:
    """Project the vertices xs, ys, zs of a part, whose pose is `m`, into us, vs (pixels) and ws (1/z).

    Returns the first and last column and the first and last row whose pixel centres the projections enclose, the last
    before the first where there is none; and whether the projections are of no use, because a vertex lies before the
    near plane or further beside the image than BESIDE: then all of the image is returned.
    """
    m00, m01, m02, m10, m11, m12, m20, m21, m22, tx, ty, tz = single(m)
    fx, fy, cx, cy = np.float32(lens[0]), np.float32(lens[1]), np.float32(lens[2]), np.float32(lens[3])
    xs, ys, zs = vertices
    before = np.int32(0)
    for k in range(len(xs)):
        depth = m20 * xs[k] + m21 * ys[k] + m22 * zs[k] + tz
        before |= np.int32(depth < _NEAR)
        ws[k] = _ONE / (depth if depth > _NEAR else _NEAR)
    left, right = _project_axis(xs, ys, zs, (m00, m01, m02, tx), fx, cx, ws, us)
    top, bottom = _project_axis(xs, ys, zs, (m10, m11, m12, ty), fy, cy, ws, vs)
    far_left, far_right = left < -BESIDE, right > width + BESIDE
    if before or far_left or far_right or top < -BESIDE or bottom > height + BESIDE:
        return (0, width - 1, 0, height - 1), True
    return (max(int(left), 0), min(int(right), width - 1), max(int(top), 0), min(int(bottom), height - 1)), False


@inner(fastmath={"nnan", "nsz", "contract"})
def _project_axis(xs: Any, ys: Any, zs: Any, row: Any, focal: Any, centre: Any, ws: Any, out: Any) -> Any:
    """One image coordinate of all vertices, and the first and last pixel centre between the smallest and the largest.

    Written so that the compiler makes vectors of it: with more arrays written in one loop there are too many pairs
    that could overlap, and it does not know the smallest of floats for a sum; either costs a factor of six.
    """
    mx, my, mz, t = row
    first, last = np.int32(2**30), np.int32(-(2**30))
    for k in range(len(xs)):
        value = (mx * xs[k] + my * ys[k] + mz * zs[k] + t) * ws[k] * focal + centre
        out[k] = value
        value = value if value < _FAR else _FAR
        value = value if value > -_FAR else -_FAR
        first, last = min(first, np.int32(np.ceil(value))), max(last, np.int32(np.floor(value)))
    return first, last
