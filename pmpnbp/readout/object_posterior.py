"""How sure can one be of the object, given the scan? Draws from the posterior of root pose and joint positions.

The belief's own spread follows its diffusion and is no uncertainty (docs/algorithm.md, "Spread"). Here the whole object
is rendered at every draw and scored as the estimate is, and the score counts as the log likelihood, times CONFIDENCE:
a pixel's score 1 - (d/tau)^2 is a Gaussian's logarithm in the difference of depths d. Draws stay in the hypothesis that
the estimate is of, but for joints, which are redrawn over their whole range: a quarter turn of a closed cabinet is not
among them. Joints that close a loop are left out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

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


def draw(rng: np.random.Generator, problem: Problem, root: Array, joints: Array) -> tuple[Array, Array]:
    """Root poses (K, 7) and joint vectors (K, D) of equal weight, given an estimate (7,), (D,) near the best one."""
    model = problem.mrf.model
    tolerance = problem.tolerance_end

    def placed(offsets: Array) -> tuple[Array, Array]:
        roots = poses.perturb(root, offsets[:, :3], offsets[:, 3:6], problem.mrf.centres[0])
        return roots, joints + offsets[:, 6:]

    def log_density(offsets: Array) -> Array:
        roots, q = placed(offsets)
        outside = ~model.wraps & ((q < model.lower) | (q > model.upper))
        found = np.full(len(offsets), -np.inf)
        inside = ~outside.any(axis=1)
        if inside.any():
            turned = within_limits(q[inside], model.lower, model.upper, model.wraps)
            found[inside] = _log_posterior(problem, roots[inside], turned, tolerance)
        return found

    grids = tuple(
        _grid(problem, root, joints, k, tolerance) for k in range(model.dof) if 0 < _span(problem, k) < np.inf
    )
    start = _start(rng, problem, root, joints, tolerance, grids)
    jitter = np.full(6 + model.dof, JITTER)
    last = sample(rng, log_density, start, OUTLIER_STEPS, jitter=jitter, grids=grids)[0][-1]
    start = replace_outlier_chains(rng, last, log_density(last))
    history, _ = sample(rng, log_density, start, BURN_IN + KEPT_STEPS, jitter=jitter, grids=grids)
    roots, q = placed(history[BURN_IN::THINNING].reshape(-1, 6 + model.dof))
    return roots, within_limits(q, model.lower, model.upper, model.wraps)


def link_covariances(rng: np.random.Generator, problem: Problem, root: Array, joints: Array) -> Array:
    """(L, 6, 6) of every link about the estimate (7,), (D,), by draws; in the order of `covariance`."""
    model = problem.mrf.model
    roots, q = draw(rng, problem, root, joints)
    drawn = model.link_poses(model.part_poses(roots, q), q)
    estimate = model.link_poses(model.part_poses(root, joints), joints)
    even = np.ones(len(roots))
    return np.array([covariance(estimate[link], drawn[:, link], even) for link in range(len(estimate))])


def _log_posterior(problem: Problem, roots: Array, joints: Array, tolerance: float) -> Array:
    """(C,) up to a constant, of root poses (C, 7) and joint vectors (C, D)."""
    part_poses = problem.mrf.model.part_poses(roots, joints)
    # also where the inference scores by eq. 10, whose sum of distances is no logarithm of a likelihood
    scoring = replace(problem.score(tolerance), form="robust")
    score = object_scores(problem.observation, problem.surfaces, part_poses, scoring)
    return problem.plus_prior(CONFIDENCE * score, part_poses[:, problem.prior_node], always=True)


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
    """(W, 6 + D) offsets of the chains' starts: a Gaussian about the estimate, from the curvature of the score and
    roughly the prior; each joint that has a grid is drawn from it in half of the chains."""
    model = problem.mrf.model
    information = 2 * CONFIDENCE * curvature(problem, root, joints, tolerance) + np.eye(6 + model.dof) / LOOSE**2
    if isinstance(problem.prior, GaussianPrior):
        known = np.concatenate([problem.prior.std_xyz, problem.prior.std_rpy])
        information[range(6), range(6)] += 1 / known**2
    spread = np.linalg.cholesky(np.linalg.inv(information))
    offsets = rng.standard_normal((CHAINS, len(spread))) @ spread.T
    for grid in grids:
        some = rng.random(CHAINS) < 0.5
        offsets[some, grid.coordinate] = grid.draw(rng, int(some.sum()))
    q = within_limits(joints + offsets[:, 6:], model.lower, model.upper, np.zeros_like(model.wraps))
    return np.concatenate([offsets[:, :6], q - joints], axis=1)
