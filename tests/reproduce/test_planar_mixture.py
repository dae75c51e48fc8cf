"""Products of mixtures by Gibbs sampling against the exact product, whose every component is written out."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.stats import chi2

from benchmarks.reproduce.planar.mixture import Mixture, draw_product, rule_of_thumb
from benchmarks.reproduce.planar.pattern import wrap

FALSE_ALARM = 1e-4  # of every test of a distribution here; the seeds are fixed
COUNT = 20_000


def small_mixtures(factors: int, components: int, around: float) -> list[Mixture]:
    """Close enough together for labels to change often, so that a few sweeps forget where they began. Turns lie about
    `around`."""
    rng = np.random.default_rng([11, factors])
    found = []
    for _ in range(factors):
        means = rng.normal(0.0, (1.0, 1.0, 0.1), (components, 3)) + (50.0, 60.0, around)
        weights = rng.dirichlet(np.full(components, 3.0))
        found.append(Mixture(means, np.log(weights), rng.uniform((1.0, 1.0, 0.1), (2.0, 2.0, 0.2))))
    return found


def exact_product(mixtures: list[Mixture], tilt: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights (M^d,), means (M^d, 3) and variance (3,) of all components, labels counted like the digits of a number.

    Π N(x; μ_k, v_k) is N(x; μ, v) with 1/v = Σ 1/v_k and μ = v Σ μ_k/v_k, times what exp(-½ Σ (μ_k - μ)²/v_k) varies.
    """
    log_weights, means = [], []
    precisions = np.array([m.spread**-2.0 for m in mixtures])
    variance = 1 / precisions.sum(axis=0)
    for labels in product(*(range(len(m.means)) for m in mixtures)):
        chosen = np.array([m.means[label] for m, label in zip(mixtures, labels, strict=True)])
        chosen[:, 2] = chosen[0, 2] + wrap(chosen[:, 2] - chosen[0, 2])
        mean = variance * np.sum(precisions * chosen, axis=0)
        weight = sum(m.log_weights[label] + t[label] for m, t, label in zip(mixtures, tilt, labels, strict=True))
        log_weights.append(weight - 0.5 * np.sum(precisions * (chosen - mean) ** 2))
        means.append(mean)
    weights = np.exp(np.array(log_weights) - max(log_weights))
    return weights / weights.sum(), np.array(means), variance


@pytest.mark.parametrize("around", [0.3, np.pi], ids=["turns near nothing", "turns across the wrap"])
@pytest.mark.parametrize("tilted", [False, True])
@pytest.mark.parametrize(("factors", "components"), [(1, 5), (2, 4), (3, 3)])
def test_draws_are_from_the_exact_product(factors: int, components: int, tilted: bool, around: float) -> None:
    mixtures = small_mixtures(factors, components, around)
    tilt = [np.linspace(0.0, float(tilted), components)] * factors
    poses, labels = draw_product(np.random.default_rng(12), mixtures, tilt, COUNT, 20)
    weights, means, variance = exact_product(mixtures, tilt)

    component = labels @ components ** np.arange(factors - 1, -1, -1)
    expected = COUNT * weights
    common = expected >= 5
    seen = np.bincount(component, minlength=len(weights))
    difference = (seen[common] - expected[common]) ** 2 / expected[common]
    assert difference.sum() < chi2.isf(FALSE_ALARM, common.sum() - 1)

    # each draw about the mean of its own component: chi-square with one degree per draw
    off = poses - means[component]
    off[:, 2] = wrap(off[:, 2])
    for squared in (off**2 / variance).sum(axis=0):
        assert chi2.isf(1 - FALSE_ALARM / 2, COUNT) < squared < chi2.isf(FALSE_ALARM / 2, COUNT)


def test_far_apart_mixtures_meet_between() -> None:
    """No weight underflows to nothing: two single Gaussians a hundred deviations apart have a product all the same."""
    pair = [Mixture(np.array([[x, 0.0, 0.0]]), np.zeros(1), np.full(3, 0.1)) for x in (0.0, 10.0)]
    poses, _ = draw_product(np.random.default_rng(1), pair, [np.zeros(1)] * 2, 100, 2)
    assert abs(poses[:, 0].mean() - 5.0) < 0.05


def test_the_same_generator_gives_the_same_draws() -> None:
    mixtures = small_mixtures(3, 3, 0.0)
    tilt = [np.zeros(3)] * 3
    first, second = (draw_product(np.random.default_rng(3), mixtures, tilt, 50, 4) for _ in range(2))
    for ours, theirs in zip(first, second, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_the_rule_of_thumb_on_a_gaussian() -> None:
    """0.9 σ M^(-1/7), to the few percent by which 4000 draws know their own σ; turns about the wrap are as others."""
    rng = np.random.default_rng(4)
    sigma = np.array([5.0, 2.0, 0.2])
    poses = np.array([10.0, 20.0, np.pi]) + sigma * rng.standard_normal((4000, 3))
    poses[:, 2] = wrap(poses[:, 2])
    weights = np.full(4000, -np.log(4000))
    found = rule_of_thumb(poses, weights, np.zeros(3), np.full(3, 100.0))
    np.testing.assert_allclose(found, 0.9 * sigma * 4000 ** (-1 / 7), rtol=0.06)
    np.testing.assert_allclose(rule_of_thumb(poses, weights, np.ones(3), np.full(3, 1.2)), [1.2, 1.0, 1.0])
    doubled = np.concatenate([poses, rng.uniform(0, 300, (4000, 3))]), np.concatenate([weights, np.full(4000, -1e30)])
    np.testing.assert_allclose(rule_of_thumb(*doubled, np.zeros(3), np.full(3, 100.0)), found, rtol=1e-9)
