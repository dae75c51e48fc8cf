"""ADD and ADD-S by their laws: zero at the truth, the length of a slide, blind to what nearest points cannot tell."""

from __future__ import annotations

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.readout.metrics import add, add_s, model_points
from pmpnbp.scene import meshes

BOX = meshes.box((0.4, 0.2, 0.1))


def pose(rng: np.random.Generator) -> np.ndarray:
    return np.concatenate([rng.standard_normal(3), poses.random_quaternions(rng, ())])


def test_both_are_zero_at_the_truth_and_for_the_negative_quaternion(rng: np.random.Generator) -> None:
    points, truth = model_points(BOX), pose(rng)
    negative = np.concatenate([truth[:3], -truth[3:]])
    assert add(points, truth, truth) == 0.0
    assert add(points, negative, truth) == pytest.approx(0.0, abs=1e-12)
    assert add_s(points, negative, truth) == pytest.approx(0.0, abs=1e-12)


def test_add_of_a_slide_is_its_length_whatever_the_pose(rng: np.random.Generator) -> None:
    points = model_points(BOX)
    for _ in range(5):
        truth, shift = pose(rng), rng.standard_normal(3)
        moved = np.concatenate([truth[:3] + shift, truth[3:]])
        assert add(points, moved, truth) == pytest.approx(np.linalg.norm(shift), rel=1e-12)


def test_add_of_a_turn_is_the_mean_chord() -> None:
    """A point at distance r from the axis moves by 2 r sin(angle / 2)."""
    points, angle = model_points(BOX), 0.3
    turned = np.concatenate([np.zeros(3), poses.from_rotation_vector(np.array([0.0, 0.0, angle]))])
    chord = 2 * np.hypot(points[:, 0], points[:, 1]) * np.sin(angle / 2)
    assert add(points, turned, poses.IDENTITY) == pytest.approx(chord.mean(), rel=1e-12)


def test_neither_depends_on_the_world(rng: np.random.Generator) -> None:
    points, a, b, world = model_points(BOX), pose(rng), pose(rng), pose(rng)
    for metric in (add, add_s):
        there = metric(points, poses.multiply(world, a), poses.multiply(world, b))
        assert there == pytest.approx(metric(points, a, b), rel=1e-9)


def test_add_s_is_never_more_than_add(rng: np.random.Generator) -> None:
    points = model_points(BOX)
    for _ in range(10):
        a, b = pose(rng), pose(rng)
        assert add_s(points, a, b) <= add(points, a, b) + 1e-12


def test_only_add_sees_the_half_turn_of_a_box() -> None:
    """A box looks the same after half a turn: what ADD-S leaves is the distance between the drawn surface points."""
    points = model_points(BOX)
    half_turn = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    assert add(points, half_turn, poses.IDENTITY) > 0.15
    assert add_s(points, half_turn, poses.IDENTITY) < 0.01


def test_model_points_lie_on_the_surface_in_proportion_to_area() -> None:
    points = model_points(BOX, 2000)
    half = np.array([0.2, 0.1, 0.05])
    outside = np.abs(points) - half
    assert np.abs(outside.max(axis=1)).max() < 1e-12
    np.testing.assert_array_equal(points, model_points(BOX, 2000))
    # stratified along the area: each pair of sides gets its share to within one stratum per triangle
    on_z = (np.abs(outside[:, 2]) < 1e-9).mean()
    area = 0.4 * 0.2 / (0.4 * 0.2 + 0.4 * 0.1 + 0.2 * 0.1)
    assert on_z == pytest.approx(area, abs=12 / 2000)
