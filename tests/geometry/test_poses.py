"""Poses obey the laws of a group that acts on points, over batch shapes, near the identity and near half a turn."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.spatial.transform import Rotation

from pmpnbp.geometry import poses

SHAPES = [(), (5,), (0,), (2, 3)]
# Turns from far below the square root of the precision to just short of, at and beyond half a turn.
ANGLES = [0.0, 1e-300, 1e-12, 1e-7, 1e-3, 1.0, np.pi - 1e-3, np.pi - 1e-8, np.pi]

angle = st.floats(-np.pi, np.pi)
coordinate = st.floats(-10, 10)


def random_poses(rng: np.random.Generator, shape: tuple[int, ...]) -> poses.Array:
    return np.concatenate([rng.normal(size=(*shape, 3)), poses.random_quaternions(rng, shape)], axis=-1)


def turn(axis: poses.Array, by: float) -> poses.Array:
    return poses.from_rotation_vector(by * axis / np.linalg.norm(axis))


def assert_same_rotation(a: poses.Array, b: poses.Array, tolerance: float = 1e-12) -> None:
    assert a.shape == b.shape
    assert np.all(np.minimum(np.abs(a - b), np.abs(a + b)).sum(axis=-1) < tolerance)


def assert_same_pose(a: poses.Array, b: poses.Array) -> None:
    np.testing.assert_allclose(a[..., :3], b[..., :3], atol=1e-12)
    assert_same_rotation(a[..., 3:], b[..., 3:])


@pytest.mark.parametrize("shape", SHAPES)
def test_poses_form_a_group(rng: np.random.Generator, shape: tuple[int, ...]) -> None:
    a, b, c = (random_poses(rng, shape) for _ in range(3))
    assert poses.multiply(a, b).shape == (*shape, 7)
    assert_same_pose(poses.multiply(poses.multiply(a, b), c), poses.multiply(a, poses.multiply(b, c)))
    unit = np.broadcast_to(poses.IDENTITY, a.shape)
    assert_same_pose(poses.multiply(a, poses.IDENTITY), a)
    assert_same_pose(poses.multiply(poses.IDENTITY, a), a)
    assert_same_pose(poses.multiply(a, poses.inverse(a)), unit)
    assert_same_pose(poses.multiply(poses.inverse(a), a), unit)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_product_moves_points_as_its_factors_do_in_turn(rng: np.random.Generator, shape: tuple[int, ...]) -> None:
    a, b, points = random_poses(rng, shape), random_poses(rng, shape), rng.normal(size=(*shape, 3))
    there = poses.transform_points(poses.multiply(a, b), points)
    np.testing.assert_allclose(there, poses.transform_points(a, poses.transform_points(b, points)), atol=1e-12)


def test_leading_axes_broadcast(rng: np.random.Generator) -> None:
    a, b = random_poses(rng, (4, 1)), random_poses(rng, (3,))
    product = poses.multiply(a, b)
    assert product.shape == (4, 3, 7)
    assert_same_pose(product[2, 1], poses.multiply(a[2, 0], b[1]))
    points = poses.transform_points(a, rng.normal(size=(3, 3)))
    assert points.shape == (4, 3, 3)


def test_a_quaternion_and_its_negative_are_one_rotation(rng: np.random.Generator) -> None:
    a, b, points = random_poses(rng, (50,)), random_poses(rng, (50,)), rng.normal(size=(50, 3))
    opposite = np.concatenate([a[:, :3], -a[:, 3:]], axis=-1)
    assert_same_pose(poses.multiply(a, b), poses.multiply(opposite, b))
    np.testing.assert_allclose(poses.transform_points(a, points), poses.transform_points(opposite, points), atol=1e-12)
    np.testing.assert_allclose(poses.to_matrix(a), poses.to_matrix(opposite), atol=1e-12)
    np.testing.assert_allclose(poses.rotation_angle(a[:, 3:], b[:, 3:]), poses.rotation_angle(-a[:, 3:], b[:, 3:]))
    np.testing.assert_allclose(poses.to_rotation_vector(a[:, 3:]), poses.to_rotation_vector(-a[:, 3:]), atol=1e-12)


def test_single_precision_comes_in_and_double_goes_out(rng: np.random.Generator) -> None:
    a, b = random_poses(rng, (6,)), random_poses(rng, (6,))
    product = poses.multiply(a.astype(np.float32), b.astype(np.float32))
    assert product.dtype == np.float64
    np.testing.assert_allclose(product, poses.multiply(a, b), atol=1e-5)


def test_rotations_agree_with_scipy(rng: np.random.Generator) -> None:
    a, b, v = random_poses(rng, (200,))[:, 3:], random_poses(rng, (200,))[:, 3:], rng.normal(size=(200, 3))
    first = Rotation.from_quat(a, scalar_first=True)
    second = Rotation.from_quat(b, scalar_first=True)
    assert_same_rotation(poses.quaternion_multiply(a, b), (first * second).as_quat(scalar_first=True))
    np.testing.assert_allclose(poses.rotate(a, v), first.apply(v), atol=1e-12)
    np.testing.assert_allclose(poses.to_rotation_vector(a), first.as_rotvec(), atol=1e-12)
    np.testing.assert_allclose(poses.rotation_angle(a, b), (first.inv() * second).magnitude(), atol=1e-12)
    matrix = poses.to_matrix(np.concatenate([np.zeros((200, 3)), a], axis=-1))
    np.testing.assert_allclose(matrix[:, :3, :3], first.as_matrix(), atol=1e-12)


@pytest.mark.parametrize("by", ANGLES)
def test_logarithm_undoes_the_exponential(rng: np.random.Generator, by: float) -> None:
    axes = rng.normal(size=(20, 3))
    axes /= np.linalg.norm(axes, axis=-1, keepdims=True)
    q = poses.from_rotation_vector(by * axes)
    np.testing.assert_allclose(np.linalg.norm(q, axis=-1), 1.0, atol=1e-15)
    back = poses.to_rotation_vector(q)
    # At exactly half a turn both ends of the axis are right.
    off = np.linalg.norm(back - by * axes, axis=-1)
    if by == np.pi:
        off = np.minimum(off, np.linalg.norm(back + by * axes, axis=-1))
    assert np.all(off <= 1e-14 + 1e-15 * by)
    if 0 < by < 1e-6:
        np.testing.assert_allclose(back, by * axes, rtol=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("length", [0.0, 1e-300, 1e-10, 0.9e-9, 1.1e-9, 1e-4, 1.0, 3.0])
def test_exponential_and_logarithm_are_scipys(rng: np.random.Generator, shape: tuple[int, ...], length: float) -> None:
    rotation = length * rng.uniform(-0.5, 0.5, (*shape, 3))
    q = poses.from_rotation_vector(rotation)
    assert q.shape == (*shape, 4) and poses.to_rotation_vector(q).shape == (*shape, 3)
    if q.size:
        known = Rotation.from_rotvec(rotation.reshape(-1, 3))
        np.testing.assert_allclose(q.reshape(-1, 4), known.as_quat(scalar_first=True), rtol=1e-12, atol=1e-15)
        back = poses.to_rotation_vector(-q).reshape(-1, 3)
        np.testing.assert_allclose(back, known.as_rotvec(), rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("by", ANGLES)
def test_angle_between_rotations_is_that_of_the_turn_between_them(rng: np.random.Generator, by: float) -> None:
    a = poses.random_quaternions(rng, (20,))
    b = poses.quaternion_multiply(a, turn(np.array([1.0, -2.0, 0.5]), by))
    np.testing.assert_allclose(poses.rotation_angle(a, b), by, atol=2e-15)
    np.testing.assert_allclose(poses.rotation_angle(a, -b), by, atol=2e-15)


@given(roll=angle, pitch=st.floats(-np.pi / 2, np.pi / 2), yaw=angle)
def test_rpy_is_about_fixed_axes_in_turn(roll: float, pitch: float, yaw: float) -> None:
    q = poses.from_rpy([roll, pitch, yaw])
    expected = Rotation.from_euler("xyz", [roll, pitch, yaw]).as_quat(scalar_first=True)
    assert_same_rotation(q, expected)
    # With the pitch at a right angle only roll ± yaw is determined: the rotation must survive, not the numbers. There
    # arcsin amplifies a rounding error to its square root.
    assert_same_rotation(poses.from_rpy(poses.to_rpy(q)), q, tolerance=1e-7)


def test_rpy_of_a_batch_survives_away_from_the_poles(rng: np.random.Generator) -> None:
    rpy = rng.uniform([-3.1, -1.5, -3.1], [3.1, 1.5, 3.1], size=(4, 25, 3))
    np.testing.assert_allclose(poses.to_rpy(poses.from_rpy(rpy)), rpy, atol=1e-12)
    pose = poses.from_xyz_rpy(rpy * 2, rpy)
    np.testing.assert_array_equal(pose[..., :3], rpy * 2)
    np.testing.assert_array_equal(pose[..., 3:], poses.from_rpy(rpy))


@pytest.mark.parametrize("shape", SHAPES)
def test_matrices_and_poses_say_the_same(rng: np.random.Generator, shape: tuple[int, ...]) -> None:
    a, b = random_poses(rng, shape), random_poses(rng, shape)
    assert poses.to_matrix(a).shape == (*shape, 4, 4)
    np.testing.assert_allclose(
        poses.to_matrix(poses.multiply(a, b)), poses.to_matrix(a) @ poses.to_matrix(b), atol=1e-12
    )
    if a.size:
        assert_same_pose(poses.from_matrix(poses.to_matrix(a)), a)


@pytest.mark.parametrize("by", ANGLES)
@pytest.mark.parametrize("axis", [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [-1, 2, 3]])
def test_matrices_are_read_at_any_turn(axis: list[float], by: float) -> None:
    pose = np.concatenate([[1.0, 2.0, 3.0], turn(np.array(axis, dtype=float), by)])
    assert_same_pose(poses.from_matrix(poses.to_matrix(pose)), pose)


@pytest.mark.parametrize(
    "matrix",
    [np.diag([1.0, 1.0, -1.0, 1.0]), np.diag([2.0, 2.0, 2.0, 1.0]), np.full((4, 4), np.nan)],
    ids=["mirror", "scale", "nan"],
)
def test_a_matrix_that_is_no_rotation_is_refused(matrix: poses.Array) -> None:
    with pytest.raises(ValueError, match="the upper left 3x3 block of the matrix is not a rotation"):
        poses.from_matrix(matrix)


def test_normalise_gives_unit_quaternions_and_leaves_positions() -> None:
    pose = poses.normalise([[1, 2, 3, 0, 0, 5, 0], [0, 0, 0, -2, 0, 0, 0]])
    np.testing.assert_array_equal(pose, [[1, 2, 3, 0, 0, 1, 0], [0, 0, 0, -1, 0, 0, 0]])


@pytest.mark.parametrize("bad", [[0, 0, 0, 0, 0, 0, 0], [0, np.nan, 0, 1, 0, 0, 0], [0, 0, 0, np.inf, 0, 0, 0]])
def test_a_quaternion_without_direction_is_an_error(bad: list[float]) -> None:
    with pytest.raises(ValueError, match="seven finite numbers"):
        poses.normalise([[0, 0, 0, 1, 0, 0, 0], bad])


def test_perturb_turns_about_the_given_point(rng: np.random.Generator) -> None:
    pose, centre = random_poses(rng, (30,)), rng.normal(size=3)
    translation, rotation = rng.normal(size=(30, 3)), rng.normal(size=(30, 3))
    moved = poses.perturb(pose, translation, rotation, centre)
    at = poses.transform_points(pose, np.broadcast_to(centre, (30, 3)))
    np.testing.assert_allclose(poses.transform_points(moved, np.broadcast_to(centre, (30, 3))), at + translation)
    turned = poses.quaternion_multiply(moved[:, 3:], poses.quaternion_conjugate(pose[:, 3:]))
    assert_same_rotation(turned, poses.from_rotation_vector(rotation))


def test_poses_that_move_often_keep_quaternions_of_unit_length(rng: np.random.Generator) -> None:
    pose = random_poses(rng, (3,))
    for _ in range(5_000):
        pose = poses.perturb(pose, np.zeros(3), rng.normal(size=(3, 3)), np.ones(3))
    np.testing.assert_allclose(np.linalg.norm(pose[:, 3:], axis=1), 1.0, atol=4e-16)


def test_a_perturbation_is_told_from_where_it_led(rng: np.random.Generator) -> None:
    before = np.concatenate([rng.standard_normal((20, 3)), poses.random_quaternions(rng, (20,))], axis=1)
    translation, rotation, centre = rng.standard_normal((3, 20, 3))
    rotation *= (rng.uniform(0.0, 3.0, 20) / np.linalg.norm(rotation, axis=1))[:, None]
    found = poses.perturbation(before, poses.perturb(before, translation, rotation, centre), centre)
    np.testing.assert_allclose(found, (translation, rotation), atol=1e-9)


def test_perturb_by_nothing_changes_nothing(rng: np.random.Generator) -> None:
    pose = random_poses(rng, (8,))
    assert_same_pose(poses.perturb(pose, np.zeros(3), np.zeros(3), np.ones(3)), pose)


def test_mean_is_the_middle_whatever_the_signs(rng: np.random.Generator) -> None:
    middle = random_poses(rng, ())
    steps = 0.3 * rng.normal(size=(40, 6))
    around = poses.perturb(middle, np.concatenate([steps, -steps])[:, :3], np.concatenate([steps, -steps])[:, 3:])
    around[:, 3:] *= rng.choice([-1.0, 1.0], size=(80, 1))
    assert_same_pose(poses.mean(around, np.full(80, 0.7)), middle)


def test_mean_weighs(rng: np.random.Generator) -> None:
    two = random_poses(rng, (2,))
    assert_same_pose(poses.mean(two, np.array([0.0, 3.0])), two[1])
    np.testing.assert_allclose(poses.mean(two, np.array([1.0, 3.0]))[:3], 0.25 * two[0, :3] + 0.75 * two[1, :3])


def test_random_quaternions_are_uniform_over_rotations(rng: np.random.Generator) -> None:
    """Two Kolmogorov-Smirnov tests at 0.1 % each, so a right sampler fails for at most 0.2 % of seeds; one is fixed.

    Under Haar measure the angle has distribution function (a - sin a) / pi, and a turned vector's height is uniform.
    """
    q = poses.random_quaternions(rng, (4000,))
    angles = poses.rotation_angle(q, poses.IDENTITY[3:])
    assert stats.kstest(angles, lambda a: (a - np.sin(a)) / np.pi).pvalue > 1e-3
    height = poses.rotate(q, np.array([0.0, 0.6, 0.8]))[:, 2]
    assert stats.kstest(height, stats.uniform(-1, 2).cdf).pvalue > 1e-3


@given(x=coordinate, y=coordinate, z=coordinate, roll=angle, pitch=angle, yaw=angle)
def test_a_rigid_motion_keeps_distances(x: float, y: float, z: float, roll: float, pitch: float, yaw: float) -> None:
    pose = poses.from_xyz_rpy([x, y, z], [roll, pitch, yaw])
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0], [0.5, -1, 3]])
    moved = poses.transform_points(pose, points)
    np.testing.assert_allclose(
        np.linalg.norm(moved[:, None] - moved, axis=-1), np.linalg.norm(points[:, None] - points, axis=-1), atol=1e-12
    )
