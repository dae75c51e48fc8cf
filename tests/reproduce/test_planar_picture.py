"""The picture and the score of a shape at a pose."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.reproduce.planar.pattern import CIRCLE, RADIUS, RECTANGLE, configuration, four_arms
from benchmarks.reproduce.planar.picture import SIZE, Scene, covers, draw_scene, log_unary, score_slowly, scores

FIGURE = four_arms()


def scene(clutter: int) -> Scene:
    rng = np.random.default_rng(8)
    return draw_scene(rng, FIGURE, configuration(rng, FIGURE, SIZE), clutter)


@pytest.mark.parametrize("shape", [CIRCLE, RECTANGLE])
def test_scores_are_those_of_the_slow_twin(shape: int) -> None:
    """Everywhere, also beyond the picture's edge, and where a shape is."""
    seen = scene(20)
    poses = np.random.default_rng(1).uniform((-20, -20, -4), (SIZE + 20, SIZE + 20, 4), (200, 3))
    poses = np.concatenate([poses, seen.truth, seen.clutter])
    slow = [score_slowly(seen.picture, shape, pose) for pose in poses]
    np.testing.assert_allclose(scores(seen.picture, shape, poses), slow, rtol=0, atol=1e-12)


def test_the_picture_is_the_union_of_its_shapes() -> None:
    seen = scene(7)
    assert np.bincount(seen.clutter_shape).tolist() == [2, 5]
    shapes = (*FIGURE.shape, *seen.clutter_shape)
    union = np.any([covers(s, p) for s, p in zip(shapes, (*seen.truth, *seen.clutter), strict=True)], axis=0)
    np.testing.assert_array_equal(seen.picture, union)
    area = np.pi * RADIUS**2
    # a disc differs from its pixels by less than its circumference
    assert abs(covers(CIRCLE, np.array([150.0, 150.0, 0.0])).sum() - area) < 2 * np.pi * RADIUS


def test_the_truth_scores_high_without_clutter() -> None:
    """Its inside is white to the last sample, and the ring's white is what neighbours were allowed or an arm that is
    bent back upon the figure."""
    seen = scene(0)
    for node, pose in enumerate(seen.truth):
        assert scores(seen.picture, FIGURE.shape[node], pose) > 0.75


def test_a_score_falls_off_beside_the_truth() -> None:
    seen = scene(0)
    for node, pose in enumerate(seen.truth):
        aside = pose + np.array([-np.sin(pose[2]), np.cos(pose[2]), 0.0]) * 6.0
        assert scores(seen.picture, FIGURE.shape[node], aside) < scores(seen.picture, FIGURE.shape[node], pose)


def test_only_the_circle_has_to_stand_upright() -> None:
    seen = scene(0)
    upside_down = seen.truth + np.array([0.0, 0.0, np.pi])
    for node, (truth, turned) in enumerate(zip(seen.truth, upside_down, strict=True)):
        lost = log_unary(seen.picture, FIGURE, node, truth, 10.0) - log_unary(seen.picture, FIGURE, node, turned, 10.0)
        assert lost > 100 if node == 0 else abs(lost) < 3
    poses = np.tile(seen.truth[1], (2, 3, 1))
    assert log_unary(seen.picture, FIGURE, 1, poses, 1.0).shape == (2, 3)
