"""Poses as kernels reckon with them: seven numbers x y z qw qx qy qz in registers, as `geometry.poses` specifies.

As tuples: a pose's slice of an array is counted by whoever takes it and looked up again for each of its numbers, and
takes three times as long.
"""

from __future__ import annotations

from typing import Any

from pmpnbp.potentials.kernels.compiling import inner

IDENTITY = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


@inner
def seven(pose: Any) -> Any:
    """The numbers of a pose (7,)."""
    return pose[0], pose[1], pose[2], pose[3], pose[4], pose[5], pose[6]


@inner
def store(pose: Any, out: Any) -> None:
    """Seven numbers into `out` (7,)."""
    for k in range(7):
        out[k] = pose[k]


@inner
def shifted(a: Any, px: Any, py: Any, pz: Any) -> Any:
    """Where a has the point p: the three numbers of a * a shift by p."""
    w, x, y, z = a[3], a[4], a[5], a[6]
    # p + 2 u × (u × p + w p)
    cx, cy, cz = y * pz - z * py + w * px, z * px - x * pz + w * py, x * py - y * px + w * pz
    return (
        a[0] + px + 2.0 * (y * cz - z * cy),
        a[1] + py + 2.0 * (z * cx - x * cz),
        a[2] + pz + 2.0 * (x * cy - y * cx),
    )


@inner
def turned(a: Any, bw: Any, bx: Any, by: Any, bz: Any) -> Any:
    """The quaternion of a * a turn by b, four numbers."""
    w, x, y, z = a[3], a[4], a[5], a[6]
    return (
        w * bw - x * bx - y * by - z * bz,
        w * bx + x * bw + y * bz - z * by,
        w * by - x * bz + y * bw + z * bx,
        w * bz + x * by - y * bx + z * bw,
    )


@inner
def product(a: Any, b: Any) -> Any:
    """a * b"""
    return shifted(a, b[0], b[1], b[2]) + turned(a, b[3], b[4], b[5], b[6])


@inner
def difference(a: Any, b: Any) -> Any:
    """a^-1 * b"""
    back = (0.0, 0.0, 0.0, a[3], -a[4], -a[5], -a[6])
    return shifted(back, b[0] - a[0], b[1] - a[1], b[2] - a[2]) + turned(back, b[3], b[4], b[5], b[6])


@inner
def inverse(a: Any) -> Any:
    """a^-1"""
    back = (0.0, 0.0, 0.0, a[3], -a[4], -a[5], -a[6])
    return shifted(back, -a[0], -a[1], -a[2]) + back[3:]


@inner
def rotated(a: Any, sine: Any, cosine: Any, axis: Any) -> Any:
    """a * a turn about `axis` (3,) of which half the angle has this sine and cosine"""
    return a[:3] + turned(a, cosine, sine * axis[0], sine * axis[1], sine * axis[2])


@inner
def slid(a: Any, distance: Any, axis: Any) -> Any:
    """a * a shift by a distance along `axis` (3,)"""
    return shifted(a, distance * axis[0], distance * axis[1], distance * axis[2]) + a[3:]
