"""Weights in the log domain obey their laws: sums, bounds, tempering; and systematic resampling is unbiased."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.special import logsumexp

from pmpnbp.geometry.poses import Array
from pmpnbp.inference import log_weights as lw

rows = arrays.arrays(np.float64, st.tuples(st.integers(1, 4), st.integers(1, 30)), elements=st.floats(-1e5, 1e5))


@given(rows)
def test_log_sum_exp_agrees_with_scipy(values: Array) -> None:
    np.testing.assert_allclose(lw.log_sum_exp(values), logsumexp(values, axis=-1), rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(lw.log_sum_exp(values, axis=0), logsumexp(values, axis=0), rtol=1e-12, atol=1e-12)


def test_log_sum_exp_of_nothing_is_minus_infinity() -> None:
    values = np.array([[-np.inf, -np.inf], [-np.inf, 3.0]])
    np.testing.assert_array_equal(lw.log_sum_exp(values), [-np.inf, 3.0])


@given(rows)
def test_normalised_weights_add_up_to_one_and_keep_their_ratios(values: Array) -> None:
    normalised = lw.normalise(values)
    np.testing.assert_allclose(np.exp(normalised).sum(axis=-1), 1.0, rtol=1e-9)
    np.testing.assert_allclose(np.diff(normalised), np.diff(values), atol=1e-9)


def test_a_row_without_any_weight_becomes_uniform_and_others_keep_their_zeros() -> None:
    normalised = lw.normalise(np.array([[-np.inf, -np.inf, -np.inf, -np.inf], [0.0, -np.inf, 0.0, -np.inf]]))
    np.testing.assert_allclose(np.exp(normalised), [[0.25] * 4, [0.5, 0.0, 0.5, 0.0]], rtol=1e-15)


@given(rows)
def test_effective_sample_size_is_between_one_and_all(values: Array) -> None:
    effective = lw.effective_sample_size(lw.normalise(values))
    assert np.all(effective >= 1 - 1e-9) and np.all(effective <= values.shape[-1] * (1 + 1e-9))


def test_effective_sample_size_of_k_equal_weights_is_k() -> None:
    for k in (1, 3, 8):
        weights = np.full(8, -np.inf)
        weights[:k] = -np.log(k)
        np.testing.assert_allclose(lw.effective_sample_size(weights), k, rtol=1e-12)


@pytest.mark.parametrize("share", [0.05, 0.15, 0.5, 0.9])
def test_tempering_reaches_the_share_it_is_asked_for(rng: np.random.Generator, share: float) -> None:
    potential = 10.0 ** np.arange(-1, 5)[:, None] * rng.standard_normal((6, 300))
    factor = lw.tempering(potential, share)
    reached = lw.effective_sample_size(lw.normalise(factor[:, None] * potential)) / 300
    untempered = lw.effective_sample_size(lw.normalise(potential)) / 300
    tempered = factor < 1
    assert tempered[-1] and np.all(tempered == (untempered < share))
    np.testing.assert_allclose(reached[tempered], share, rtol=1e-3)
    np.testing.assert_array_equal(factor[~tempered], 1.0)


def test_tempering_asks_for_less_the_steeper_the_potential_and_the_larger_the_share(rng: np.random.Generator) -> None:
    potential = rng.standard_normal(400)
    by_steepness = [float(lw.tempering(scale * potential, 0.15)) for scale in (1, 10, 100, 1000)]
    assert by_steepness == sorted(by_steepness, reverse=True) and by_steepness[-1] < by_steepness[1] < 1
    # what counts is the product: ten times as steep, a tenth of the factor
    np.testing.assert_allclose(by_steepness[2] / by_steepness[3], 10.0, rtol=1e-3)
    by_share = [float(lw.tempering(100 * potential, share)) for share in (0.05, 0.15, 0.4, 0.8)]
    assert by_share == sorted(by_share, reverse=True) and by_share[-1] < by_share[0]


def test_tempering_is_blind_to_a_constant_and_survives_zero_weights(rng: np.random.Generator) -> None:
    potential = 50 * rng.standard_normal(200)
    np.testing.assert_allclose(lw.tempering(potential + 1e4, 0.15), lw.tempering(potential, 0.15), rtol=1e-6)
    potential[::2] = -np.inf
    factor = lw.tempering(potential, 0.15)
    assert 0 < factor <= 1
    assert lw.effective_sample_size(lw.normalise(factor * potential)) >= 0.15 * 200 * (1 - 1e-3)


def test_systematic_resampling_is_unbiased(rng: np.random.Generator) -> None:
    """Mean counts over 4000 resamplings against count * weight. A count's standard deviation is that of its random
    part, sqrt(f (1 - f)) with f the fraction of count * weight; 5 of them in 20 particles: under 2e-5 by chance.
    Rare particles, whose counts are far from Gaussian, are for the next test."""
    log_weights = np.log(rng.dirichlet(np.full(20, 3.0)))
    count, repeats = 17, 4000
    drawn = lw.systematic(rng, np.broadcast_to(log_weights, (repeats, 20)), count)
    mean = np.bincount(drawn.ravel(), minlength=20) / repeats
    expected = count * np.exp(log_weights)
    fraction = expected % 1.0
    assert np.all(expected > 0.1)
    assert np.all(np.abs(mean - expected) <= 5 * np.sqrt(fraction * (1 - fraction) / repeats) + 1e-9)


def test_systematic_counts_are_the_floor_or_one_more(rng: np.random.Generator) -> None:
    weights = rng.dirichlet(np.full(9, 0.7), size=200)
    drawn = lw.systematic(rng, np.log(weights), 30)
    for row, expected in zip(drawn, 30 * weights, strict=True):
        counts = np.bincount(row, minlength=9)
        assert np.all((counts >= np.floor(expected - 1e-9)) & (counts <= np.ceil(expected + 1e-9)))


def test_systematic_never_draws_a_weight_of_zero(rng: np.random.Generator) -> None:
    log_weights = np.full((500, 6), -np.inf)
    log_weights[:, [2, 4]] = -np.log(2)
    assert set(np.unique(lw.systematic(rng, log_weights, 11)).tolist()) == {2, 4}


def test_systematic_keeps_leading_axes_and_draws_rows_apart(rng: np.random.Generator) -> None:
    log_weights = np.full((3, 5, 4), -np.log(4))
    drawn = lw.systematic(rng, log_weights, 6)
    assert drawn.shape == (3, 5, 6)
    assert len({tuple(row) for row in drawn.reshape(-1, 6).tolist()}) > 1
