"""What hides a part is counted pixel by pixel, as its slow twin here does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.inference import problem as problems
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.unary import render_part, visible_fractions
from pmpnbp.readout.placement import VISIBLE_TOLERANCE
from pmpnbp.readout.sight import Sight, sights
from pmpnbp.scene.prior import UniformPrior
from tests.inference import small_worlds as worlds

MODEL = worlds.cupboard()
ROOT, JOINTS = worlds.cupboard_truth()
PARTS = MODEL.part_poses(ROOT, JOINTS)
MIDDLE = poses.transform_points(ROOT, np.array([0.0, 0.0, 0.2]))
BACK = poses.rotate(ROOT[3:], np.array([-1.0, 0.2, 0.3]))


@pytest.fixture(scope="module")
def problem() -> Problem:
    """The cupboard from behind, where its back hides much of the drawer."""
    camera = worlds.camera_at(MIDDLE + 1.3 * BACK, MIDDLE)
    return problems.build(
        MODEL, worlds.seen(MODEL, ROOT, JOINTS, camera), UniformPrior("upright"), worlds.settings(), particles=20
    )


def with_board(problem: Problem) -> Problem:
    """The same with a board measured close to the camera, over the left half of the image."""
    (view,) = problem.observation.views
    depth = view.depth.copy()
    depth[:, : depth.shape[1] // 2] = 0.4
    views = (replace(view, depth=depth),)
    return replace(problem, observation=replace(problem.observation, views=views))


def slow(problem: Problem, node: int) -> dict[str, int]:
    """Of the pixels that a part would cover alone, how many are of what nearest thing."""
    (view,) = problem.observation.views
    alone = [render_part(view.camera, problem.surfaces, part, pose) for part, pose in enumerate(PARTS)]
    counts: dict[str, int] = {}
    for pixel in np.argwhere(alone[node] > 0):
        depths = [float(depth[tuple(pixel)]) or np.inf for depth in alone]
        nearest, measured = int(np.argmin(depths)), float(view.depth[tuple(pixel)])
        blocked = 0 < measured < min(depths) - VISIBLE_TOLERANCE
        what = "in front" if blocked else str(nearest)
        counts[what] = counts.get(what, 0) + 1
    return counts


@pytest.mark.parametrize("board", [False, True])
def test_it_counts_as_its_slow_twin(problem: Problem, board: bool) -> None:
    looked = with_board(problem) if board else problem
    found = sights(looked, PARTS)
    for node, sight in enumerate(found):
        assert isinstance(sight, Sight)
        counts = slow(looked, node)
        covered = sum(counts.values())
        assert sight.in_front == pytest.approx(counts.pop("in front", 0) / covered)
        assert sight.seen == pytest.approx(counts.pop(str(node), 0) / covered, abs=0.01)
        assert {str(part) for part in sight.behind} == set(counts)
        for part, share in sight.behind.items():
            assert share == pytest.approx(counts[str(part)] / covered, abs=0.01)
        assert sight.seen + sight.in_front + sum(sight.behind.values()) == pytest.approx(1.0)
        assert list(sight.behind.values()) == sorted(sight.behind.values(), reverse=True)
    assert any(sight is not None and sight.behind for sight in found)
    assert board == any(sight is not None and sight.in_front > 0.1 for sight in found)


def test_what_is_in_sight_is_what_the_result_tells(problem: Problem) -> None:
    for looked in (problem, with_board(problem)):
        wanted = visible_fractions(looked.observation, looked.surfaces, PARTS, VISIBLE_TOLERANCE)
        np.testing.assert_allclose([sight.seen if sight else 0.0 for sight in sights(looked, PARTS)], wanted)


def test_a_further_view_that_sees_more_tells(problem: Problem) -> None:
    front = problem.observation.views[0]
    camera = worlds.camera_at(MIDDLE - 1.3 * BACK * [1, 1, -1], MIDDLE)
    (other,) = worlds.seen(MODEL, ROOT, JOINTS, camera).views
    both = replace(problem, observation=replace(problem.observation, views=(front, other)))
    drawer = next(n for n, part in enumerate(MODEL.parts) if "link1" in part.links)
    (before, after) = (sights(looked, PARTS)[drawer] for looked in (problem, both))
    assert before is not None and after is not None
    assert (before.view, after.view) == (0, 1) and after.seen > before.seen


def test_what_lies_outside_the_image_has_none(problem: Problem) -> None:
    aside = poses.multiply(np.array([0.0, 0, 50.0, 1, 0, 0, 0]), PARTS)
    assert sights(problem, aside) == [None] * len(PARTS)
