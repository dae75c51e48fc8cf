"""The whole-object estimate: part poses become a root and joints that agree with the kinematic tree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import mrf, problem, run
from pmpnbp.inference.tree_estimate import (
    LOG_RATIO,
    SPREADS,
    assemble,
    configuration_scores,
    improve,
    polish,
    profile_scores,
    vary,
)
from pmpnbp.scene.articulated_object import ArticulatedObject, Joint
from pmpnbp.scene.prior import UniformPrior
from pmpnbp.settings import schedule
from tests.inference import small_worlds as worlds
from tests.inference.recorded_steps import scattered_state


def geared() -> ArticulatedObject:
    """A slide, a hinge that follows it twice as far and turned round, and a two-axis joint (no part between)."""
    joints = [
        Joint("slide", "prismatic", "link0", "link1", worlds.at(0.1, yaw=0.3), worlds.X, -0.1, 0.4, (0,)),
        Joint(
            "follower", "revolute", "link1", "link2", worlds.at(z=0.2), worlds.Y, -0.8, 0.2, (0,), "slide", -2.0, 0.0
        ),
        Joint("pan", "revolute", "link0", "yoke", worlds.at(z=0.3), worlds.Z, -1.0, 1.0, (1,)),
        Joint("tilt", "revolute", "yoke", "head", worlds.at(z=0.05), worlds.Y, -0.6, 0.6, (2,)),
    ]
    visible = {name: worlds.block([0.1, 0.07, 0.05]) for name in ("link0", "link1", "link2", "head")}
    return worlds.articulated(joints, visible)


MODELS = {
    "sliding chain": worlds.sliding_chain(4),
    "hinged chain": worlds.hinged_chain(5),
    "star": worlds.star(4),
    "geared": geared(),
}


def configurations(rng: np.random.Generator, model: ArticulatedObject, count: int) -> tuple[Array, Array]:
    root = np.concatenate([rng.uniform(-1, 1, (count, 3)), poses.random_quaternions(rng, (count,))], axis=-1)
    return root, rng.uniform(model.lower, model.upper, (count, model.dof))


@pytest.mark.parametrize("name", MODELS)
def test_consistent_poses_give_their_joints_back_from_every_anchor(rng: np.random.Generator, name: str) -> None:
    model = MODELS[name]
    field = mrf.build(model)
    root, joints = configurations(rng, model, 20)
    part_poses = model.part_poses(root, joints)
    for anchor in range(len(model.parts)):
        found_root, found_joints = assemble(field, part_poses, anchor)
        np.testing.assert_allclose(found_joints, joints, atol=1e-5)
        again = model.part_poses(found_root, found_joints)
        np.testing.assert_allclose(again[..., :3], part_poses[..., :3], atol=1e-5)
        assert poses.rotation_angle(again[..., 3:], part_poses[..., 3:]).max() < 1e-4


@pytest.mark.parametrize("name", MODELS)
def test_whatever_the_poses_the_joints_are_within_their_limits(rng: np.random.Generator, name: str) -> None:
    model = MODELS[name]
    field = mrf.build(model)
    root, joints = configurations(rng, model, 20)
    noise = rng.standard_normal((2, 20, len(model.parts), 3))
    scattered = poses.perturb(model.part_poses(root, joints), 0.3 * noise[0], noise[1])
    for anchor in range(len(model.parts)):
        found_root, found = assemble(field, scattered, anchor)
        assert np.all(found >= model.lower - 1e-9) and np.all(found <= model.upper + 1e-9)
        assert np.all(np.isfinite(found_root))
    _, from_root = assemble(field, scattered, 0)
    assert np.any((from_root == model.lower) | (from_root == model.upper))  # some had to be held back


@pytest.mark.parametrize("anchor", range(3))
def test_the_anchor_stays_where_it_is(rng: np.random.Generator, anchor: int) -> None:
    model = worlds.hinged_chain(3)
    root, joints = configurations(rng, model, 10)
    noise = rng.standard_normal((2, 10, 3, 3))
    scattered = poses.perturb(model.part_poses(root, joints), 0.05 * noise[0], 0.1 * noise[1])
    found = model.part_poses(*assemble(mrf.build(model), scattered, anchor))
    np.testing.assert_allclose(found[:, anchor, :3], scattered[:, anchor, :3], atol=1e-9)
    assert poses.rotation_angle(found[:, anchor, 3:], scattered[:, anchor, 3:]).max() < 1e-7


def test_neighbours_come_as_near_to_their_own_poses_as_a_slide_allows() -> None:
    model = worlds.sliding_chain(3, offset=0.3, half_range=0.05)
    asked = np.stack([worlds.at(0.0), worlds.at(0.32, 0.1), worlds.at(0.9)])
    _, joints = assemble(mrf.build(model), asked[None], 0)
    # the first slides by the 2 cm it is off along the axis, the second as far as it can
    np.testing.assert_allclose(joints, [[0.02, 0.05]], atol=1e-9)


@pytest.mark.parametrize("anchor", range(4))
def test_in_a_loop_the_tree_is_what_counts(anchor: int) -> None:
    model = worlds.four_bar()
    root, joints = worlds.at(1.0, yaw=0.3), np.array([0.4, -0.4, 0.4])
    found_root, found = assemble(mrf.build(model), model.part_poses(root, joints)[None], anchor)
    np.testing.assert_allclose(found[0], joints, atol=1e-6)
    np.testing.assert_allclose(found_root[0, :3], root[:3], atol=1e-6)


@pytest.fixture(scope="module")
def scene() -> problem.Problem:
    model = worlds.cupboard()
    observation = worlds.seen(model, *worlds.cupboard_truth())
    return problem.build(model, observation, UniformPrior("upright"), worlds.settings(), particles=40)


def test_variations_stay_within_limits_and_near(scene: problem.Problem, rng: np.random.Generator) -> None:
    model = scene.mrf.model
    root, joints = worlds.cupboard_truth()
    plan = schedule(scene.settings, 10)
    roots, varied = vary(rng, scene, np.tile(root, (3, 1)), np.tile(joints, (3, 1)), 24, plan)
    assert roots.shape == (3, 24, 7) and varied.shape == (3, 24, 2)
    assert np.all((varied >= model.lower) & (varied <= model.upper))
    moved = np.linalg.norm(roots[..., :3] - root[:3], axis=-1)
    assert 0 < moved.max() < 0.5


def test_the_truth_scores_best_and_polishing_never_loses(scene: problem.Problem, rng: np.random.Generator) -> None:
    root, joints = worlds.cupboard_truth()
    plan = schedule(scene.settings, 18)
    truth = configuration_scores(scene, root[None], joints[None], plan.tolerance)[0]
    off = poses.perturb(root, np.array([0.02, -0.015, 0.01]), np.array([0.0, 0.02, 0.05]))
    start = configuration_scores(scene, off[None], joints[None] - 0.02, plan.tolerance)[0]
    assert start < truth
    wide = schedule(scene.settings, 6)
    scores = [
        polish(np.random.default_rng(1), scene, off[None], joints[None] - 0.02, wide, plan.tolerance, rounds)[2][0]
        for rounds in (0, 2, 10)
    ]
    assert scores[0] == pytest.approx(start)
    assert scores == sorted(scores) and scores[-1] > start


def test_hypotheses_are_polished_each_for_itself(scene: problem.Problem) -> None:
    """None gets worse, none takes another's place, and one that lies far from all evidence stays there."""
    root, joints = worlds.cupboard_truth()
    plan = schedule(scene.settings, 12)
    far = poses.perturb(root, np.array([0.0, 0.0, 30.0]), np.zeros(3))
    off = poses.perturb(root, np.array([0.01, -0.01, 0.0]), np.zeros(3))
    roots, many = np.stack([off, far, root]), np.tile(joints, (3, 1))
    before = configuration_scores(scene, roots, many, plan.tolerance)
    found, moved, scores = polish(np.random.default_rng(2), scene, roots, many, plan, plan.tolerance, 6)
    assert np.all(scores >= before) and scores[0] > before[0]
    np.testing.assert_allclose(scores, configuration_scores(scene, found, moved, plan.tolerance))
    assert np.linalg.norm(found[0, :3] - root[:3]) < 0.01 and np.linalg.norm(found[1, :3] - far[:3]) < 1.0


def test_the_estimate_agrees_with_the_tree_and_keeps_the_best_it_had(
    scene: problem.Problem, rng: np.random.Generator
) -> None:
    model = scene.mrf.model
    root, joints = worlds.cupboard_truth()
    plan = schedule(scene.settings, 18)
    lost = scattered_state(rng, scene)  # a belief that knows nothing, and an estimate that is right
    state = replace(lost, root=root, joints=joints)
    found_root, found_joints, mle, score, _ = improve(rng, scene, state, state.belief, plan)
    assert found_root is not None and found_joints is not None
    np.testing.assert_allclose(mle, model.part_poses(found_root, found_joints), atol=1e-12)
    assert score >= configuration_scores(scene, root[None], joints[None], plan.tolerance)[0]
    assert np.linalg.norm(found_root[:3] - root[:3]) < 0.01


def test_every_report_agrees_with_the_tree(scene: problem.Problem) -> None:
    model = scene.mrf.model
    short = {"search_iterations": 2, "search_proposals": 200, "anneal_iterations": 2, "refine_iterations": 2}
    small = replace(scene, settings=worlds.settings(**short))
    reports = list(run.iterate(small, 6))
    assert {report.stage for report in reports} == {"start", "search", "belief propagation", "refine"}
    for report in reports[1:]:
        again = model.part_poses(report.map_poses[0], report.map_joints)
        np.testing.assert_allclose(report.map_poses[..., :3], again[..., :3], atol=1e-9)
        assert np.all((report.map_joints >= model.lower - 1e-9) & (report.map_joints <= model.upper + 1e-9))


@pytest.mark.parametrize("off", [0.0, 0.003, 0.006, 0.01, 0.014])
def test_a_profile_score_is_that_of_the_most_likely_normal_error(off: float) -> None:
    """A box seen from the front, every depth off by as much: against the densities that the score stands for."""
    model = worlds.articulated([], {"link0": worlds.block([0.2, 0.3, 0.3])})
    truth, none = worlds.at(1.0), np.zeros((1, 0))
    camera = worlds.camera_at([0.0, 0.0, 0.0], [1.0, 0.0, 0.0])
    scene = problem.build(
        model, worlds.seen(model, truth, none[0], camera), UniformPrior("upright"), worlds.settings(), particles=40
    )
    here, there = (profile_scores(scene, worlds.at(1.0 + by)[None], none)[0] for by in (0.0, off))
    unit = scene.tolerance_end / np.sqrt(2 * LOG_RATIO)
    deviations = unit * np.array([spread for spread, _ in SPREADS])
    # of what else is there the density is such that the ratio of both is e to the LOG_RATIO for an error of none
    elsewhere = norm.pdf(0.0, scale=unit) / np.exp(LOG_RATIO)
    pixels = here / (np.log(norm.pdf(0.0, scale=deviations) / elsewhere).max() / LOG_RATIO)
    assert pixels > 300
    expected = pixels * np.log(norm.pdf(off, scale=deviations) / elsewhere).max() / LOG_RATIO
    # the rim of a box that is farther away has a pixel less here and there
    assert there == pytest.approx(expected, rel=0.05, abs=0.02 * pixels)


@pytest.mark.parametrize(("tolerance", "firm_cost"), [(0.5, 6.0), (1.0, 6.0), (2.0, 6.0), (2.1, 1.0), (5.0, 1.0)])
def test_pixels_cost_more_than_others_only_of_whole_objects_at_tight_tolerances(
    scene: problem.Problem, tolerance: float, firm_cost: float
) -> None:
    tolerance *= scene.tolerance_end
    plain = scene.plain_score(tolerance)
    assert plain.tolerance == tolerance and plain.firm_cost == 1.0
    assert scene.score(tolerance) == replace(plain, firm_cost=firm_cost)


def test_a_prior_counts_once_in_a_profile_score(scene: problem.Problem, rng: np.random.Generator) -> None:
    root, joints = worlds.cupboard_truth()
    informed = problem.build(
        scene.mrf.model, scene.observation, worlds.rough_prior(rng, root), scene.settings, particles=40
    )
    plain, held = (profile_scores(made, root[None], joints[None]) for made in (scene, informed))
    np.testing.assert_allclose(held - plain, informed.plus_prior(np.zeros(1), root[None]), rtol=1e-6, atol=1e-6)
