"""What a hypothesis might be mistaken for: quarter turns keep the middle in place, exchanged parts lie where the others
were, and the search finds the right one of two that look alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.inference import problem as problems
from pmpnbp.inference import rivals, run
from pmpnbp.inference.belief import FLIP
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.tree_estimate import configuration_scores
from pmpnbp.scene.articulated_object import ArticulatedObject, Joint
from pmpnbp.scene.prior import UniformPrior
from tests.inference import small_worlds as worlds

TRUTH = worlds.at(1.2, z=0.5, yaw=0.4)
OPENED = np.array([0.9])


def book() -> ArticulatedObject:
    """Two plates of nearly one size, hinged along an edge."""
    hinge = Joint("hinge", "revolute", "link0", "link1", worlds.at(0.0, 0.15), worlds.X, 0.0, 3.0, (0,))
    return worlds.articulated(
        [hinge], {"link0": worlds.block([0.2, 0.15, 0.012]), "link1": worlds.block([0.2, 0.15, 0.008])}
    )


@pytest.fixture(scope="module")
def scene() -> Problem:
    model = book()
    observation = worlds.seen(model, TRUTH, OPENED)
    return problems.build(model, observation, UniformPrior("any"), worlds.settings(), particles=40)


def test_quarter_turns_keep_the_point_they_are_about(rng: np.random.Generator) -> None:
    roots = np.concatenate([rng.normal(size=(6, 3)), poses.random_quaternions(rng, (6,))], axis=1)
    middle, axis = rng.normal(size=3), np.array([0.0, 0.6, 0.8])
    centre = poses.transform_points(roots, middle)
    there = rivals.turned(roots, centre, np.broadcast_to(axis, (6, 3)), 1)
    np.testing.assert_allclose(poses.transform_points(there, middle), centre, atol=1e-12)
    np.testing.assert_allclose(poses.rotation_angle(there[:, 3:], roots[:, 3:]), np.pi / 2)
    around = roots
    for _ in range(4):
        around = rivals.turned(around, centre, np.broadcast_to(axis, (6, 3)), 1)
    np.testing.assert_allclose(around[:, :3], roots[:, :3], atol=1e-9)
    np.testing.assert_allclose(poses.rotation_angle(around[:, 3:], roots[:, 3:]), 0.0, atol=1e-7)


def test_parts_of_one_size_are_pairs_both_ways_and_others_are_not() -> None:
    assert sorted(
        rivals.like_parts(
            problems.build(book(), worlds.NOTHING_SEEN, UniformPrior("any"), worlds.settings(), particles=4)
        )
    ) == [(0, 1), (1, 0)]
    cupboard = problems.build(
        worlds.cupboard(), worlds.NOTHING_SEEN, UniformPrior("any"), worlds.settings(), particles=4
    )
    sizes = [np.sort(np.ptp(part.mesh.vertices, axis=0)) for part in cupboard.mrf.model.parts]
    for one, other in rivals.like_parts(cupboard):
        assert sizes[one][-1] < rivals.LIKE * sizes[other][-1] + 1e-12


def test_an_exchanged_part_fills_the_other_s_box(scene: Problem) -> None:
    """Its corners' box is, in the other's frame, centred where that one's is, and as large but for their difference."""
    held = worlds.hypotheses(scene, TRUTH[None], OPENED[None])
    found = rivals._exchanged(np.random.default_rng(0), scene, held)
    assert len(found) == 8
    relative = scene.mrf.model.part_poses(poses.IDENTITY, OPENED)
    boxes = 0
    for root in found:
        parts = poses.multiply(root[0], relative)
        for one, other in ((0, 1), (1, 0)):
            vertices = scene.mrf.model.parts[one].mesh.vertices
            there = poses.transform_points(
                poses.multiply(poses.inverse(held.part_poses[0, other]), parts[one]), vertices
            )
            middle = (there.min(axis=0) + there.max(axis=0)) / 2
            if np.allclose(middle, scene.mrf.centres[other], atol=1e-6):
                theirs = np.ptp(scene.mrf.model.parts[other].mesh.vertices, axis=0)
                np.testing.assert_allclose(np.ptp(there, axis=0), theirs, atol=0.01)
                boxes += 1
    assert boxes >= 8


def test_look_alikes_come_best_first_and_no_more_than_asked(scene: Problem) -> None:
    held = worlds.hypotheses(scene, np.stack([TRUTH, worlds.at(1.3, z=0.5)]), np.stack([OPENED, OPENED]))
    plan = scene.schedule(scene.search_iterations)
    found = rivals.look_alikes(np.random.default_rng(1), scene, held, plan, 10)
    assert len(found.roots) == 10 and np.all(found.source == FLIP)
    score = configuration_scores(scene, found.roots, found.joints, plan.tolerance)
    assert np.all(np.diff(score) <= 1e-9)
    np.testing.assert_allclose(
        found.part_poses[..., :3], scene.mrf.model.part_poses(found.roots, found.joints)[..., :3], atol=1e-9
    )
    upright = replace(scene, prior=UniformPrior("upright"))
    assert rivals._exchanged(np.random.default_rng(0), upright, held) == []


def test_a_shut_door_is_laid_where_the_back_was(rng: np.random.Generator) -> None:
    """A box whose door is shut, taken for its back with the door out of sight: turned by half, and shut, it is where
    it is."""
    hinge = Joint("hinge", "revolute", "link0", "link1", worlds.at(-0.16, -0.15), worlds.Z, 0.0, 2.0, (0,))
    door = worlds.block([0.04, 0.3, 0.4], worlds.at(y=0.15))
    model = worlds.articulated([hinge], {"link0": worlds.block([0.28, 0.3, 0.4]), "link1": door})
    truth = worlds.at(1.2, yaw=0.2)
    problem = problems.build(
        model, worlds.seen(model, truth, np.zeros(1)), UniformPrior("upright"), worlds.settings(), particles=4
    )
    turn = poses.from_rotation_vector(np.array([0.0, 0.0, np.pi + 0.2]))
    back = truth[:3] - 0.04 * np.array([np.cos(0.2), np.sin(0.2), 0.0])  # its back where the door is
    held = worlds.hypotheses(problem, np.concatenate([back, turn])[None], np.array([[1.2]]))
    turns = rivals._quarter_turns(problem, held, poses.transform_points(held.part_poses, problem.mrf.centres)[:, 0])
    rest, found = rivals._at_rest(problem, held, turns)
    np.testing.assert_array_equal(rest, [0.0])
    assert np.linalg.norm(turns[1, :3] - truth[:3]) > 0.035
    assert np.linalg.norm(found[1, :3] - truth[:3]) < 0.015  # not sideways, which the front does not tell
    assert poses.rotation_angle(found[1, 3:], truth[3:]) < 1e-6
    alike = rivals.look_alikes(rng, problem, held, problem.schedule(problem.search_iterations), 4)
    right = np.linalg.norm(alike.roots[:, :3] - truth[:3], axis=1) < 0.02
    assert (right & (np.abs(alike.joints[:, 0]) < 0.1)).any()


def test_the_search_tells_the_plates_apart(scene: Problem) -> None:
    """4 mm are what tells them apart; from whichever way the search comes, at 5 seeds of 6 at least."""
    right = 0
    for seed in range(6):
        *_, last = run.iterate(replace(scene, seed=seed), scene.search_iterations)
        truth = scene.mrf.model.part_poses(TRUTH, OPENED)
        offset = poses.transform_points(last.map_poses, scene.mrf.centres) - poses.transform_points(
            truth, scene.mrf.centres
        )
        right += bool(np.linalg.norm(offset, axis=1).max() < 0.03)
    assert right >= 5


def test_shifted_ones_have_the_middle_of_a_part_where_that_of_its_like_was(
    rng: np.random.Generator, scene: Problem
) -> None:
    roots = poses.perturb(np.tile(TRUTH, (3, 1)), rng.normal(0, 0.1, (3, 3)), rng.normal(0, 0.3, (3, 3)))
    joints = rng.uniform(0, 3, (3, 1))
    given = worlds.hypotheses(scene, roots, joints)
    moved = rivals.shifted(rng, scene, given)
    before = poses.transform_points(given.part_poses, scene.mrf.centres)
    after = poses.transform_points(moved.part_poses, scene.mrf.centres)
    assert len(moved.roots) == 6
    for row, parent in enumerate(moved.ancestor):
        np.testing.assert_allclose(moved.roots[row, 3:], roots[parent, 3:])
        np.testing.assert_array_equal(moved.joints[row], joints[parent])
        gap = np.linalg.norm(after[row] - before[parent][::-1], axis=1)
        assert gap.min() < 1e-9  # the one part in the other's place
    assert len({tuple(root[:3].round(6)) for root in moved.roots}) == 6


def test_where_no_part_is_like_another_nothing_is_shifted(rng: np.random.Generator, scene: Problem) -> None:
    hinge = Joint("hinge", "revolute", "link0", "link1", worlds.at(0.0, 0.15), worlds.X, 0.0, 3.0, (0,))
    model = worlds.articulated(
        [hinge], {"link0": worlds.block([0.2, 0.15, 0.1]), "link1": worlds.block([0.05, 0.04, 0.03])}
    )
    unlike = problems.build(
        model, worlds.seen(model, TRUTH, OPENED), UniformPrior("any"), worlds.settings(), particles=40
    )
    assert len(rivals.shifted(rng, unlike, worlds.hypotheses(unlike, TRUTH[None], OPENED[None])).roots) == 0
