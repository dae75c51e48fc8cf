"""The closest configuration of a joint: exact on the joint, no worse than scipy's optimum off it, within the limits."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from pmpnbp.geometry import poses
from pmpnbp.potentials.joint_projection import gearing, limit_axes, project, residual
from pmpnbp.scene.articulated_object import Edge


def make_edge(
    rng: np.random.Generator,
    revolute: list[bool],
    lower: list[float],
    upper: list[float],
    *,
    wraps: list[bool] | None = None,
    coordinates: list[int] | None = None,
    multiplier: list[float] | None = None,
    offset: list[float] | None = None,
) -> Edge:
    count = len(revolute)
    frames = np.concatenate(
        [0.3 * rng.normal(size=(count + 1, 3)), poses.random_quaternions(rng, (count + 1,))], axis=-1
    )
    axes = rng.normal(size=(count, 3))
    return Edge(
        parent=0,
        child=1,
        poses_before=frames[:-1],
        pose_after=frames[-1],
        revolute=np.array(revolute),
        axes=axes / np.linalg.norm(axes, axis=-1, keepdims=True),
        lower=np.array(lower, dtype=float),
        upper=np.array(upper, dtype=float),
        wraps=np.array(wraps or [False] * count),
        coordinates=np.array(coordinates or list(range(count))),
        multiplier=np.array(multiplier or [1.0] * count),
        offset=np.array(offset or [0.0] * count),
    )


def disturbed(rng: np.random.Generator, pose: poses.Array, metres: float, radians: float) -> poses.Array:
    step = np.concatenate(
        [
            metres * rng.normal(size=(*pose.shape[:-1], 3)),
            poses.from_rotation_vector(radians * rng.normal(size=(*pose.shape[:-1], 3))),
        ],
        axis=-1,
    )
    return poses.multiply(pose, step)


def squares(translation: poses.Array, rotation: poses.Array, length: float) -> poses.Array:
    return np.sum(translation**2, axis=-1) + length**2 * np.sum(rotation**2, axis=-1)


ONE_AXIS = {
    "slide": ([False], [-0.1], [0.4], [False]),
    "hinge": ([True], [-0.5], [2.0], [False]),
    "wide hinge": ([True], [-2.9], [3.0], [False]),
    "several turns": ([True], [-2 * np.pi], [2 * np.pi], [False]),
    "continuous": ([True], [-np.pi], [np.pi], [True]),
}
CHAINS = {
    "slide and hinge": ([False, True], [-0.2, -1.0], [0.3, 1.5]),
    "two hinges": ([True, True], [-1.5, -2.0], [1.5, 2.0]),
    "two slides and a hinge": ([False, False, True], [-0.5, -0.5, -3.0], [0.5, 0.5, 3.0]),
    "three hinges": ([True] * 3, [-1.2] * 3, [1.2] * 3),
}


@pytest.mark.parametrize("name", ONE_AXIS)
def test_a_configuration_is_found_again(rng: np.random.Generator, name: str) -> None:
    revolute, lower, upper, wraps = ONE_AXIS[name]
    edge = make_edge(rng, revolute, lower, upper, wraps=wraps)
    at = rng.uniform(lower, upper, size=(3, 40, 1))
    found, translation, rotation = project(edge, edge.pose_parent_child(at))
    assert found.shape == at.shape
    assert translation.shape == rotation.shape == (3, 40, 3)
    np.testing.assert_allclose(translation, 0, atol=1e-12)
    np.testing.assert_allclose(rotation, 0, atol=1e-12)
    if edge.upper[0] - edge.lower[0] <= 2 * np.pi:
        np.testing.assert_allclose(found, at, atol=1e-12)
    else:
        assert np.all(np.abs(found) <= np.pi + 1e-12)  # the turn nearest to the middle of the range


@pytest.mark.parametrize("name", ONE_AXIS)
def test_one_axis_leaves_the_least_of_its_own_kind(rng: np.random.Generator, name: str) -> None:
    revolute, lower, upper, wraps = ONE_AXIS[name]
    edge = make_edge(rng, revolute, lower, upper, wraps=wraps)
    pose = disturbed(rng, edge.pose_parent_child(rng.uniform(-4, 4, size=(100, 1))), 0.2, 0.6)
    found, translation, rotation = project(edge, pose)
    assert np.all((found >= edge.lower) & (found <= edge.upper))
    left = rotation if revolute[0] else translation
    grid = np.linspace(edge.lower, edge.upper, 400)
    on_grid = residual(edge, pose[:, None], np.broadcast_to(grid, (100, 400, 1)))[1 if revolute[0] else 0]
    assert np.all(np.linalg.norm(left, axis=-1) <= np.linalg.norm(on_grid, axis=-1).min(axis=1) + 1e-12)


@pytest.mark.parametrize("name", ONE_AXIS)
def test_one_axis_puts_back_together_what_it_takes_apart(rng: np.random.Generator, name: str) -> None:
    revolute, lower, upper, wraps = ONE_AXIS[name]
    edge = make_edge(rng, revolute, lower, upper, wraps=wraps)
    pose = disturbed(rng, edge.pose_parent_child(rng.uniform(lower, upper, size=(20, 1))), 0.1, 0.4)
    found, translation, rotation = project(edge, pose)
    left = np.concatenate([translation, poses.from_rotation_vector(rotation)], axis=-1)
    end = poses.multiply(edge.pose_parent_child(found), poses.inverse(edge.pose_after))
    again = poses.multiply(poses.multiply(end, left), edge.pose_after)
    np.testing.assert_allclose(poses.to_matrix(again), poses.to_matrix(pose), atol=1e-12)


def test_beyond_its_range_a_hinge_stops_at_the_limit_that_is_nearer_round_the_circle(rng: np.random.Generator) -> None:
    edge = make_edge(rng, [True], [0.0], [1.0])
    at = np.array([[1.2], [0.5 + np.pi - 0.01], [0.5 + np.pi + 0.01], [-0.3]])
    found, _, rotation = project(edge, edge.pose_parent_child(at))
    np.testing.assert_allclose(found, [[1.0], [1.0], [0.0], [0.0]])
    np.testing.assert_allclose(np.linalg.norm(rotation, axis=-1), [0.2, np.pi - 0.51, np.pi - 0.51, 0.3])


def test_the_sign_of_a_quaternion_does_not_matter(rng: np.random.Generator) -> None:
    for edge in (make_edge(rng, [True], [-2.0], [1.0]), make_edge(rng, [True, True], [-1.0] * 2, [1.0] * 2)):
        pose = disturbed(rng, edge.pose_parent_child(rng.uniform(-1, 1, size=(30, len(edge.axes)))), 0.1, 0.3)
        opposite = np.concatenate([pose[:, :3], -pose[:, 3:]], axis=-1)
        for here, there in zip(project(edge, pose), project(edge, opposite), strict=True):
            np.testing.assert_allclose(here, there, atol=1e-9)


@pytest.mark.parametrize("name", CHAINS)
def test_a_chain_is_followed_to_the_pose_it_made(rng: np.random.Generator, name: str) -> None:
    revolute, lower, upper = CHAINS[name]
    edge = make_edge(rng, revolute, lower, upper)
    made = edge.pose_parent_child(rng.uniform(lower, upper, size=(300, len(lower))))
    found, translation, rotation = project(edge, made)
    assert np.all((found >= edge.lower) & (found <= edge.upper))
    np.testing.assert_allclose(translation, 0, atol=1e-6)
    np.testing.assert_allclose(rotation, 0, atol=1e-6)


@pytest.mark.parametrize("name", CHAINS)
def test_a_chain_comes_as_close_as_scipy_does(rng: np.random.Generator, name: str) -> None:
    revolute, lower, upper = CHAINS[name]
    edge, length = make_edge(rng, revolute, lower, upper), 0.2
    made = edge.pose_parent_child(rng.uniform(lower, upper, size=(12, len(lower))))
    pose = disturbed(rng, made, 0.05, 0.3)
    found = squares(*project(edge, pose, length_per_radian=length)[1:], length)
    for target, reached in zip(pose, found, strict=True):

        def left(axes: poses.Array, target: poses.Array = target) -> poses.Array:
            translation, rotation = residual(edge, target, axes)
            return np.concatenate([translation, length * rotation])

        starts = rng.uniform(lower, upper, size=(6, len(lower)))
        best = min(2 * least_squares(left, start, bounds=(lower, upper)).cost for start in starts)
        assert reached <= best * (1 + 1e-6) + 1e-12


def test_a_chain_takes_one_pose_or_none(rng: np.random.Generator) -> None:
    edge = make_edge(rng, [False, True], [-1.0, -1.0], [1.0, 1.0])
    found, translation, rotation = project(edge, edge.pose_parent_child(np.array([0.3, -0.4])))
    assert found.shape == (2,)
    assert translation.shape == rotation.shape == (3,)
    np.testing.assert_allclose(found, [0.3, -0.4], atol=1e-9)
    assert project(edge, np.zeros((0, 7)))[0].shape == (0, 2)


def test_an_axis_that_wraps_has_no_ends_in_a_chain(rng: np.random.Generator) -> None:
    edge = make_edge(rng, [False, True], [-1.0, -np.pi], [1.0, np.pi], wraps=[False, True])
    at = np.stack([np.full(60, 0.2), np.linspace(-np.pi, np.pi, 60)], axis=-1)
    found, translation, rotation = project(edge, edge.pose_parent_child(at))
    np.testing.assert_allclose(translation, 0, atol=1e-8)
    np.testing.assert_allclose(rotation, 0, atol=1e-8)
    assert np.all((found >= edge.lower - 1e-12) & (found <= edge.upper + 1e-12))


def test_axes_that_follow_one_joint_move_together(rng: np.random.Generator) -> None:
    # Joint position j in 0..0.5: the first axis is at 2 j + 0.1, the second at -j.
    edge = make_edge(
        rng, [True, True], [0.1, -0.5], [1.1, 0.0], coordinates=[3, 3], multiplier=[2.0, -1.0], offset=[0.1, 0.0]
    )
    assert gearing(edge).matrix.shape == (2, 1)
    for axes, joint in zip(limit_axes(edge), (0.0, 0.5), strict=True):
        np.testing.assert_allclose(axes, [2 * joint + 0.1, -joint])
    joint = rng.uniform(0, 0.5, size=(50, 1))
    at = np.concatenate([2 * joint + 0.1, -joint], axis=-1)
    pose = edge.pose_parent_child(at)
    found, _, _ = project(edge, pose)
    np.testing.assert_allclose(found, at, atol=1e-7)
    found, _, _ = project(edge, disturbed(rng, pose, 0.05, 0.2))
    np.testing.assert_allclose(found[:, 0], 0.1 - 2 * found[:, 1], atol=1e-12)
