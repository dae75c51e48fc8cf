"""The compiled kinematics of the whole tree against the same in NumPy, joint by joint."""

from __future__ import annotations

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.inference import mrf
from pmpnbp.inference.tree_estimate import assemble, assembled_from
from tests.inference import small_worlds as worlds
from tests.inference.test_tree_estimate import MODELS, configurations

ONE_AXIS = {name: model for name, model in MODELS.items() if name != "geared"} | {"loop": worlds.four_bar()}


@pytest.mark.parametrize("name", MODELS)
def test_parts_are_where_the_joints_put_them_one_by_one(rng: np.random.Generator, name: str) -> None:
    model = MODELS[name]
    roots, joints = configurations(rng, model, 30)
    # q and -q are one rotation, but both walk the same way and so agree to the sign
    np.testing.assert_allclose(
        mrf.build(model).part_poses(roots, joints), model.part_poses(roots, joints), atol=1e-12, rtol=0
    )


def test_roots_and_joints_broadcast(rng: np.random.Generator) -> None:
    model = worlds.star(3)
    field = mrf.build(model)
    roots, joints = configurations(rng, model, 4)
    for root, positions in (
        (roots[0], joints[0]),
        (poses.IDENTITY, joints),
        (roots[:, None], joints),
        (roots[:0], joints[:0]),
    ):
        expected = model.part_poses(root, positions)
        found = field.part_poses(root, positions)
        assert found.shape == expected.shape
        np.testing.assert_allclose(found, expected, atol=1e-12, rtol=0)


@pytest.mark.parametrize("name", ONE_AXIS)
def test_many_are_put_together_as_each_from_its_own_anchor(rng: np.random.Generator, name: str) -> None:
    model = ONE_AXIS[name]
    field = mrf.build(model)
    roots, joints = configurations(rng, model, 60)
    noise = rng.standard_normal((2, 60, len(model.parts), 3))
    scattered = poses.perturb(model.part_poses(roots, joints), 0.1 * noise[0], 0.3 * noise[1])
    anchors = rng.integers(len(model.parts), size=60)
    rest = np.tile(np.clip(0.0, model.lower, model.upper), (60, 1))
    found_roots, found = assemble(field, scattered, anchors)
    for row, anchor in enumerate(anchors):
        root, positions = assembled_from(field, scattered[[row]], rest[[row]], int(anchor))
        np.testing.assert_allclose(found_roots[row], root[0], atol=1e-9, rtol=0)
        np.testing.assert_allclose(found[row], positions[0], atol=1e-9, rtol=0)


def test_one_anchor_for_all_and_chains_of_axes_in_either_way(rng: np.random.Generator) -> None:
    model = MODELS["geared"]
    field = mrf.build(model)
    part_poses = model.part_poses(*configurations(rng, model, 8))
    mixed = np.arange(8) % len(model.parts)
    roots, joints = assemble(field, part_poses, mixed)
    for anchor in range(len(model.parts)):
        alone_roots, alone = assemble(field, part_poses, anchor)
        np.testing.assert_allclose(roots[mixed == anchor], alone_roots[mixed == anchor], atol=1e-9)
        np.testing.assert_allclose(joints[mixed == anchor], alone[mixed == anchor], atol=1e-9)
