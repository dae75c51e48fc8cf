"""Trials of the comparison, in small."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.reproduce.planar.problem import Samples, Settings, Span
from benchmarks.reproduce.planar.run import METHODS, scene, top_mode, trial


@pytest.mark.parametrize("method", METHODS)
def test_a_trial_is_the_same_bit_for_bit(method: str) -> None:
    first, second = (trial(3, method, 12, 4, 5) for _ in range(2))
    np.testing.assert_array_equal(first.errors, second.errors)
    np.testing.assert_array_equal(first.estimate, second.estimate)
    assert first.reports == second.reports
    assert first.errors.shape == (4, 9) and np.all(first.seconds > 0)
    np.testing.assert_allclose(first.mean_error[-1], first.errors[-1].mean())


def test_methods_look_at_the_same_picture() -> None:
    np.testing.assert_array_equal(scene(4, 10).picture, scene(4, 10).picture)
    assert (scene(4, 10).picture != scene(5, 10).picture).any()


@pytest.mark.parametrize("method", METHODS)
def test_most_of_the_figure_is_found_where_nothing_else_is(method: str) -> None:
    """Without clutter most nodes come within 10 pixels, where uniform guesses would put one in 300. Not all: a node can
    settle on another arm's rectangle for good."""
    errors = np.array([trial(seed, method, 100, 45, 0).errors[-1] for seed in range(3)])
    assert np.mean(errors < 10) > 0.6


def test_an_unknown_method_is_named() -> None:
    with pytest.raises(ValueError, match="method 'shove' is not known; there are pull, push"):
        trial(0, "shove", 4, 1, 0)  # type: ignore[arg-type]


def test_the_top_mode_is_not_between_modes() -> None:
    """A light cluster, a heavy one and a stray of large weight: the heavy cluster's middle, turns across the wrap."""
    rng = np.random.default_rng(1)
    light, heavy = rng.normal((50, 50, 0), 1.0, (30, 3)), rng.normal((200, 80, np.pi), (1, 1, 0.1), (60, 3))
    weights = np.concatenate([np.full(30, 0.3 / 30), np.full(60, 0.55 / 60), [0.15]])
    found = top_mode(Samples(np.concatenate([light, heavy, [[120.0, 120.0, 0.0]]]), np.log(weights)))
    np.testing.assert_allclose(found[:2], [200, 80], atol=0.6)
    assert abs(abs(found[2]) - np.pi) < 0.1


def test_a_span_is_geometric() -> None:
    span = Span(16.0, 1.0)
    assert [span.at(done) for done in (0.0, 0.5, 1.0)] == pytest.approx([16.0, 4.0, 1.0])
    assert Settings().components > 0
