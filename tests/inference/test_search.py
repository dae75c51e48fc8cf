"""The global search: children lie on their joints within limits, hypotheses are distinct, and it finds the object."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import global_search, hypotheses, initialisation, problem, rivals, run, settling
from pmpnbp.inference.belief import FLIP, OWN, SURFACE
from pmpnbp.inference.confirmation import confirmation
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.tree_estimate import configuration_scores
from pmpnbp.readout.metrics import add, model_points
from pmpnbp.scene.articulated_object import ArticulatedObject, Joint
from pmpnbp.scene.prior import UniformPrior
from pmpnbp.settings import changed, schedule
from tests.inference import small_worlds as worlds


def geared() -> ArticulatedObject:
    """Two doors of which the second follows the first, half as far and the other way."""
    joints = [
        Joint("left", "revolute", "link0", "link1", worlds.at(0.15, 0.2), worlds.Z, -0.2, 1.2, (0,)),
        Joint(
            "right", "revolute", "link0", "link2", worlds.at(0.15, -0.2), worlds.Z, -0.5, 0.2, (0,), "left", -0.5, 0.1
        ),
    ]
    door = worlds.block([0.02, 0.18, 0.3])
    return worlds.articulated(joints, {"link0": worlds.block([0.3, 0.4, 0.4]), "link1": door, "link2": door})


def likes_x(node: Array, part_poses: Array) -> Array:
    """Log unary potential: the further along x the better, so that every joint wants to go to one of its ends."""
    return 100.0 * part_poses[..., 0]


def walked(
    model: ArticulatedObject, rng: np.random.Generator, unary: Callable[[Array, Array], Array]
) -> tuple[Problem, hypotheses.Hypotheses, Array]:
    made = worlds.given_unary(model, unary, worlds.settings(), particles=20)
    count = 50
    roots = np.concatenate([rng.uniform(-1, 1, (count, 3)), poses.random_quaternions(rng, (count,))], axis=-1)
    joints = initialisation.random_joints(rng, made, count)
    proposals = hypotheses.Proposals(
        roots=roots,
        joints=joints,
        source=np.full(count, SURFACE, dtype=np.uint8),
        ancestor=np.full(count, -1, dtype=np.int32),
        held=np.zeros(count, dtype=np.int64),
    )
    return made, hypotheses.walk(rng, made, proposals, schedule(made.settings, 1)), joints


MODELS = {
    "sliding chain": worlds.sliding_chain(4),
    "hinged chain": worlds.hinged_chain(4),
    "star": worlds.star(3),
    "geared": geared(),
    "closed loop": worlds.four_bar(),
}


@pytest.mark.parametrize("name", MODELS)
def test_walking_puts_every_part_where_the_joints_say(rng: np.random.Generator, name: str) -> None:
    model = MODELS[name]
    _, tried, start = walked(model, rng, likes_x)
    assert np.all((tried.joints >= model.lower - 1e-9) & (tried.joints <= model.upper + 1e-9))
    again = model.part_poses(tried.roots, tried.joints)
    np.testing.assert_allclose(tried.part_poses[..., :3], again[..., :3], atol=1e-9)
    assert poses.rotation_angle(tried.part_poses[..., 3:], again[..., 3:]).max() < 1e-7
    assert not np.allclose(tried.joints, start)


def test_a_joint_that_follows_is_not_chosen_for_itself(rng: np.random.Generator) -> None:
    _, tried, _ = walked(geared(), rng, likes_x)
    left, right = geared().edges
    np.testing.assert_allclose(right.axis_positions(tried.joints), -0.5 * left.axis_positions(tried.joints) + 0.1)
    assert np.ptp(tried.joints) > 0.5


def test_every_other_hypothesis_takes_the_best_position_tried(rng: np.random.Generator) -> None:
    """Those that choose without chance never do worse than where they stood."""
    model = worlds.sliding_chain(2)
    _, tried, start = walked(model, rng, likes_x)
    stood = 100.0 * model.part_poses(tried.roots, start)[:, 1, 0]
    assert np.all(tried.unary[::2, 1] >= stood[::2] - 1e-9)
    np.testing.assert_allclose(tried.unary, 100.0 * tried.part_poses[..., 0])


def test_of_a_walk_those_arrive_that_explain_most_and_all_that_must_not_get_lost(rng: np.random.Generator) -> None:
    made = worlds.given_unary(worlds.sliding_chain(4), likes_x, worlds.settings(), particles=20)
    count, left, kept = 400, 20, slice(100, 105)
    roots = np.concatenate([rng.uniform(-1, 1, (count, 3)), poses.random_quaternions(rng, (count,))], axis=-1)
    # whichever way the chains lie, one of the first ten is ahead of all others from the root on
    roots[:10, 0] += 100.0
    ancestor = np.where(np.arange(count) < 100, -1, rng.integers(50, size=count)).astype(np.int32)
    joints, source = initialisation.random_joints(rng, made, count), np.full(count, OWN, dtype=np.uint8)
    held = np.zeros(count, dtype=np.int64)
    proposals = hypotheses.Proposals(roots=roots, joints=joints, source=source, ancestor=ancestor, held=held)
    arrived = hypotheses.walk(rng, made, proposals, schedule(made.settings, 1), kept, left)
    assert left <= len(arrived.roots) <= left + 5 + 50
    again = made.mrf.model.part_poses(arrived.roots, arrived.joints)
    np.testing.assert_allclose(arrived.part_poses[..., :3], again[..., :3], atol=1e-9)
    for must in (roots[:10], roots[kept]):
        assert all((arrived.roots == one).all(axis=1).any() for one in must)
    assert set(ancestor) <= set(arrived.ancestor)


def test_joints_up_to_a_part_that_is_held_stay_and_the_others_are_searched(rng: np.random.Generator) -> None:
    model = worlds.star(3)
    made = worlds.given_unary(model, likes_x, worlds.settings(), particles=20)
    count = 60
    roots = np.concatenate([rng.uniform(-1, 1, (count, 3)), poses.random_quaternions(rng, (count,))], axis=-1)
    joints, held = initialisation.random_joints(rng, made, count), rng.integers(len(model.parts), size=count)
    proposals = hypotheses.Proposals(
        roots=roots,
        joints=joints,
        source=np.full(count, SURFACE, dtype=np.uint8),
        ancestor=np.full(count, -1, dtype=np.int32),
        held=held,
    )
    arrived = hypotheses.walk(rng, made, proposals, schedule(made.settings, 1))
    stayed = np.isclose(arrived.joints, joints, rtol=0, atol=1e-9)
    for edge in model.edges:
        # all arms hang on the middle part
        assert np.all(stayed[held == edge.child][:, edge.coordinates])
        assert np.mean(stayed[held != edge.child][:, edge.coordinates]) < 0.8
    np.testing.assert_allclose(arrived.unary, likes_x(np.arange(len(model.parts)), arrived.part_poses))


def test_of_a_walk_those_arrive_that_hold_what_is_seen_however_hidden_the_root_is(rng: np.random.Generator) -> None:
    """One of 400 has the last part where it explains something; of those that hold nothing twenty arrive by chance."""
    model, seen = worlds.hinged_chain(4), np.array([3.0, 2.0, 1.0])

    def last_is_seen(node: Array, part_poses: Array) -> Array:
        gap = np.linalg.norm(part_poses[..., :3] - seen, axis=-1)
        return np.where((node == 3) & (gap < 0.01), 50.0, 0.0)

    made = worlds.given_unary(model, last_is_seen, worlds.settings(), particles=20)
    count, right = 400, 237
    roots = np.concatenate([rng.uniform(-1, 1, (count, 3)), poses.random_quaternions(rng, (count,))], axis=-1)
    joints = initialisation.random_joints(rng, made, count)
    roots[right, :3] += seen - model.part_poses(roots[right], joints[right])[3, :3]
    proposals = hypotheses.Proposals(
        roots=roots,
        joints=joints,
        source=np.full(count, SURFACE, dtype=np.uint8),
        ancestor=np.full(count, -1, dtype=np.int32),
        held=np.full(count, 3),
    )
    arrived = hypotheses.walk(rng, made, proposals, schedule(made.settings, 1), slice(0), 20)
    assert len(arrived.roots) == 20 and arrived.unary.sum(axis=1).max() == 50.0
    np.testing.assert_allclose(arrived.roots[arrived.unary.sum(axis=1).argmax()], roots[right])


def test_ranked_puts_the_best_of_each_island_before_the_best_of_all() -> None:
    score = np.array([5.0, 9.0, 1.0, 7.0, 8.0, 2.0])
    ancestor = np.array([-1, -1, 4, 4, 2, 2], dtype=np.int32)
    np.testing.assert_array_equal(hypotheses.ranked(score, ancestor, 3), [4, 3, 1])
    np.testing.assert_array_equal(hypotheses.ranked(score, ancestor, 9), [4, 3, 1, 0, 5, 2])


def test_trials_cover_the_range_finely_enough_and_start_from_where_the_joint_is(rng: np.random.Generator) -> None:
    edge = worlds.sliding_chain(2, half_range=0.2).edges[0]
    plan = schedule(worlds.settings(), 1)
    settled = rng.uniform(-0.2, 0.2, (30, 1))
    axes = hypotheses._trials(rng, edge, settled, 0.1, plan, all_over=True)
    near = hypotheses._trials(rng, edge, settled, 0.1, plan, all_over=False)
    assert near.shape == (30, 1 + hypotheses.NEAR, 1)
    np.testing.assert_array_equal(axes[:, 0], settled)
    np.testing.assert_array_equal(near[:, 0], settled)
    assert np.all((axes >= edge.lower) & (axes <= edge.upper))
    gaps = np.diff(np.sort(axes[..., 0], axis=1), axis=1, prepend=-0.2, append=0.2)
    assert gaps.max() <= 2 * 1.5 * plan.tolerance  # no place is further than that from one that was tried


def test_hypotheses_that_are_kept_lie_apart(rng: np.random.Generator) -> None:
    made, tried, _ = walked(worlds.hinged_chain(3), rng, lambda node, pose: np.ones(len(pose)))
    tried = tried.joined(tried)  # each of them twice
    order = np.arange(100)
    leaders, member_of = hypotheses.distinct(made, tried, order, 100, 0.05)
    assert len(leaders) <= 50 and np.all(leaders < 50)
    np.testing.assert_array_equal(member_of[:50], member_of[50:])
    chosen = tried.part_poses[leaders][:, :, :3]
    spacing = np.linalg.norm(chosen[:, None] - chosen[None], axis=-1).max(axis=2)
    assert spacing[~np.eye(len(leaders), dtype=bool)].min() > 0


MODEL = worlds.cupboard()
ROOT, JOINTS = worlds.cupboard_truth()


def errors_of(model: ArticulatedObject, mle: Array, truth: Array) -> Array:
    return np.array(
        [add(model_points(part.mesh), pose, true) for part, pose, true in zip(model.parts, mle, truth, strict=True)]
    )


@pytest.fixture(scope="module")
def scene() -> Problem:
    observation = worlds.seen(MODEL, ROOT, JOINTS)
    return problem.build(
        MODEL, observation, UniformPrior("upright"), worlds.settings(search_proposals=1500), particles=100
    )


@pytest.fixture(scope="module")
def searched(scene: Problem) -> list[run.IterationReport]:
    return list(run.iterate(scene, scene.search_iterations))


def test_a_searched_belief_is_made_of_whole_objects(scene: Problem, searched: list[run.IterationReport]) -> None:
    for report in searched[1:]:
        belief = report.belief
        assert report.stage == "search" and belief.joint_positions is not None
        again = MODEL.part_poses(belief.poses[0], belief.joint_positions)
        np.testing.assert_allclose(np.swapaxes(belief.poses, 0, 1)[..., :3], again[..., :3], atol=1e-6)
        np.testing.assert_allclose(np.exp(belief.log_weights).sum(axis=1), 1.0, rtol=1e-9)
        assert np.all(belief.origin.island == belief.origin.island[0])
        islands = len(np.unique(belief.origin.island[0]))
        assert islands <= min(global_search.FIRST_ISLANDS * scene.settings.search_islands, scene.particles)
        if report.iteration >= scene.search_iterations - 1:
            assert islands <= 2 * scene.settings.search_islands
        # the first particle leads the best island, and is the estimate
        assert belief.origin.island[0, 0] == 0
        np.testing.assert_array_equal(report.map_poses, belief.poses[:, 0])
        np.testing.assert_array_equal(report.map_joints, belief.joint_positions[0])


def test_finalists_go_on_once_for_each_place_and_not_where_hopeless(scene: Problem) -> None:
    """Seven on four places, best last: three on the best, two a little behind, one far behind, one beyond the most."""
    plan = schedule(scene.settings, 4, 4)
    sideways = np.array([0.8, 0.6, 0.4, 0.4, 0.2, 0.2, 0.2])
    score = np.array([10.0, 49.0, 70.0, 71.0, 98.0, 99.0, 100.0])
    roots = np.tile(ROOT, (7, 1))
    roots[:, 0] += sideways
    joints = np.tile(JOINTS, (7, 1))
    tried = replace(worlds.hypotheses(scene, roots, joints), unary=np.ones((7, 3)))
    for most, expected in ((7, [6, 3]), (5, [6, 3]), (3, [6])):
        going_on = settling._promising(scene, tried, score, plan, most)
        np.testing.assert_array_equal(going_on.ancestor, expected)
    gone_below = settling._promising(scene, tried, score - 200.0, plan, 7)
    np.testing.assert_array_equal(gone_below.ancestor, [6, 3])


@pytest.mark.parametrize("close", [0.0, 1e3])
def test_where_rivals_contest_each_other_what_looks_like_them_is_tried(
    scene: Problem, monkeypatch: pytest.MonkeyPatch, close: float
) -> None:
    """Of two wrong rivals, the truth turned by a quarter and by half, neither leads to it by small moves."""
    monkeypatch.setattr(settling, "CLOSE", close)
    middle, plan = ROOT[:3], replace(schedule(scene.settings, 4, 4), tolerance=0.024)
    turns = np.array([[1], [2]])
    roots = rivals.turned(np.tile(ROOT, (2, 1)), middle, np.tile(worlds.Z, (2, 1)), turns)
    joints = np.tile(JOINTS, (2, 1))
    wrong = worlds.hypotheses(scene, roots, joints)
    score = configuration_scores(scene, roots, joints, plan.tolerance)
    found, reached = settling._contested(
        np.random.default_rng(0), scene, wrong, score, plan, settling.SETTLE_UNINFORMED
    )
    np.testing.assert_array_equal(found.roots[:2], roots)
    np.testing.assert_array_equal(reached[:2], score)
    best = int(reached.argmax())
    truth = MODEL.part_poses(ROOT, JOINTS)
    assert errors_of(MODEL, found.part_poses[best], truth).max() < 0.01
    # what nothing contests is looked at twice, too, with less effort; all are counted, however hopeless
    monkeypatch.setattr(settling, "HOPELESS", 1e9)
    _, reached = settling._contested(np.random.default_rng(0), scene, wrong, score, plan, settling.SETTLE_UNINFORMED)
    monkeypatch.setattr(settling, "shifted", lambda rng, problem, near: near.taken(np.arange(0)))
    _, unshifted = settling._contested(np.random.default_rng(0), scene, wrong, score, plan, settling.SETTLE_UNINFORMED)
    assert len(unshifted) > 2 + settling.UNCONTESTED if close else len(unshifted) == 2 + settling.UNCONTESTED
    # and with a part where another was
    assert len(reached) > len(unshifted)


def test_what_is_hopeless_beside_the_best_is_polished_no_longer(
    scene: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Near the truth, a step aside and far off: the last is left behind, and all where another has twice as much."""
    plan = replace(schedule(scene.settings, 4, 4), tolerance=0.024)
    roots = np.tile(ROOT, (3, 1))
    roots[:, 0] += [0.002, 0.004, 2.0]
    tried = worlds.hypotheses(scene, roots, np.tile(JOINTS, (3, 1)))
    polished, rounds = settling._polished, []

    def recorded(*given: Any, **how: Any) -> Any:
        rounds.append((len(given[2].roots), given[5]))
        return polished(*given, **how)

    monkeypatch.setattr(settling, "_polished", recorded)
    left, score = settling._raced(np.random.default_rng(0), scene, tried, plan, 8, -np.inf)
    assert rounds == [(3, settling.HEAT), (2, 8 - settling.HEAT)]
    assert len(left.roots) == len(score) == 2 and score.min() > 0.95 * score.max()
    none, nothing = settling._raced(np.random.default_rng(0), scene, tried, plan, 8, 2.1 * score.max())
    assert len(none.roots) == len(nothing) == 0 and len(rounds) == 3


def test_a_searched_particle_says_where_it_came_from(searched: list[run.IterationReport]) -> None:
    assert set(np.unique(searched[1].belief.origin.source)) == {SURFACE}
    later = searched[3].belief
    assert {OWN, FLIP} & set(np.unique(later.origin.source).tolist())
    fresh = later.origin.source == SURFACE
    assert np.all(later.origin.ancestor[fresh] == -1)
    assert np.all((later.origin.ancestor[~fresh] >= 0) & (later.origin.ancestor[~fresh] < 100))


def test_the_best_of_the_search_does_not_get_lost(searched: list[run.IterationReport], scene: Problem) -> None:
    """Scores of different iterations do not compare, their tolerances differ; the places of the best ones do."""
    truth = MODEL.part_poses(ROOT, JOINTS)
    assert errors_of(MODEL, searched[-1].map_poses, truth).max() < 0.05


def searched_with(scene: Problem, **changes: object) -> list[run.IterationReport]:
    """A short search, which does not look for more where much is left unexplained."""
    hurry = {"search_proposals": 10, "search_islands": 1, "search_iterations": 2, "search_iterations_per_joint": 0}
    hurry["search_unexplained"] = 0
    hurried = replace(scene, settings=changed(scene.settings, hurry | changes))
    return list(run.iterate(hurried, hurried.search_iterations))


def test_what_the_scan_does_not_confirm_is_searched_again(scene: Problem) -> None:
    """Too few proposals to find anything at once, mostly: of several searches the best stays."""
    better = 0
    for seed in range(4):
        scores = [
            searched_with(replace(scene, seed=seed), search_explained=1.0, search_restarts=restarts)[-1].map_score
            for restarts in (0, 3)
        ]
        assert scores == sorted(scores)
        better += scores[1] > scores[0]
    assert better
    once, *more = (searched_with(scene, search_explained=1.0, search_restarts=restarts) for restarts in (0, 1, 3))
    assert once[-1].notes == ()
    for reports, restarts in zip(more, (1, 3), strict=True):
        assert [report.iteration for report in reports] == [report.iteration for report in once]
        np.testing.assert_array_equal(reports[-2].belief.poses, once[-2].belief.poses)
        assert f"the search was made {restarts + 1} times" in reports[-1].notes[0]
    scores = [reports[-1].map_score for reports in (once, *more)]
    assert scores == sorted(scores)
    again = searched_with(scene, search_explained=1.0, search_restarts=1)[-1]
    np.testing.assert_array_equal(again.belief.poses, more[0][-1].belief.poses)


def test_what_the_scan_confirms_is_not_searched_again(scene: Problem, searched: list[run.IterationReport]) -> None:
    last = searched[-1]
    assert scene.settings.search_restarts > 0 and last.notes == ()
    assert confirmation(scene, last.map_poses[0], last.map_joints, 0.024).explained > scene.settings.search_explained
    never = searched_with(scene, search_explained=0.0)[-1]
    assert never.notes == ()


def test_a_search_made_again_is_as_long_as_without_a_prior(scene: Problem) -> None:
    """What a narrow prior says that is wrong is made good then."""
    near = worlds.rough_prior(np.random.default_rng(0), ROOT, MODEL.parts[0].links[0])
    narrow = problem.build(MODEL, scene.observation, near, scene.settings)
    again = replace(narrow, patient=True)
    assert narrow.narrow and not again.narrow
    assert narrow.search_iterations < again.search_iterations == scene.search_iterations
    assert narrow.search_proposals < again.search_proposals == scene.search_proposals
    reports = searched_with(narrow, search_explained=2.0, search_restarts=1)
    assert reports[-1].iteration == 1 and "the search was made 2 times" in reports[-1].notes[0]


@pytest.mark.parametrize("seed", [0, 1])
def test_it_finds_an_upright_object_anywhere(scene: Problem, seed: int) -> None:
    report = list(run.iterate(replace(scene, seed=seed), 24))[-1]
    assert errors_of(MODEL, report.map_poses, MODEL.part_poses(ROOT, JOINTS)).max() < 0.01


@pytest.mark.parametrize(
    "root",
    [
        pytest.param(worlds.at(1.4, 0.1, 0.5, roll=np.pi, yaw=np.pi - 0.35), id="upside down"),
        pytest.param(worlds.at(1.4, 0.1, 0.2, roll=0.9, pitch=0.4, yaw=2.6), id="tilted"),
    ],
)
def test_any_orientation_finds_an_object_that_does_not_stand(root: Array) -> None:
    observation = worlds.seen(MODEL, root, JOINTS)
    made = problem.build(
        MODEL, observation, UniformPrior("any"), worlds.settings(search_proposals=3000), particles=100, seed=1
    )
    report = list(run.iterate(made, made.search_iterations + 12))[-1]
    assert errors_of(MODEL, report.map_poses, MODEL.part_poses(root, JOINTS)).max() < 0.01


def test_islands_go_a_step_of_registration_further(rng: np.random.Generator, scene: Problem) -> None:
    """Those named, towards where they explain more, with the scores and poses of where they then are."""
    plan = schedule(scene.settings, 1, 4)
    roots = poses.perturb(np.tile(ROOT, (6, 1)), rng.normal(0, 0.02, (6, 3)), rng.normal(0, 0.02, (6, 3)))
    joints = np.tile(JOINTS, (6, 1))
    tried = worlds.hypotheses(scene, roots, joints)
    rows = np.array([4, 1, 3])
    before = configuration_scores(scene, roots[rows], joints[rows], plan.tolerance)
    known = before.copy()
    found, score = global_search._registered(rng, scene, tried, rows, known, plan)
    np.testing.assert_array_equal(known, before)
    assert np.all(score >= before) and np.median(score - before) > 0
    np.testing.assert_allclose(
        score, configuration_scores(scene, found.roots[rows], found.joints[rows], plan.tolerance)
    )
    np.testing.assert_array_equal(found.part_poses, scene.mrf.part_poses(found.roots, found.joints))
    assert np.all(found.unary[rows].sum(axis=1) > 0)
    others = np.setdiff1d(np.arange(6), rows)
    np.testing.assert_array_equal(found.roots[others], roots[others])
    np.testing.assert_array_equal(tried.roots, roots)


def test_upright_the_search_starts_from_hypotheses_that_stand(rng: np.random.Generator, scene: Problem) -> None:
    roots, source, _ = initialisation.fresh_roots(rng, scene, initialisation.random_joints(rng, scene, 300))
    assert set(source) == {SURFACE}
    up = poses.rotate(roots[:, 3:], worlds.UP)
    np.testing.assert_allclose(up, np.tile(worlds.UP, (len(up), 1)), atol=1e-9)
