"""Where does the sampling of a mode begin? With a Gaussian about as wide as its density, and grids of the joints that
it does not fit: the nearer they come to the density, the fewer draws it takes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.held_part import LITTLE, Held
from pmpnbp.inference.joint_draws import short_way_round
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.registration import curvature
from pmpnbp.readout.importance_sampling import Grid, LogDensity
from pmpnbp.readout.log_posterior import confidence, log_posterior
from pmpnbp.scene.prior import GaussianPrior

# Cells over a joint's range, and the least share of a uniform density in draws from them.
CELLS, UNIFORM = 32, 0.1
# Of so many cells next to each other one is looked at first; where that is worse by more nats, so are all. On even
# seeds of `benchmarks.belief`, wrong models and absent objects among them, the same joints are then drawn from grids.
STRIDE, HOPELESS = 4, 250.0
# Densities along one axis alone, and of a few places, are taken this much less sharp: the other coordinates are not
# quite where they are taken to be, and the score is rough, by some nats. Where few draws count so are their weights.
HALF_SURE = 0.5
# A joint is drawn over its range where so much of its weight lies so many standard deviations from the mode, and all of
# it in more cells than PEAKED, as many of equal weight.
ELSEWHERE, FAR, PEAKED = 0.02, 4.0, 4.0
# Metres and radians: how far a parameter that the scan does not hold is started from.
LOOSE = 0.02
# An axis of the first proposal is flat where it has this share of the variance of what is not held; where along it the
# density is looked at, metres or radians.
FLAT, SCANNED = 0.25, (0.001, 0.002, 0.004, 0.008, 0.015, 0.03, 0.06, 0.12, 0.25, 0.5, 1.0, 2.0, 3.0)
# Standard deviations along any other axis, likewise; how many times the variance that is found there it keeps, for each
# coordinate, once at the least, and at the most, and what share of its own at least: of a proposal that is too narrow a
# few draws of many coordinates count as if there were nothing beyond them, while draws of few are told as wide as it.
NEAR, WIDER_EACH, WIDER, NARROW = (0.25, 0.5, 1.0, 2.0), 0.16, 3.0, 0.1


@dataclass(frozen=True)
class Elsewhere:
    """Where one joint of a configuration could as well be. grids : of those that could be anywhere; roots : (K, 7) and
    joints : (K, D), with each that is not hopeless elsewhere in the best place far from where it is, also where that
    slopes towards a better one: what it is brought to is another way there; nats : the most that the log posterior is
    of all that were tried, at the offsets `best` (6 + D,)"""

    grids: tuple[Grid, ...]
    roots: Array
    joints: Array
    nats: float
    best: Array


def curvature_information(
    problem: Problem, place: Held, tolerance: float, free: NDArray[np.int64], loose: float
) -> Array:
    """(6 + D + F, 6 + D + F), the inverse of the Gaussian's covariance that has the curvature of the score and roughly
    the priors, in a place's coordinates and the nuisances numbered `free` (F,); where neither tells anything it is
    `loose`, metres and radians."""
    information = 2 * confidence(problem) * curvature(problem, place.root, place.joints, tolerance, free)
    size = 6 + len(place.joints)
    if place.part:
        own = np.eye(len(information))
        own[:size, :size] = place.by_root
        information = own.T @ information @ own
    information[:size, :size] += prior_information(problem, place)
    information += np.diag(np.concatenate([np.full(size, loose), problem.nuisance_std[free]]) ** -2.0)
    return information


def prior_information(problem: Problem, place: Held) -> Array:
    """(6 + D, 6 + D): what a Gaussian prior tells of a place's coordinates, by `Problem.log_prior` and of joints; zero
    where the prior is none."""
    size = 6 + len(place.joints)
    found = np.zeros((size, size))
    if isinstance(problem.prior, GaussianPrior):
        moved = place.placed(LITTLE * np.concatenate([np.zeros((1, size)), np.eye(size)]))
        here, *there = place.mrf.part_poses(*moved)[:, problem.prior_node]
        slopes = np.concatenate(poses.perturbation(here, np.array(there), np.zeros(3)), axis=1) / LITTLE
        found = (slopes / np.concatenate([problem.prior.std_xyz, problem.prior.std_rpy]) ** 2) @ slopes.T
        for coordinate, (_, std) in problem.joint_prior.items():
            found[6 + coordinate, 6 + coordinate] += std**-2.0
    return found


def measured_covariance(density: LogDensity, here: float, covariance: Array) -> Array:
    """A covariance (P, P) about as wide as the density, whose logarithm is `here` at the mode, is along each of its own
    axes: where the curvature holds nothing outlines may, or nothing does, and elsewhere they hold more than it does."""
    variances, axes = np.linalg.eigh(covariance)
    found, flat = variances.copy(), variances > FLAT * LOOSE**2
    found[flat] = _variances(density, here, axes.T[flat], np.tile(SCANNED, (int(flat.sum()), 1)))
    held = variances[~flat]
    wider = np.clip(WIDER_EACH * len(variances), 1.0, WIDER)
    found[~flat] = wider * _variances(density, here, axes.T[~flat], np.sqrt(held)[:, None] * NEAR)
    found[~flat] = np.clip(found[~flat], NARROW * held, held)
    return (axes * np.where(found > 0, found, variances)) @ axes.T


def _variances(density: LogDensity, here: float, axes: Array, distances: Array) -> Array:
    """(K,) of a density along axes (K, P) through its mode, looked at on both sides of it at `distances` (K, S);
    0 where it has no width."""
    steps, middle = np.concatenate([-distances[:, ::-1], distances], axis=1), distances.shape[1]
    log = density((steps[..., None] * axes[:, None]).reshape(-1, axes.shape[1])).reshape(steps.shape)
    steps, log = np.insert(steps, middle, 0.0, axis=1), np.insert(log, middle, here, axis=1)
    weights = np.exp(HALF_SURE * (log - log.max(axis=1, keepdims=True)))
    mass, spread = np.trapezoid(weights, steps, axis=1), np.trapezoid(weights * steps**2, steps, axis=1)
    return np.divide(spread, mass, out=np.zeros(len(axes)), where=mass > 0)


def joints_elsewhere(problem: Problem, place: Held, here: float, stds: Array) -> Elsewhere:
    """Where joints of a place could as well be, all others and the part that it is held by as they are.

    A joint has a grid, of offsets to its position, where its weight lies elsewhere than within a few of `stds` (D,)
    from where it is, or a cell from there where that is not told. here : the log posterior where they are
    """
    model, joints = problem.mrf.model, place.joints
    spans = model.upper - model.lower
    moving = np.flatnonzero((spans > 0) & np.isfinite(spans))
    if not len(moving):
        return Elsewhere((), np.zeros((0, 7)), np.zeros((0, model.dof)), here, np.zeros(6 + model.dof))
    offsets = (np.arange(CELLS) + 0.5) / CELLS * spans[moving, None] + (model.lower - joints)[moving, None]
    cells = spans / CELLS
    # no Gaussian fits a joint of which the curvature tells nothing
    told = stds**2 < FLAT * LOOSE**2
    away = np.abs(short_way_round(offsets, model.wraps[moving, None]))
    distant = away > np.where(told, FAR * np.maximum(stds, cells), cells)[moving, None]
    log = np.full(offsets.shape, -np.inf)
    first = np.arange(CELLS) % STRIDE == STRIDE // 2
    log[:, first] = _along(problem, place, moving, offsets[:, first])
    groups = distant.reshape(len(moving), -1, STRIDE).any(axis=2)
    open_ = np.any(groups & (log[:, first] > here - HOPELESS), axis=1)
    log[np.ix_(open_, ~first)] = _along(problem, place, moving[open_], offsets[np.ix_(open_, ~first)])
    grids, others, axes = [], [], np.eye(6 + model.dof)[6 + moving]
    for row in np.flatnonzero(open_):
        coordinate = moving[row]
        top = max(here, log[row].max())
        beyond = cells[coordinate] * np.exp(log[row, distant[row]] - top).sum()
        near = np.sqrt(2 * np.pi) * min(float(stds[coordinate]), spans[coordinate]) * np.exp(here - top)
        best = int(np.where(distant[row], log[row], -np.inf).argmax())
        if log[row, best] > here - HOPELESS:
            others.append(offsets[row, best] * axes[row])
        weights = np.exp(HALF_SURE * (log[row] - log[row].max()))
        weights /= weights.sum()
        # two sharp peaks are two modes, and weighed as such
        peaked = PEAKED * (weights @ weights) > 1
        if peaked or beyond <= ELSEWHERE * (beyond + near):
            continue
        weights = (1 - UNIFORM) * weights + UNIFORM / CELLS
        begin = float(model.lower[coordinate] - joints[coordinate])
        grids.append(Grid(6 + int(coordinate), begin, begin + float(spans[coordinate]), weights))
    roots, found = place.placed(np.array(others).reshape(-1, 6 + model.dof))
    row, cell = np.unravel_index(log.argmax(), log.shape)
    return Elsewhere(tuple(grids), roots, found, float(log[row, cell]), offsets[row, cell] * axes[row])


def _along(problem: Problem, place: Held, coordinates: NDArray[np.int64], offsets: Array) -> Array:
    """(J, K): the log posterior with one of the joint coordinates (J,) moved by each of its offsets (J, K)."""
    tried = np.zeros((*offsets.shape, 6 + len(place.joints)))
    tried[np.arange(len(coordinates)), :, 6 + coordinates] = offsets
    return log_posterior(problem, *place.placed(tried.reshape(-1, tried.shape[2]))).reshape(offsets.shape)
