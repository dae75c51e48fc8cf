"""Draws from a density that is known up to a constant: an ensemble of Markov chains that learn from each other.

Differential evolution Markov chain (ter Braak 2006, Statistics and Computing 16): each chain's proposal is a step along
the difference of two other chains, which gives steps the scale and the correlations of the density without tuning.
Between separate modes of one coordinate such steps are never accepted; redraws of that coordinate alone cross over.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry.poses import Array

# A step is the difference times GAMMA / sqrt(2 K) in K dimensions, the optimum for a Gaussian; in MODE_JUMPS of the
# proposals times 1, which takes a chain from one mode to another (ter Braak 2006).
GAMMA, MODE_JUMPS = 2.38, 0.1
# Steps are shortened at random, down to this share of their length.
SHORTEST = 0.3
# Outliers lie this many interquartile ranges below the lower quartile (Vrugt et al. 2009).
OUTLIER_RANGES = 2

# log density (W,), up to a constant, of rows (W, K); -inf where there is none
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
        """(W,), up to a constant, at positions (W,), beyond the ends as if it went around."""
        share = np.mod((positions - self.lower) / (self.upper - self.lower), 1.0)
        return np.log(self.weights[np.minimum((share * len(self.weights)).astype(int), len(self.weights) - 1)])


def sample(
    rng: np.random.Generator,
    log_density: LogDensity,
    start: Array,
    steps: int,
    *,
    jitter: Array,
    grids: tuple[Grid, ...] = (),
) -> tuple[Array, float]:
    """The chains after each of `steps` steps, (steps, W, K), and the share of differences that was accepted.

    start : (W, K), W even and at least 4, where the density is above zero; jitter : (K,) standard deviations of noise
    on every step, small against the density's own; grids : of coordinates that are redrawn, one of them in every step
    """
    chains, dimensions = start.shape
    current, value = start.copy(), log_density(start)
    history = np.empty((steps, chains, dimensions))
    accepted = 0
    for step in range(steps):
        for half in (0, 1):
            rows, others = np.arange(half, chains, 2), np.arange(1 - half, chains, 2)
            moved = current[rows] + _differences(rng, current[others], len(rows))
            moved += jitter * rng.standard_normal(moved.shape)
            accepted += _accept(rng, log_density, current, value, rows, moved, np.zeros(len(rows)))
        if grids:
            grid = grids[int(rng.integers(len(grids)))]
            moved = current.copy()
            moved[:, grid.coordinate] = grid.draw(rng, chains)
            back, forth = (grid.log_density(rows[:, grid.coordinate]) for rows in (current, moved))
            _accept(rng, log_density, current, value, np.arange(chains), moved, back - forth)
        history[step] = current
    return history, accepted / max(steps * chains, 1)


def replace_outlier_chains(rng: np.random.Generator, chains: Array, log_densities: Array) -> Array:
    """Chains (W, K) with each outlier, by its log density (W,), moved to where a random one of the others is (Vrugt et
    al. 2009, International Journal of Nonlinear Sciences and Numerical Simulation 10). Breaks the stationarity of the
    chains: for the burn-in only."""
    low, high = np.quantile(log_densities, [0.25, 0.75])
    outlier = log_densities < low - OUTLIER_RANGES * (high - low)
    replaced = chains.copy()
    replaced[outlier] = chains[rng.choice(np.flatnonzero(~outlier), int(outlier.sum()))]
    return replaced


def _differences(rng: np.random.Generator, others: Array, count: int) -> Array:
    """(count, K): multiples of differences between two of the others."""
    first = rng.integers(len(others), size=count)
    second = (first + rng.integers(1, len(others), size=count)) % len(others)
    length = GAMMA / np.sqrt(2 * others.shape[1]) * rng.uniform(SHORTEST, 1.0, count)
    length = np.where(rng.random(count) < MODE_JUMPS, 1.0, length)
    return length[:, None] * (others[first] - others[second])


def _accept(
    rng: np.random.Generator,
    log_density: LogDensity,
    current: Array,
    value: Array,
    rows: NDArray[np.int64],
    moved: Array,
    log_correction: Array,
) -> int:
    """Metropolis-Hastings: replaces `rows` of `current` and `value` by the proposals that are accepted; how many."""
    proposed = log_density(moved)
    with np.errstate(invalid="ignore"):
        accepted = np.log(rng.random(len(rows))) < proposed - value[rows] + log_correction
    current[rows[accepted]], value[rows[accepted]] = moved[accepted], proposed[accepted]
    return int(accepted.sum())
