"""An object whose lengths are stretched along its root's axes is the one whose URDF says so."""

from __future__ import annotations

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.sizes import axes_at_zero, resized
from pmpnbp.scene.urdf import load_model
from tests.inference import small_worlds as worlds

SIZES = np.array([0.1, -0.2, 0.3])
WRIST = """<robot name="r"><link name="base">{shape}</link><link name="upper">{shape}</link><link name="between"/>
<link name="hand">{shape}</link><link name="tag"/>
<joint name="a" type="revolute"><parent link="base"/><child link="upper"/><origin xyz="{0} {1} {2}" rpy="{rpy}"/>
<axis xyz="0 1 0"/><limit lower="{least}" upper="2" effort="1" velocity="1"/></joint>
<joint name="b" type="prismatic"><parent link="upper"/><child link="between"/><origin xyz="{3} {4} {5}"/>
<axis xyz="1 0 0"/><limit lower="0" upper="0.4" effort="1" velocity="1"/></joint>
<joint name="c" type="continuous"><parent link="between"/><child link="hand"/><origin xyz="{6} {7} {8}"/>
<axis xyz="0 0 1"/></joint>
<joint name="d" type="fixed"><parent link="hand"/><child link="tag"/><origin xyz="{9} {10} {11}"/></joint></robot>"""
SHAPE = '<visual><geometry><box size="0.1 0.2 0.3"/></geometry></visual>'
# the upper arm's frame is turned: its x, y and z are the root's y, z and x
TURNED = (1.5707963267948966, 0.0, 1.5707963267948966)


def arm(tmp_path_factory: pytest.TempPathFactory, offsets: np.ndarray, least: float = -2.0) -> ArticulatedObject:
    path = tmp_path_factory.mktemp("arm") / "arm.urdf"
    rpy = " ".join(map(repr, TURNED))
    path.write_text(WRIST.format(*offsets.ravel(), shape=SHAPE, rpy=rpy, least=least), encoding="utf-8")
    return load_model(path)


def test_a_resized_arm_is_the_one_whose_urdf_has_these_lengths(
    tmp_path_factory: pytest.TempPathFactory, rng: np.random.Generator
) -> None:
    """Joint origins in the frames of their parents, of which that of the upper arm and of all beyond is turned; links
    without shape and fixed ones too. A joint that cannot reach zero changes nothing."""
    offsets = rng.uniform(-0.5, 0.5, (4, 3))
    turn = poses.to_matrix(poses.from_xyz_rpy(np.zeros(3), TURNED))[:3, :3]
    stretched = offsets @ np.diag(1 + SIZES)
    stretched[1:] = offsets[1:] @ turn.T @ np.diag(1 + SIZES) @ turn
    expected = arm(tmp_path_factory, stretched)
    joints = np.column_stack([rng.uniform(0.5, 2, 20), rng.uniform(0, 0.4, 20), rng.uniform(-3, 3, 20)])
    roots = np.concatenate([rng.normal(size=(20, 3)), poses.random_quaternions(rng, (20,))], axis=1)
    for least in (-2.0, 0.5):
        found = resized(arm(tmp_path_factory, offsets, least), SIZES)
        parts = found.part_poses(roots, joints)
        np.testing.assert_allclose(parts, expected.part_poses(roots, joints), atol=1e-12)
        links = found.link_poses(parts, joints)
        np.testing.assert_allclose(links, expected.link_poses(parts, joints), atol=1e-12)


def test_sizes_replace_those_that_were_there(rng: np.random.Generator) -> None:
    model, (root, joints) = worlds.cupboard(), worlds.cupboard_truth()
    twice = resized(resized(model, rng.uniform(-0.3, 0.3, 3)), SIZES)
    np.testing.assert_allclose(twice.part_poses(root, joints), resized(model, SIZES).part_poses(root, joints))
    back = resized(twice, np.zeros(3))
    np.testing.assert_allclose(back.part_poses(root, joints), model.part_poses(root, joints), atol=1e-15)


def test_many_sizes_are_many_models(rng: np.random.Generator) -> None:
    model, (root, joints) = worlds.cupboard(), worlds.cupboard_truth()
    sizes = rng.uniform(-0.3, 0.3, (5, 3))
    roots, vectors = np.tile(root, (5, 1)), np.tile(joints, (5, 1))
    many = resized(model, sizes)
    parts = many.part_poses(roots, vectors)
    links = many.link_poses(parts, vectors)
    for number, one in enumerate(sizes):
        alone = resized(model, one)
        np.testing.assert_allclose(parts[number], alone.part_poses(root, joints), atol=1e-15)
        np.testing.assert_allclose(links[number], alone.link_poses(parts[number], joints), atol=1e-15)


def test_axes_at_zero_turn_a_parts_axes_into_the_roots(tmp_path_factory: pytest.TempPathFactory) -> None:
    axes = axes_at_zero(arm(tmp_path_factory, np.zeros((4, 3))))
    np.testing.assert_allclose(axes[0], np.eye(3), atol=1e-12)
    np.testing.assert_allclose(axes[1] @ [1, 0, 0], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(axes[2], axes[1], atol=1e-12)
