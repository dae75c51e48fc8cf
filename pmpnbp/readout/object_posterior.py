"""How sure can one be of the object, given the scan? Weighted draws of root pose and joint positions about a mode.

The belief's own spread follows its diffusion and is no uncertainty (docs/algorithm.md, "Spread"). Here the whole object
is rendered at every draw and scored as the estimate is, and the score counts as the log likelihood, times `confidence`:
a pixel's score 1 - (d/tau)^2 is a Gaussian's logarithm in the difference of depths d. Draws stay in the mode that they
are asked about, but for joints whose place the scan does not tell, which go over their whole range. Joints that close a
loop are left out. Nuisances that are not fixed are drawn with the rest, so that a depth scale which the scan does not
tell is a spread along the line of sight.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.joint_draws import within_limits
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.registration import curvature
from pmpnbp.potentials.unary import object_scores
from pmpnbp.readout.chain_bends import bends, bent_otherwise
from pmpnbp.readout.checkpoint import Checkpoint, go_on
from pmpnbp.readout.free_turn import free_turn, turned_anyhow
from pmpnbp.readout.image_grain import grain
from pmpnbp.readout.importance_sampling import Grid, LogDensity, Proposal, adaptive_importance
from pmpnbp.readout.particle_statistics import short_way_round
from pmpnbp.scene.prior import GaussianPrior, UniformPrior

# A pixel's score 1 - (d / tau)^2 counts as a Gaussian's logarithm with a standard deviation of FLOOR, metres, and so
# many times the depths' own: pixels share their errors with their neighbours (steps of depth, outlines, the mesh), so
# that each says less than its noise would have it. Set on even seeds of `benchmarks.belief`, docs/algorithm.md.
FLOOR, SHARED = 0.0035, 1.8
# Draws of the first round, whose proposal is a guess; of each further one, at least, and for each coordinate at most,
# else as many as the covariance that is fitted to them has elements; rounds at most; and how many draws have to count
# before no more are made.
FIRST, LEAST, EACH, ROUNDS, ENOUGH = 96, 64, 16, 48, 60.0
# Metres and radians: no joint is taken for better known than this where modes are weighed.
SHUT = 1e-4
# Cells over a joint's range, and the least share of a uniform density in draws from them.
CELLS, UNIFORM = 32, 0.1
# Of so many cells next to each other one is looked at first; where that is worse by more nats, so are all. On even
# seeds of `benchmarks.belief`, wrong models and absent objects among them, the same joints are then drawn from grids.
STRIDE, HOPELESS = 4, 250.0
# Densities along one axis alone, and of a few places, are taken this much less sharp: the other coordinates are not
# quite where they are taken to be, and the score is rough, by some nats. Where few draws count so are their weights.
HALF_SURE = 0.5
# Share of its score by which a place may be worth more or less than another for no good reason: on even seeds rivals
# in sight are worse than right estimates by 4 % and more, and those that are taken for each other within 2 %. Of 0.007,
# 0.005 and 0.0035 the second had as many certain parts right as the first, and the third fewer.
MISFIT = 0.005
# A joint is drawn over its range where so much of its weight lies so many standard deviations from the mode.
ELSEWHERE, FAR = 0.02, 4.0
# Metres and radians: how far a parameter that the scan does not hold is started from.
LOOSE = 0.02
# An axis of the first proposal is flat where it has this share of the variance of what is not held; where along it the
# density is looked at, metres or radians.
FLAT, SCANNED = 0.25, (0.001, 0.002, 0.004, 0.008, 0.015, 0.03, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0, 3.0)
# Metres from the mode at most: where nothing at all is seen the draws would go on without end.
ASTRAY = 2.0
# How far such a parameter starts beside nuisances that the scan does not tell either: it goes as far as their prior
# takes it.
UNTOLD = 1.0


@dataclass(frozen=True, kw_only=True)
class ModeDraws:
    """Draws of one mode of the object.

    roots : (K, 7); joints : (K, D); log_weights : (K,), their exponentials sum to 1
    middle, stds : (6 + D,) their mean, before they were stirred, and standard deviations, before they were bent: the
        translation of the root's centre and its rotation vector from where it was drawn about, joints
    nuisances : (K, ...), see `potentials/nuisances.py`; None where all are fixed
    best_root, best_joints : (7,), (D,) of the draw of the highest density; gain : nats by which that is higher than at
        the configuration that was drawn about
    log_evidence : of the mode: logarithm of the posterior's integral over it, up to what is the same for all modes
    log_room : logarithm of the volume that its joint positions fill, before they were bent, likewise
    effective_sample_size : how many draws of equal weight would tell as much
    """

    roots: Array
    joints: Array
    log_weights: Array
    middle: Array
    stds: Array
    nuisances: Array | None
    best_root: Array
    best_joints: Array
    gain: float
    log_evidence: float
    log_room: float
    effective_sample_size: float


def mode_draws(
    rng: np.random.Generator,
    problem: Problem,
    root: Array,
    joints: Array,
    checkpoint: Checkpoint = go_on,
    surpassed: float = np.inf,
) -> ModeDraws:
    """Draws about a mode's best configuration (7,), (D,). Raises what `checkpoint` does, called before each round.

    surpassed : nats; no more are made once one is better by more than that, for then they are about the wrong place
    """
    model = problem.mrf.model
    free = np.flatnonzero(problem.nuisance_std)
    information = _information(problem, root, joints, problem.tolerance_end, free, LOOSE)
    density = _density(problem, root, joints, free, checkpoint)
    covariance = _scanned(density, np.asarray(np.linalg.inv(information), dtype=np.float64))
    grids = _grids(problem, root, joints, np.diag(information)[6 : 6 + model.dof] ** -0.5)
    lower, upper = _limits(problem, joints, len(free))
    size = len(information)
    first = Proposal(np.zeros(size), covariance, lower, upper, grids)
    counts = (FIRST, *[max(LEAST, size * min(size, EACH))] * (ROUNDS - 1))
    here = float(density(np.zeros((1, size)))[0])
    drawn = adaptive_importance(rng, density, first, counts, ENOUGH, HALF_SURE, here + surpassed)
    rows, weights = drawn.rows[:, : 6 + model.dof], np.exp(drawn.log_weights)
    best = int(drawn.log_density.argmax())
    best_roots, best_joints = _placed(problem, root, joints, rows[[best]])
    middle, hidden = weights @ rows, grain(problem, root, joints)
    roots, q = _stirred(rng, problem, root, joints, rows, hidden)
    covariance = np.einsum("k,ki,kj->ij", weights, rows - middle, rows - middle) + hidden
    return ModeDraws(
        roots=roots,
        joints=_bent(rng, problem, _placed(problem, root, joints, middle[None]), covariance, (roots, q)),
        log_weights=drawn.log_weights,
        middle=middle,
        stds=np.sqrt(weights @ (mode_offsets(problem, root, joints, roots, q) - middle) ** 2),
        nuisances=_nuisances(problem, free, drawn.rows[:, 6 + model.dof :]),
        best_root=best_roots[0],
        best_joints=within_limits(best_joints[0], model.lower, model.upper, model.wraps),
        gain=float(drawn.log_density[best] - here),
        log_evidence=drawn.log_integral,
        log_room=_log_room(weights, q),
        effective_sample_size=drawn.effective_sample_size,
    )


def mode_offsets(problem: Problem, root: Array, joints: Array, roots: Array, drawn_joints: Array) -> Array:
    """(K, 6 + D) of draws (K, 7), (K, D) from a configuration (7,), (D,): the translation of the root's centre, its
    rotation vector, joints."""
    moves, turns = poses.perturbation(root, roots, problem.mrf.centres[0])
    return np.concatenate([moves, turns, short_way_round(drawn_joints - joints, problem.mrf.model.wraps)], axis=1)


def misfit(nats: float) -> float:
    """Nats of evidence that count as one, between places of a posterior that is so high."""
    return 1.0 + MISFIT * abs(nats)


def _stirred(
    rng: np.random.Generator, problem: Problem, root: Array, joints: Array, rows: Array, hidden: Array
) -> tuple[Array, Array]:
    """Root poses (K, 7) and joint vectors (K, D) at offsets (K, 6 + D) and what a covariance (6 + D, 6 + D) hides, by
    any turn that nothing tells."""
    model = problem.mrf.model
    values, axes = np.linalg.eigh(hidden)
    # the symmetric root: axes of equal variance are any
    stir = rng.standard_normal((len(rows), len(values))) @ (axes * np.sqrt(np.maximum(values, 0.0))) @ axes.T
    roots, q = _placed(problem, root, joints, rows + stir)
    q = within_limits(q, model.lower, model.upper, model.wraps)
    if isinstance(problem.prior, UniformPrior) and (spin := free_turn(model)):
        roots, q = turned_anyhow(rng, model, spin, roots, q)
    return roots, within_limits(q, model.lower, model.upper, model.wraps)


def _bent(
    rng: np.random.Generator,
    problem: Problem,
    middle: tuple[Array, Array],
    covariance: Array,
    draws: tuple[Array, Array],
) -> Array:
    """Joint vectors (K, D) of draws, bent otherwise where their middle, (1, 7) and (1, D), may be: nats count there as
    between places."""
    mrf, model = problem.mrf, problem.mrf.model
    root, joints = middle[0], within_limits(middle[1], model.lower, model.upper, model.wraps)
    motions = bends(mrf, root[0], joints[0])
    if not motions:
        return draws[1]
    share = 1 / misfit(float(log_posterior(problem, root, joints)[0]))
    at = (root[0], joints[0])
    return bent_otherwise(rng, mrf, motions, at, covariance, draws, lambda *some: share * log_posterior(problem, *some))


def _log_room(weights: Array, joints: Array) -> float:
    """Logarithm of the volume that joint positions (K, D) of `weights` (K,) fill, up to what is the same for all."""
    gap = joints - weights @ joints
    spread = np.einsum("k,ki,kj->ij", weights, gap, gap) + SHUT**2 * np.eye(gap.shape[1])
    return float(np.linalg.slogdet(spread)[1] / 2)


def nuisance_stds(problem: Problem, root: Array, joints: Array) -> Array:
    """(K,) standard deviations of the nuisances near an estimate (7,), (D,), all else free to follow: those of the
    Gaussian that has the curvature of the score. Outlines are left out, which tell more."""
    free = np.flatnonzero(problem.nuisance_std)
    stds = np.zeros_like(problem.nuisance_std)
    covariance = np.linalg.inv(_information(problem, root, joints, problem.tolerance_end, free, UNTOLD))
    stds[free] = np.sqrt(np.diag(covariance)[6 + len(joints) :])
    return stds


def _placed(problem: Problem, root: Array, joints: Array, offsets: Array) -> tuple[Array, Array]:
    """Root poses (C, 7) and joint vectors (C, D), which may be beyond their limits, at offsets (C, 6 + D + F)."""
    roots = poses.perturb(root, offsets[:, :3], offsets[:, 3:6], problem.mrf.centres[0])
    return roots, joints + offsets[:, 6 : 6 + len(joints)]


def _density(
    problem: Problem, root: Array, joints: Array, free: NDArray[np.int64], checkpoint: Checkpoint
) -> LogDensity:
    """The log posterior of offsets (C, 6 + D + F) to a configuration (7,), (D,) and to the `free` nuisances (F,);
    `checkpoint` is called before each lot of them."""
    model = problem.mrf.model
    lower, upper = _limits(problem, joints, len(free))

    def log_density(offsets: Array) -> Array:
        checkpoint()
        found = np.full(len(offsets), -np.inf)
        inside = np.all((offsets >= lower) & (offsets <= upper), axis=1)
        if inside.any():
            roots, q = _placed(problem, root, joints, offsets[inside])
            turned = within_limits(q, model.lower, model.upper, model.wraps)
            nuisances = _nuisances(problem, free, offsets[inside, 6 + model.dof :])
            found[inside] = log_posterior(problem, roots, turned, nuisances)
        return found

    return log_density


def _limits(problem: Problem, joints: Array, free: int) -> tuple[Array, Array]:
    """Least and largest offsets (6 + D + F,) of root, joints and free nuisances."""
    model = problem.mrf.model
    reach = np.concatenate([np.full(3, ASTRAY), np.full(3, np.pi)])
    turns = np.where(model.wraps, np.inf, 0.0)
    others = np.full(free, np.inf)
    return (
        np.concatenate([-reach, model.lower - joints - turns, -others]),
        np.concatenate([reach, model.upper - joints + turns, others]),
    )


def _nuisances(problem: Problem, free: NDArray[np.int64], offsets: Array) -> Array | None:
    """(C, K): the problem's, the `free` ones (F,) moved by `offsets` (C, F); None where all are fixed."""
    if problem.nuisances is None:
        return None
    moved = np.tile(problem.nuisances, (len(offsets), 1))
    moved[:, free] += offsets
    # a share beyond this turns the object inside out
    return np.clip(moved, -0.9, 0.9)


def confidence(problem: Problem) -> float:
    """Nats that a pixel's score counts, at the tolerance that annealing ends at."""
    variance = FLOOR**2 + (SHARED * float(problem.noise.max(initial=0.0))) ** 2
    return float(problem.tolerance_end**2 / (2 * variance))


def log_posterior(problem: Problem, roots: Array, joints: Array, nuisances: Array | None = None) -> Array:
    """(C,) up to a constant, of root poses (C, 7) and joint vectors (C, D), under nuisances (C, K) or the problem's."""
    part_poses = problem.part_poses(roots, joints, nuisances)
    # also where the inference scores by eq. 10, whose sum of distances is no logarithm of a likelihood
    scoring = replace(problem.score(problem.tolerance_end), form="robust")
    nuisances = problem.nuisances if nuisances is None else nuisances
    score = confidence(problem) * object_scores(problem.observation, problem.surfaces, part_poses, scoring, nuisances)
    if nuisances is not None:
        score = score + problem.log_nuisance_prior(nuisances)
    return problem.plus_prior(score, part_poses[:, problem.prior_node], always=True)


def _scanned(density: LogDensity, covariance: Array) -> Array:
    """A covariance (P, P) as wide as the density along those of its own axes that the curvature does not hold: outlines
    may, or nothing does."""
    variances, axes = np.linalg.eigh(covariance)
    flat = np.flatnonzero(variances > FLAT * LOOSE**2)
    if not len(flat):
        return covariance
    steps = np.array([*(-np.array(SCANNED[::-1])), 0.0, *SCANNED])
    log = density((steps[:, None] * axes.T[flat, None]).reshape(-1, len(axes))).reshape(len(flat), -1)
    weights = np.exp(HALF_SURE * (log - log.max(axis=1, keepdims=True)))
    mass = np.trapezoid(weights, steps, axis=1)
    found = np.trapezoid(weights * steps**2, steps, axis=1)
    told = (mass > 0) & (found > 0)
    variances[flat[told]] = (found / np.where(mass > 0, mass, 1.0))[told]
    return (axes * variances) @ axes.T


def _grids(problem: Problem, root: Array, joints: Array, stds: Array) -> tuple[Grid, ...]:
    """Where joints could as well be, all others as they are: offsets to the positions of those whose weight lies
    elsewhere than within a few of `stds` (D,) from where they are."""
    model = problem.mrf.model
    spans = model.upper - model.lower
    moving = np.flatnonzero((spans > 0) & np.isfinite(spans))
    if not len(moving):
        return ()
    offsets = (np.arange(CELLS) + 0.5) / CELLS * spans[moving, None] + (model.lower - joints)[moving, None]
    distant = np.abs(offsets) > FAR * np.maximum(stds, spans / CELLS)[moving, None]
    here = float(log_posterior(problem, root[None], joints[None])[0])
    log = np.full(offsets.shape, -np.inf)
    first = np.arange(CELLS) % STRIDE == STRIDE // 2
    log[:, first] = _along(problem, root, joints, moving, offsets[:, first])
    groups = distant.reshape(len(moving), -1, STRIDE).any(axis=2)
    open_ = np.any(groups & (log[:, first] > here - HOPELESS), axis=1)
    log[np.ix_(open_, ~first)] = _along(problem, root, joints, moving[open_], offsets[np.ix_(open_, ~first)])
    found = []
    for place in np.flatnonzero(open_):
        coordinate = moving[place]
        cell = spans[coordinate] / CELLS
        top = max(here, log[place].max())
        beyond = cell * np.exp(log[place, distant[place]] - top).sum()
        near = np.sqrt(2 * np.pi) * min(float(stds[coordinate]), spans[coordinate]) * np.exp(here - top)
        if beyond <= ELSEWHERE * (beyond + near):
            continue
        weights = np.exp(HALF_SURE * (log[place] - log[place].max()))
        weights = (1 - UNIFORM) * weights / weights.sum() + UNIFORM / CELLS
        begin = float(model.lower[coordinate] - joints[coordinate])
        found.append(Grid(6 + int(coordinate), begin, begin + float(spans[coordinate]), weights))
    return tuple(found)


def _along(problem: Problem, root: Array, joints: Array, coordinates: NDArray[np.int64], offsets: Array) -> Array:
    """(J, K): the log posterior with one of the joint coordinates (J,) moved by each of its offsets (J, K)."""
    tried = np.tile(joints, (*offsets.shape, 1))
    tried[np.arange(len(coordinates)), :, coordinates] += offsets
    rows = tried.reshape(-1, len(joints))
    return log_posterior(problem, np.tile(root, (len(rows), 1)), rows).reshape(offsets.shape)


def _information(
    problem: Problem, root: Array, joints: Array, tolerance: float, free: NDArray[np.int64], loose: float
) -> Array:
    """(6 + D + F, 6 + D + F), the inverse of the Gaussian's covariance that has the curvature of the score and roughly
    the priors; where neither tells anything it is `loose`, metres and radians."""
    information = 2 * confidence(problem) * curvature(problem, root, joints, tolerance, free)
    information += np.diag(np.concatenate([np.full(6 + len(joints), loose), problem.nuisance_std[free]]) ** -2.0)
    if isinstance(problem.prior, GaussianPrior):
        known = np.concatenate([problem.prior.std_xyz, problem.prior.std_rpy])
        information[range(6), range(6)] += 1 / known**2
    return information
