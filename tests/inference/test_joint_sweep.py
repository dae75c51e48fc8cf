"""The sweep of single joints: a joint in a wrong place is found again, and nothing is lost by looking."""

from __future__ import annotations

import numpy as np
import pytest

from pmpnbp.inference import joint_sweep
from pmpnbp.inference import problem as problems
from pmpnbp.inference.joint_sweep import APART, PLACES, elsewhere, sweep
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.tree_estimate import configuration_scores, polish, profile_scores
from pmpnbp.scene.prior import UniformPrior
from pmpnbp.settings import Schedule, schedule
from tests.inference import small_worlds as worlds

TOLERANCE = 0.024


@pytest.fixture(scope="module")
def chain() -> tuple[Problem, np.ndarray, np.ndarray]:
    """A hinged chain of four, seen folded, and its true configuration."""
    model = worlds.hinged_chain(4)
    root, joints = worlds.at(1.3, z=0.4), np.array([0.6, -0.9, 0.7])
    observation = worlds.seen(model, root, joints)
    built = problems.build(model, observation, UniformPrior("upright"), worlds.settings(), particles=40)
    return built, root, joints


def search_end(problem: Problem) -> Schedule:
    return schedule(problem.settings, problem.search_iterations, problem.search_iterations)


@pytest.mark.parametrize("joint", [0, 1, 2])
def test_a_joint_in_a_wrong_place_is_found(chain: tuple[Problem, np.ndarray, np.ndarray], joint: int) -> None:
    """Where small moves alone do not find it."""
    problem, root, truth = chain
    plan = search_end(problem)
    wrong = truth.copy()
    wrong[joint] = -truth[joint]
    local = polish(np.random.default_rng(0), problem, root[None], wrong[None], plan, TOLERANCE, 10)
    _, found, score = sweep(np.random.default_rng(0), problem, root, wrong, plan, 3)
    np.testing.assert_allclose(found, truth, atol=0.15)  # its wrong place is 1.2 away and more
    assert score > profile_scores(problem, *local[:2])[0]


def test_the_truth_stays(chain: tuple[Problem, np.ndarray, np.ndarray]) -> None:
    problem, root, truth = chain
    before = profile_scores(problem, root[None], truth[None])[0]
    _, found, score = sweep(np.random.default_rng(0), problem, root, truth, search_end(problem), 3)
    assert score >= before
    np.testing.assert_allclose(found, truth, atol=0.15)  # its wrong place is 1.2 away and more


def test_a_step_that_finds_no_better_place_is_the_last(
    chain: tuple[Problem, np.ndarray, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even where every other place is polished before it is dropped."""
    problem, root, truth = chain
    steps = []

    def counted(*arguments: object) -> object:
        steps.append(arguments)
        return elsewhere(*arguments)

    monkeypatch.setattr(joint_sweep, "elsewhere", counted)
    monkeypatch.setattr(joint_sweep, "LOSS_BEFORE", 100.0)
    monkeypatch.setattr(joint_sweep, "LOSS_AFTER", 100.0)
    sweep(np.random.default_rng(0), problem, root, truth, search_end(problem), 3)
    assert len(steps) == 1


def test_no_joint_may_move_when_none_is_asked_for(chain: tuple[Problem, np.ndarray, np.ndarray]) -> None:
    problem, root, truth = chain
    same, joints, score = sweep(np.random.default_rng(0), problem, root, truth, search_end(problem), 0)
    np.testing.assert_array_equal(same, root)
    np.testing.assert_array_equal(joints, truth)
    assert score == profile_scores(problem, root[None], truth[None])[0]


def test_elsewhere_is_far_from_here_and_worth_what_it_says(chain: tuple[Problem, np.ndarray, np.ndarray]) -> None:
    """For several configurations at once, the places of each joint in turn, which are far from each other too."""
    problem, root, truth = chain
    model, plan = problem.mrf.model, search_end(problem)
    here = np.stack([truth, -truth, 0.5 * truth])
    roots = np.tile(root, (3, 1))
    found, score = elsewhere(np.random.default_rng(0), problem, roots, here, plan)
    # no joint here has room for half a turn
    assert found.shape == (3, 3 * PLACES + 1, 3) and np.all(score[:, 3 * PLACES] == -np.inf)
    for joint in range(3):
        places = slice(joint * PLACES, (joint + 1) * PLACES)
        taken = np.concatenate([here[:, None, joint], found[:, places, joint]], axis=1)
        gaps = np.abs(taken[:, :, None] - taken[:, None])[:, ~np.eye(PLACES + 1, dtype=bool)]
        assert np.all(gaps > APART * (model.upper[joint] - model.lower[joint]))
        for place in range(places.start, places.stop):
            expected = configuration_scores(problem, roots, found[:, place], plan.tolerance)
            np.testing.assert_allclose(score[:, place], expected)
        assert np.all(np.diff(score[:, places], axis=1) <= 0)
