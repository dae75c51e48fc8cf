"""The estimate finds depth scales, camera offsets and sizes together with the object, where the scan tells them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import problem as problems
from pmpnbp.inference.nuisance_fit import fitted, scores
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.registration import NEAR, curvature, linearised
from pmpnbp.inference.tree_estimate import configuration_scores
from pmpnbp.potentials import nuisances
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.observe import observe
from pmpnbp.scene.prior import UniformPrior
from pmpnbp.scene.sizes import resized
from tests.inference import small_worlds as worlds

MODEL = worlds.cupboard()
ROOT, JOINTS = worlds.cupboard_truth()
TOLERANCE = 0.012


def problem_of(
    scale: float = 1.0, offset: Array | None = None, sizes: Array | None = None, **changes: float
) -> Problem:
    """Two views of the cupboard, which is larger than its model by shares `sizes` (3,): the first measures all depths
    at a scale, the second's camera stands off by `offset` (7,) from where it is said to stand. What the changes give
    no deviation is fixed."""
    changes = {"camera_std": 0.0} | changes
    scans, there = [], MODEL if sizes is None else worlds.larger(MODEL, sizes)
    for number, eye in enumerate(((0.0, 0.0, 0.7), (0.3, 0.8, 0.6))):
        said = worlds.camera_at(eye, ROOT[:3] + [0.0, 0.0, 0.2])
        stands = poses.multiply(said.pose_world_camera, worlds.at() if offset is None or number == 0 else offset)
        true = replace(said, pose_world_camera=stands)
        scan = worlds.scan(there, there.part_poses(ROOT, JOINTS), true)
        depth = scan.depth * np.float32(scale if number == 0 else 1.0)
        scans.append(Scan(said, depth))
    roi = np.concatenate([ROOT[:3] - [0.6, 0.6, 0.1], ROOT[:3] + [0.6, 0.6, 0.8]])
    return problems.build(MODEL, observe(scans, roi), UniformPrior("upright"), worlds.settings(**changes), particles=40)


def fit(problem: Problem, steps: int = 6) -> tuple[Array, Array, Array]:
    """The fit from the truth of the pose, as often as an inference makes it."""
    root, joints = ROOT, JOINTS
    plan = problem.schedule(100)
    for number in range(steps):
        found = fitted(np.random.default_rng(number), problem, root, joints, plan, TOLERANCE)
        root, joints, problem = found[0], found[1], problem.taking(found[2])
    assert problem.nuisances is not None
    return root, joints, problem.nuisances


def test_a_depth_scale_is_found_with_the_pose() -> None:
    """1.5 % too long in one of two views: without it, the estimate lies between the two. Rendered without noise."""
    problem = problem_of(scale=1.015, depth_scale_std=0.01)
    root, joints, found = fit(problem)
    scales, _, _ = nuisances.split(found, 2)
    assert scales == pytest.approx([0.015, 0.0], abs=0.003)
    assert np.linalg.norm(root[:3] - ROOT[:3]) < 0.004
    assert joints == pytest.approx(JOINTS, abs=0.02)


def test_a_further_camera_is_found_where_it_stands() -> None:
    offset = poses.from_xyz_rpy([0.02, -0.01, 0.015], [0.0, 0.01, 0.0])
    root, _, found = fit(problem_of(offset=offset, camera_std=0.02))
    _, offsets, _ = nuisances.split(found, 2)
    assert offsets[0] == pytest.approx(np.zeros(6))
    # turns and shifts of a camera look alike over one object: what they do there together is what is told
    there = poses.inverse(worlds.camera_at((0.3, 0.8, 0.6), ROOT[:3] + [0.0, 0.0, 0.2]).pose_world_camera)
    middle = poses.transform_points(there, ROOT[:3] + [0.0, 0.0, 0.2])
    taken = np.concatenate([offsets[1, :3], poses.from_rotation_vector(offsets[1, 3:])])
    moved = poses.transform_points(poses.inverse(taken), middle)
    expected = poses.transform_points(poses.inverse(offset), middle)
    assert np.linalg.norm(moved - expected) < 0.006
    assert np.linalg.norm(root[:3] - ROOT[:3]) < 0.004


def test_sizes_are_found_with_the_pose() -> None:
    """A cupboard of other sizes than its model's: with the model as it is, its door hangs centimetres off."""
    sizes = np.array([0.02, -0.02, 0.03])
    root, joints, found = fit(problem_of(sizes=sizes, size_std=0.02))
    taken = nuisances.split(found, 2)[2]
    assert taken == pytest.approx(sizes, abs=0.006)
    there, expected = resized(MODEL, taken), resized(MODEL, sizes)
    off = there.part_poses(root, joints)[:, :3] - expected.part_poses(ROOT, JOINTS)[:, :3]
    assert np.linalg.norm(off, axis=1).max() < 0.006
    assert joints == pytest.approx(JOINTS, abs=0.02)


def test_a_fit_is_never_worse_and_scores_as_the_problem_that_takes_it() -> None:
    problem = problem_of(scale=1.01, depth_scale_std=0.01, size_std=0.01)
    plan = problem.schedule(100)
    before = configuration_scores(problem, ROOT[None], JOINTS[None], TOLERANCE)[0]
    root, joints, found, score = fitted(np.random.default_rng(0), problem, ROOT, JOINTS, plan, TOLERANCE)
    assert score > before
    again = configuration_scores(problem.taking(found), root[None], joints[None], TOLERANCE)[0]
    assert score == pytest.approx(again + problem.log_nuisance_prior(found), rel=1e-9)
    assert scores(problem, root[None], joints[None], found[None], TOLERANCE)[0] == pytest.approx(score, rel=1e-9)


def test_where_all_is_fixed_nothing_changes() -> None:
    problem = problem_of()
    assert problem.nuisances is None and problem.taking(np.zeros(17)) is problem
    plain = linearised(problem, ROOT[None], JOINTS[None], TOLERANCE, np.array([NEAR]))[0]
    assert plain.shape[-1] == 6 + MODEL.dof


def test_the_slope_of_a_depth_scale_is_the_depth() -> None:
    """The information of a depth scale is the weighed sum of squared depths: a surface at 2 m moves by 2 m for 1."""
    problem = problem_of(depth_scale_std=0.01)
    information = curvature(problem, ROOT, JOINTS, TOLERANCE, np.array([0]))
    view = problem.observation.views[0]
    alone = replace(problem, observation=replace(problem.observation, views=(view,)))
    taken = replace(alone, nuisances=None)
    along = poses.rotate(view.camera.pose_world_camera[3:], np.array([0.0, 0.0, 1.0]))
    root = curvature(taken, ROOT, JOINTS, TOLERANCE)[:3, :3]
    distance = float(np.median(view.depth[view.depth < 3.0]))
    # moved along the axis, surfaces faced head on come nearer by as much: the same information per square metre
    assert information[-1, -1] == pytest.approx(distance**2 * (along @ root @ along), rel=0.35)
