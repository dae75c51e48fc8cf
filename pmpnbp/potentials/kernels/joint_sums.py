"""How well does each of a node's samples agree with a neighbour's whole message? The sums of box 1, step 2c(i), fast.

For every job and every sample i of X_s: log sum_j w_j psi(X_s = i, X_t = j). `joint_sums_reference.py` is the
specification; this is its fused form in float32. What depends on one side only is laid out once per particle as a
structure of arrays, so that the loop over j is a few dozen multiplications without a branch, 16 at a time:

- `prismatic`: residual position d - clamp(n·d) n, and the square of the angle between two quaternions as a polynomial
  in |a - b|², which keeps its digits where the angle is small, unlike 1 - (a·b)²;
- `revolute`: with z along the joint and the zero in the middle of its range, the quaternion of the child in the
  parent is (w, x, y, z). What no turn within the range can undo has half-angle sine squared
  x² + y² + max(0, |z| cos(h/2) - |w| sin(h/2))², where h is half the range, and 4 (x² + y²) = |axis_a - axis_b|²;
- `limits`: eq. 11, the distances to both limit poses.

Every row is summed by one thread in a fixed order: the result does not depend on the number of threads.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

PRISMATIC, REVOLUTE, LIMITS = 0, 1, 2

# Rows that share a scratch buffer, and the number of pairs from which a second thread pays for its start.
_ROWS = 32
_PARALLEL_FROM = 400_000

_LOG2E = float(np.log2(np.e))
# Stands for the log of zero: far below anything reachable, and far from the end of float32.
_NOTHING = np.float32(-1e30)
_LOWEST_POWER = np.float32(-100.0)


def _fit(values: Any, upper: float, degree: int) -> tuple[np.float32, ...]:
    # Interpolation at Chebyshev points is within a factor of about two of the best polynomial.
    nodes = upper / 2 * (1 - np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1)))
    series = np.polynomial.Polynomial.fit(nodes, values(nodes), degree).convert().coef
    return tuple(np.float32(c) for c in series)


# angle / |a - b| for unit quaternions a, b at most half a turn apart, by m = |a - b|² in 0..2: angle = 4 asin(|a-b|/2).
_ANGLE = _fit(lambda m: 4 * np.arcsin(np.sqrt(m) / 2) / np.sqrt(m), 2.0 + 1e-6, 6)
# angle² / |a - b|², likewise.
_ANGLE_SQUARED = _fit(lambda m: 16 * np.arcsin(np.sqrt(m) / 2) ** 2 / m, 2.0 + 1e-6, 6)
# angle² / sin²(angle/2) by the cosine of the half angle, 0..1.
_SWING_SQUARED = _fit(lambda x: 4 * np.arccos(x) ** 2 / (1 - x * x), 1.0, 5)
# 2 ** f for f in 0..1
_EXP2 = _fit(np.exp2, 1.0, 4)

_A0, _A1, _A2, _A3, _A4, _A5, _A6 = _ANGLE
_B0, _B1, _B2, _B3, _B4, _B5, _B6 = _ANGLE_SQUARED
_C0, _C1, _C2, _C3, _C4, _C5 = _SWING_SQUARED
_E0, _E1, _E2, _E3, _E4 = _EXP2

_ONE, _FOUR, _QUARTER, _ZERO = np.float32(1), np.float32(4), np.float32(0.25), np.float32(0)
_BIAS = np.int32(127)
_MANTISSA = np.int32(23)


@njit(nogil=True, fastmath=True)
def _apart(aw, ax, ay, az, bw, bx, by, bz):  # type: ignore[no-untyped-def]
    # |a - b|² of the nearer of b and -b
    dw, dx, dy, dz = aw - bw, ax - bx, ay - by, az - bz
    m = dw * dw + dx * dx + dy * dy + dz * dz
    return min(m, _FOUR - m)


@njit(nogil=True, fastmath=True)
def _prismatic_pair(nx, ny, nz, lower, upper, dx, dy, dz, m, kp, ko):  # type: ignore[no-untyped-def]
    along = min(max(nx * dx + ny * dy + nz * dz, lower), upper)
    rx, ry, rz = dx - along * nx, dy - along * ny, dz - along * nz
    angle2 = m * (_B0 + m * (_B1 + m * (_B2 + m * (_B3 + m * (_B4 + m * (_B5 + m * _B6))))))
    return kp * (rx * rx + ry * ry + rz * rz) + ko * angle2


@njit(nogil=True, fastmath=True)
def _prismatic_row(o, inner, log_w, count, outer_is_parent, lower, upper, kp, ko, out):  # type: ignore[no-untyped-def]
    ox, oy, oz, onx, ony, onz, oqw, oqx, oqy, oqz = o[0], o[1], o[2], o[3], o[4], o[5], o[6], o[7], o[8], o[9]
    x, y, z, qw, qx, qy, qz = inner[0], inner[1], inner[2], inner[6], inner[7], inner[8], inner[9]
    if outer_is_parent:
        for j in range(count):
            m = _apart(oqw, oqx, oqy, oqz, qw[j], qx[j], qy[j], qz[j])
            cost = _prismatic_pair(onx, ony, onz, lower, upper, x[j] - ox, y[j] - oy, z[j] - oz, m, kp, ko)
            out[j] = log_w[j] - cost
    else:
        nx, ny, nz = inner[3], inner[4], inner[5]
        for j in range(count):
            m = _apart(oqw, oqx, oqy, oqz, qw[j], qx[j], qy[j], qz[j])
            cost = _prismatic_pair(nx[j], ny[j], nz[j], lower, upper, ox - x[j], oy - y[j], oz - z[j], m, kp, ko)
            out[j] = log_w[j] - cost


@njit(nogil=True, fastmath=True)
def _revolute_row(o, inner, log_w, count, cos_end, sin_end, kp, ko, out):  # type: ignore[no-untyped-def]
    ox, oy, oz, onx, ony, onz, oqw, oqx, oqy, oqz = o[0], o[1], o[2], o[3], o[4], o[5], o[6], o[7], o[8], o[9]
    x, y, z, nx, ny, nz = inner[0], inner[1], inner[2], inner[3], inner[4], inner[5]
    qw, qx, qy, qz = inner[6], inner[7], inner[8], inner[9]
    for j in range(count):
        dx, dy, dz = x[j] - ox, y[j] - oy, z[j] - oz
        ax, ay, az = nx[j] - onx, ny[j] - ony, nz[j] - onz
        w = oqw * qw[j] + oqx * qx[j] + oqy * qy[j] + oqz * qz[j]
        twist = oqw * qz[j] - oqx * qy[j] + oqy * qx[j] - oqz * qw[j]
        beyond = max(abs(twist) * cos_end - abs(w) * sin_end, _ZERO)
        sine2 = min(_QUARTER * (ax * ax + ay * ay + az * az) + beyond * beyond, _ONE)
        c = np.sqrt(_ONE - sine2)
        angle2 = sine2 * (_C0 + c * (_C1 + c * (_C2 + c * (_C3 + c * (_C4 + c * _C5)))))
        out[j] = log_w[j] - kp * (dx * dx + dy * dy + dz * dz) - ko * angle2


@njit(nogil=True, fastmath=True)
def _angle(m):  # type: ignore[no-untyped-def]
    return np.sqrt(m) * (_A0 + m * (_A1 + m * (_A2 + m * (_A3 + m * (_A4 + m * (_A5 + m * _A6))))))


@njit(nogil=True, fastmath=True)
def _limits_pair(ax, ay, az, bx, by, bz, ma, mb, cp, co, kp, ko):  # type: ignore[no-untyped-def]
    position = np.sqrt(ax * ax + ay * ay + az * az) + np.sqrt(bx * bx + by * by + bz * bz) - cp
    orientation = _angle(ma) + _angle(mb) - co
    return kp * position * position + ko * orientation * orientation


@njit(nogil=True, fastmath=True)
def _limits_row(o, inner, log_w, count, outer_is_parent, cp, co, kp, ko, out):  # type: ignore[no-untyped-def]
    x, y, z, qw, qx, qy, qz = inner[0], inner[1], inner[2], inner[6], inner[7], inner[8], inner[9]
    if outer_is_parent:
        ax, ay, az, aw, ai, aj, ak = o[0], o[1], o[2], o[6], o[7], o[8], o[9]
        bx, by, bz, bw, bi, bj, bk = o[3], o[4], o[5], o[10], o[11], o[12], o[13]
        for j in range(count):
            ma = _apart(aw, ai, aj, ak, qw[j], qx[j], qy[j], qz[j])
            mb = _apart(bw, bi, bj, bk, qw[j], qx[j], qy[j], qz[j])
            u, v, w = x[j], y[j], z[j]
            cost = _limits_pair(u - ax, v - ay, w - az, u - bx, v - by, w - bz, ma, mb, cp, co, kp, ko)
            out[j] = log_w[j] - cost
    else:
        u, v, w, cw, ci, cj, ck = o[0], o[1], o[2], o[6], o[7], o[8], o[9]
        x1, y1, z1 = inner[3], inner[4], inner[5]
        rw, rx, ry, rz = inner[10], inner[11], inner[12], inner[13]
        for j in range(count):
            ma = _apart(cw, ci, cj, ck, qw[j], qx[j], qy[j], qz[j])
            mb = _apart(cw, ci, cj, ck, rw[j], rx[j], ry[j], rz[j])
            cost = _limits_pair(
                u - x[j], v - y[j], w - z[j], u - x1[j], v - y1[j], w - z1[j], ma, mb, cp, co, kp, ko
            )
            out[j] = log_w[j] - cost


@njit(nogil=True, fastmath=True)
def _largest(values, count):  # type: ignore[no-untyped-def]
    top = _NOTHING
    for j in range(count):
        top = max(top, values[j])
    return top


@njit(nogil=True, fastmath=True)
def _sum_of_powers(values, count, top):  # type: ignore[no-untyped-def]
    total = _ZERO
    for j in range(count):
        power = max(values[j] - top, _LOWEST_POWER)
        whole = np.int32(np.floor(power))
        f = power - np.float32(whole)
        scale = np.int32((whole + _BIAS) << _MANTISSA).view(np.float32)
        total += scale * (_E0 + f * (_E1 + f * (_E2 + f * (_E3 + f * _E4))))
    return total


@njit(nogil=True)
def _lay_out(poses, frame, second, kind, is_parent, origin, fields):  # type: ignore[no-untyped-def]
    # fields: 0-2 position, 3-5 axis (or position of the second limit), 6-9 quaternion, 10-13 the second limit's
    limits = kind == LIMITS and is_parent
    for i in range(poses.shape[0]):
        px, py, pz = poses[i, 0] - origin[0], poses[i, 1] - origin[1], poses[i, 2] - origin[2]
        w, x, y, z = poses[i, 3], poses[i, 4], poses[i, 5], poses[i, 6]
        for k in range(2 if limits else 1):
            local = frame if k == 0 else second
            tx, ty, tz = local[0], local[1], local[2]
            cx, cy, cz = y * tz - z * ty, z * tx - x * tz, x * ty - y * tx
            position = 0 if k == 0 else 3
            fields[position, i] = px + tx + 2 * (w * cx + y * cz - z * cy)
            fields[position + 1, i] = py + ty + 2 * (w * cy + z * cx - x * cz)
            fields[position + 2, i] = pz + tz + 2 * (w * cz + x * cy - y * cx)
            bw, bx, by, bz = local[3], local[4], local[5], local[6]
            rw = w * bw - x * bx - y * by - z * bz
            rx = w * bx + x * bw + y * bz - z * by
            ry = w * by - x * bz + y * bw + z * bx
            rz = w * bz + x * by - y * bx + z * bw
            quaternion = 6 if k == 0 else 10
            fields[quaternion, i] = rw
            fields[quaternion + 1, i] = rx
            fields[quaternion + 2, i] = ry
            fields[quaternion + 3, i] = rz
            if kind != LIMITS:
                fields[3, i] = 2 * (rx * rz + rw * ry)
                fields[4, i] = 2 * (ry * rz - rw * rx)
                fields[5, i] = 1 - 2 * (rx * rx + ry * ry)


@njit(nogil=True)
def _prepare(  # type: ignore[no-untyped-def]
    kind, is_parent, frames_s, frames_t, seconds, poses_s, poses_t, log_weights, fields_s, fields_t, log2_w
):
    for q in range(poses_s.shape[0]):
        # Positions relative to one of the particles: float32 has no digits to spare for the distance to the world.
        origin = poses_t[q, 0, :3]
        _lay_out(poses_s[q], frames_s[q], seconds[q], kind[q], is_parent[q], origin, fields_s[q])
        _lay_out(poses_t[q], frames_t[q], seconds[q], kind[q], not is_parent[q], origin, fields_t[q])
        for j in range(poses_t.shape[1]):
            log2_w[q, j] = max(log_weights[q, j] * _LOG2E, -1e30)


@njit(nogil=True)
def _block(  # type: ignore[no-untyped-def]
    q, first, last, kind, is_parent, shape, kp, ko, fields_s, fields_t, log2_w, start, stop, result
):
    values = np.empty(log2_w.shape[1], np.float32)
    o = np.empty(14, np.float32)
    s0, s1 = shape[q, 0], shape[q, 1]
    for i in range(first, last):
        for k in range(14):
            o[k] = fields_s[q, k, i]
        begin, count = start[q, i], stop[q, i] - start[q, i]
        inner, log_w = fields_t[q, :, begin:], log2_w[q, begin:]
        if kind[q] == PRISMATIC:
            _prismatic_row(o, inner, log_w, count, is_parent[q], s0, s1, kp, ko, values)
        elif kind[q] == REVOLUTE:
            _revolute_row(o, inner, log_w, count, s0, s1, kp, ko, values)
        else:
            _limits_row(o, inner, log_w, count, is_parent[q], s0, s1, kp, ko, values)
        top = _largest(values, count)
        if top < np.float32(-1e29):
            result[q, i] = -np.inf
        else:
            total = _sum_of_powers(values, count, top)
            result[q, i] = (np.float64(top) + np.log2(np.float64(total))) / _LOG2E


@njit(nogil=True, cache=True)
def _serial(  # type: ignore[no-untyped-def]
    kind, is_parent, frames_s, frames_t, seconds, shape, kp, ko, poses_s, poses_t, log_weights, start, stop,
    fields_s, fields_t, log2_w, result,
):  # fmt: skip
    _prepare(kind, is_parent, frames_s, frames_t, seconds, poses_s, poses_t, log_weights, fields_s, fields_t, log2_w)
    for q in range(poses_s.shape[0]):
        _block(
            q, 0, poses_s.shape[1], kind, is_parent, shape, kp, ko, fields_s, fields_t, log2_w, start, stop, result
        )


@njit(nogil=True, cache=True, parallel=True)
def _parallel(  # type: ignore[no-untyped-def]
    kind, is_parent, frames_s, frames_t, seconds, shape, kp, ko, poses_s, poses_t, log_weights, start, stop,
    fields_s, fields_t, log2_w, result,
):  # fmt: skip
    _prepare(kind, is_parent, frames_s, frames_t, seconds, poses_s, poses_t, log_weights, fields_s, fields_t, log2_w)
    rows = poses_s.shape[1]
    blocks = (rows + _ROWS - 1) // _ROWS
    for b in prange(poses_s.shape[0] * blocks):
        q, first = b // blocks, (b % blocks) * _ROWS
        last = min(first + _ROWS, rows)
        _block(q, first, last, kind, is_parent, shape, kp, ko, fields_s, fields_t, log2_w, start, stop, result)


def joint_sums(
    kind: NDArray[np.int32],
    s_is_parent: NDArray[np.bool_],
    frames_s: NDArray[np.float64],
    frames_t: NDArray[np.float64],
    second_limits: NDArray[np.float64],
    shape: NDArray[np.float32],
    sigma_position: float,
    sigma_orientation: float,
    poses_s: NDArray[np.float64],
    poses_t: NDArray[np.float64],
    log_weights: NDArray[np.float64],
    start: NDArray[np.int32],
    stop: NDArray[np.int32],
) -> NDArray[np.float64]:
    """(Q, M): log sum_j exp(log_weights_j) psi(s_i, t_j), over j from start_i to before stop_i; -inf over none.

    kind : (Q,) PRISMATIC, REVOLUTE or LIMITS
    s_is_parent : (Q,) which end of the joint the samples i are
    frames_s, frames_t : (Q, 7) the joint's frame in the frame of s and of t, with the joint along z, and for REVOLUTE
        the parent's turned to the middle of the range; for LIMITS the lower limit pose of the child on the parent's
        side, the identity on the child's
    second_limits : (Q, 7) the upper limit pose of the child in the parent, used by LIMITS
    shape : (Q, 2) PRISMATIC: lower and upper, metres; REVOLUTE: cosine and sine of a quarter of the range (0 and 1
        for a whole turn); LIMITS: distance between the limit poses, metres and radians
    sigma_position, sigma_orientation : metres, radians
    poses_s : (Q, M, 7), poses_t : (Q, M2, 7), x y z qw qx qy qz, metres, world, contiguous
    log_weights : (Q, M2); start, stop : (Q, M), a range of t for each sample of s
    """
    jobs, rows, columns = poses_s.shape[0], poses_s.shape[1], poses_t.shape[1]
    result = np.full((jobs, rows), -np.inf)
    if jobs == 0 or rows == 0 or columns == 0:
        return result
    run = _parallel if jobs * rows * columns >= _PARALLEL_FROM else _serial
    run(
        kind, s_is_parent, frames_s, frames_t, second_limits, shape,
        np.float32(0.5 * _LOG2E / sigma_position**2), np.float32(0.5 * _LOG2E / sigma_orientation**2),
        poses_s, poses_t, log_weights, start, stop,
        np.empty((jobs, 14, rows), np.float32), np.empty((jobs, 14, columns), np.float32),
        np.empty((jobs, columns), np.float32), result,
    )  # fmt: skip
    return result
