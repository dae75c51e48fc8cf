"""What stays from iteration to iteration is taken over, and is what it would be if it were worked out again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmpnbp.inference import problem as problems
from pmpnbp.inference import run
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.problem import Problem
from pmpnbp.json_text import json_bytes
from pmpnbp.readout.estimate import estimate
from pmpnbp.readout.mixture import of_estimate
from pmpnbp.readout.placement import Placement, place
from pmpnbp.readout.posterior import Centre, Posterior
from pmpnbp.readout.result import to_result
from pmpnbp.scene.prior import UniformPrior
from tests.inference import small_worlds as worlds

MODEL = worlds.cupboard()


@pytest.fixture(scope="module")
def problem() -> Problem:
    scan = worlds.seen(MODEL, *worlds.cupboard_truth())
    return problems.build(MODEL, scan, UniformPrior("upright"), worlds.settings(), particles=20)


@pytest.fixture(scope="module")
def reports(problem: Problem) -> list[IterationReport]:
    """Two iterations whose particles differ."""
    root, joints = worlds.cupboard_truth()
    _, made = run.begin(problem)
    at = {"map_poses": MODEL.part_poses(root, joints), "map_joints": joints, "stage": "belief propagation"}
    first = replace(made, iteration=9, **at)
    moved = replace(made.belief, poses=made.belief.poses + np.array([0.01, 0, 0, 0, 0, 0, 0]))
    return [first, replace(first, iteration=10, belief=moved)]


@pytest.fixture(scope="module")
def posterior(problem: Problem, reports: list[IterationReport]) -> Posterior:
    root, joints = worlds.cupboard_truth()
    return replace(of_estimate(problem, reports[0]), centre=Centre(root=root, joints=joints + 0.001, nuisances=None))


def text(problem: Problem, report: IterationReport, placed: Placement) -> bytes:
    return json_bytes(to_result(estimate(problem, report, placed), None))


def test_an_iteration_says_the_same_with_what_was_taken_over(
    problem: Problem, reports: list[IterationReport], posterior: Posterior
) -> None:
    first = place(problem, reports[0], posterior)
    text(problem, reports[0], first)  # all that is kept is worked out
    after, anew = place(problem, reports[1], posterior, first), place(problem, reports[1], posterior)
    assert after.standing is first.standing and anew.standing is not first.standing
    assert text(problem, reports[1], after) == text(problem, reports[1], anew)
    assert np.array_equal(after.particles, anew.particles)
    assert not np.array_equal(after.particles, first.particles)


def test_nothing_is_taken_over_where_something_has_changed(
    problem: Problem, reports: list[IterationReport], posterior: Posterior
) -> None:
    first = place(problem, reports[0], posterior)
    for other in (replace(posterior), replace(posterior, centre=None), None):
        assert place(problem, reports[1], other, first).standing is not first.standing
    assert place(replace(problem), reports[1], posterior, first).standing is not first.standing
    without = place(problem, reports[0])
    assert place(problem, reports[0], None, without).standing is not without.standing
