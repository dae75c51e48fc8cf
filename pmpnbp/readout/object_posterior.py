"""How sure can one be of the object, given the scan? Draws from the posterior of root pose and joint positions.

The belief's own spread follows its diffusion and is no uncertainty (docs/algorithm.md, "Spread"). Here the whole object
is rendered at every draw and scored as the estimate is, and the score counts as the log likelihood, times CONFIDENCE:
a pixel's score 1 - (d/tau)^2 is a Gaussian's logarithm in the difference of depths d. Draws stay in the hypothesis that
the estimate is of, but for joints, which are redrawn over their whole range: a quarter turn of a closed cabinet is not
among them. Joints that close a loop are left out. Nuisances that are not fixed are drawn with the rest, so that a depth
scale which the scan does not tell is a spread along the line of sight.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.joint_draws import within_limits
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.registration import curvature
from pmpnbp.potentials.unary import object_scores
from pmpnbp.readout.ensemble_sampling import Grid, replace_outlier_chains, sample
from pmpnbp.readout.particle_statistics import covariance
from pmpnbp.scene.prior import GaussianPrior

# Of a pixel's score, as a log likelihood. The sensor's noise alone would have it near 3 (tau 12 mm, sigma 5 mm); pixels
# share their errors with their neighbours (steps of depth, the mesh), so each counts for a fraction of that. Set on
# held-out scenes, docs/algorithm.md.
CONFIDENCE = 0.5
# Markov chains, their steps before outliers are replaced, and then those of the burn-in and those that are kept.
CHAINS, OUTLIER_STEPS, BURN_IN, KEPT_STEPS = 48, 50, 50, 150
# Every so many of the steps kept is a draw.
THINNING = 5
# Cells over a joint's range, and the least share of a uniform density in redraws.
CELLS, UNIFORM = 100, 0.1
# Metres and radians: noise on every step, and how far a parameter that the scan does not hold is started from.
JITTER, LOOSE = 1e-5, 0.02
# The same of a parameter beside nuisances that the scan does not tell either: it goes as far as their prior takes it.
UNTOLD = 1.0


def draw(rng: np.random.Generator, problem: Problem, root: Array, joints: Array) -> tuple[Array, Array]:
    """Root poses (K, 7) and joint vectors (K, D) of equal weight, given an estimate (7,), (D,) near the best one."""
    model = problem.mrf.model
    tolerance = problem.tolerance_end
    placing, free = 6 + model.dof, np.flatnonzero(problem.nuisance_std)

    def placed(offsets: Array) -> tuple[Array, Array]:
        roots = poses.perturb(root, offsets[:, :3], offsets[:, 3:6], problem.mrf.centres[0])
        return roots, joints + offsets[:, 6:placing]

    def log_density(offsets: Array) -> Array:
        roots, q = placed(offsets)
        outside = ~model.wraps & ((q < model.lower) | (q > model.upper))
        found = np.full(len(offsets), -np.inf)
        inside = ~outside.any(axis=1)
        if inside.any():
            turned = within_limits(q[inside], model.lower, model.upper, model.wraps)
            nuisances = _nuisances(problem, free, offsets[inside, placing:])
            found[inside] = _log_posterior(problem, roots[inside], turned, tolerance, nuisances)
        return found

    grids = tuple(
        _grid(problem, root, joints, k, tolerance) for k in range(model.dof) if 0 < _span(problem, k) < np.inf
    )
    start = _start(rng, problem, root, joints, tolerance, grids)
    jitter = np.concatenate([np.full(placing, JITTER), JITTER / problem.nuisance_levers[free]])
    last = sample(rng, log_density, start, OUTLIER_STEPS, jitter=jitter, grids=grids)[0][-1]
    start = replace_outlier_chains(rng, last, log_density(last))
    history, _ = sample(rng, log_density, start, BURN_IN + KEPT_STEPS, jitter=jitter, grids=grids)
    roots, q = placed(history[BURN_IN::THINNING].reshape(-1, placing + len(free)))
    return roots, within_limits(q, model.lower, model.upper, model.wraps)


def link_covariances(rng: np.random.Generator, problem: Problem, root: Array, joints: Array) -> Array:
    """(L, 6, 6) of every link about the estimate (7,), (D,), by draws; in the order of `covariance`."""
    model = problem.mrf.model
    roots, q = draw(rng, problem, root, joints)
    drawn = model.link_poses(model.part_poses(roots, q), q)
    estimate = model.link_poses(model.part_poses(root, joints), joints)
    even = np.ones(len(roots))
    return np.array([covariance(estimate[link], drawn[:, link], even) for link in range(len(estimate))])


def nuisance_stds(problem: Problem, root: Array, joints: Array) -> Array:
    """(K,) standard deviations of the nuisances near an estimate (7,), (D,), all else free to follow: those of the
    Gaussian that has the curvature of the score. Outlines are left out, which tell more."""
    free = np.flatnonzero(problem.nuisance_std)
    stds = np.zeros_like(problem.nuisance_std)
    covariance = np.linalg.inv(_information(problem, root, joints, problem.tolerance_end, free, UNTOLD))
    stds[free] = np.sqrt(np.diag(covariance)[6 + len(joints) :])
    return stds


def _nuisances(problem: Problem, free: NDArray[np.int64], offsets: Array) -> Array | None:
    """(C, K): the problem's, the `free` ones (F,) moved by `offsets` (C, F); None where all are fixed."""
    if problem.nuisances is None:
        return None
    moved = np.tile(problem.nuisances, (len(offsets), 1))
    moved[:, free] += offsets
    # a share beyond this turns the object inside out
    return np.clip(moved, -0.9, 0.9)


def _log_posterior(
    problem: Problem, roots: Array, joints: Array, tolerance: float, nuisances: Array | None = None
) -> Array:
    """(C,) up to a constant, of root poses (C, 7) and joint vectors (C, D), under nuisances (C, K) or the problem's."""
    part_poses = problem.mrf.model.part_poses(roots, joints)
    # also where the inference scores by eq. 10, whose sum of distances is no logarithm of a likelihood
    scoring = replace(problem.score(tolerance), form="robust")
    nuisances = problem.nuisances if nuisances is None else nuisances
    score = CONFIDENCE * object_scores(problem.observation, problem.surfaces, part_poses, scoring, nuisances)
    if nuisances is not None:
        score = score + problem.log_nuisance_prior(nuisances)
    return problem.plus_prior(score, part_poses[:, problem.prior_node], always=True)


def _span(problem: Problem, coordinate: int) -> float:
    return float(problem.mrf.model.upper[coordinate] - problem.mrf.model.lower[coordinate])


def _grid(problem: Problem, root: Array, joints: Array, coordinate: int, tolerance: float) -> Grid:
    """Where a joint could as well be, all others as they are: offsets to its position."""
    model = problem.mrf.model
    lower, span = float(model.lower[coordinate]), _span(problem, coordinate)
    tried = np.tile(joints, (CELLS, 1))
    tried[:, coordinate] = lower + span * (np.arange(CELLS) + 0.5) / CELLS
    log = _log_posterior(problem, np.tile(root, (CELLS, 1)), tried, tolerance)
    # half as sure as the posterior, as the others are not quite where they are taken to be
    weights = np.exp(0.5 * (log - log.max()))
    weights = (1 - UNIFORM) * weights / weights.sum() + UNIFORM / CELLS
    begin = lower - float(joints[coordinate])
    return Grid(6 + coordinate, begin, begin + span, weights)


def _start(
    rng: np.random.Generator, problem: Problem, root: Array, joints: Array, tolerance: float, grids: tuple[Grid, ...]
) -> Array:
    """(W, 6 + D + F) offsets of the chains' starts: a Gaussian about the estimate, from the curvature of the score and
    roughly the prior; each joint that has a grid is drawn from it in half of the chains."""
    model = problem.mrf.model
    placing = 6 + model.dof
    information = _information(problem, root, joints, tolerance, np.flatnonzero(problem.nuisance_std), LOOSE)
    spread = np.linalg.cholesky(np.linalg.inv(information))
    offsets = rng.standard_normal((CHAINS, len(spread))) @ spread.T
    for grid in grids:
        some = rng.random(CHAINS) < 0.5
        offsets[some, grid.coordinate] = grid.draw(rng, int(some.sum()))
    q = within_limits(joints + offsets[:, 6:placing], model.lower, model.upper, np.zeros_like(model.wraps))
    return np.concatenate([offsets[:, :6], q - joints, offsets[:, placing:]], axis=1)


def _information(
    problem: Problem, root: Array, joints: Array, tolerance: float, free: NDArray[np.int64], loose: float
) -> Array:
    """(6 + D + F, 6 + D + F), the inverse of the Gaussian's covariance that has the curvature of the score and roughly
    the priors; where neither tells anything it is `loose`, metres and radians."""
    information = 2 * CONFIDENCE * curvature(problem, root, joints, tolerance, free)
    information += np.diag(np.concatenate([np.full(6 + len(joints), loose), problem.nuisance_std[free]]) ** -2.0)
    if isinstance(problem.prior, GaussianPrior):
        known = np.concatenate([problem.prior.std_xyz, problem.prior.std_rpy])
        information[range(6), range(6)] += 1 / known**2
    return information
