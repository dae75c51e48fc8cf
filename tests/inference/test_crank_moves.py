"""Two joints turned, and the links behind them, or before, brought back: which places that gives."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.inference import mrf as fields
from pmpnbp.inference.crank_moves import TURNS, crank_moves
from pmpnbp.scene.articulated_object import ArticulatedObject
from tests.inference import small_worlds as worlds

COUNT = 6
MODEL = worlds.hinged_chain(COUNT)
ROOT = worlds.at(0.4, -0.1, 0.3, 0.2, -0.4, 1.0)


def test_there_is_one_for_every_pair_of_joints_and_of_turns_from_either_end() -> None:
    roots, joints = crank_moves(fields.build(MODEL), ROOT, np.zeros(MODEL.dof))
    pairs, turns = MODEL.dof - 1, len(TURNS) * (len(TURNS) + 1)
    assert roots.shape == (2 * pairs * turns, 7) and joints.shape == (2 * pairs * turns, MODEL.dof)
    half = len(roots) // 2
    # with what hangs on them brought back the root and the joints before stay, and those two are turned as was said
    np.testing.assert_allclose(roots[:half], np.tile(ROOT, (half, 1)), atol=1e-12)
    for first in range(pairs):
        of_pair = joints[:half][first * turns : (first + 1) * turns]
        np.testing.assert_allclose(of_pair[:, :first], 0.0, atol=1e-9)
        np.testing.assert_allclose(of_pair[:, first : first + 2], list(product(TURNS, (*TURNS, 0.0))), atol=1e-9)


@pytest.mark.parametrize("end", ["behind", "before"])
def test_the_rest_of_the_chain_is_nearer_its_place_than_if_only_the_two_were_turned(
    end: str, rng: np.random.Generator
) -> None:
    joints = rng.uniform(-0.5, 0.5, MODEL.dof)
    mrf = fields.build(MODEL)
    here = MODEL.part_poses(ROOT, joints)
    roots, found = crank_moves(mrf, ROOT, joints)
    half, turns = len(roots) // 2, len(TURNS) * (len(TURNS) + 1)
    rows = np.arange(half) if end == "behind" else np.arange(half, 2 * half)
    placed = MODEL.part_poses(roots[rows], found[rows])
    plain = np.repeat(joints[None], turns, axis=0)
    plain[:, [1, 2]] += list(product(TURNS, (*TURNS, 0.0)))
    turned = MODEL.part_poses(np.tile(ROOT, (turns, 1)), plain)
    of_second_pair = placed[turns : 2 * turns]
    if end == "behind":
        apart, alone = (poses.rotation_angle(one[:, -1, 3:], here[-1, 3:]) for one in (of_second_pair, turned))
        assert np.median(apart / alone) < 0.5
        apart, alone = (np.linalg.norm(one[:, -1, :3] - here[-1, :3], axis=1) for one in (of_second_pair, turned))
        assert np.all(apart < alone)
    else:
        # the second link that was turned is where turning left it, and the first one of all as good as in its place
        np.testing.assert_allclose(of_second_pair[:, 3, :3], turned[:, 3, :3], atol=1e-9)
        assert np.median(poses.rotation_angle(of_second_pair[:, 0, 3:], here[0, 3:])) < 0.2


def test_limits_are_kept_and_an_object_without_two_joints_in_a_row_has_none() -> None:
    at_limit = np.full(MODEL.dof, 1.2)
    _, joints = crank_moves(fields.build(MODEL), ROOT, at_limit)
    assert np.all((joints >= MODEL.lower) & (joints <= MODEL.upper))
    below = sum(turn < 0 for turn in TURNS)
    assert len(joints) == 2 * (MODEL.dof - 1) * below * (below + 1)
    star: ArticulatedObject = worlds.star(3)
    roots, joints = crank_moves(fields.build(star), ROOT, np.zeros(star.dof))
    assert roots.shape == (0, 7) and joints.shape == (0, star.dof)
