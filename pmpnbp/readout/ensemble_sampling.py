"""Draws from a density that is known up to a constant: an ensemble of Markov chains that learn from each other.

Differential evolution Markov chain (ter Braak 2006, Statistics and Computing 16): a walker steps along the difference
of two others, so that steps are as long and as slanted as the density is, without anyone having to say so. What such
steps never cross, from one hypothesis of a coordinate to another, redraws of single coordinates do.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry.poses import Array

# Length of steps in K dimensions that is accepted about as often as is best: LENGTH / sqrt(2 K) (ter Braak 2006). Now
# and then it is 1, which lets a walker change over to where another one is.
LENGTH, WHOLE = 2.38, 0.1

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
        found: Array = np.log(self.weights[np.minimum((share * len(self.weights)).astype(int), len(self.weights) - 1)])
        return found


def sample(
    rng: np.random.Generator,
    log_density: LogDensity,
    start: Array,
    steps: int,
    *,
    jitter: Array,
    grids: tuple[Grid, ...] = (),
) -> tuple[Array, float]:
    """The walkers after each of `steps` steps, (steps, W, K), and the share of moves along differences that was taken.

    start : (W, K), W even and at least 4, where the density is above zero; jitter : (K,) standard deviations of noise
    on every step, small against the density's own; grids : of coordinates that are redrawn, one of them in every step
    """
    walkers, dimensions = start.shape
    current, value = start.copy(), log_density(start)
    history = np.empty((steps, walkers, dimensions))
    taken = 0
    for step in range(steps):
        for half in (0, 1):
            rows, others = np.arange(half, walkers, 2), np.arange(1 - half, walkers, 2)
            moved = current[rows] + _differences(rng, current[others], len(rows))
            moved += jitter * rng.standard_normal(moved.shape)
            taken += _accept(rng, log_density, current, value, rows, moved, np.zeros(len(rows)))
        if grids:
            grid = grids[int(rng.integers(len(grids)))]
            moved = current.copy()
            moved[:, grid.coordinate] = grid.draw(rng, walkers)
            back, forth = (grid.log_density(rows[:, grid.coordinate]) for rows in (current, moved))
            _accept(rng, log_density, current, value, np.arange(walkers), moved, back - forth)
        history[step] = current
    return history, taken / max(steps * walkers, 1)


def without_stragglers(rng: np.random.Generator, walkers: Array, value: Array) -> Array:
    """(W, K): walkers of which those that got stuck where hardly any density is begin again where another one stands:
    log densities `value` (W,) more than twice the quartiles' distance below the lower quartile (Vrugt et al. 2009,
    International Journal of Nonlinear Sciences and Numerical Simulation 10). Only before draws are taken."""
    low, high = np.quantile(value, [0.25, 0.75])
    stuck = value < low - 2 * (high - low)
    found = walkers.copy()
    found[stuck] = walkers[rng.choice(np.flatnonzero(~stuck), int(stuck.sum()))]
    return found


def _differences(rng: np.random.Generator, others: Array, count: int) -> Array:
    """(count, K): multiples of differences between two of the others."""
    first = rng.integers(len(others), size=count)
    second = (first + rng.integers(1, len(others), size=count)) % len(others)
    length = LENGTH / np.sqrt(2 * others.shape[1]) * rng.uniform(0.3, 1.0, count)
    length = np.where(rng.random(count) < WHOLE, 1.0, length)
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
    """Metropolis and Hastings: moves `rows` of `current` and `value`, in place, where chance has it; how many."""
    there = log_density(moved)
    with np.errstate(invalid="ignore"):
        better = np.log(rng.random(len(rows))) < there - value[rows] + log_correction
    current[rows[better]], value[rows[better]] = moved[better], there[better]
    return int(better.sum())
