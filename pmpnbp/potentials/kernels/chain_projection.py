"""Which configuration of a chain of axes comes closest to a pose? Bounded least squares, compiled, one pose at a time.

Each pose is compared with a fixed set of starts through their linearisations, which do not depend on the pose and are
made once; the best few are refined by Levenberg-Marquardt steps, in which a free motion that a bound stops is held
there. Its witness in the tests is scipy's bounded least squares.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange
from numpy.typing import NDArray

from pmpnbp.potentials.kernels.chain_kinematics import Chain, forward, pose_error, slopes
from pmpnbp.potentials.kernels.compiling import inner, kernel

# Starts that are refined, the most steps of each, and the poses that a thread takes at a time.
_REFINED, _STEPS, _BLOCK = 2, 25, 64
# Poses from which a second thread pays for its start.
_PARALLEL_FROM = 256

# Damping is relative to the trace of the normal equations. It grows after a step that made things worse, ever faster
# (Nielsen 1999), and shrinks after one that gained most of what the linear model had promised.
_DAMPING, _LEAST_DAMPING, _MOST_DAMPING = 1e-4, 1e-9, 1e6
_GOOD_GAIN, _POOR_GAIN = 0.75, 0.5
# At rest: hardly damped, a step gains less than this share of the squared error, or than this many square metres.
_HARDLY_DAMPED, _SHARE_AT_REST, _AT_REST = 1e-2, 1e-9, 1e-18
# Of the linearisation at a start, which is good far off only where it is damped.
_START_DAMPING = 1e-3
# Keeps divisions and roots off zero.
_TINY, _TINY_TRACE = 1e-300, 1e-12


class _Starts(NamedTuple):
    """Free motions (S, F) to look from, the chain's end (S, 7) there, how it moves (S, 6, F), and the step (S, F, 6)
    that an error there asks for."""

    motions: NDArray[np.float64]
    ends: NDArray[np.float64]
    jacobians: NDArray[np.float64]
    steps: NDArray[np.float64]


class _Workspace(NamedTuple):
    """What refining a pose writes to: arrays that are made once for many poses.

    q, trial : (F,) free motions, accepted and tried; end, along, origin : see `forward`
    error, trial_error : (6,); jacobian, normal, gradient : see `slopes` and `_normal_equations`
    change, held, work : see `_bounded_step`
    """

    q: NDArray[np.float64]
    trial: NDArray[np.float64]
    end: NDArray[np.float64]
    along: NDArray[np.float64]
    origin: NDArray[np.float64]
    error: NDArray[np.float64]
    trial_error: NDArray[np.float64]
    jacobian: NDArray[np.float64]
    normal: NDArray[np.float64]
    gradient: NDArray[np.float64]
    change: NDArray[np.float64]
    held: NDArray[np.bool_]
    work: NDArray[np.float64]


@inner
def _solve(a, b):  # type: ignore[no-untyped-def]
    """b <- a^-1 b, for a symmetric positive a, which is used up (Cholesky)."""
    n = len(b)
    for i in range(n):
        for j in range(i + 1):
            total = a[i, j]
            for k in range(j):
                total -= a[i, k] * a[j, k]
            a[i, j] = np.sqrt(max(total, _TINY)) if i == j else total / a[j, j]
    for i in range(n):
        for k in range(i):
            b[i] -= a[i, k] * b[k]
        b[i] /= a[i, i]
    for i in range(n - 1, -1, -1):
        for k in range(i + 1, n):
            b[i] -= a[k, i] * b[k]
        b[i] /= a[i, i]


@inner
def _normal_equations(jacobian, error, normal, gradient):  # type: ignore[no-untyped-def]
    """Fills J^T J (F, F) and J^T e (F,), and returns the trace of the former."""
    size = _TINY_TRACE
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


@inner
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


@inner
def _rank(chain, starts, target, error, change, chosen, costs):  # type: ignore[no-untyped-def]
    """The `_REFINED` starts (indices in `chosen`) whose linearised problem leaves least."""
    lower, upper, wraps, length = chain.lower, chain.upper, chain.wraps, chain.length
    motions, ends, jacobians, steps = starts
    for slot in range(len(costs)):
        costs[slot], chosen[slot] = np.inf, 0
    for s in range(len(motions)):
        pose_error(ends[s], target, length, error)
        for f in range(len(lower)):
            step = 0.0
            for d in range(6):
                step += steps[s, f, d] * error[d]
            if not wraps[f]:
                step = min(max(step, lower[f] - motions[s, f]), upper[f] - motions[s, f])
            change[f] = step
        cost = 0.0
        for d in range(6):
            left = error[d]
            for f in range(len(lower)):
                left -= jacobians[s, d, f] * change[f]
            cost += left * left
        slot = len(costs)
        while slot > 0 and cost < costs[slot - 1]:
            slot -= 1
        if slot < len(costs):
            for later in range(len(costs) - 1, slot, -1):
                costs[later], chosen[later] = costs[later - 1], chosen[later - 1]
            costs[slot], chosen[slot] = cost, s


@inner
def _try_step(normal, gradient, change, q, lower, wraps, trial):  # type: ignore[no-untyped-def]
    """Fills `trial` with the free motions `q` after the step `change`; returns what that gains by the linear model."""
    promised = _TINY
    for f in range(len(q)):
        promised += 2 * gradient[f] * change[f]
        for g in range(len(q)):
            promised -= change[f] * normal[f, g] * change[g]
        trial[f] = q[f] + change[f]
        if wraps[f]:
            trial[f] = lower[f] + (trial[f] - lower[f]) % (2 * np.pi)
    return promised


# Inlined, or counting references to the members of two tuples costs a tenth of the time.
@inner(inline="always")
def _refine(chain, target, at):  # type: ignore[no-untyped-def]
    """Levenberg-Marquardt from the free motions `at.q`, which are moved to where the squared error is least nearby;
    returns that."""
    before, revolute, axes, matrix, offset, lower, upper, wraps, length = chain
    q, trial, end, along, origin, error, trial_error, jacobian, normal, gradient, change, held, work = at
    forward(before, revolute, axes, matrix, offset, q, end, along, origin)
    cost = pose_error(end, target, length, error)
    damping, growth = _DAMPING, 2.0
    slopes(revolute, matrix, end, along, origin, length, jacobian)
    size = _normal_equations(jacobian, error, normal, gradient)
    for _ in range(_STEPS):
        _bounded_step(normal, gradient, damping * size, q, lower, upper, wraps, held, work, change)
        promised = _try_step(normal, gradient, change, q, lower, wraps, trial)
        forward(before, revolute, axes, matrix, offset, trial, end, along, origin)
        reached = pose_error(end, target, length, trial_error)
        if not reached < cost:  # worse, or no number
            damping, growth = damping * growth, growth * 2
            if damping > _MOST_DAMPING:
                break
            continue
        gained = cost - reached
        settled = damping < _HARDLY_DAMPED and gained <= _SHARE_AT_REST * cost + _AT_REST
        cost = reached
        for f in range(len(q)):
            q[f] = min(max(trial[f], lower[f]), upper[f])
        if settled:
            break
        for d in range(6):
            error[d] = trial_error[d]
        # A linear model that promised much more than came does not deserve a longer step.
        gain = gained / promised
        if gain > _GOOD_GAIN:
            damping = max(damping / 10, _LEAST_DAMPING)
        elif gain < _POOR_GAIN:
            damping = damping * 4
        growth = 2.0
        slopes(revolute, matrix, end, along, origin, length, jacobian)
        size = _normal_equations(jacobian, error, normal, gradient)
    return cost


@inner
def _project(chain, starts, targets, first, last, result):  # type: ignore[no-untyped-def]
    """Fills rows `first` to `last` of `result` (B, F) with the free motions that come closest to `targets` (B, 7)."""
    depth, free = chain.matrix.shape
    at = _Workspace(
        q=np.empty(free),
        trial=np.empty(free),
        end=np.empty(7),
        along=np.empty((depth, 3)),
        origin=np.empty((depth, 3)),
        error=np.empty(6),
        trial_error=np.empty(6),
        jacobian=np.empty((6, free)),
        normal=np.empty((free, free)),
        gradient=np.empty(free),
        change=np.empty(2 * free),
        held=np.empty(free, np.bool_),
        work=np.empty((free, free)),
    )
    refined = min(_REFINED, len(starts.motions))
    chosen, costs = np.empty(refined, np.int64), np.empty(refined)
    for b in range(first, last):
        _rank(chain, starts, targets[b], at.error, at.change, chosen, costs)
        least = np.inf
        for rank in range(refined):
            for f in range(free):
                at.q[f] = starts.motions[chosen[rank], f]
            cost = _refine(chain, targets[b], at)
            if cost < least:
                least = cost
                for f in range(free):
                    result[b, f] = at.q[f]


@inner
def _linearise(chain, starts):  # type: ignore[no-untyped-def]
    """Fills all but the free motions of `starts`."""
    before, revolute, axes, matrix, offset, _, _, _, length = chain
    depth, free = matrix.shape
    along, origin = np.empty((depth, 3)), np.empty((depth, 3))
    normal, column, unit = np.empty((free, free)), np.empty(free), np.zeros(6)
    for s in range(len(starts.motions)):
        forward(before, revolute, axes, matrix, offset, starts.motions[s], starts.ends[s], along, origin)
        slopes(revolute, matrix, starts.ends[s], along, origin, length, starts.jacobians[s])
        for d in range(6):
            unit[d] = 1.0
            size = _normal_equations(starts.jacobians[s], unit, normal, column)
            unit[d] = 0.0
            for f in range(free):
                normal[f, f] += _START_DAMPING * size
            _solve(normal, column)
            for f in range(free):
                starts.steps[s, f, d] = column[f]


# Plain tuples at the border: numba takes 0.6 ms a call to recognise named ones.
@kernel
def _serial(links, look, targets, result):  # type: ignore[no-untyped-def]
    chain, starts = Chain(*links), _Starts(*look)
    _linearise(chain, starts)
    _project(chain, starts, targets, np.int64(0), len(targets), result)


@kernel(parallel=True)
def _parallel(links, look, targets, result):  # type: ignore[no-untyped-def]
    chain, starts = Chain(*links), _Starts(*look)
    _linearise(chain, starts)
    for block in prange((len(targets) + _BLOCK - 1) // _BLOCK):
        first, last = block * _BLOCK, min((block + 1) * _BLOCK, len(targets))
        _project(chain, starts, targets, first, last, result)


def nearest_on_chain(chain: Chain, starts: NDArray[np.float64], targets: NDArray[np.float64]) -> NDArray[np.float64]:
    """Free motions (B, F) within bounds whose chain end comes closest to `targets` (B, 7), from `starts` (S, F).

    What is least is |position|² + (length * angle)² between end and target, metres².
    """
    count, free = starts.shape
    linearised = starts, np.empty((count, 7)), np.empty((count, 6, free)), np.empty((count, free, 6))
    result = np.empty((len(targets), free))
    (_parallel if len(targets) >= _PARALLEL_FROM else _serial)(tuple(chain), linearised, targets, result)
    return result
