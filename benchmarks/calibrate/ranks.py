"""Where does the truth lie among the draws? Ranks, and whether they are spread as an honest posterior's are.

Simulation-based calibration: where the truth is drawn from the prior and the draws from the exact posterior given what
was rendered of it, the truth's rank among the draws is uniform. Draws too narrow pile the ranks up at both ends, draws
too wide in the middle, draws that lean to one side at one end.

S. Talts, M. Betancourt, D. Simpson, A. Vehtari and A. Gelman, Validating Bayesian inference algorithms with
simulation-based calibration, arXiv:1804.06788 (2018).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import stats

from pmpnbp.geometry.poses import Array

# Ranks in each bar of a histogram on average, at least: chi-square's law holds from about five on. Bars at most.
EACH, MOST = 10, 10
NARROW, WIDE, LOW, HIGH, UNIFORM = "too narrow", "too wide", "too low", "too high", "uniform"


def ranks(rng: np.random.Generator, draws: Array, truth: Array, weights: Array) -> Array:
    """(...) ranks, 0 to 1, of `truth` (...) among `draws` (K, ...) of weights (K,).

    The truth counts as one draw more, of as many as the weights are worth, and its place among its equals is drawn: so
    the ranks of n draws of equal weight are exactly uniform where the truth is one of n + 1.
    """
    share = weights / weights.sum()
    worth = 1.0 / np.sum(share**2)
    below = np.einsum("k,k...->...", share, draws < truth)
    equal = np.einsum("k,k...->...", share, draws == truth)
    found: Array = (worth * below + rng.random(truth.shape) * (worth * equal + 1.0)) / (worth + 1.0)
    return found


def bars(runs: int) -> int:
    """Bars in a histogram of so many ranks."""
    return int(np.clip(runs // EACH, 2, MOST))


def counts(found: Array) -> Array:
    """How many of ranks (R,) are in each bar."""
    height, _ = np.histogram(found, bars(len(found)), (0.0, 1.0))
    return height.astype(np.float64)


def uniformity(found: Array) -> float:
    """The chance (chi-square's) that uniform ranks are spread less evenly than these (R,); 1 for none."""
    return float(stats.chisquare(counts(found)).pvalue) if len(found) else 1.0


def holm(chances: Sequence[float]) -> Array:
    """The same of several tests, each raised by how many there are: the least of them is below a level no oftener than
    that of one test (Holm 1979)."""
    order = np.argsort(chances)
    raised = np.maximum.accumulate(np.array(chances)[order] * np.arange(len(order), 0, -1))
    found = np.empty(len(order))
    found[order] = np.minimum(raised, 1.0)
    return found


def shape(found: Array) -> str:
    """In which way ranks (R,) that are not uniform depart from it most: by their mean, which is 1/2 ± 1/√(12 R), or by
    how far they are from 1/2, on average 1/4 ± 1/√(48 R)."""
    lean = (found.mean() - 0.5) * np.sqrt(12 * len(found))
    far = (np.abs(found - 0.5).mean() - 0.25) * np.sqrt(48 * len(found))
    if abs(lean) > abs(far):
        # a truth above the draws has a high rank, and then these are too low
        return LOW if lean > 0 else HIGH
    return NARROW if far > 0 else WIDE
