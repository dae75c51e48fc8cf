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

from typing import Any, NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from pmpnbp.potentials.kernels.compiling import inner, kernel
from pmpnbp.potentials.kernels.pose_algebra import seven, turned

PRISMATIC, REVOLUTE, LIMITS, LIMITS_SLIDE, LIMITS_TURN = 0, 1, 2, 3, 4

# Rows that share a scratch buffer, and the number of pairs from which a second thread pays for its start.
_ROWS = 32
_PARALLEL_FROM = 400_000
# What is laid out of a particle: position, axis (or the second limit's position), quaternion, the second limit's.
_FIELDS = 14

_LOG2E = float(np.log2(np.e))
# Stands for minus the log of zero: far beyond anything reachable, and far from the end of float32.
_NOTHING, _REACHABLE = np.float32(1e30), np.float32(1e29)
_LOWEST_POWER = np.float32(-100.0)
# Minima are taken of the bits: floats from 0 up are in the order of their bits as integers, and LLVM vectorises the
# minimum of integers but not that of floats. A cost that rounding took below 0 may be mistaken for the least: no harm,
# it is as good a reference for the sum.
_LARGEST = np.int32(0x7F000000)


def _fit(values: Any, upper: float, degree: int) -> tuple[np.float32, ...]:
    # Interpolation at Chebyshev points is within a factor of about two of the best polynomial.
    nodes = upper / 2 * (1 - np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1)))
    series = np.polynomial.Polynomial.fit(nodes, values(nodes), degree).convert().coef
    return tuple(np.float32(c) for c in series)


# angle / |a - b| for unit quaternions a, b at most half a turn apart, by m = |a - b|² in 0..2: angle = 4 asin(|a-b|/2).
_ANGLE = _fit(lambda m: 4 * np.arcsin(np.sqrt(m) / 2) / np.sqrt(m), 2.0 + 1e-6, 6)
_ANGLE_SQUARED = _fit(lambda m: 16 * np.arcsin(np.sqrt(m) / 2) ** 2 / m, 2.0 + 1e-6, 5)  # / |a - b|², likewise
# angle² / sin²(angle/2) by the cosine of the half angle, 0..1.
_SWING_SQUARED = _fit(lambda x: 4 * np.arccos(x) ** 2 / (1 - x * x), 1.0, 7)
# 2 ** f for f in 0..1
_EXP2 = _fit(np.exp2, 1.0, 4)

_A0, _A1, _A2, _A3, _A4, _A5, _A6 = _ANGLE
_B0, _B1, _B2, _B3, _B4, _B5 = _ANGLE_SQUARED
_C0, _C1, _C2, _C3, _C4, _C5, _C6, _C7 = _SWING_SQUARED
_E0, _E1, _E2, _E3, _E4 = _EXP2

_ONE, _FOUR, _QUARTER, _ZERO = np.float32(1), np.float32(4), np.float32(0.25), np.float32(0)
_BIAS, _MANTISSA = np.int32(127), np.int32(23)


@inner(fastmath=True)
def _apart(aw, ax, ay, az, bw, bx, by, bz):  # type: ignore[no-untyped-def]
    # |a - b|² of the nearer of b and -b
    dw, dx, dy, dz = aw - bw, ax - bx, ay - by, az - bz
    m = dw * dw + dx * dx + dy * dy + dz * dz
    return min(m, _FOUR - m)


@inner(fastmath=True)
def _angle(m):  # type: ignore[no-untyped-def]
    return np.sqrt(m) * (_A0 + m * (_A1 + m * (_A2 + m * (_A3 + m * (_A4 + m * (_A5 + m * _A6))))))


@inner(fastmath=True)
def _angle_squared(m):  # type: ignore[no-untyped-def]
    return m * (_B0 + m * (_B1 + m * (_B2 + m * (_B3 + m * (_B4 + m * _B5)))))


@inner(fastmath=True)
def _off_slide(nx, ny, nz, lower, upper, dx, dy, dz):  # type: ignore[no-untyped-def]
    along = min(max(nx * dx + ny * dy + nz * dz, lower), upper)
    rx, ry, rz = dx - along * nx, dy - along * ny, dz - along * nz
    return rx * rx + ry * ry + rz * rz


@inner(fastmath=True)
def _prismatic_row(o, t, behind, begin, end, outer_is_parent, lower, upper, kp, ko, out):  # type: ignore[no-untyped-def]
    x, y, z, nx, ny, nz, qw, qx, qy, qz = o[0], o[1], o[2], o[3], o[4], o[5], o[6], o[7], o[8], o[9]
    least = _LARGEST
    if outer_is_parent:
        for j in range(begin, end):
            off = _off_slide(nx, ny, nz, lower, upper, t[0, j] - x, t[1, j] - y, t[2, j] - z)
            turn = _angle_squared(_apart(qw, qx, qy, qz, t[6, j], t[7, j], t[8, j], t[9, j]))
            cost = behind[j] + kp * off + ko * turn
            out[j] = cost
            least = min(least, np.float32(cost).view(np.int32))
    else:
        for j in range(begin, end):
            off = _off_slide(t[3, j], t[4, j], t[5, j], lower, upper, x - t[0, j], y - t[1, j], z - t[2, j])
            turn = _angle_squared(_apart(qw, qx, qy, qz, t[6, j], t[7, j], t[8, j], t[9, j]))
            cost = behind[j] + kp * off + ko * turn
            out[j] = cost
            least = min(least, np.float32(cost).view(np.int32))
    return np.int32(least).view(np.float32)


@inner(fastmath=True)
def _revolute_row(o, t, behind, begin, end, cos_end, sin_end, kp, ko, out):  # type: ignore[no-untyped-def]
    x, y, z, nx, ny, nz, qw, qx, qy, qz = o[0], o[1], o[2], o[3], o[4], o[5], o[6], o[7], o[8], o[9]
    least = _LARGEST
    for j in range(begin, end):
        dx, dy, dz = t[0, j] - x, t[1, j] - y, t[2, j] - z
        ax, ay, az = t[3, j] - nx, t[4, j] - ny, t[5, j] - nz
        cosine = qw * t[6, j] + qx * t[7, j] + qy * t[8, j] + qz * t[9, j]
        sine = qw * t[9, j] - qx * t[8, j] + qy * t[7, j] - qz * t[6, j]
        beyond = max(abs(sine) * cos_end - abs(cosine) * sin_end, _ZERO)
        sine2 = min(_QUARTER * (ax * ax + ay * ay + az * az) + beyond * beyond, _ONE)
        c = np.sqrt(_ONE - sine2)
        ratio = _C0 + c * (_C1 + c * (_C2 + c * (_C3 + c * (_C4 + c * (_C5 + c * (_C6 + c * _C7))))))
        cost = behind[j] + kp * (dx * dx + dy * dy + dz * dz) + ko * sine2 * ratio
        out[j] = cost
        least = min(least, np.float32(cost).view(np.int32))
    return np.int32(least).view(np.float32)


@inner(fastmath=True)
def _limits_cost(kind, ax, ay, az, bx, by, bz, ma, mb, cp, co, kp, ko):  # type: ignore[no-untyped-def]
    # eq. 11
    a2 = ax * ax + ay * ay + az * az
    if kind == LIMITS_TURN:
        position2 = _FOUR * a2
    else:
        position = np.sqrt(a2) + np.sqrt(bx * bx + by * by + bz * bz) - cp
        position2 = position * position
    if kind == LIMITS_SLIDE:
        orientation2 = _FOUR * _angle_squared(ma)
    else:
        orientation = _angle(ma) + _angle(mb) - co
        orientation2 = orientation * orientation
    return kp * position2 + ko * orientation2


@inner(fastmath=True)
def _limits_given_parent(kind, o, t, behind, begin, end, cp, co, kp, ko, out):  # type: ignore[no-untyped-def]
    ax, ay, az, aw, ai, aj, ak = o[0], o[1], o[2], o[6], o[7], o[8], o[9]
    bx, by, bz, bw, bi, bj, bk = o[3], o[4], o[5], o[10], o[11], o[12], o[13]
    least = _LARGEST
    for j in range(begin, end):
        x, y, z = t[0, j], t[1, j], t[2, j]
        ma = _apart(aw, ai, aj, ak, t[6, j], t[7, j], t[8, j], t[9, j])
        mb = _apart(bw, bi, bj, bk, t[6, j], t[7, j], t[8, j], t[9, j])
        cost = behind[j] + _limits_cost(kind, x - ax, y - ay, z - az, x - bx, y - by, z - bz, ma, mb, cp, co, kp, ko)
        out[j] = cost
        least = min(least, np.float32(cost).view(np.int32))
    return np.int32(least).view(np.float32)


@inner(fastmath=True)
def _limits_given_child(kind, o, t, behind, begin, end, cp, co, kp, ko, out):  # type: ignore[no-untyped-def]
    x, y, z, qw, qx, qy, qz = o[0], o[1], o[2], o[6], o[7], o[8], o[9]
    least = _LARGEST
    for j in range(begin, end):
        ax, ay, az, bx, by, bz = t[0, j], t[1, j], t[2, j], t[3, j], t[4, j], t[5, j]
        ma = _apart(qw, qx, qy, qz, t[6, j], t[7, j], t[8, j], t[9, j])
        mb = _apart(qw, qx, qy, qz, t[10, j], t[11, j], t[12, j], t[13, j])
        cost = behind[j] + _limits_cost(kind, x - ax, y - ay, z - az, x - bx, y - by, z - bz, ma, mb, cp, co, kp, ko)
        out[j] = cost
        least = min(least, np.float32(cost).view(np.int32))
    return np.int32(least).view(np.float32)


@inner(fastmath=True)
def _limits_row(kind, o, t, behind, begin, end, outer_is_parent, cp, co, kp, ko, out):  # type: ignore[no-untyped-def]
    # The constants let the compiler drop what a kind does not need: half of the square roots.
    if outer_is_parent:
        if kind == LIMITS_SLIDE:
            return _limits_given_parent(LIMITS_SLIDE, o, t, behind, begin, end, cp, co, kp, ko, out)
        if kind == LIMITS_TURN:
            return _limits_given_parent(LIMITS_TURN, o, t, behind, begin, end, cp, co, kp, ko, out)
        return _limits_given_parent(LIMITS, o, t, behind, begin, end, cp, co, kp, ko, out)
    if kind == LIMITS_SLIDE:
        return _limits_given_child(LIMITS_SLIDE, o, t, behind, begin, end, cp, co, kp, ko, out)
    if kind == LIMITS_TURN:
        return _limits_given_child(LIMITS_TURN, o, t, behind, begin, end, cp, co, kp, ko, out)
    return _limits_given_child(LIMITS, o, t, behind, begin, end, cp, co, kp, ko, out)


@inner(fastmath=True)
def _sum_of_powers(values, begin, end, least):  # type: ignore[no-untyped-def]
    total = _ZERO
    for j in range(begin, end):
        power = max(least - values[j], _LOWEST_POWER)
        whole = np.int32(np.floor(power))
        f = power - np.float32(whole)
        scale = np.int32((whole + _BIAS) << _MANTISSA).view(np.float32)
        total += scale * (_E0 + f * (_E1 + f * (_E2 + f * (_E3 + f * _E4))))
    return total


@inner
def _lay_out(poses, frame, second, kind, is_parent, origin, fields):  # type: ignore[no-untyped-def]
    # fields: 0-2 position, 3-5 axis (or position of the second limit), 6-9 quaternion, 10-13 the second limit's
    limits = kind >= LIMITS and is_parent
    for i in range(poses.shape[0]):
        px, py, pz = poses[i, 0] - origin[0], poses[i, 1] - origin[1], poses[i, 2] - origin[2]
        pose = seven(poses[i])
        w, x, y, z = pose[3], pose[4], pose[5], pose[6]
        for k in range(2 if limits else 1):
            local, position, quaternion = (frame, 0, 6) if k == 0 else (second, 3, 10)
            tx, ty, tz = local[0], local[1], local[2]
            cx, cy, cz = y * tz - z * ty, z * tx - x * tz, x * ty - y * tx
            fields[position, i] = px + tx + 2 * (w * cx + y * cz - z * cy)
            fields[position + 1, i] = py + ty + 2 * (w * cy + z * cx - x * cz)
            fields[position + 2, i] = pz + tz + 2 * (w * cz + x * cy - y * cx)
            rw, rx, ry, rz = turned(pose, local[3], local[4], local[5], local[6])
            fields[quaternion, i] = rw
            fields[quaternion + 1, i] = rx
            fields[quaternion + 2, i] = ry
            fields[quaternion + 3, i] = rz
            if kind < LIMITS:
                fields[3, i] = 2 * (rx * rz + rw * ry)
                fields[4, i] = 2 * (ry * rz - rw * rx)
                fields[5, i] = 1 - 2 * (rx * rx + ry * ry)


@inner
def _prepare(jobs, laid_out):  # type: ignore[no-untyped-def]
    """Fills `laid_out`: the fields of s and t, how far each t's log weight lies behind the highest, and that."""
    kind, is_parent, frames_s, frames_t, seconds, _, poses_s, poses_t, log_weights, _, _ = jobs
    fields_s, fields_t, behind, highest = laid_out
    for q in range(poses_s.shape[0]):
        # Positions relative to one of the particles: float32 has no digits to spare for the distance to the world.
        origin = poses_t[q, 0, :3]
        _lay_out(poses_s[q], frames_s[q], seconds[q], kind[q], is_parent[q], origin, fields_s[q])
        _lay_out(poses_t[q], frames_t[q], seconds[q], kind[q], not is_parent[q], origin, fields_t[q])
        highest[q] = -np.inf
        for j in range(poses_t.shape[1]):
            highest[q] = max(highest[q], log_weights[q, j])
        for j in range(poses_t.shape[1]):
            lost = np.isneginf(log_weights[q, j])
            behind[q, j] = _NOTHING if lost else min((highest[q] - log_weights[q, j]) * _LOG2E, _NOTHING)


@inner
def _block(q, first, last, jobs, kp, ko, laid_out, result):  # type: ignore[no-untyped-def]
    """Rows `first` to `last` of job q. kp, ko : what a squared metre and a squared radian cost"""
    kind, is_parent, _, _, _, shape, _, _, _, start, stop = jobs
    fields_s, fields_t, behind, highest = laid_out
    values = np.empty(behind.shape[1], np.float32)
    o = np.empty(_FIELDS, np.float32)
    t, behind_t = fields_t[q], behind[q]
    s0, s1 = shape[q, 0], shape[q, 1]
    for i in range(first, last):
        for k in range(_FIELDS):
            o[k] = fields_s[q, k, i]
        # Unsigned, or every index would be tested for one counted from the end, and the loops stay scalar.
        begin, end = np.uint64(start[q, i]), np.uint64(stop[q, i])
        if kind[q] == PRISMATIC:
            least = _prismatic_row(o, t, behind_t, begin, end, is_parent[q], s0, s1, kp, ko, values)
        elif kind[q] == REVOLUTE:
            least = _revolute_row(o, t, behind_t, begin, end, s0, s1, kp, ko, values)
        else:
            least = _limits_row(kind[q], o, t, behind_t, begin, end, is_parent[q], s0, s1, kp, ko, values)
        if begin >= end or least > _REACHABLE:
            result[q, i] = -np.inf
        else:
            total = _sum_of_powers(values, begin, end, least)
            result[q, i] = highest[q] + (np.log2(np.float64(total)) - np.float64(least)) / _LOG2E


@kernel
def _serial(jobs, kp, ko, laid_out, result):  # type: ignore[no-untyped-def]
    _prepare(jobs, laid_out)
    for q in range(result.shape[0]):
        _block(q, np.int64(0), result.shape[1], jobs, kp, ko, laid_out, result)


@kernel(parallel=True)
def _parallel(jobs, kp, ko, laid_out, result):  # type: ignore[no-untyped-def]
    _prepare(jobs, laid_out)
    rows = result.shape[1]
    blocks = (rows + _ROWS - 1) // _ROWS
    for b in prange(result.shape[0] * blocks):
        q, first = b // blocks, (b % blocks) * _ROWS
        _block(q, first, min(first + _ROWS, rows), jobs, kp, ko, laid_out, result)


class Jobs(NamedTuple):
    """Q sums to be done, each over a joint between samples s_i, i < M, and t_j, j < M2.

    kind : (Q,) PRISMATIC or REVOLUTE (the residual after projection), or LIMITS (eq. 11); LIMITS_SLIDE and LIMITS_TURN
        are the same as LIMITS, cheaper, where the two limit poses share their orientation or their position
    s_is_parent : (Q,) which end of the joint the samples s are
    frames_s, frames_t : (Q, 7) the joint's frame in the frame of s and of t, with the joint along z, and for REVOLUTE
        the parent's turned to the middle of the range; for LIMITS the lower limit pose of the child on the parent's
        side, the identity on the child's
    second_limits : (Q, 7) the upper limit pose of the child in the parent, used by LIMITS
    shape : (Q, 2) PRISMATIC: lower and upper, metres; REVOLUTE: cosine and sine of a quarter of the range (0 and 1
        for a whole turn); LIMITS: distance between the limit poses, metres and radians
    poses_s : (Q, M, 7), poses_t : (Q, M2, 7), x y z qw qx qy qz, metres, world, contiguous
    log_weights : (Q, M2), of t
    start, stop : (Q, M), which t each s_i meets: from start to before stop
    """

    kind: NDArray[np.int32]
    s_is_parent: NDArray[np.bool_]
    frames_s: NDArray[np.float64]
    frames_t: NDArray[np.float64]
    second_limits: NDArray[np.float64]
    shape: NDArray[np.float32]
    poses_s: NDArray[np.float64]
    poses_t: NDArray[np.float64]
    log_weights: NDArray[np.float64]
    start: NDArray[np.int32]
    stop: NDArray[np.int32]

    def only(self, rows: NDArray[np.intp]) -> Jobs:
        """Those of `rows`."""
        return Jobs._make(member[rows] for member in self)


def joint_sums(jobs: Jobs, sigma_position: float, sigma_orientation: float) -> NDArray[np.float64]:
    """(Q, M): log sum_j exp(log_weights_j) psi(s_i, t_j) over the t_j that s_i meets; -inf where it meets none."""
    count, rows, columns = *jobs.poses_s.shape[:2], jobs.poses_t.shape[1]
    result = np.full((count, rows), -np.inf)
    if count == 0 or rows == 0 or columns == 0:
        return result
    run = _parallel if count * rows * columns >= _PARALLEL_FROM else _serial
    laid_out = (
        np.empty((count, _FIELDS, rows), np.float32),
        np.empty((count, _FIELDS, columns), np.float32),
        np.empty((count, columns), np.float32),
        np.empty(count),
    )
    kp, ko = (np.float32(0.5 * _LOG2E / sigma**2) for sigma in (sigma_position, sigma_orientation))
    # a plain tuple: numba takes half a millisecond to recognise a named one
    run(tuple(jobs), kp, ko, laid_out, result)
    return result
