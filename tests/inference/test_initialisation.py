"""Iteration 0 and the search's proposals follow their laws: matched points meet, priors have their spread."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import initialisation, problem
from pmpnbp.inference.belief import START, SURFACE
from pmpnbp.inference.problem import Problem
from pmpnbp.scene.articulated_object import Joint
from pmpnbp.scene.observation import Observation
from pmpnbp.scene.prior import GaussianPrior, UniformPrior
from tests.inference import small_worlds as worlds

MODEL = worlds.cupboard()


def point_seen(point: Array, normal: Array, up: Array = worlds.UP) -> Observation:
    return Observation((), point[None], normal[None] / np.linalg.norm(normal), np.zeros((0, 4)), up, None)


def problem_of(observation: Observation, prior: UniformPrior | GaussianPrior, particles: int = 100) -> Problem:
    return problem.build(MODEL, observation, prior, worlds.settings(), particles=particles)


def surface_distance(model_poses: Array, point: Array, normal: Array) -> Array:
    """(C, F): how far a point (3,) lies from each box face of the cupboard that looks along `normal` (3,), metres;
    infinity for other faces."""
    found = []
    for node, part in enumerate(MODEL.parts):
        vertices = part.mesh.vertices
        lower, upper = vertices.min(axis=0), vertices.max(axis=0)
        local = poses.transform_points(poses.inverse(model_poses[:, node]), point)
        direction = poses.rotate(poses.quaternion_conjugate(model_poses[:, node, 3:]), normal)
        for axis in range(3):
            for side, sign in ((lower, -1.0), (upper, 1.0)):
                nearest = np.clip(local, lower, upper)
                nearest[:, axis] = side[axis]
                away = np.linalg.norm(local - nearest, axis=1)
                found.append(np.where(sign * direction[:, axis] > 1 - 1e-6, away, np.inf))
    return np.stack(found, axis=1)


@pytest.mark.parametrize("normal", [[0.3, -0.5, 0.8], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
def test_any_orientation_a_surface_point_meets_the_scans_and_their_normals_agree(
    rng: np.random.Generator, normal: list[float]
) -> None:
    point, direction = np.array([0.4, -0.3, 1.2]), np.array(normal) / np.linalg.norm(normal)
    made = problem_of(point_seen(point, direction), UniformPrior("any"))
    joints = initialisation.random_joints(rng, made, 300)
    roots, part = initialisation.matched_roots(rng, made, joints)
    distance = surface_distance(MODEL.part_poses(roots, joints), point, direction)
    assert distance.min(axis=1).max() < 1e-6
    by_part = distance.reshape(300, len(MODEL.parts), -1).min(axis=2)
    assert by_part[np.arange(300), part].max() < 1e-6 and len(set(part)) == len(MODEL.parts)


def test_upright_a_surface_point_meets_the_scans_and_its_normal_turns_to_it(rng: np.random.Generator) -> None:
    point, normal = np.array([0.4, -0.3, 1.2]), np.array([0.6, -0.8, 0.0])
    made = problem_of(point_seen(point, normal), UniformPrior("upright"))
    joints = initialisation.random_joints(rng, made, 300)
    roots, _ = initialisation.matched_roots(rng, made, joints)
    distance = surface_distance(MODEL.part_poses(roots, joints), point, normal).min(axis=1)
    # a pair whose inclinations differ is drawn again at most 12 times; about one in three faces fits at once
    assert np.mean(distance < 1e-6) > 0.97
    up = poses.rotate(roots[:, 3:], worlds.UP)
    np.testing.assert_allclose(up, np.tile(worlds.UP, (300, 1)), atol=1e-9)


@pytest.mark.parametrize("up", [[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [0.3, 0.4, -0.86]])
def test_of_matches_of_upright_surfaces_half_stand_on_what_is_level(rng: np.random.Generator, up: list[float]) -> None:
    """Of 400 a binomial's 5 standard deviations: one in a million."""
    direction = np.array(up) / np.linalg.norm(up)
    aside = np.cross(direction, [0.6, -0.5, 0.1])
    aside /= np.linalg.norm(aside)
    floor, wall = np.array([*direction, 0.4]), np.array([*aside, 3.0])
    height = MODEL.parts[0].inference_mesh.vertices[:, 2].max()
    counts = {}
    for name, normal, above, planes in (
        ("standing", aside, 0.5 * height, [floor, wall]),
        ("out of reach", aside, 5 * height, [floor, wall]),
        ("lying", direction, 0.5 * height, [floor]),
        ("no floor", aside, 0.5 * height, [wall]),
    ):
        # what is seen is so high above the floor
        seen = point_seen((above - 0.4) * direction + 0.2 * aside, normal, direction)
        made = problem_of(replace(seen, planes=np.array(planes)), UniformPrior("upright"))
        roots, _ = initialisation.matched_roots(rng, made, initialisation.random_joints(rng, made, 400))
        # the cupboard's root is where it stands
        counts[name] = int(np.sum(np.abs(roots[:, :3] @ direction + 0.4) < 1e-9))
    assert abs(counts.pop("standing") - 400 * initialisation.STANDING) < 5 * np.sqrt(400 / 4)
    assert counts == {"out of reach": 0, "lying": 0, "no floor": 0}


@pytest.mark.parametrize("up", [[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [0.3, 0.4, -0.86], [0.0, 0.0, -1.0]])
def test_upright_means_along_the_scenes_up_with_any_yaw(rng: np.random.Generator, up: list[float]) -> None:
    direction = np.array(up) / np.linalg.norm(up)
    np.testing.assert_allclose(poses.rotate(initialisation.upright(direction), worlds.UP), direction, atol=1e-9)
    made = problem_of(point_seen(np.ones(3), direction, direction), UniformPrior("upright"))
    joints = initialisation.random_joints(rng, made, 200)
    for drawn in (
        initialisation.matched_roots(rng, made, joints)[0],
        initialisation.start(rng, made).belief.poses.reshape(-1, 7),
    ):
        np.testing.assert_allclose(
            poses.rotate(drawn[:, 3:], worlds.UP), np.tile(direction, (len(drawn), 1)), atol=1e-6
        )
    # a horizontal surface says nothing about the yaw: the turns point everywhere
    heading = poses.rotate(initialisation.matched_roots(rng, made, joints)[0][:, 3:], worlds.X)
    assert np.linalg.norm(heading.mean(axis=0)) < 0.25  # 200 uniform headings: a chance of e^-12.5


def test_any_orientation_at_the_start_is_uniform_over_all_rotations(rng: np.random.Generator) -> None:
    """The mean of q qᵀ over 3 × 4000 uniform quaternions is I / 4, each entry's deviation at most 0.25 / sqrt(12000).
    Five of them in ten entries: under 1e-5 by chance."""
    made = problem_of(point_seen(np.zeros(3), worlds.X), UniformPrior("any"), particles=4000)
    q = initialisation.start(rng, made).belief.poses[..., 3:].reshape(-1, 4)
    moment = np.einsum("ti,tj->ij", q, q) / len(q)
    np.testing.assert_allclose(moment, np.eye(4) / 4, atol=5 * 0.25 / np.sqrt(len(q)))


def test_the_papers_start_puts_origins_on_observed_points(rng: np.random.Generator) -> None:
    observation = worlds.seen(MODEL, *worlds.cupboard_truth())
    belief = initialisation.start(rng, problem_of(observation, UniformPrior("upright"))).belief
    assert belief.poses.shape == (3, 100, 7)
    known = {tuple(point) for point in observation.points.tolist()}
    assert all(tuple(position) in known for position in belief.poses[..., :3].reshape(-1, 3).tolist())
    assert np.all(belief.origin.source == START) and np.all(belief.origin.ancestor == -1)
    np.testing.assert_allclose(np.exp(belief.log_weights).sum(axis=1), 1.0)


@pytest.mark.parametrize("link", ["link0", "link1"])
def test_draws_from_a_gaussian_prior_have_its_mean_and_spread(rng: np.random.Generator, link: str) -> None:
    """4000 draws: means and standard deviations of six coordinates within 5 of their own deviations (1.6 % and 1.1 % of
    the standard deviation): under 1e-5 by chance."""
    std_xyz, std_rpy = np.array([0.08, 0.02, 0.05]), np.array([0.15, 0.05, 0.1])
    mean = worlds.at(0.5, 0.2, 0.9, 0.4, -0.3, 1.0)
    prior = GaussianPrior(link, mean, std_xyz, std_rpy, {"slide": (0.1, 0.01)})
    made = problem_of(worlds.NOTHING_SEEN, prior)
    count = 4000
    joints = initialisation.random_joints(rng, made, count)
    roots = initialisation.prior_roots(rng, made, joints)
    drawn = MODEL.part_poses(roots, joints)[:, [part.name for part in MODEL.parts].index(link)]
    turn = poses.quaternion_multiply(drawn[:, 3:], poses.quaternion_conjugate(mean[3:]))
    offset = np.concatenate([drawn[:, :3] - mean[:3], poses.to_rotation_vector(turn)], axis=1)
    std = np.concatenate([std_xyz, std_rpy])
    assert np.all(np.abs(offset.mean(axis=0)) < 5 * std / np.sqrt(count))
    assert np.all(np.abs(offset.std(axis=0) / std - 1) < 5 / np.sqrt(2 * count))
    # the joint that it names is drawn from it (cut off at three deviations), the other one from its whole range
    assert abs(joints[:, 0].mean() - 0.1) < 5 * 0.01 / np.sqrt(count)
    assert abs(joints[:, 0].std() / 0.01 - 0.99) < 0.06
    assert abs(joints[:, 1].mean() - 0.75) < 5 * 1.5 / np.sqrt(12 * count)
    assert joints[:, 1].min() < 0.02 and joints[:, 1].max() > 1.48


def test_a_prior_draws_whole_objects(rng: np.random.Generator) -> None:
    prior = worlds.rough_prior(rng, worlds.at(0.3))
    belief = initialisation.start(rng, problem_of(worlds.NOTHING_SEEN, prior)).belief
    assert belief.joint_positions is not None
    again = MODEL.part_poses(belief.poses[0], belief.joint_positions)
    np.testing.assert_allclose(np.swapaxes(belief.poses, 0, 1), again, atol=1e-12)


def test_a_prior_on_a_link_within_a_part_speaks_of_the_part(rng: np.random.Generator) -> None:
    joints = [
        Joint("weld", "fixed", "link0", "tag", worlds.at(0.2, 0.1, yaw=0.5), worlds.X, 0.0, 0.0),
        Joint("hinge", "revolute", "link0", "link1", worlds.at(0.3), worlds.Z, -1.0, 1.0, (0,)),
    ]
    model = worlds.articulated(joints, {"link0": worlds.block([0.1] * 3), "link1": worlds.block([0.1] * 3)})
    tag = worlds.at(1.0, 2.0, 3.0, yaw=1.0)
    prior = GaussianPrior("tag", tag, np.full(3, 1e-6), np.full(3, 1e-6), {})
    made = problem.build(model, worlds.NOTHING_SEEN, prior, worlds.settings(), particles=10)
    drawn = initialisation.random_joints(rng, made, 5)
    roots = initialisation.prior_roots(rng, made, drawn)
    found = model.link_poses(model.part_poses(roots, drawn), drawn)[:, model.links.index("tag")]
    np.testing.assert_allclose(found[:, :3], np.tile(tag[:3], (5, 1)), atol=1e-4)


def test_random_joints_stay_within_their_limits(rng: np.random.Generator) -> None:
    made = problem_of(worlds.NOTHING_SEEN, UniformPrior("upright"))
    drawn = initialisation.random_joints(rng, made, 1000)
    assert np.all((drawn >= MODEL.lower) & (drawn <= MODEL.upper))
    outside = GaussianPrior("link0", poses.IDENTITY, np.ones(3), np.ones(3), {"slide": (0.25, 0.1)})
    drawn = initialisation.random_joints(rng, problem_of(worlds.NOTHING_SEEN, outside), 1000)
    assert np.all((drawn >= MODEL.lower) & (drawn <= MODEL.upper)) and drawn[:, 0].max() == 0.25


def test_a_part_that_is_not_visible_is_never_matched(rng: np.random.Generator) -> None:
    joints = [
        Joint("left", "revolute", "link0", "hub", worlds.at(0.2), worlds.Z, -1.0, 1.0, (0,)),
        Joint("a", "revolute", "hub", "link1", worlds.at(0.1), worlds.X, -1.0, 1.0, (1,)),
        Joint("b", "revolute", "hub", "link2", worlds.at(-0.1), worlds.X, -1.0, 1.0, (2,)),
    ]
    visible = {name: worlds.block([0.1, 0.2, 0.05]) for name in ("link0", "link1", "link2")}
    model = worlds.articulated(joints, visible)
    assert [part.visible for part in model.parts] == [True, False, True, True]
    observation = point_seen(np.array([1.0, 0.0, 0.0]), np.array([-1.0, 0.0, 0.2]))
    made = problem.build(model, observation, UniformPrior("any"), worlds.settings(), particles=10)
    roots, _ = initialisation.matched_roots(rng, made, initialisation.random_joints(rng, made, 50))
    assert np.all(np.isfinite(roots))


def test_starting_twice_from_the_same_numbers_is_the_same(rng: np.random.Generator) -> None:
    for prior in (UniformPrior("any"), worlds.rough_prior(rng, worlds.at())):
        made = replace(problem_of(worlds.NOTHING_SEEN, prior))
        first, second = (initialisation.start(np.random.default_rng([7, 0]), made).belief.poses for _ in range(2))
        assert first.tobytes() == second.tobytes()


def gaussian(mean: Array, metres: float, radians: float) -> GaussianPrior:
    return GaussianPrior("link0", mean, np.full(3, metres), np.full(3, radians))


def test_with_a_prior_the_search_starts_on_the_scan_near_it(rng: np.random.Generator) -> None:
    """Most roots have a surface point of the object on the scan with a normal that agrees, turned as the prior draws
    them; the rest are the prior's own draws, which have a like spread."""
    mean, point, normal = worlds.at(0.5, 0.2, 0.4), np.array([0.25, 0.2, 0.45]), np.array([-1.0, 0.0, 0.0])
    made = problem_of(point_seen(point, normal), gaussian(mean, 0.3, 0.05))
    joints = initialisation.random_joints(rng, made, 400)
    roots, source, laid = initialisation.fresh_roots(rng, made, joints)
    matched = source == SURFACE
    assert set(source) == {SURFACE, START} and matched.mean() == initialisation.MATCHED
    placed = MODEL.part_poses(roots, joints)
    # the faces are turned by the prior's draws: to the nearest face, whichever way it looks
    near, of_laid = np.full(400, np.inf), np.full(400, np.inf)
    for node, part in enumerate(MODEL.parts):
        lower, upper = part.mesh.vertices.min(axis=0), part.mesh.vertices.max(axis=0)
        local = poses.transform_points(poses.inverse(placed[:, node]), point)
        outside = np.linalg.norm(local - np.clip(local, lower, upper), axis=1)
        depth = np.minimum(local - lower, upper - local).min(axis=1)
        distance = np.where(outside > 0, outside, depth)
        near, of_laid = np.minimum(near, distance), np.where(laid == node, distance, of_laid)
    assert near[matched].max() < 1e-6 < np.median(near[~matched])
    assert of_laid[matched].max() < 1e-6 and len(set(laid[matched])) == len(MODEL.parts) and not np.any(laid[~matched])
    angle = poses.rotation_angle(roots[:, 3:], np.broadcast_to(mean[3:], (400, 4)))
    # the mean length of three deviates is 1.6 deviations
    assert abs(angle.mean() / (1.596 * 0.05) - 1) < 0.15


def test_with_a_prior_of_two_points_that_are_as_good_the_likelier_one_is_taken(rng: np.random.Generator) -> None:
    """Which of CANDIDATES is taken is drawn by the prior where it leaves the object."""
    mean, normal = worlds.at(0.5, 0.2, 0.4), np.array([[-1.0, 0.0, 0.0]])
    points = np.array([[0.3, 0.2, 0.4], [-0.3, 0.2, 0.4]])
    observation = Observation((), points, np.repeat(normal, 2, axis=0), np.zeros((0, 4)), worlds.UP, None)
    made = problem_of(observation, gaussian(mean, 0.2, 0.01))
    joints = np.zeros((1000, made.mrf.model.dof))
    roots, source, _ = initialisation.fresh_roots(rng, made, joints)
    # a face on the second point leaves the root three deviations away or farther
    assert np.mean(roots[source == SURFACE, 0] > 0.0) > 0.9


def test_with_a_prior_far_from_all_that_was_seen_its_own_draws_remain(rng: np.random.Generator) -> None:
    made = problem_of(point_seen(np.array([9.0, 9.0, 9.0]), worlds.X), gaussian(worlds.at(0.5), 0.1, 0.1))
    joints = initialisation.random_joints(rng, made, 50)
    roots, _, _ = initialisation.fresh_roots(rng, made, joints)
    assert np.linalg.norm(roots[:, :3] - [0.5, 0.0, 0.0], axis=1).max() < 1.0


def test_a_prior_is_narrow_that_says_where_the_object_is() -> None:
    seen = point_seen(np.ones(3), worlds.X)
    narrow, wide = (problem_of(seen, gaussian(worlds.at(1.0), *std)) for std in ((0.08, 0.15), (0.3, 0.15)))
    free = problem_of(seen, UniformPrior("upright"))
    assert narrow.narrow and not wide.narrow and not free.narrow
    assert not problem_of(seen, gaussian(worlds.at(1.0), 0.05, 0.5)).narrow
    assert narrow.search_iterations < wide.search_iterations == free.search_iterations
    assert narrow.search_proposals < wide.search_proposals == free.search_proposals
    assert narrow.anneal_iterations < wide.anneal_iterations == free.anneal_iterations
    last = narrow.annealed
    assert narrow.schedule(last + 1).progress == 1.0 > narrow.schedule(last).progress
    # as the paper starts, annealing is all there is
    changed = replace(narrow, settings=replace(narrow.settings, search_iterations=0))
    assert changed.anneal_iterations == changed.annealed == wide.anneal_iterations
