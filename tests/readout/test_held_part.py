"""Coordinates of an object that is held by one of its parts: their laws, which part it is, and what is open behind a
part that hides all others."""

from __future__ import annotations

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import mrf as fields
from pmpnbp.inference import problem as problems
from pmpnbp.inference.held_part import Held, held
from pmpnbp.inference.problem import Problem
from pmpnbp.readout.log_posterior import log_posterior
from pmpnbp.readout.object_posterior import ModeDraws, mode_draws
from pmpnbp.scene.articulated_object import ArticulatedObject, Joint
from pmpnbp.scene.prior import UniformPrior
from tests.inference import small_worlds as worlds

CUPBOARD = worlds.cupboard()
MRF = fields.build(CUPBOARD)
ROOT, JOINTS = worlds.cupboard_truth()
# Of the elbow between a screen and the arm on which it stands before its foot.
ELBOW, LIMIT = 1, 0.6


def screen() -> ArticulatedObject:
    """A foot, an arm that swings on it about z, and a screen at the arm's end that does so, too."""
    up = np.array([0.0, 0.0, 1.0])
    joints = [
        Joint("swing", "revolute", "link0", "link1", worlds.at(z=0.3), up, -0.5, 0.5, (0,)),
        Joint("elbow", "revolute", "link1", "link2", worlds.at(0.2), up, -LIMIT, LIMIT, (1,)),
    ]
    surfaces = {
        "link0": worlds.block([0.08, 0.06, 0.3], worlds.at(z=0.15)),
        "link1": worlds.block([0.2, 0.03, 0.03], worlds.at(0.1)),
        "link2": worlds.block([0.02, 0.6, 0.7], worlds.at(0.02)),
    }
    return worlds.articulated(joints, surfaces)


def hiding() -> tuple[Problem, Array, Array]:
    """The screen, looked at from the front, and where it is."""
    model, root, joints = screen(), worlds.at(1.5, 0.1, -0.3, yaw=np.pi - 0.2), np.array([0.1, -0.05])
    camera = worlds.camera_at((0.0, 0.0, 0.1), root[:3] + [0, 0, 0.3], width=80, height=60)
    made = problems.build(model, worlds.seen(model, root, joints, camera), UniformPrior("any"), worlds.settings())
    return made, root, joints


@pytest.mark.parametrize("part", range(MRF.nodes))
def test_offsets_and_places_undo_each_other(part: int, rng: np.random.Generator) -> None:
    place = Held(MRF, part, ROOT, JOINTS)
    offsets = 0.1 * rng.standard_normal((20, 8))
    roots, joints = place.placed(offsets)
    np.testing.assert_allclose(place.offsets(roots, joints), offsets, atol=1e-12)
    np.testing.assert_allclose(place.placed(np.zeros((1, 8)))[0][0], ROOT, atol=1e-12)


@pytest.mark.parametrize("part", range(MRF.nodes))
def test_joints_move_all_but_the_part_that_holds(part: int) -> None:
    offsets = np.zeros((2, 8))
    offsets[[0, 1], [6, 7]] = 0.1, -0.3
    roots, joints = Held(MRF, part, ROOT, JOINTS).placed(offsets)
    here, there = MRF.part_poses(ROOT, JOINTS), MRF.part_poses(roots, joints)
    np.testing.assert_allclose(there[:, part, :3], np.tile(here[part, :3], (2, 1)), atol=1e-12)
    assert poses.rotation_angle(there[:, part, 3:], here[part, 3:]).max() < 1e-7
    # of the cupboard's parts the slide moves link1, and the hinge link2, against the others
    moved = np.linalg.norm(there[..., :3] - here[:, :3], axis=-1) + poses.rotation_angle(there[..., 3:], here[:, 3:])
    against = [{1} if part != 1 else {0, 2}, {2} if part != 2 else {0, 1}]
    assert [set(np.flatnonzero(row > 0.05).tolist()) for row in moved] == against


@pytest.mark.parametrize("part", range(MRF.nodes))
def test_small_moves_are_the_root_s_by_a_matrix_that_keeps_volumes(part: int, rng: np.random.Generator) -> None:
    place, by_root = Held(MRF, part, ROOT, JOINTS), Held(MRF, 0, ROOT, JOINTS)
    offsets = 1e-5 * rng.standard_normal((20, 8))
    np.testing.assert_allclose(by_root.offsets(*place.placed(offsets)), offsets @ place.by_root.T, atol=1e-8)
    assert abs(np.linalg.det(place.by_root)) == pytest.approx(1.0, abs=1e-3)


def test_what_is_seen_best_holds_what_hides_its_own_root() -> None:
    made, root, joints = hiding()
    assert held(made, root, joints).part == 2
    front = worlds.seen(CUPBOARD, ROOT, JOINTS, worlds.camera_at((0.0, 0.0, 0.7), ROOT[:3]))
    assert held(problems.build(CUPBOARD, front, UniformPrior("any"), worlds.settings()), ROOT, JOINTS).part == 0


def moments(draws: ModeDraws) -> tuple[float, float]:
    """Mean and standard deviation of the elbow."""
    weights, elbow = np.exp(draws.log_weights), draws.joints[:, ELBOW]
    mean = float(weights @ elbow)
    return mean, float(np.sqrt(weights @ (elbow - mean) ** 2))


def test_what_a_part_hides_behind_it_may_be_anywhere_there() -> None:
    """Whatever the elbow's angle, foot and arm are behind the screen. Twenty sets of draws; of their mean and standard
    deviation five standard errors are tolerated: by Student's distribution with 19 degrees of freedom, one in ten
    thousand a comparison."""
    made, root, joints = hiding()
    place = Held(made.mrf, 2, root, joints)
    bent = np.zeros((41, 8))
    bent[:, 6 + ELBOW] = np.linspace(-LIMIT, LIMIT, 41) - joints[ELBOW]
    assert np.ptp(log_posterior(made, *place.placed(bent))) < 1e-6
    draws = [mode_draws(np.random.default_rng([4, k]), made, root, joints) for k in range(20)]
    found = np.array([moments(one) for one in draws])
    for measured, expected in zip(found.T, (0.0, LIMIT / np.sqrt(3)), strict=True):
        assert abs(measured.mean() - expected) < 5 * measured.std(ddof=1) / np.sqrt(len(found)), (measured, expected)
    # and the screen is where it is seen
    parts = made.mrf.part_poses(draws[0].roots, draws[0].joints)
    off = np.linalg.norm(parts[:, :, :3] - made.mrf.part_poses(root, joints)[:, :3], axis=2)
    told = np.sqrt(np.exp(draws[0].log_weights) @ off**2)
    assert told[2] < 0.005 and told[0] > 0.05
