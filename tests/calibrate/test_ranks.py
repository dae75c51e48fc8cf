"""Ranks among weighted draws: uniform where the posterior is exact, and told where it is not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from benchmarks.calibrate import ranks as statistic
from benchmarks.calibrate.ranks import holm, ranks, shape, uniformity
from pmpnbp.geometry.poses import Array

RUNS, DRAWS, NOISE = 400, 300, 0.5


def toy_ranks(rng: np.random.Generator, width: float = 1.0, lean: float = 0.0) -> Array:
    """(RUNS,) ranks of truths from N(0, 1), seen once with noise, in the posterior, which is Gaussian; `width` times as
    wide as it is, and off by `lean` of its deviations. Draws are from Student's t, twice as wide, and weighted."""
    found = []
    for truth in rng.standard_normal(RUNS):
        seen = truth + NOISE * rng.standard_normal()
        mean, std = seen / (1 + NOISE**2), np.sqrt(NOISE**2 / (1 + NOISE**2))
        draws = mean + 2 * std * rng.standard_t(5, DRAWS)
        log_weights = stats.norm.logpdf(draws, mean + lean * std, width * std)
        log_weights -= stats.t.logpdf((draws - mean) / (2 * std), 5)
        weights = np.exp(log_weights - log_weights.max())
        found.append(float(ranks(rng, draws[:, None], np.array([truth]), weights)[0]))
    return np.array(found)


@pytest.mark.parametrize("seed", range(5))
def test_ranks_in_an_exact_posterior_are_uniform(seed: int) -> None:
    """A false alarm in a thousand for each of the seeds, which are fixed."""
    assert uniformity(toy_ranks(np.random.default_rng(seed))) > 0.001


@pytest.mark.parametrize(
    ("width", "lean", "told"),
    [(0.6, 0.0, statistic.NARROW), (1.7, 0.0, statistic.WIDE), (1.0, 0.6, statistic.HIGH), (1.0, -0.6, statistic.LOW)],
)
def test_a_posterior_that_is_not_exact_is_caught(width: float, lean: float, told: str) -> None:
    found = toy_ranks(np.random.default_rng(7), width, lean)
    assert uniformity(found) < 1e-6
    assert shape(found) == told


def test_equal_weights_give_the_place_of_the_truth_among_the_draws(rng: np.random.Generator) -> None:
    """The truth is one of n + 1: with r draws below it, its rank is anywhere from r to r + 1 of n + 1."""
    draws = np.arange(9.0)[:, None]
    for below, truth in ((0, -1.0), (4, 3.5), (9, 20.0)):
        found = np.array([ranks(rng, draws, np.array([truth]), np.ones(9))[0] for _ in range(2000)])
        assert below / 10 <= found.min() and found.max() <= (below + 1) / 10
        # 4.5 standard deviations of the mean of that many uniform numbers, a false alarm in 10⁵; the seed is fixed
        assert found.mean() == pytest.approx((below + 0.5) / 10, abs=4.5 * 0.1 / np.sqrt(12 * 2000))


def test_among_equals_any_place_is_as_likely(rng: np.random.Generator) -> None:
    """Joints lie at their limits exactly: a rank there must not be 0 or 1."""
    found = np.array([ranks(rng, np.zeros((20, 1)), np.zeros(1), np.ones(20))[0] for _ in range(500)])
    assert uniformity(found) > 0.001  # a false alarm in a thousand; the seed is fixed


def test_a_draw_that_weighs_nothing_says_nothing(rng: np.random.Generator) -> None:
    draws, weights = np.array([[0.0], [1.0], [9.0]]), np.array([0.5, 0.5, 0.0])
    assert ranks(rng, draws, np.array([5.0]), weights)[0] >= 2 / 3


def test_several_tests_are_judged_together() -> None:
    """By hand: 0.01 of three is 0.03, 0.03 of the two left 0.06, and 0.04, the last, is raised to that."""
    np.testing.assert_allclose(holm([0.04, 0.01, 0.03]), [0.06, 0.03, 0.06])
    assert holm([0.9, 0.8]).max() == 1.0
