"""Half a turn that the next two joints make good: the part behind them stays, the one between does not."""

from __future__ import annotations

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.inference import joint_sweep
from pmpnbp.inference import mrf as mrf_module
from pmpnbp.inference import problem as problems
from pmpnbp.inference.triple_moves import in_a_row, triple_moves
from pmpnbp.scene.articulated_object import ArticulatedObject, Joint
from pmpnbp.scene.meshes import box, transformed
from pmpnbp.scene.parts import LinkSurface
from pmpnbp.scene.prior import UniformPrior
from pmpnbp.settings import schedule
from tests.inference import small_worlds as worlds


def arm(limit: float = 3.3) -> ArticulatedObject:
    """A shoulder that turns about the upright, a forearm that rolls, a wrist that bends, a hand that rolls."""
    joints = [
        Joint("shoulder", "revolute", "link0", "link1", worlds.at(z=0.1), worlds.Y, -1.0, 1.0, (0,)),
        Joint("roll", "revolute", "link1", "link2", worlds.at(z=0.3), worlds.Z, -limit, limit, (1,)),
        Joint("flex", "revolute", "link2", "link3", worlds.at(0.02, z=0.3), worlds.Y, -2.0, 2.0, (2,)),
        Joint("hand", "continuous", "link3", "link4", worlds.at(z=0.1), worlds.Z, -np.pi, np.pi, (3,)),
    ]
    surfaces = {f"link{k}": worlds.block([0.05, 0.06, 0.1]) for k in range(5)}
    # a fin on the forearm and a hook on the hand show how they are rolled
    bar, fin = box([0.05, 0.06, 0.28]), transformed(box([0.1, 0.01, 0.2]), worlds.at(0.07, z=0.0))
    surfaces["link2"] = LinkSurface(exact=tuple(transformed(mesh, worlds.at(z=0.15)) for mesh in (bar, fin)))
    hand, hook = box([0.06, 0.12, 0.1]), transformed(box([0.08, 0.02, 0.02]), worlds.at(0.06, 0.04, 0.04))
    surfaces["link4"] = LinkSurface(exact=tuple(transformed(mesh, worlds.at(z=0.08)) for mesh in (hand, hook)))
    return worlds.articulated(joints, surfaces)


def test_a_wrist_bent_the_other_way_leaves_the_hand_in_place(rng: np.random.Generator) -> None:
    model = arm()
    mrf = mrf_module.build(model)
    joints = np.column_stack(
        [rng.uniform(-1, 1, 8), rng.uniform(-3, 3, 8), rng.uniform(0.3, 1.5, 8), rng.uniform(-3, 3, 8)]
    )
    roots = np.tile(worlds.at(0.5, yaw=0.4), (8, 1))
    found, possible = triple_moves(mrf, model.part_poses(roots, joints), joints)
    # the shoulder has no room for half a turn; the roll has
    assert found.shape == (8, 2, 4) and not possible[:, 0].any() and possible[:, 1].all()
    changed = found[:, 1]
    np.testing.assert_array_equal(changed[:, 0], joints[:, 0])
    np.testing.assert_allclose(np.abs(changed[:, 1] - joints[:, 1]), np.pi)
    before, after = model.part_poses(roots, joints), model.part_poses(roots, changed)
    # the elbow's 2 cm between roll and bend do not come back, the rest does
    assert np.linalg.norm(before[:, 4, :3] - after[:, 4, :3], axis=1).max() < 0.05
    assert poses.rotation_angle(before[:, 4, 3:], after[:, 4, 3:]).max() < 0.2
    assert np.all(changed[:, 2] < 0.0)
    assert poses.rotation_angle(before[:, 2, 3:], after[:, 2, 3:]) == pytest.approx(np.pi)


def test_a_joint_without_room_for_half_a_turn_is_said_to_have_none() -> None:
    model = arm(limit=1.5)
    joints = np.array([[0.0, 0.2, 0.5, 0.1]])
    _, possible = triple_moves(mrf_module.build(model), model.part_poses(worlds.at()[None], joints), joints)
    assert not possible.any()


def row_of_bars(limit: float = 2.0) -> ArticulatedObject:
    return worlds.hinged_chain(5, limit=limit, flat=True)


def test_an_elbow_bent_the_other_way_leaves_what_is_behind_it(rng: np.random.Generator) -> None:
    model = row_of_bars()
    mrf = mrf_module.build(model)
    joints = rng.uniform(-0.6, 0.6, (8, 4))
    roots = np.tile(worlds.at(0.5, yaw=0.4, roll=1.0), (8, 1))
    before = model.part_poses(roots, joints)
    found, possible = triple_moves(mrf, before, joints)
    # two triples: half turns, for which there is no room, and elbows
    assert found.shape == (8, 4, 4) and not possible[:, :2].any()
    for elbow, (between, behind) in {2: ([1, 2], [3, 4]), 3: ([2, 3], [4])}.items():
        rows = possible[:, elbow]
        assert rows.sum() >= 4
        after = model.part_poses(roots, found[:, elbow])
        np.testing.assert_allclose(after[rows][:, behind, :3], before[rows][:, behind, :3], atol=1e-6)
        assert poses.rotation_angle(after[rows][:, behind, 3:], before[rows][:, behind, 3:]).max() < 1e-6
        assert poses.rotation_angle(after[rows][:, between, 3:], before[rows][:, between, 3:]).min() > 0.05
        # and bent once more it is as it was
        again, _ = triple_moves(mrf, after, found[:, elbow])
        np.testing.assert_allclose(again[rows, elbow], joints[rows], atol=1e-6)


def test_an_elbow_in_a_line_or_without_room_is_not_bent_the_other_way() -> None:
    straight = np.array([[0.3, 0.0, 0.0, 0.2]])
    for limit, joints in ((2.0, straight), (0.7, np.array([[0.6, 0.6, -0.6, -0.6]]))):
        model = row_of_bars(limit)
        _, possible = triple_moves(mrf_module.build(model), model.part_poses(worlds.at()[None], joints), joints)
        assert not possible[:, 2].any()


@pytest.fixture
def nothing_put_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """What hangs on a joint, put anew, finds these ways back as well."""
    none = np.zeros((0, 4)), np.zeros(0)
    monkeypatch.setattr(joint_sweep, "with_those_behind_anew", lambda *arguments: none)


@pytest.mark.usefixtures("nothing_put_anew")
def test_the_sweep_comes_back_from_an_elbow_bent_the_other_way(monkeypatch: pytest.MonkeyPatch) -> None:
    model, root, truth = row_of_bars(), worlds.at(1.0, -0.3, 0.3, roll=1.2), np.array([0.2, 0.5, -0.9, 0.5])
    scene = problems.build(
        model, worlds.seen(model, root, truth), UniformPrior("upright"), worlds.settings(), particles=40
    )
    plan = schedule(scene.settings, scene.search_iterations, scene.search_iterations)
    wrong, possible = triple_moves(scene.mrf, model.part_poses(root[None], truth[None]), truth[None])
    assert possible[0, 3]

    def swept() -> np.ndarray:
        return joint_sweep.sweep(np.random.default_rng(0), scene, root, wrong[0, 3], plan, 1)[1]

    np.testing.assert_allclose(swept(), truth, atol=0.1)
    none = np.zeros((1, 0, 4)), np.zeros((1, 0), dtype=bool)
    monkeypatch.setattr(joint_sweep, "triple_moves", lambda mrf, part_poses, joints: none)
    assert np.abs(swept() - truth).max() > 0.3


def test_an_object_of_two_joints_has_no_three_in_a_row() -> None:
    model = worlds.cupboard()
    joints = np.zeros((1, 2))
    found, possible = triple_moves(mrf_module.build(model), model.part_poses(worlds.at()[None], joints), joints)
    assert found.shape == (1, 0, 2) and possible.shape == (1, 0)


def test_two_edges_in_a_row_are_one(rng: np.random.Generator) -> None:
    model = arm()
    first, second = model.edges[1], model.edges[2]
    q = rng.uniform(-1, 1, (5, 2))
    apart = poses.multiply(first.pose_parent_child(q[:, :1]), second.pose_parent_child(q[:, 1:]))
    np.testing.assert_allclose(in_a_row(first, second).pose_parent_child(q), apart, atol=1e-12)


@pytest.mark.usefixtures("nothing_put_anew")
def test_the_sweep_comes_back_from_a_wrist_bent_the_other_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """In one step, where one joint at a time finds no better place."""
    model, root, truth = arm(), worlds.at(1.0, z=0.3, yaw=0.3), np.array([0.5, 0.7, 1.0, -0.4])
    scene = problems.build(
        model, worlds.seen(model, root, truth), UniformPrior("upright"), worlds.settings(), particles=40
    )
    plan = schedule(scene.settings, scene.search_iterations, scene.search_iterations)
    wrong, _ = triple_moves(scene.mrf, model.part_poses(root[None], truth[None]), truth[None])

    def swept() -> np.ndarray:
        rng = np.random.default_rng(0)
        return joint_sweep.sweep(rng, scene, root, wrong[0, 1], plan, 1)[1]

    assert abs(wrong[0, 1, 2] - truth[2]) > 1.0
    np.testing.assert_allclose(swept(), truth, atol=0.15)
    none = np.zeros((1, 0, 4)), np.zeros((1, 0), dtype=bool)
    monkeypatch.setattr(joint_sweep, "triple_moves", lambda mrf, part_poses, joints: none)
    assert np.abs(swept() - truth).max() > 1.0
