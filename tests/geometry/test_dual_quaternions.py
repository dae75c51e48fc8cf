"""Dual quaternions obey the laws of their algebra, say what poses say, and agree with pytransform3d.

pytransform3d writes a dual quaternion as we do, [real w x y z][dual w x y z], and a pose as x y z qw qx qy qz; its
functions take one at a time.
"""

from __future__ import annotations

import numpy as np
import pytest
from pytransform3d import transformations as pt

from pmpnbp.geometry import dual_quaternions as dq
from pmpnbp.geometry import poses

IDENTITY = dq.from_pose(poses.IDENTITY)
SHAPES = [(), (5,), (0,), (2, 3)]


def random_poses(rng: np.random.Generator, shape: tuple[int, ...]) -> poses.Array:
    return np.concatenate([rng.normal(size=(*shape, 3)), poses.random_quaternions(rng, shape)], axis=-1)


def random_dual_quaternions(rng: np.random.Generator, shape: tuple[int, ...]) -> poses.Array:
    return dq.from_pose(random_poses(rng, shape))


def assert_same(a: poses.Array, b: poses.Array) -> None:
    assert a.shape == b.shape
    assert np.all(np.minimum(np.abs(a - b).sum(axis=-1), np.abs(a + b).sum(axis=-1)) < 1e-12)


def test_a_pose_is_its_position_times_its_orientation() -> None:
    x, y, z, *q = pose = np.array([0.3, -1.0, 2.0, 0.5, -0.5, 0.5, 0.5])
    position = np.array([1, 0, 0, 0, 0, x / 2, y / 2, z / 2])
    orientation = np.array([*q, 0, 0, 0, 0])
    np.testing.assert_allclose(dq.from_pose(pose), dq.multiply(position, orientation), atol=1e-15)


@pytest.mark.parametrize("shape", SHAPES)
def test_positions_survive(rng: np.random.Generator, shape: tuple[int, ...]) -> None:
    pose = random_poses(rng, shape)
    assert dq.from_pose(pose).shape == (*shape, 8)
    np.testing.assert_allclose(dq.position_of(dq.from_pose(pose)), pose[..., :3], atol=1e-14)


@pytest.mark.parametrize("shape", SHAPES)
def test_the_algebra_is_associative_and_unit_elements_have_inverses(
    rng: np.random.Generator, shape: tuple[int, ...]
) -> None:
    a, b, c = (rng.normal(size=(*shape, 8)) for _ in range(3))
    left, right = dq.multiply(dq.multiply(a, b), c), dq.multiply(a, dq.multiply(b, c))
    np.testing.assert_allclose(left, right, atol=1e-12)
    np.testing.assert_allclose(dq.multiply(a, b + c), dq.multiply(a, b) + dq.multiply(a, c), atol=1e-12)
    np.testing.assert_array_equal(dq.multiply(a, IDENTITY), a)
    pose = random_poses(rng, shape)
    unit, inverse = dq.from_pose(pose), dq.from_pose(poses.inverse(pose))
    one = np.broadcast_to(IDENTITY, unit.shape)
    np.testing.assert_allclose(dq.multiply(unit, inverse), one, atol=1e-14)
    np.testing.assert_allclose(dq.multiply(inverse, unit), one, atol=1e-14)


@pytest.mark.parametrize("shape", SHAPES)
def test_products_are_products_of_poses(rng: np.random.Generator, shape: tuple[int, ...]) -> None:
    a, b = random_poses(rng, shape), random_poses(rng, shape)
    assert_same(dq.multiply(dq.from_pose(a), dq.from_pose(b)), dq.from_pose(poses.multiply(a, b)))


def test_leading_axes_broadcast(rng: np.random.Generator) -> None:
    a, b = random_dual_quaternions(rng, (4, 1)), random_dual_quaternions(rng, (3,))
    assert dq.multiply(a, b).shape == (4, 3, 8)
    assert [part.shape for part in dq.distance(a, b)] == [(4, 3), (4, 3)]


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


def test_agrees_with_pytransform3d(rng: np.random.Generator) -> None:
    first, second = random_poses(rng, (25,)), random_poses(rng, (25,))
    for pose, other in zip(first, second, strict=True):
        a, b = dq.from_pose(pose), dq.from_pose(other)
        np.testing.assert_allclose(a, pt.dual_quaternion_from_pq(pose), atol=1e-12)
        np.testing.assert_allclose(dq.position_of(a), pt.pq_from_dual_quaternion(a)[:3], atol=1e-12)
        np.testing.assert_allclose(dq.multiply(a, b), pt.concatenate_dual_quaternions(a, b), atol=1e-12)
