"""What an image's grain hides: of a plain picture counted by hand, of objects as by least squares written out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import mrf as fields
from pmpnbp.inference import problem as problems
from pmpnbp.inference.problem import Problem
from pmpnbp.readout.image_grain import (
    EDGE,
    JUMP,
    SHAPE,
    UNTOLD,
    WHOLE,
    grain,
    hidden_by_grain,
    outline_pixels,
    shape,
    sharpness,
)
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.prior import UniformPrior
from tests.inference import small_worlds as worlds

STEP = 1e-5
OBJECTS = {"cupboard": worlds.cupboard(), "chain": worlds.hinged_chain(6), "star": worlds.star(4)}


def test_outline_pixels_are_those_beside_which_something_is_farther_off() -> None:
    """Part 1 stands before part 0, 1 cm before its left half and 10 cm before its right one."""
    depth, number = np.zeros((9, 12), dtype=np.float32), np.full((9, 12), -1, dtype=np.int16)
    depth[1:8, 1:11], number[1:8, 1:11] = 1.0, 0
    depth[1:8, 1:6] = 0.91
    depth[3:6, 3:9], number[3:6, 3:9] = 0.9, 1
    shown = depth > 0
    # part 0: its rim, 7 x 10, and the column at its step where part 1 is not; part 1: three sides of its right half
    rim, step, sides = 2 * 10 + 2 * 5, 2, 3 + 3 + 3 - 2
    # pixels touch at corners, too: of part 1's upper and lower side the one to the left of the step sees over it
    np.testing.assert_array_equal(outline_pixels(depth, number, shown, 0.02, 2), [rim + step, sides + 2])
    np.testing.assert_array_equal(outline_pixels(depth, number, shown, 0.11 / JUMP, 2), [rim, 0])
    shown[:, 6:] = False
    assert outline_pixels(depth, number, shown, 0.02, 2)[0] == 5 + 7 + 5 - 2 + step


def test_an_outline_beyond_the_picture_tells_nothing() -> None:
    depth, number = np.ones((4, 5), dtype=np.float32), np.zeros((4, 5), dtype=np.int16)
    assert outline_pixels(depth, number, depth > 0, 0.01, 1)[0] == 0


def moved_parts(model: ArticulatedObject, root: Array, joints: Array) -> tuple[Array, Array]:
    """Parts (1, 1 + P, N, 7) as they are and with each coordinate moved, one after the other; steps (1, P)."""
    centre = fields.build(model).centres[0]
    found = [model.part_poses(root, joints)]
    for place in range(6 + model.dof):
        move = np.zeros(6 + model.dof)
        move[place] = STEP
        found.append(model.part_poses(poses.perturb(root, move[:3], move[3:6], centre), joints + move[6:]))
    return np.array(found)[None], np.full((1, len(found) - 1), STEP)


@pytest.mark.parametrize("name", OBJECTS)
def test_it_is_the_covariance_of_a_fit_to_parts_that_are_off(name: str, rng: np.random.Generator) -> None:
    model = OBJECTS[name]
    mrf, sharp = fields.build(model), rng.uniform(1e5, 1e8, len(model.parts))
    root = worlds.at(0.3, -0.2, 0.1, *rng.uniform(-1, 1, 3))
    parts, steps = moved_parts(model, root, rng.uniform(model.lower, model.upper))
    rows = []
    for node, (radius, told) in enumerate(zip(mrf.radii, sharp, strict=True)):
        here = parts[0, 0, node]
        columns = []
        for there in parts[0, 1:, node]:
            middle = poses.transform_points(there, mrf.centres[node]) - poses.transform_points(here, mrf.centres[node])
            turn = poses.quaternion_multiply(there[3:], poses.quaternion_conjugate(here[3:]))
            rim = radius / np.sqrt(3) * poses.to_rotation_vector(turn)
            columns.append(np.sqrt(told) * np.concatenate([middle, rim]) / STEP)
        rows.append(np.array(columns).T)
    design = np.concatenate(rows)
    pseudo = np.linalg.pinv(design)  # the fit is this times parts' errors, in units of their deviations
    (found,) = hidden_by_grain(mrf, parts, steps, sharp[None])
    scale = np.sqrt(np.diag(pseudo @ pseudo.T))
    np.testing.assert_allclose(found / np.outer(scale, scale), pseudo @ pseudo.T / np.outer(scale, scale), atol=1e-5)
    # the others' outlines tell of a part, too: none is hidden by more than its own outline alone would
    for node, told in enumerate(sharp):
        own = rows[node] / np.sqrt(told)
        assert np.diag(own @ found @ own.T).max() <= (1 + 1e-5) / told


def test_the_end_of_a_chain_is_known_as_well_as_its_beginning() -> None:
    model = OBJECTS["chain"]
    mrf, nodes = fields.build(model), len(model.parts)
    parts, steps = moved_parts(model, worlds.at(), np.full(model.dof, 0.2))
    (found,) = hidden_by_grain(mrf, parts, steps, np.full((1, nodes), 1e6))
    slopes = (
        poses.transform_points(parts[0, 1:], mrf.centres) - poses.transform_points(parts[0, 0], mrf.centres)
    ) / STEP
    spread = np.sqrt(np.einsum("pna,pq,qna->n", slopes, found, slopes))
    assert spread.max() / spread.min() < 2
    # as joints that were each off on their own would not leave it
    alone = np.sqrt(np.einsum("pna,p,pna->n", slopes, np.diag(found), slopes))
    assert alone[-1] / alone[0] > 3


def looked_at(eye: tuple[float, float, float], **settings: float) -> tuple[Problem, Array, Array]:
    model, (root, joints) = worlds.cupboard(), worlds.cupboard_truth()
    camera = worlds.camera_at(eye, root[:3] + [0, 0, 0.2])
    observation = worlds.seen(model, root, joints, camera)
    chosen = worlds.settings(**settings)
    return problems.build(model, observation, UniformPrior("upright"), chosen, particles=20), root, joints


def test_what_no_outline_tells_has_no_grain() -> None:
    """From low behind the closed back the drawer is not seen, and all the rest hides less than a millimetre."""
    made, root, joints = looked_at((2.9, -0.4, 0.3))
    found = grain(made, root, joints)
    assert found[6, 6] == pytest.approx(0.0, abs=UNTOLD**2 / 1e6)
    assert 1e-4 < np.sqrt(found[0, 0]) < 1e-3
    from_front, root, joints = looked_at((0.0, 0.0, 0.7))
    assert 1e-4 < np.sqrt(grain(from_front, root, joints)[6, 6]) < 2e-3


def test_two_views_have_their_own_grain_each() -> None:
    made, root, joints = looked_at((0.0, 0.0, 0.7))
    (view,) = made.observation.views
    twice = replace(made, observation=replace(made.observation, views=(view, view)), nuisance_std=np.zeros(17))
    np.testing.assert_allclose(grain(twice, root, joints), grain(made, root, joints) / 2, rtol=1e-6, atol=1e-15)


def test_a_long_outline_tells_more_but_not_without_end() -> None:
    told = sharpness(np.array([0.0, 1.0, 4.0, 1e9]), 0.005, np.zeros(4))
    np.testing.assert_allclose(told[1:] ** -0.5, 0.005 * np.hypot([EDGE, EDGE / 2, 0.0], WHOLE), rtol=1e-6)
    assert told[0] == 0.0
    np.testing.assert_allclose(sharpness(np.full(1, 1e9), 0.0, np.full(1, 0.002)) ** -0.5, 0.002)


def test_a_free_depth_scale_lets_the_object_be_nearer_or_farther() -> None:
    """By as much as outlines may be too far in or out, along the line of sight and in no other direction."""
    fixed, root, joints = looked_at((0.0, 0.0, 0.7))
    free, _, _ = looked_at((0.0, 0.0, 0.7), depth_scale_std=0.01)
    more = grain(free, root, joints) - grain(fixed, root, joints)
    middles = poses.transform_points(fixed.mrf.part_poses(root, joints), fixed.mrf.centres)
    sight = middles.mean(axis=0) - [0.0, 0.0, 0.7]
    variances, axes = np.linalg.eigh(more[:3, :3])
    np.testing.assert_allclose(variances[:2], 0.0, atol=1e-12)
    np.testing.assert_allclose(abs(axes[:, 2] @ sight), np.linalg.norm(sight), rtol=1e-9)
    assert 1e-3 < np.sqrt(variances[2]) < 5e-3
    # a scale that is all but known is no farther off than it may be
    known, _, _ = looked_at((0.0, 0.0, 0.7), depth_scale_std=1e-5)
    least = grain(known, root, joints)[:3, :3] - grain(fixed, root, joints)[:3, :3]
    np.testing.assert_allclose(np.sqrt(np.trace(least)), 1e-5 * np.linalg.norm(sight), rtol=1e-3)


def test_parts_whose_sizes_are_free_are_known_less_well() -> None:
    fixed, root, joints = looked_at((0.0, 0.0, 0.7))
    free, _, _ = looked_at((0.0, 0.0, 0.7), size_std=0.02)
    np.testing.assert_allclose(shape(free), SHAPE * 0.02 * free.mrf.radii)
    assert not shape(fixed).any()
    assert np.all(np.diag(grain(free, root, joints)) > 2 * np.diag(grain(fixed, root, joints)))
