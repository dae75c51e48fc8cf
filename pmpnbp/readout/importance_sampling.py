"""Weighted draws from a density that is known up to a constant, and its integral: adaptive importance sampling.

Each round draws from Student's t about the mean of the rounds before, as wide as those were, and every draw is weighed
against the mixture of all rounds' proposals (Cornuet et al. 2012, Scandinavian Journal of Statistics 39). The tails of
Student's t keep weights bounded where the density is wider than was thought. A coordinate whose density has several
modes, or is spread over its range, is drawn from a grid instead.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from pmpnbp.geometry.poses import Array
from pmpnbp.inference.log_weights import log_sum_exp, normalise, tempering

FREEDOM = 10.0
# Of a coordinate of a proposal: what is narrower is one number, and has no inverse.
LEAST_VARIANCE = 1e-14
# Added to correlations: those of coordinates of which one is known a million times as well as another are rounded.
ROUNDING = 1e-9
# Weights are tempered until this share of all draws counts, before mean and covariance are taken from them.
EFFECTIVE_SHARE, STEPS = 0.07, 8
# Where fewer draws count, or fewer than half of those that there are, weights are tempered further than is allowed.
FEW = 20.0
# A rough density differs by ROUGHNESS nats, a standard deviation, between places that are all but the same, and its
# logarithm rises by about RISE for a deviation of the proposal. What is FARTHEST nats below the highest tells no trend;
# of what is beside the trend a share is KEPT where proposals are fitted.
ROUGHNESS, RISE, FARTHEST, KEPT = 4.0, 1.0, 40.0, 0.25
# Nats that roughness may put a draw below the best one: only such differences are taken to a lower power.
ROUGH = 4 * ROUGHNESS
# A coordinate within so many standard deviations of a limit is folded there; as many coordinates at most, as each
# doubles the images that a draw may come from.
NEAR_LIMIT, MOST_FOLDED = 4.0, 5

# log density (C,), up to a constant, of rows (C, P); -inf where there is none
LogDensity = Callable[[Array], Array]


@dataclass(frozen=True)
class Grid:
    """A density of coordinate `coordinate` that is constant in each of G cells between `lower` and `upper`.

    weights : (G,), above zero, their sum 1
    """

    coordinate: int
    lower: float
    upper: float
    weights: Array

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """(count,) positions."""
        cell = rng.choice(len(self.weights), count, p=self.weights)
        return self.lower + (self.upper - self.lower) * (cell + rng.random(count)) / len(self.weights)

    def log_density(self, positions: Array) -> Array:
        """(C,) at positions (C,); -inf beyond the ends."""
        share = (positions - self.lower) / (self.upper - self.lower)
        cell = np.clip((share * len(self.weights)).astype(int), 0, len(self.weights) - 1)
        inside = np.log(self.weights[cell] * len(self.weights) / (self.upper - self.lower))
        return np.where((share >= 0) & (share <= 1), inside, -np.inf)


@dataclass(frozen=True)
class Proposal:
    """Student's t in P coordinates, folded back at limits near its mean; those that have a grid are drawn from it.

    mean : (P,); covariance : (P, P), the scale matrix; lower, upper : (P,) limits, may be infinite
    """

    mean: Array
    covariance: Array
    lower: Array
    upper: Array
    grids: tuple[Grid, ...] = ()

    def draw(self, rng: np.random.Generator, count: int) -> Array:
        """(count, P); beyond a limit that is not near there may be some."""
        own, spread = self._own, self._spread
        scale = np.sqrt(FREEDOM / rng.chisquare(FREEDOM, (count, 1)))
        found = np.tile(self.mean, (count, 1))
        found[:, own] += scale * rng.standard_normal((count, len(own))) @ spread.T
        coordinates, limits = self._folds
        inward = np.sign(self.lower[coordinates] + self.upper[coordinates] - 2 * limits)
        found[:, coordinates] = limits + inward * np.abs(found[:, coordinates] - limits)
        for grid in self.grids:
            found[:, grid.coordinate] = grid.draw(rng, count)
        return found

    @cached_property
    def _own(self) -> NDArray[np.int64]:
        free = np.ones(len(self.mean), dtype=np.bool_)
        free[[grid.coordinate for grid in self.grids]] = False
        return np.flatnonzero(free)

    @cached_property
    def _spread(self) -> Array:
        stds, correlation = standardised(self.covariance[np.ix_(self._own, self._own)])
        return stds[:, None] * np.asarray(np.linalg.cholesky(correlation), dtype=np.float64)

    @cached_property
    def _whitening(self) -> Array:
        return np.asarray(np.linalg.inv(self._spread), dtype=np.float64)

    @cached_property
    def _log_norm(self) -> float:
        count = len(self._own)
        norm = gammaln((FREEDOM + count) / 2) - gammaln(FREEDOM / 2) - 0.5 * count * np.log(FREEDOM * np.pi)
        return float(norm - np.log(np.diag(self._spread)).sum())

    @cached_property
    def _folds(self) -> tuple[NDArray[np.int64], Array]:
        """Coordinates (F,) that are folded, and the limits (F,) at which they are."""
        stds = np.sqrt(np.diag(self.covariance))
        below, above = (self.mean - self.lower) / stds, (self.upper - self.mean) / stds
        nearest = np.minimum(below, above)
        near = self._own[nearest[self._own] < NEAR_LIMIT]
        chosen = near[np.argsort(nearest[near], kind="stable")][:MOST_FOLDED]
        return chosen, np.where(below <= above, self.lower, self.upper)[chosen]


def standardised(covariance: Array) -> tuple[Array, Array]:
    """Standard deviations (P,) of a covariance (P, P), and its correlations (P, P), which have an inverse for sure."""
    stds = np.sqrt(np.maximum(np.diag(covariance), LEAST_VARIANCE))
    return stds, covariance / np.outer(stds, stds) + ROUNDING * np.eye(len(stds))


def log_densities(proposals: Sequence[Proposal], rows: Array) -> Array:
    """(R, C) of R proposals of the same coordinates and grids at rows (C, P) within the limits."""
    own, grids = proposals[0]._own, proposals[0].grids
    whitenings = np.stack([one._whitening for one in proposals])
    means = np.stack([one.mean[own] for one in proposals])
    deviates = (rows[:, own] - means[:, None]) @ whitenings.swapaxes(1, 2)
    squares = (deviates**2).sum(axis=-1)[..., None]
    folded = max(len(one._folds[0]) for one in proposals)
    if folded:
        # a row may be the image of any of its mirror images, which are where a step along these columns leads
        columns, gaps = np.zeros((len(proposals), len(own), folded)), np.zeros((len(proposals), len(rows), folded))
        images = np.array(list(product((0.0, 1.0), repeat=folded)))
        shown = np.ones((len(proposals), 1, len(images)), dtype=np.bool_)
        for number, one in enumerate(proposals):
            coordinates, limits = one._folds
            columns[number, :, : len(limits)] = whitenings[number][:, np.searchsorted(own, coordinates)]
            gaps[number, :, : len(limits)] = 2 * (limits - rows[:, coordinates])
            shown[number, 0] = ~images[:, len(limits) :].any(axis=1)
        # |deviates + columns steps|^2 of each image, multiplied out: no array is as large as all images together
        steps = images * gaps[:, :, None]
        along, across = deviates @ columns, columns.swapaxes(1, 2) @ columns
        squares = squares + 2 * (steps @ along[..., None])[..., 0] + ((steps @ across[:, None]) * steps).sum(axis=-1)
        squares = np.where(shown, squares, np.inf)
    log = -0.5 * (FREEDOM + len(own)) * np.log1p(np.maximum(squares, 0.0) / FREEDOM)
    found = log_sum_exp(log) + np.array([[one._log_norm] for one in proposals])
    for grid in grids:
        found = found + grid.log_density(rows[:, grid.coordinate])
    return found


@dataclass(frozen=True)
class WeightedDraws:
    """rows : (C, P); log_density : (C,) there; log_weights : (C,), truncated, their exponentials sum to 1
    log_integral : of the density over all coordinates
    effective_sample_size : how many draws of equal weight would tell as much, 0 where none has any: of the weights
        tempered as far as was allowed, but not truncated, for these tell how well the proposals cover the density
    """

    rows: Array
    log_density: Array
    log_weights: Array
    log_integral: float
    effective_sample_size: float


def adaptive_importance(
    rng: np.random.Generator,
    log_density: LogDensity,
    proposal: Proposal,
    counts: Sequence[int],
    enough: float,
    least_power: float = 1.0,
    least: int = 0,
    high: float = np.inf,
) -> WeightedDraws:
    """Draws, as many in each round as `counts` says, the first from `proposal`, until there are `least` and `enough`
    count; the density need not be above zero at all of them. Where it is nowhere, the weights are even and the integral
    is 0.

    least_power : below 1 for a density with an error of its own at every place: weights are tempered until `enough`
        count, to this power at the least. As the proposals are fitted to the draws, a Gaussian keeps its width. Where
        not even FEW count so the power is lower still: else one draw would be told, which has no width at all
    high : no more are made once there is one of a higher log density
    """
    proposals: list[Proposal] = []
    rows, value = np.zeros((0, len(proposal.mean))), np.zeros(0)
    # of all rounds' proposals together, each weighed by how many it drew, at the rows so far
    proposed = np.zeros(0)
    for round_number, count in enumerate(counts):
        proposals.append(proposal)
        new = proposal.draw(rng, count)
        proposed = np.logaddexp(proposed, np.log(count) + log_densities([proposal], rows)[0])
        own = np.log(counts[: len(proposals)])[:, None] + log_densities(proposals, new)
        proposed = np.concatenate([proposed, log_sum_exp(own, axis=0)])
        rows, value = np.concatenate([rows, new]), np.concatenate([value, log_density(new)])
        log_weights = value - proposed + np.log(len(rows))
        if value.max() > high:
            break
        if not np.isfinite(value).any():
            continue
        if round_number and len(rows) >= least and _count(_tempered(log_weights, least_power)) >= enough:
            break
        smoothed = _smoothed(proposal, rows, log_weights) if least_power < 1 else log_weights
        proposal = _refitted(proposal, rows, smoothed)
    told = _tempered(log_weights, max(float(tempering(log_weights, enough / len(rows))), least_power))
    counted = _count(told)
    if counted < FEW:
        told = told * float(tempering(told, min(FEW / len(rows), 0.5)))
    integral = float(log_sum_exp(_truncated(log_weights))) - np.log(len(rows))
    return WeightedDraws(rows, value, normalise(_truncated(told)), integral, counted)


def _tempered(log_weights: Array, power: float) -> Array:
    """Log weights (C,) to a power, in what roughness may have made of them: a draw that is far worse than the best one
    is so for good. Else a few hundred draws metres away would together weigh as much as those about the mode."""
    top = log_weights.max()
    if not np.isfinite(top):
        return log_weights
    return power * np.maximum(log_weights - top, -ROUGH) + np.minimum(log_weights - top + ROUGH, 0.0)


def _count(log_weights: Array) -> float:
    """How many draws of equal weight would tell as much as draws of `log_weights` (C,); 0 where none has any."""
    top = log_weights.max()
    if not np.isfinite(top):
        return 0.0
    # by `effective_sample_size` of what is normalised it takes five times as long, in every round
    weights = np.exp(log_weights - top)
    return float(weights.sum() ** 2 / (weights @ weights))


def _truncated(log_weights: Array) -> Array:
    """Weights (C,) of the square root of C times their mean at most (Ionides 2008, Journal of Computational and
    Graphical Statistics 17): a single draw from where the proposals are too thin is then not all there is."""
    return np.minimum(log_weights, log_sum_exp(log_weights) - 0.5 * np.log(len(log_weights)))


def _refitted(proposal: Proposal, rows: Array, log_weights: Array) -> Proposal:
    """The proposal about the mean of tempered weights, as wide as they are; of few draws that count, rather as wide as
    it was."""
    tempered = tempering(log_weights, EFFECTIVE_SHARE, STEPS) * log_weights
    weights, effective, dimensions = np.exp(normalise(tempered)), _count(tempered), len(proposal.mean)
    mean = weights @ rows
    spread = (weights[:, None] * (rows - mean)).T @ (rows - mean)
    covariance = (effective * spread + dimensions * proposal.covariance) / (effective + dimensions)
    covariance += LEAST_VARIANCE * np.eye(dimensions)
    return Proposal(mean, covariance, proposal.lower, proposal.upper, proposal.grids)


def _smoothed(proposal: Proposal, rows: Array, log_weights: Array) -> Array:
    """Log weights (C,) of rows (C, P) with less of a rough density's roughness: a linear trend, by least squares with a
    prior, and a share of what is beside it. A few rows then tell where the density lies, and not which of them is
    highest."""
    used = log_weights > log_weights.max() - FARTHEST
    deviates = (rows[:, proposal._own] - proposal.mean[proposal._own]) @ proposal._whitening.T
    middle, mean = deviates[used].mean(axis=0), log_weights[used].mean()
    apart = deviates[used] - middle
    information = apart.T @ apart + (ROUGHNESS / RISE) ** 2 * np.eye(len(middle))
    trend = mean + (deviates - middle) @ np.linalg.solve(information, apart.T @ (log_weights[used] - mean))
    trend = np.minimum(trend, log_weights.max())
    return trend + KEPT * (log_weights - trend)
