"""Where the object is told to be: the middle of its draws, in all that is known where all else is held."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.problem import LONG_CHAIN, Problem
from pmpnbp.readout import mixture
from pmpnbp.readout.log_posterior import log_posterior
from pmpnbp.readout.mixture import coordinate_levers, of_estimate
from pmpnbp.readout.object_posterior import _held_stds, draws_or_better
from tests.readout.noisy_chain import JOINTS, noisy_chain


@pytest.fixture(scope="module")
def chain() -> tuple[Problem, IterationReport]:
    return noisy_chain()


def test_joints_that_tell_of_one_another_are_at_their_middle_together(chain: tuple[Problem, IterationReport]) -> None:
    """Alone some are known, some are not; these at their middle and those not, the chain would be bent where it is
    hidden, as far as the draws are spread, and its end be somewhere else."""
    problem, report = chain
    found = of_estimate(problem, report)
    own = found.mode == 0
    spread = np.sqrt(((found.drawn_joints[own] - JOINTS) ** 2).mean(axis=0)) * coordinate_levers(problem)[6:]
    assert problem.mrf.depth >= LONG_CHAIN and spread.min() < problem.tolerance_end < spread.max()
    assert found.centre is not None and np.all(found.centre.joints != found.modes[0].joints)
    drawn = log_posterior(problem, found.drawn_roots[own], found.drawn_joints[own])
    assert log_posterior(problem, found.centre.root[None], found.centre.joints[None])[0] > np.median(drawn)
    told = problem.mrf.part_poses(found.centre.root, found.centre.joints)
    assert np.linalg.norm(told[:, :3] - report.map_poses[:, :3], axis=1).max() < 0.02


def test_a_middle_that_explains_less_is_not_told(
    chain: tuple[Problem, IterationReport], monkeypatch: pytest.MonkeyPatch
) -> None:
    problem, report = chain

    def beside(*given: Any, **named: Any) -> Any:
        draws = draws_or_better(*given, **named)
        return replace(draws, middle=draws.middle + 0.05)

    monkeypatch.setattr(mixture, "draws_or_better", beside)
    found = of_estimate(problem, report)
    assert found.centre is not None
    np.testing.assert_array_equal(found.centre.root, found.modes[0].root)
    np.testing.assert_array_equal(found.centre.joints, found.modes[0].joints)


def test_deviations_where_all_else_is_held_are_those_of_conditional_gaussians(rng: np.random.Generator) -> None:
    """Of one coordinate, given all others: its variance less what these tell."""
    scales = np.array([1e-4, 1.0, 30.0, 0.2])
    shape = rng.standard_normal((4, 4)) * scales[:, None]
    covariance = shape @ shape.T
    for one in range(4):
        rest = np.delete(np.arange(4), one)
        across = covariance[one, rest]
        left = covariance[one, one] - across @ np.linalg.solve(covariance[np.ix_(rest, rest)], across)
        assert _held_stds(covariance)[one] == pytest.approx(np.sqrt(left), rel=1e-4)
    np.testing.assert_allclose(_held_stds(np.diag(scales**2)), scales, rtol=1e-6)
    # a joint whose limits are one position
    scales[2] = 0.0
    still = np.outer(np.arange(4) != 2, np.arange(4) != 2)
    np.testing.assert_allclose(_held_stds(still * (covariance + np.eye(4)))[2], 0.0, atol=1e-6)
    np.testing.assert_allclose(_held_stds(np.diag(scales**2)), scales, rtol=1e-6, atol=1e-6)
