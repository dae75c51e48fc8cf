"""The ensemble of chains: its draws are those of the density, wherever it began, and however many hills there are.

False-alarm rates: many ensembles with seeds of their own are made, and the mean over them of a moment is compared with
the exact one in standard errors of that mean, of which five are tolerated: by Student's distribution with 39 degrees of
freedom, less than two in a hundred thousand a comparison.

A step of many chains costs little more than one of few: ensembles are large, and short.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from pmpnbp.geometry.poses import Array
from pmpnbp.readout.ensemble_sampling import Grid, sample

ENSEMBLES = 40
TOLERATED = 5.0


def ensembles(make: Callable[[np.random.Generator], Array]) -> list[Array]:
    """The draws (K, D) of every ensemble."""
    return [make(np.random.default_rng([3, k])) for k in range(ENSEMBLES)]


def settled(history: Array) -> Array:
    """Draws of the later half."""
    return history[len(history) // 2 :].reshape(-1, history.shape[2])


def agree(made: list[Array], of: Callable[[Array], Array], expected: Array) -> None:
    """Fails where the mean over the ensembles of `of` draws (K, D) is too far from what is expected."""
    found = np.array([of(draws) for draws in made])
    standard_error = found.std(axis=0, ddof=1) / np.sqrt(len(found))
    assert np.all(np.abs(found.mean(axis=0) - expected) < TOLERATED * standard_error), (found, expected)


def test_draws_of_a_slanted_gaussian() -> None:
    """Standard deviations of 1 mm to 5 m and a correlation of 0.95, from a start that is a tenth as wide."""
    std = np.array([1e-3, 1.0, 5.0])
    correlation = np.array([[1.0, 0.95, 0.0], [0.95, 1.0, 0.3], [0.0, 0.3, 1.0]])
    covariance = correlation * np.outer(std, std)
    precision, mean = np.linalg.inv(covariance), np.array([0.01, -2.0, 7.0])

    def log_density(rows: Array) -> Array:
        return -0.5 * np.einsum("wi,ij,wj->w", rows - mean, precision, rows - mean)

    def draws(rng: np.random.Generator) -> Array:
        start = mean + 0.1 * std * rng.standard_normal((48, 3))
        return settled(sample(rng, log_density, start, 300, jitter=1e-5 * std)[0])

    made = ensembles(draws)
    agree(made, lambda rows: rows.mean(axis=0), mean)
    agree(made, lambda rows: np.cov(rows.T) / np.outer(std, std), correlation)


def test_what_lies_outside_is_never_drawn_and_the_edge_not_shunned() -> None:
    """Uniform over a triangle."""

    def log_density(rows: Array) -> Array:
        inside = (rows >= 0).all(axis=1) & (rows.sum(axis=1) <= 1)
        return np.where(inside, 0.0, -np.inf)

    def draws(rng: np.random.Generator) -> Array:
        start = np.full((32, 2), 0.3) + 0.01 * rng.random((32, 2))
        rows = settled(sample(rng, log_density, start, 200, jitter=np.full(2, 1e-4))[0])
        assert np.isfinite(log_density(rows)).all()
        return rows

    made = ensembles(draws)
    agree(made, lambda rows: rows.mean(axis=0), np.full(2, 1 / 3))
    agree(made, lambda rows: np.mean(rows**2, axis=0), np.full(2, 1 / 6))


def test_redraws_cross_to_another_hill() -> None:
    """Two hills ten standard deviations apart, one three times as heavy; all walkers begin on the lighter one. The
    grid's density need not be the hills' own."""

    def log_density(rows: Array) -> Array:
        x = rows[:, 0]
        other = -0.5 * rows[:, 1] ** 2
        return other + np.logaddexp(
            np.log(0.25) - 0.5 * ((x - 2) / 0.3) ** 2, np.log(0.75) - 0.5 * ((x - 5) / 0.3) ** 2
        )

    grid = Grid(0, 0.0, 8.0, np.array([1, 4, 4, 1, 2, 2, 1, 1]) / 16)

    def draws(rng: np.random.Generator) -> Array:
        start = np.array([2.0, 0.0]) + 0.1 * rng.standard_normal((48, 2))
        return settled(sample(rng, log_density, start, 300, jitter=np.full(2, 1e-4), grids=(grid,))[0])

    made = ensembles(draws)
    agree(made, lambda rows: np.array([np.mean(rows[:, 0] > 3.5)]), np.array([0.75]))
    agree(made, lambda rows: rows[:, :1].mean(axis=0), np.array([4.25]))
    agree(made, lambda rows: np.mean(rows[:, 1:] ** 2, axis=0), np.array([1.0]))


def test_a_grid_draws_what_it_says() -> None:
    """Shares of a million draws: standard error 0.05 %, five of them tolerated."""
    grid = Grid(2, -1.0, 3.0, np.array([0.1, 0.2, 0.3, 0.4]))
    drawn = grid.draw(np.random.default_rng(5), 1_000_000)
    assert drawn.min() >= -1 and drawn.max() < 3
    shares = np.histogram(drawn, 4, (-1, 3))[0] / len(drawn)
    np.testing.assert_allclose(shares, grid.weights, atol=0.0025)
    np.testing.assert_allclose(
        np.exp(grid.log_density(np.array([-0.5, 0.5, 1.5, 2.5, 3.5]))), [0.1, 0.2, 0.3, 0.4, 0.1]
    )


@pytest.mark.parametrize("grids", [(), (Grid(0, -3.0, 3.0, np.full(6, 1 / 6)),)])
def test_the_same_seed_gives_the_same_draws(grids: tuple[Grid, ...]) -> None:
    def history() -> tuple[Array, float]:
        start = np.random.default_rng(1).standard_normal((8, 2))
        return sample(
            np.random.default_rng(2),
            lambda rows: -0.5 * (rows**2).sum(axis=1),
            start,
            50,
            jitter=np.full(2, 1e-4),
            grids=grids,
        )

    once, again = history(), history()
    np.testing.assert_array_equal(once[0], again[0])
    assert once[0].shape == (50, 8, 2) and once[1] == again[1] and 0.1 < once[1] < 0.9
