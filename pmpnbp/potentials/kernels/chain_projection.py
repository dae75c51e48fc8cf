"""Which configuration of a chain of axes comes closest to a pose? Bounded least squares, compiled, one pose at a time.

Each pose is compared with a fixed set of starts through their linearisations, which do not depend on the pose and are
made once; the best few are refined by Levenberg-Marquardt steps, in which a free motion that a bound stops is held
there. Its witness in the tests is scipy's bounded least squares.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

_REFINED, _STEPS, _BLOCK = 2, 25, 64
_PARALLEL_FROM = 256


@njit(nogil=True)
def _compose(a, b, out):  # type: ignore[no-untyped-def]
    w, x, y, z = a[3], a[4], a[5], a[6]
    bx, by, bz = b[0], b[1], b[2]
    cx, cy, cz = y * bz - z * by + w * bx, z * bx - x * bz + w * by, x * by - y * bx + w * bz
    px, py, pz = (
        a[0] + bx + 2 * (y * cz - z * cy),
        a[1] + by + 2 * (z * cx - x * cz),
        a[2] + bz + 2 * (x * cy - y * cx),
    )
    bw, bi, bj, bk = b[3], b[4], b[5], b[6]
    out[3] = w * bw - x * bi - y * bj - z * bk
    out[4] = w * bi + x * bw + y * bk - z * bj
    out[5] = w * bj - x * bk + y * bw + z * bi
    out[6] = w * bk + x * bj - y * bi + z * bw
    out[0], out[1], out[2] = px, py, pz


@njit(nogil=True)
def _forward(before, revolute, axes, matrix, offset, q, end, along, origin, motion):  # type: ignore[no-untyped-def]
    """End of the chain (7,) at free motions q, and each axis's direction and place (K, 3) there."""
    for d in range(7):
        end[d] = 1.0 if d == 3 else 0.0
    for k in range(len(before)):
        _compose(end, before[k], end)
        position = offset[k]
        for f in range(len(q)):
            position += matrix[k, f] * q[f]
        ax, ay, az = axes[k, 0], axes[k, 1], axes[k, 2]
        w, x, y, z = end[3], end[4], end[5], end[6]
        cx, cy, cz = y * az - z * ay + w * ax, z * ax - x * az + w * ay, x * ay - y * ax + w * az
        along[k, 0] = ax + 2 * (y * cz - z * cy)
        along[k, 1] = ay + 2 * (z * cx - x * cz)
        along[k, 2] = az + 2 * (x * cy - y * cx)
        for d in range(3):
            origin[k, d] = end[d]
        if revolute[k]:
            sine = np.sin(position / 2)
            motion[0], motion[1], motion[2] = 0.0, 0.0, 0.0
            motion[3], motion[4], motion[5], motion[6] = np.cos(position / 2), sine * ax, sine * ay, sine * az
            _compose(end, motion, end)
        else:
            for d in range(3):
                end[d] += position * along[k, d]


@njit(nogil=True)
def _error(end, target, length, error):  # type: ignore[no-untyped-def]
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


@njit(nogil=True)
def _slopes(revolute, matrix, end, along, origin, length, jacobian):  # type: ignore[no-untyped-def]
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


@njit(nogil=True)
def _solve(a, b):  # type: ignore[no-untyped-def]
    """b <- a^-1 b, for a symmetric positive a, which is used up (Cholesky)."""
    n = len(b)
    for i in range(n):
        for j in range(i + 1):
            total = a[i, j]
            for k in range(j):
                total -= a[i, k] * a[j, k]
            a[i, j] = np.sqrt(max(total, 1e-300)) if i == j else total / a[j, j]
    for i in range(n):
        for k in range(i):
            b[i] -= a[i, k] * b[k]
        b[i] /= a[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= a[k, i] * b[k]
        b[i] /= a[i, i]


@njit(nogil=True)
def _normal_equations(jacobian, error, normal, gradient):  # type: ignore[no-untyped-def]
    """Fills J^T J (F, F) and J^T e (F,), and returns the trace of the former."""
    size = 1e-12
    for f in range(len(gradient)):
        gradient[f] = 0.0
        for d in range(6):
            gradient[f] += jacobian[d, f] * error[d]
        for g in range(f + 1):
            total = 0.0
            for d in range(6):
                total += jacobian[d, f] * jacobian[d, g]
            normal[f, g] = total
            normal[g, f] = total
        size += normal[f, f]
    return size


@njit(nogil=True)
def _bounded_step(normal, gradient, damping, q, lower, upper, wraps, held, work, change):  # type: ignore[no-untyped-def]
    """The damped step, the first F of `change`: a free motion that would leave its bounds goes to the bound.

    The other F of `change`, and `held` and `work`, are scratch.
    """
    free = len(q)
    for f in range(free):
        against = (q[f] <= lower[f] and gradient[f] < 0) or (q[f] >= upper[f] and gradient[f] > 0)
        held[f] = against and not wraps[f]
        change[f] = 0.0
    # Each pass holds one more at least; what is held at its bound pulls on the others through the normal equations.
    for _ in range(free + 1):
        for f in range(free):
            right = gradient[f]
            for g in range(free):
                if held[g]:
                    right -= normal[f, g] * change[g]
                work[f, g] = 0.0 if held[f] or held[g] else normal[f, g]
            work[f, f] = 1.0 if held[f] else normal[f, f] + damping
            change[free + f] = change[f] if held[f] else right
        _solve(work, change[free:])
        stopped = False
        for f in range(free):
            if not held[f]:
                change[f] = change[free + f]
                if not wraps[f] and (q[f] + change[f] < lower[f] or q[f] + change[f] > upper[f]):
                    change[f] = min(max(change[f], lower[f] - q[f]), upper[f] - q[f])
                    held[f] = True
                    stopped = True
        if not stopped:
            break


@njit(nogil=True)
def _rank(starts, ends, jacobians, steps, lower, upper, wraps, target, length, error, chosen, costs):  # type: ignore[no-untyped-def]
    """The `_REFINED` starts (indices in `chosen`) whose linearised problem leaves least."""
    for slot in range(len(costs)):
        costs[slot], chosen[slot] = np.inf, 0
    for s in range(len(starts)):
        _error(ends[s], target, length, error)
        for f in range(starts.shape[1]):
            change = 0.0
            for d in range(6):
                change += steps[s, f, d] * error[d]
            if not wraps[f]:
                change = min(max(change, lower[f] - starts[s, f]), upper[f] - starts[s, f])
            steps[s, f, 6] = change
        cost = 0.0
        for d in range(6):
            left = error[d]
            for f in range(starts.shape[1]):
                left -= jacobians[s, d, f] * steps[s, f, 6]
            cost += left * left
        slot = len(costs)
        while slot > 0 and cost < costs[slot - 1]:
            slot -= 1
        if slot < len(costs):
            for later in range(len(costs) - 1, slot, -1):
                costs[later], chosen[later] = costs[later - 1], chosen[later - 1]
            costs[slot], chosen[slot] = cost, s


@njit(nogil=True)
def _project(  # type: ignore[no-untyped-def]
    before,
    revolute,
    axes,
    matrix,
    offset,
    lower,
    upper,
    wraps,
    starts,
    ends,
    jacobians,
    linear,
    targets,
    length,
    first,
    last,
    result,
):
    depth, free = matrix.shape
    steps = linear.copy()
    end, motion, error, trial_error = np.empty(7), np.empty(7), np.empty(6), np.empty(6)
    along, origin = np.empty((depth, 3)), np.empty((depth, 3))
    jacobian, normal, work = np.empty((6, free)), np.empty((free, free)), np.empty((free, free))
    gradient, change, held = np.empty(free), np.empty(2 * free), np.empty(free, np.bool_)
    q, trial = np.empty(free), np.empty(free)
    chosen, costs = np.empty(min(_REFINED, len(starts)), np.int64), np.empty(min(_REFINED, len(starts)))
    for b in range(first, last):
        target = targets[b]
        _rank(starts, ends, jacobians, steps, lower, upper, wraps, target, length, error, chosen, costs)
        least = np.inf
        for rank in range(len(chosen)):
            for f in range(free):
                q[f] = starts[chosen[rank], f]
            _forward(before, revolute, axes, matrix, offset, q, end, along, origin, motion)
            cost = _error(end, target, length, error)
            damping, growth, settled = 1e-4, 2.0, False
            _slopes(revolute, matrix, end, along, origin, length, jacobian)
            size = _normal_equations(jacobian, error, normal, gradient)
            for _ in range(_STEPS):
                _bounded_step(normal, gradient, damping * size, q, lower, upper, wraps, held, work, change)
                promised = 1e-300
                for f in range(free):
                    promised += 2 * gradient[f] * change[f]
                    for g in range(free):
                        promised -= change[f] * normal[f, g] * change[g]
                    trial[f] = q[f] + change[f]
                    if wraps[f]:
                        trial[f] = lower[f] + (trial[f] - lower[f]) % (2 * np.pi)
                _forward(before, revolute, axes, matrix, offset, trial, end, along, origin, motion)
                reached = _error(end, target, length, trial_error)
                if reached < cost:
                    settled = damping < 1e-2 and cost - reached <= 1e-9 * cost + 1e-18
                    before_step, cost = cost, reached
                    for f in range(free):
                        q[f] = min(max(trial[f], lower[f]), upper[f])
                    if settled:
                        break
                    for d in range(6):
                        error[d] = trial_error[d]
                    # A linear model that promised much more than came does not deserve a longer step.
                    gain = (before_step - reached) / promised
                    damping = max(damping / 10, 1e-9) if gain > 0.75 else damping * 4 if gain < 0.5 else damping
                    growth = 2.0
                    _slopes(revolute, matrix, end, along, origin, length, jacobian)
                    size = _normal_equations(jacobian, error, normal, gradient)
                else:
                    damping, growth = damping * growth, growth * 2
                    if damping > 1e6:
                        break
            if cost < least:
                least = cost
                for f in range(free):
                    result[b, f] = q[f]


@njit(nogil=True)
def _linearise(before, revolute, axes, matrix, offset, starts, length, ends, jacobians, linear):  # type: ignore[no-untyped-def]
    """At every start the chain's end, how it moves, and the step (F, 6) that an error there asks for."""
    depth, free = matrix.shape
    along, origin, motion = np.empty((depth, 3)), np.empty((depth, 3)), np.empty(7)
    normal, column, unit = np.empty((free, free)), np.empty(free), np.zeros(6)
    for s in range(len(starts)):
        _forward(before, revolute, axes, matrix, offset, starts[s], ends[s], along, origin, motion)
        _slopes(revolute, matrix, ends[s], along, origin, length, jacobians[s])
        for d in range(6):
            unit[d] = 1.0
            size = _normal_equations(jacobians[s], unit, normal, column)
            unit[d] = 0.0
            for f in range(free):
                normal[f, f] += 1e-3 * size
            _solve(normal, column)
            for f in range(free):
                linear[s, f, d] = column[f]


@njit(nogil=True, cache=True)
def _serial(  # type: ignore[no-untyped-def]
    before,
    revolute,
    axes,
    matrix,
    offset,
    lower,
    upper,
    wraps,
    starts,
    targets,
    length,
    ends,
    jacobians,
    linear,
    result,
):
    _linearise(before, revolute, axes, matrix, offset, starts, length, ends, jacobians, linear)
    _project(
        before,
        revolute,
        axes,
        matrix,
        offset,
        lower,
        upper,
        wraps,
        starts,
        ends,
        jacobians,
        linear,
        targets,
        length,
        0,
        len(targets),
        result,
    )


@njit(nogil=True, cache=True, parallel=True)
def _parallel(  # type: ignore[no-untyped-def]
    before,
    revolute,
    axes,
    matrix,
    offset,
    lower,
    upper,
    wraps,
    starts,
    targets,
    length,
    ends,
    jacobians,
    linear,
    result,
):
    _linearise(before, revolute, axes, matrix, offset, starts, length, ends, jacobians, linear)
    for block in prange((len(targets) + _BLOCK - 1) // _BLOCK):
        first, last = block * _BLOCK, min((block + 1) * _BLOCK, len(targets))
        _project(
            before,
            revolute,
            axes,
            matrix,
            offset,
            lower,
            upper,
            wraps,
            starts,
            ends,
            jacobians,
            linear,
            targets,
            length,
            first,
            last,
            result,
        )


def nearest_on_chain(
    before: NDArray[np.float64],
    revolute: NDArray[np.bool_],
    axes: NDArray[np.float64],
    matrix: NDArray[np.float64],
    offset: NDArray[np.float64],
    lower: NDArray[np.float64],
    upper: NDArray[np.float64],
    wraps: NDArray[np.bool_],
    starts: NDArray[np.float64],
    targets: NDArray[np.float64],
    length: float,
) -> NDArray[np.float64]:
    """Free motions (B, F) within bounds whose chain end comes closest to `targets`.

    The chain's end is before_0 * motion_0 … before_K-1 * motion_K-1, with axis k moved by entry k of matrix @ free +
    offset. What is least is |position|² + (length * angle)² between it and the target, metres².

    before : (K, 7) poses x y z qw qx qy qz; revolute : (K,); axes : (K, 3) unit vectors
    matrix : (K, F); offset : (K,); lower, upper, wraps : (F,), a free motion that wraps is an angle without bounds
    starts : (S, F) where to look from; targets : (B, 7)
    """
    count, free = starts.shape
    result = np.empty((len(targets), free))
    run = _parallel if len(targets) >= _PARALLEL_FROM else _serial
    run(
        before,
        revolute,
        axes,
        matrix,
        offset,
        lower,
        upper,
        wraps,
        starts,
        targets,
        length,
        np.empty((count, 7)),
        np.empty((count, 6, free)),
        np.zeros((count, free, 7)),
        result,
    )
    return result
