"""Dual quaternions obey the laws of their algebra, say what poses say, and agree with pytransform3d.

pytransform3d writes a dual quaternion as we do, [real w x y z][dual w x y z], and a pose as x y z qw qx qy qz; its
functions take one at a time, and its power goes the way the given sign goes, where ours goes the short way.
"""

from __future__ import annotations

import numpy as np
import pytest
from pytransform3d import transformations as pt

from pmpnbp.geometry import dual_quaternions as dq
from pmpnbp.geometry import poses

SHAPES = [(), (5,), (0,), (2, 3)]


def random_poses(rng: np.random.Generator, shape: tuple[int, ...]) -> poses.Array:
    return np.concatenate([rng.normal(size=(*shape, 3)), poses.random_quaternions(rng, shape)], axis=-1)


def random_dual_quaternions(rng: np.random.Generator, shape: tuple[int, ...]) -> poses.Array:
    return dq.from_pose(random_poses(rng, shape))


def assert_same(a: poses.Array, b: poses.Array, tolerance: float = 1e-12) -> None:
    assert a.shape == b.shape
    assert np.all(np.minimum(np.abs(a - b).sum(axis=-1), np.abs(a + b).sum(axis=-1)) < tolerance)


def test_a_pose_is_its_position_times_its_orientation() -> None:
    x, y, z, *q = pose = np.array([0.3, -1.0, 2.0, 0.5, -0.5, 0.5, 0.5])
    position = np.array([1, 0, 0, 0, 0, x / 2, y / 2, z / 2])
    orientation = np.array([*q, 0, 0, 0, 0])
    np.testing.assert_allclose(dq.from_pose(pose), dq.multiply(position, orientation), atol=1e-15)


@pytest.mark.parametrize("shape", SHAPES)
def test_poses_survive(rng: np.random.Generator, shape: tuple[int, ...]) -> None:
    pose = random_poses(rng, shape)
    assert dq.from_pose(pose).shape == (*shape, 8)
    np.testing.assert_allclose(dq.to_pose(dq.from_pose(pose)), pose, atol=1e-14)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_algebra_is_associative_and_unit_elements_have_inverses(
    rng: np.random.Generator, shape: tuple[int, ...]
) -> None:
    a, b, c = (rng.normal(size=(*shape, 8)) for _ in range(3))
    left, right = dq.multiply(dq.multiply(a, b), c), dq.multiply(a, dq.multiply(b, c))
    np.testing.assert_allclose(left, right, atol=1e-12)
    np.testing.assert_allclose(dq.multiply(a, b + c), dq.multiply(a, b) + dq.multiply(a, c), atol=1e-12)
    np.testing.assert_array_equal(dq.multiply(a, dq.IDENTITY), a)
    unit = random_dual_quaternions(rng, shape)
    one = np.broadcast_to(dq.IDENTITY, unit.shape)
    np.testing.assert_allclose(dq.multiply(unit, dq.conjugate(unit)), one, atol=1e-14)
    np.testing.assert_allclose(dq.multiply(dq.conjugate(unit), unit), one, atol=1e-14)


def test_conjugates_of_a_product(rng: np.random.Generator) -> None:
    a, b = rng.normal(size=(2, 30, 8))
    for conjugate in (dq.conjugate, dq.point_conjugate):
        np.testing.assert_allclose(conjugate(dq.multiply(a, b)), dq.multiply(conjugate(b), conjugate(a)), atol=1e-12)
    # The dual-number conjugate touches no quaternion, so it keeps the order.
    np.testing.assert_allclose(
        dq.dual_conjugate(dq.multiply(a, b)), dq.multiply(dq.dual_conjugate(a), dq.dual_conjugate(b)), atol=1e-12
    )
    for conjugate in (dq.conjugate, dq.dual_conjugate, dq.point_conjugate):
        np.testing.assert_array_equal(conjugate(conjugate(a)), a)


@pytest.mark.parametrize("shape", SHAPES)
def test_products_are_products_of_poses(rng: np.random.Generator, shape: tuple[int, ...]) -> None:
    a, b = random_poses(rng, shape), random_poses(rng, shape)
    product = dq.multiply(dq.from_pose(a), dq.from_pose(b))
    np.testing.assert_allclose(dq.to_pose(product), poses.multiply(a, b), atol=1e-12)
    np.testing.assert_allclose(dq.to_pose(dq.conjugate(dq.from_pose(a))), poses.inverse(a), atol=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_points_move_as_eq_12_has_it(rng: np.random.Generator, shape: tuple[int, ...]) -> None:
    pose, points = random_poses(rng, shape), rng.normal(size=(*shape, 3))
    expected = poses.transform_points(pose, points)
    np.testing.assert_allclose(dq.transform_points(dq.from_pose(pose), points), expected, atol=1e-12)
    np.testing.assert_allclose(dq.transform_points(-dq.from_pose(pose), points), expected, atol=1e-12)


def test_leading_axes_broadcast(rng: np.random.Generator) -> None:
    a, points = random_dual_quaternions(rng, (4, 1)), rng.normal(size=(3, 3))
    assert dq.transform_points(a, points).shape == (4, 3, 3)
    assert dq.multiply(a, random_dual_quaternions(rng, (3,))).shape == (4, 3, 8)
    assert dq.interpolate(a, a[::-1], np.linspace(0, 1, 3)).shape == (4, 3, 8)


def test_normalise_finds_the_unit_one_nearby(rng: np.random.Generator) -> None:
    unit = random_dual_quaternions(rng, (20,))
    np.testing.assert_allclose(dq.normalise(2.5 * unit), unit, atol=1e-14)
    spoilt = dq.normalise(unit + 1e-3 * rng.normal(size=(20, 8)))
    np.testing.assert_allclose(spoilt, unit, atol=1e-2)
    np.testing.assert_allclose(np.linalg.norm(spoilt[:, :4], axis=-1), 1, atol=1e-14)
    np.testing.assert_allclose(np.sum(spoilt[:, :4] * spoilt[:, 4:], axis=-1), 0, atol=1e-14)


@pytest.mark.parametrize("bad", [np.zeros(8), np.r_[np.zeros(4), 1, 0, 0, 0], np.full(8, np.nan)])
def test_a_real_part_without_direction_is_an_error(bad: poses.Array) -> None:
    with pytest.raises(ValueError, match="a real part that is not zero"):
        dq.normalise(bad)


def test_distance_is_a_metric_in_both_parts(rng: np.random.Generator) -> None:
    a, b, c = (random_dual_quaternions(rng, (300,)) for _ in range(3))
    for part in (0, 1):
        ab, ba, bc, ac = (
            dq.distance(a, b)[part],
            dq.distance(b, a)[part],
            dq.distance(b, c)[part],
            dq.distance(a, c)[part],
        )
        np.testing.assert_allclose(ab, ba, atol=1e-12)
        np.testing.assert_allclose(ab, dq.distance(-a, b)[part], atol=1e-12)
        np.testing.assert_allclose(dq.distance(a, -a)[part], 0, atol=1e-12)
        assert np.all(ab + bc >= ac - 1e-12)


def test_distance_of_a_known_motion(rng: np.random.Generator) -> None:
    pose = random_poses(rng, (10,))
    step = np.concatenate([[0.3, 0.0, -0.4], poses.from_rotation_vector(np.array([0.0, 0.7, 0.0]))])
    position, orientation = dq.distance(dq.from_pose(pose), dq.from_pose(poses.multiply(pose, step)))
    np.testing.assert_allclose(position, 0.5)
    np.testing.assert_allclose(orientation, 0.7)


@pytest.mark.parametrize("size", [0.0, 1e-12, 1e-7, 1e-3, 1.0, 3.1])
def test_powers_add_up(rng: np.random.Generator, size: float) -> None:
    rotation = size * np.array([0.6, 0.0, -0.8])
    pose = np.concatenate([[0.2, -0.5, 1.0], poses.from_rotation_vector(rotation)])
    a = dq.from_pose(pose)
    assert_same(dq.power(a, 1.0), a)
    assert_same(dq.power(a, 0.0), dq.IDENTITY)
    assert_same(dq.power(a, -1.0), dq.conjugate(a))
    # Across the threshold below which a turn is neglected the position may be off by about that much.
    assert_same(dq.multiply(dq.power(a, 0.3), dq.power(a, 0.7)), a, tolerance=1e-8)
    assert_same(dq.multiply(dq.power(a, 0.5), dq.power(a, 0.5)), a, tolerance=1e-8)
    assert_same(dq.power(-a, 0.4), dq.power(a, 0.4))


def test_interpolation_along_a_slide_and_a_hinge_is_even() -> None:
    start = np.concatenate([[1.0, 0, 0], poses.from_rotation_vector(np.array([0.0, 0.0, 0.4]))])
    slide = np.array([0.0, 0.6, 0.0, 1, 0, 0, 0])
    hinge = np.concatenate([np.zeros(3), poses.from_rotation_vector(np.array([0.0, 1.2, 0.0]))])
    for motion in (slide, hinge):
        end = poses.multiply(start, motion)
        third = dq.interpolate(dq.from_pose(start), dq.from_pose(end), 1 / 3)
        part = motion.copy()
        part[:3] /= 3
        part[3:] = poses.from_rotation_vector(poses.to_rotation_vector(motion[3:]) / 3)
        assert_same(third, dq.from_pose(poses.multiply(start, part)))


def test_interpolation_keeps_to_unit_dual_quaternions_and_ends_at_its_ends(rng: np.random.Generator) -> None:
    a, b = random_dual_quaternions(rng, (50,)), random_dual_quaternions(rng, (50,))
    for fraction in (0.0, 0.25, 0.9, 1.0):
        between = dq.interpolate(a, b, fraction)
        np.testing.assert_allclose(np.linalg.norm(between[:, :4], axis=-1), 1, atol=1e-12)
        np.testing.assert_allclose(np.sum(between[:, :4] * between[:, 4:], axis=-1), 0, atol=1e-12)
    assert_same(dq.interpolate(a, b, 0.0), a)
    assert_same(dq.interpolate(a, b, 1.0), b)


def test_agrees_with_pytransform3d(rng: np.random.Generator) -> None:
    first, second = random_poses(rng, (25,)), random_poses(rng, (25,))
    for pose, other in zip(first, second, strict=True):
        a, b = dq.from_pose(pose), dq.from_pose(other)
        np.testing.assert_allclose(a, pt.dual_quaternion_from_pq(pose), atol=1e-12)
        np.testing.assert_allclose(dq.to_pose(a), pt.pq_from_dual_quaternion(a), atol=1e-12)
        np.testing.assert_allclose(dq.multiply(a, b), pt.concatenate_dual_quaternions(a, b), atol=1e-12)
        np.testing.assert_allclose(dq.conjugate(a), pt.dq_q_conj(a), atol=1e-12)
        np.testing.assert_allclose(dq.point_conjugate(a), pt.dq_conj(a), atol=1e-12)
        point = rng.normal(size=3)
        np.testing.assert_allclose(dq.transform_points(a, point), pt.dq_prod_vector(a, point), atol=1e-12)
        short = np.where(a[0] < 0, -a, a)
        assert_same(dq.power(a, 0.37), pt.dual_quaternion_power(short, 0.37), tolerance=1e-9)
        difference = dq.multiply(dq.conjugate(a), b)
        nearer = b if difference[0] >= 0 else -b
        assert_same(dq.interpolate(a, b, 0.62), pt.dual_quaternion_sclerp(a, nearer, 0.62), tolerance=1e-9)
