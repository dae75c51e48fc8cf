"""Adaptive importance sampling: weighted draws are of the density, and its integral is right, from any start.

False-alarm rates: many sets of draws with seeds of their own are made, and the mean over them of a moment is compared
with the exact one in standard errors of that mean, of which five are tolerated: by Student's distribution with 39
degrees of freedom, less than two in a hundred thousand a comparison.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

import numpy as np
import pytest
from scipy import stats

from pmpnbp.geometry.poses import Array
from pmpnbp.readout import importance_sampling
from pmpnbp.readout.importance_sampling import (
    FEW,
    FREEDOM,
    ROUNDING,
    Grid,
    LogDensity,
    Proposal,
    WeightedDraws,
    adaptive_importance,
    log_densities,
)

SETS = 40
TOLERATED = 5.0
COUNTS = (100, 400, 400, 400)


def unlimited(covariance: Array, mean: Array | None = None, grids: tuple[Grid, ...] = ()) -> Proposal:
    dimensions = len(covariance)
    middle = np.zeros(dimensions) if mean is None else mean
    return Proposal(middle, covariance, np.full(dimensions, -np.inf), np.full(dimensions, np.inf), grids)


def sets(log_density: LogDensity, proposal: Proposal) -> list[WeightedDraws]:
    return [adaptive_importance(np.random.default_rng([3, k]), log_density, proposal, COUNTS, 1e9) for k in range(SETS)]


def agree(made: list[WeightedDraws], of: Callable[[Array, Array], Array], expected: Array) -> None:
    """Fails where the mean over the sets of `of` rows (C, P) and weights (C,) is too far from what is expected."""
    found = np.array([of(draws.rows, np.exp(draws.log_weights)) for draws in made])
    standard_error = found.std(axis=0, ddof=1) / np.sqrt(len(found))
    assert np.all(np.abs(found.mean(axis=0) - expected) < TOLERATED * standard_error), (found.mean(axis=0), expected)


def integral_is(made: list[WeightedDraws], expected: float) -> None:
    found = np.exp([draws.log_integral for draws in made])
    assert abs(found.mean() - expected) < TOLERATED * found.std(ddof=1) / np.sqrt(len(found)), (found.mean(), expected)


def test_draws_of_a_slanted_gaussian_from_a_start_that_is_wrong_every_way() -> None:
    """Standard deviations of 1 mm to 1 m and a correlation of 0.95, from a start three times as wide, and off."""
    std = np.array([1e-3, 0.1, 1.0])
    correlation = np.array([[1.0, 0.95, 0.0], [0.95, 1.0, 0.3], [0.0, 0.3, 1.0]])
    covariance = correlation * np.outer(std, std)
    precision, mean = np.linalg.inv(covariance), np.array([0.001, -0.05, 0.5])

    def log_density(rows: Array) -> Array:
        return -0.5 * np.einsum("wi,ij,wj->w", rows - mean, precision, rows - mean)

    made = sets(log_density, unlimited(np.diag((3 * std) ** 2)))
    agree(made, lambda rows, weights: weights @ rows, mean)
    agree(made, lambda rows, weights: np.einsum("c,ci,cj->ij", weights, rows - mean, rows - mean), covariance)
    integral_is(made, float(np.sqrt(np.linalg.det(2 * np.pi * covariance))))


def test_a_density_that_is_cut_off_at_a_limit_is_not_shunned_there() -> None:
    """Exponential from a limit on, a gaussian across, and a third coordinate between two limits."""

    def log_density(rows: Array) -> Array:
        inside = (rows[:, 0] >= -0.01) & (np.abs(rows[:, 2]) <= 0.3)
        return np.where(inside, -(rows[:, 0] + 0.01) / 0.02 - 0.5 * (rows[:, 1] / 0.1) ** 2, -np.inf)

    proposal = Proposal(
        np.zeros(3), np.diag([0.02, 0.1, 0.3]) ** 2, np.array([-0.01, -np.inf, -0.3]), np.array([0.5, np.inf, 0.3])
    )
    made = sets(log_density, proposal)
    for draws in made:  # what is drawn beyond a limit that is near is drawn again within
        assert draws.rows[:, 0].min() >= -0.01
    agree(made, lambda rows, weights: weights @ rows, np.array([0.01, 0.0, 0.0]))
    agree(made, lambda rows, weights: weights @ rows**2, np.array([0.0005, 0.01, 0.03]))
    integral_is(made, 0.02 * 0.1 * np.sqrt(2 * np.pi) * 0.6)


def test_a_grid_reaches_every_hill() -> None:
    """Two hills ten standard deviations apart, one three times as heavy; the start is on the lighter one. The grid's
    density need not be the hills' own."""

    def log_density(rows: Array) -> Array:
        x = rows[:, 0]
        hills = np.logaddexp(np.log(0.25) - 0.5 * ((x - 2) / 0.3) ** 2, np.log(0.75) - 0.5 * ((x - 5) / 0.3) ** 2)
        return hills - 0.5 * rows[:, 1] ** 2

    grid = Grid(0, 0.0, 8.0, np.array([1, 4, 4, 1, 2, 2, 1, 1]) / 16)
    made = sets(log_density, unlimited(np.eye(2), np.array([2.0, 0.0]), (grid,)))
    agree(made, lambda rows, weights: np.array([weights @ (rows[:, 0] > 3.5)]), np.array([0.75]))
    agree(made, lambda rows, weights: weights @ rows, np.array([4.25, 0.0]))
    integral_is(made, 2 * np.pi * 0.3)


@pytest.mark.parametrize("limits", [(-np.inf, np.inf), (-0.5, np.inf), (-5.0, 0.8)])
def test_a_proposal_s_density_is_that_of_its_draws(limits: tuple[float, float]) -> None:
    """By Kolmogorov and Smirnov, one in ten thousand a case, against the integral of what it says; which is 1."""
    lower, upper = np.array([limits[0], -np.inf]), np.array([limits[1], np.inf])
    proposal = Proposal(np.array([0.1, 2.0]), np.array([[0.25, 0.1], [0.1, 0.3]]), lower, upper)
    at = np.linspace(max(limits[0], -12), min(limits[1], 12), 1201)
    across = 2 + np.linspace(-12, 12, 241)
    grid = np.stack(np.meshgrid(at, across, indexing="ij"), axis=-1).reshape(-1, 2)
    density = np.trapezoid(np.exp(log_densities([proposal], grid)[0]).reshape(len(at), len(across)), across, axis=1)
    below = np.concatenate([[0.0], np.cumsum((density[1:] + density[:-1]) / 2 * np.diff(at))])
    assert below[-1] == pytest.approx(1.0, abs=2e-3)
    drawn = proposal.draw(np.random.default_rng(4), 4000)[:, 0]
    assert stats.kstest(drawn, lambda x: np.interp(x, at, below / below[-1])).pvalue > 1e-4


def test_a_density_folded_at_several_limits_is_the_sum_over_all_mirror_images(rng: np.random.Generator) -> None:
    """Its slow twin: every image is weighed by scipy's Student's t."""
    slant = rng.standard_normal((5, 5))
    mean, covariance = rng.standard_normal(5), slant @ slant.T
    lower, upper = np.full(5, -np.inf), np.full(5, np.inf)
    lower[0], upper[2], upper[4] = mean[0] - 0.3, mean[2] + 0.1, mean[4] + 0.5
    grid = Grid(1, -1.0, 1.0, np.array([0.25, 0.75]))
    rows = mean + 2 * rng.standard_normal((50, 5))
    rows[:, 1] = rng.uniform(-1, 1, 50)
    rows = np.where(rows < lower, 2 * lower - rows, np.where(rows > upper, 2 * upper - rows, rows))

    own = [0, 2, 3, 4]
    # the proposal adds as much to correlations
    rounded = covariance + ROUNDING * np.diag(np.diag(covariance))
    student = stats.multivariate_t(mean[own], rounded[np.ix_(own, own)], df=FREEDOM)
    expected = np.zeros(len(rows))
    for folded in product((False, True), repeat=3):
        image = rows.copy()
        for (coordinate, limit), mirrored in zip(((0, lower[0]), (2, upper[2]), (4, upper[4])), folded, strict=True):
            image[:, coordinate] = 2 * limit - image[:, coordinate] if mirrored else image[:, coordinate]
        expected += student.pdf(image[:, own])
    (found,) = log_densities([Proposal(mean, covariance, lower, upper, (grid,))], rows)
    np.testing.assert_allclose(found, np.log(expected) + grid.log_density(rows[:, 1]), rtol=1e-9)


def test_a_density_that_is_nowhere_leaves_even_weights_and_no_integral() -> None:
    made = adaptive_importance(
        np.random.default_rng(1), lambda rows: np.full(len(rows), -np.inf), unlimited(np.eye(2)), (20, 20), 1e9
    )
    assert made.log_integral == -np.inf and np.isfinite(made.rows).all()
    np.testing.assert_allclose(np.exp(made.log_weights), 1 / 40)


def test_it_ends_when_enough_draws_count() -> None:
    def log_density(rows: Array) -> Array:
        return -0.5 * (rows**2).sum(axis=1)

    few, many = (
        adaptive_importance(np.random.default_rng(2), log_density, unlimited(np.eye(2)), COUNTS, enough)
        for enough in (50.0, 1e9)
    )
    assert len(few.rows) == 500 and len(many.rows) == sum(COUNTS)
    assert few.effective_sample_size >= 50
    np.testing.assert_array_equal(few.rows, many.rows[:500])


def test_it_goes_on_until_there_are_as_many_as_are_asked_for() -> None:
    def log_density(rows: Array) -> Array:
        return -0.5 * (rows**2).sum(axis=1)

    made = adaptive_importance(np.random.default_rng(2), log_density, unlimited(np.eye(2)), [100] * 20, 50.0, least=730)
    assert len(made.rows) == 800


def test_a_start_beside_a_rough_density_is_left_in_a_few_rounds(monkeypatch: pytest.MonkeyPatch) -> None:
    """From 1.2 deviations off in each of ten coordinates, with an error of 4 nats: the mean over 24 sets is off by less
    than half as much as where proposals are fitted to the rough weights. Its own standard error is 0.02."""

    def middle() -> float:
        found = []
        for k in range(24):
            rng = np.random.default_rng([8, k])

            def rough(rows: Array, rng: np.random.Generator = rng) -> Array:
                return np.asarray(-0.5 * (rows**2).sum(axis=1) + 4.0 * rng.standard_normal(len(rows)))

            start = unlimited(1.5 * np.eye(10), np.full(10, 1.2))
            made = adaptive_importance(rng, rough, start, (96, *[100] * 4), 1e9, 0.3)
            found.append(np.exp(made.log_weights) @ made.rows)
        return float(np.mean(found))

    smoothed = middle()
    monkeypatch.setattr(importance_sampling, "KEPT", 1.0)
    assert 0.0 < 2 * smoothed < middle()


def test_draws_that_are_far_worse_weigh_next_to_nothing_however_little_power_weights_have(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Metres of a density that is 25 nats below the mode: had all weights one power it would widen what is told."""

    def log_density(rows: Array) -> Array:
        return np.asarray(np.maximum(-0.5 * ((rows / 0.1) ** 2).sum(axis=1), -25.0))

    def far_share() -> float:
        made = adaptive_importance(np.random.default_rng(9), log_density, unlimited(np.eye(2)), [200] * 6, 150.0, 0.25)
        moments = np.exp(made.log_weights) * (made.rows**2).sum(axis=1)
        return float(moments[made.log_density == -25.0].sum() / moments.sum())

    own = far_share()
    monkeypatch.setattr(importance_sampling, "ROUGH", np.inf)
    assert own < 0.1 < 0.25 < far_share()


def test_a_density_with_an_error_at_every_place_is_drawn_as_wide_as_without() -> None:
    """With one of 3 nats, less than half as many draws would count; widths are right to a tenth over the sets."""

    def widths(least_power: float) -> tuple[Array, float]:
        found, counted = [], []
        for k in range(SETS):
            rng = np.random.default_rng([4, k])

            def rough(rows: Array, rng: np.random.Generator = rng) -> Array:
                return np.asarray(-0.5 * (rows**2).sum(axis=1) + 3.0 * rng.standard_normal(len(rows)))

            start = unlimited(1.7 * np.eye(6), np.full(6, 0.3))
            made = adaptive_importance(rng, rough, start, (100, *[200] * 15), 100.0, least_power)
            weights = np.exp(made.log_weights)
            found.append(np.sqrt(weights @ (made.rows - weights @ made.rows) ** 2))
            counted.append(made.effective_sample_size)
        return np.mean(found, axis=0), float(np.median(counted))

    tempered, counted = widths(0.5)
    np.testing.assert_allclose(tempered, 1.0, atol=0.1)
    assert counted >= 100 > 2 * widths(1.0)[1]


def test_where_next_to_no_draw_counts_a_few_are_told_all_the_same() -> None:
    """A thousandth as wide as the start in each of eight coordinates: one draw is as good as all. So much is said, and
    what is told is wider than a single draw."""

    def narrow(rows: Array) -> Array:
        return np.asarray(-0.5 * ((rows / 1e-3) ** 2).sum(axis=1))

    made = adaptive_importance(np.random.default_rng(6), narrow, unlimited(np.eye(8)), (200, 200), 100.0, 0.5)
    weights = np.exp(made.log_weights)
    assert made.effective_sample_size < 3 < FEW * 0.4 < 1 / (weights**2).sum()
    assert np.all(np.sqrt(weights @ (made.rows - weights @ made.rows) ** 2) > 0.05)


def test_it_ends_with_a_draw_that_is_better_than_the_place_can_be() -> None:
    def log_density(rows: Array) -> Array:
        return np.asarray(-0.5 * ((rows - 3.0) ** 2).sum(axis=1))

    better = float(log_density(np.zeros((1, 2)))[0]) + 4.0
    made = adaptive_importance(np.random.default_rng(7), log_density, unlimited(np.eye(2)), COUNTS, 1e9, high=better)
    assert len(made.rows) == COUNTS[0] and made.log_density.max() > -5.0


def test_a_grid_draws_what_it_says() -> None:
    """Shares of a million draws: standard error 0.05 %, five of them tolerated."""
    grid = Grid(2, -1.0, 3.0, np.array([0.1, 0.2, 0.3, 0.4]))
    drawn = grid.draw(np.random.default_rng(5), 1_000_000)
    assert drawn.min() >= -1 and drawn.max() < 3
    shares = np.histogram(drawn, 4, (-1, 3))[0] / len(drawn)
    np.testing.assert_allclose(shares, grid.weights, atol=0.0025)
    found = np.exp(grid.log_density(np.array([-0.5, 0.5, 1.5, 2.5, 3.5, -1.5])))
    np.testing.assert_allclose(found, [0.1, 0.2, 0.3, 0.4, 0.0, 0.0])
