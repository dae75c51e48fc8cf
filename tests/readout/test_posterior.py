"""The mixture of modes: a box that looks the same from front and back, and what is made of its draws."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import problem as problems
from pmpnbp.inference import run
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.confirmation import confirmation
from pmpnbp.inference.held_part import Held
from pmpnbp.inference.nuisance_fit import fitted
from pmpnbp.inference.problem import LONG_CHAIN, Problem
from pmpnbp.potentials.nuisances import apparent
from pmpnbp.readout import mixture, places
from pmpnbp.readout.checkpoint import Checkpoint
from pmpnbp.readout.estimate import estimate
from pmpnbp.readout.fit import assess
from pmpnbp.readout.log_posterior import log_posterior
from pmpnbp.readout.mixture import at_rest, of_estimate, read_out
from pmpnbp.readout.object_posterior import Better, ModeDraws, draws_or_better
from pmpnbp.readout.particle_statistics import covariance
from pmpnbp.readout.placement import place, standing
from pmpnbp.readout.places import POLISH_ROUNDS
from pmpnbp.readout.posterior import FEWEST_DRAWS, LONG, TURN, Posterior, spread
from pmpnbp.readout.posterior import TURNED as OFTEN
from pmpnbp.recording.posteriors import posterior_arrays
from pmpnbp.scene.articulated_object import ArticulatedObject, Joint
from pmpnbp.scene.observe import observe
from pmpnbp.scene.prior import GaussianPrior, UniformPrior
from pmpnbp.scene.sizes import resized
from tests.inference import small_worlds as worlds
from tests.inference.small_worlds import X, articulated, at, block

ROOT, SHUT = at(1.4, 0.1, 0.0, yaw=np.pi - 0.35), np.array([0.0])
TURNED = poses.multiply(ROOT, at(yaw=np.pi))


def twin() -> ArticulatedObject:
    """A box with a drawer that cannot be seen while it is shut: turned by half it looks the same."""
    slide = Joint("slide", "prismatic", "link0", "link1", at(0.148, 0.0, 0.2), X, 0.0, 0.25, (0,))
    return articulated([slide], {"link0": block([0.3, 0.4, 0.4], at(z=0.2)), "link1": block([0.2, 0.3, 0.2], at(-0.1))})


@pytest.fixture(scope="module")
def problem() -> Problem:
    model = twin()
    observation = worlds.seen(model, ROOT, SHUT)
    return problems.build(model, observation, UniformPrior("upright"), worlds.settings(), particles=20, seed=5)


def report(problem: Problem, *rivals: Array, root: Array = ROOT, iteration: int = 12) -> IterationReport:
    """An iteration whose estimate is at `root`, the drawer shut, and the search's rivals (7,), shut too."""
    _, made = run.begin(problem)
    kept = np.array([np.concatenate([one, SHUT]) for one in rivals]) if rivals else None
    return replace(
        made,
        iteration=iteration,
        stage="belief propagation",
        map_poses=problem.mrf.part_poses(root, SHUT),
        map_joints=SHUT,
        rivals=kept,
    )


def test_two_places_that_look_the_same_are_two_modes_of_about_one_weight(problem: Problem) -> None:
    """From behind the drawer may be anywhere, from the front it is shut: that room is not what weighs."""
    for seed in range(3):
        found = of_estimate(replace(problem, seed=seed), report(problem, ROOT, TURNED))
        assert len(found.modes) == 2
        assert 0.3 < found.modes[0].weight < 0.7 and sum(mode.weight for mode in found.modes) == pytest.approx(1.0)
        turns = [poses.rotation_angle(mode.root[3:], ROOT[3:]) for mode in found.modes]
        assert min(turns) < 0.1 and max(turns) > 3.0
        slides = [found.drawn_joints[found.mode == k, 0] for k in np.argsort(turns)]
        shares = [np.exp(found.log_weights[found.mode == k]) for k in np.argsort(turns)]
        means = [share @ slide / share.sum() for slide, share in zip(slides, shares, strict=True)]
        assert means[0] < 0.01 and 0.05 < means[1] < 0.2


def elbow() -> ArticulatedObject:
    """A board before two small links, and above it a bar behind them: which way they are bent cannot be seen."""
    hinges = [
        Joint(f"hinge{k}", "revolute", f"link{k - 1}", f"link{k}", at(z=height), X, -2.0, 2.0, (k - 1,))
        for k, height in ((1, 0.0), (2, 0.2), (3, 0.2))
    ]
    small = block([0.04, 0.04, 0.2], at(z=0.1))
    board, bar = block([0.02, 0.9, 0.5], at(-0.15, 0.0, 0.2)), block([0.06, 0.05, 0.5], at(z=0.28))
    return articulated(hinges, {"link0": board, "link1": small, "link2": small, "link3": bar})


def test_a_hidden_elbow_may_be_bent_either_way() -> None:
    """Though the search left no rival: of those two links nobody is certain, of what holds them both everybody is."""
    model, root, bent = elbow(), at(1.3), np.array([0.35, -0.7, 0.35])
    seen = worlds.seen(model, root, bent, worlds.camera_at((0.0, 0.0, 0.5), (1.3, 0.0, 0.4)))
    problem = problems.build(model, seen, UniformPrior("upright"), worlds.settings(), particles=20, seed=5)
    _, made = run.begin(problem)
    placed = problem.mrf.part_poses(root, bent)
    told = replace(made, iteration=12, stage="belief propagation", map_poses=placed, map_joints=bent)
    for seed in range(3):
        found = of_estimate(replace(problem, seed=seed), told)
        assert len(found.modes) == 2 and all(0.35 < mode.weight < 0.65 for mode in found.modes)
        joints = sorted((mode.joints for mode in found.modes), key=lambda one: one[0])
        np.testing.assert_allclose(joints, [-bent, bent], atol=0.1)
        assert spread(problem, found, root, bent).certain(found, 0.02).tolist() == [True, False, False, True]


def propeller() -> ArticulatedObject:
    """A bar that turns about its middle, before a board: turned by half it looks the same."""
    turn = Joint("turn", "continuous", "link0", "link1", at(-0.06, 0.0, 0.3), X, -np.pi, np.pi, (0,))
    return articulated([turn], {"link0": block([0.04, 0.3, 0.5], at(z=0.25)), "link1": block([0.03, 0.4, 0.05])})


@pytest.mark.parametrize("turned", [0.4, np.pi - 0.01])
def test_a_joint_that_may_as_well_be_elsewhere_is_there_with_as_much_weight(turned: float) -> None:
    """Though the search left no rival; a turn that nothing but its zero ends is in one place on both sides of that."""
    model, root, joints = propeller(), at(1.3), np.array([turned])
    seen = worlds.seen(model, root, joints, worlds.camera_at((0.0, 0.0, 0.4), (1.3, 0.0, 0.3)))
    problem = problems.build(model, seen, UniformPrior("upright"), worlds.settings(), particles=20, seed=5)
    _, made = run.begin(problem)
    told = replace(
        made,
        iteration=12,
        stage="belief propagation",
        map_poses=problem.mrf.part_poses(root, joints),
        map_joints=joints,
    )
    for seed in range(3):
        found = of_estimate(replace(problem, seed=seed), told)
        assert len(found.modes) == 2 and all(0.35 < mode.weight < 0.65 for mode in found.modes)
        apart = np.abs(found.modes[0].joints - found.modes[1].joints)[0]
        assert apart == pytest.approx(np.pi, abs=0.05)
        assert spread(problem, found, root, joints).certain(found, 0.02).tolist() == [True, False]


def test_nobody_is_certain_of_which_of_two_it_is(problem: Problem) -> None:
    both = of_estimate(problem, report(problem, TURNED))
    alone = of_estimate(problem, report(problem))
    assert not spread(problem, both, ROOT, SHUT).certain(both, 0.02).any()
    assert spread(problem, alone, ROOT, SHUT).certain(alone, 0.02).all()


def test_rivals_that_are_the_estimate_or_far_worse_are_no_modes(problem: Problem) -> None:
    near = poses.multiply(ROOT, at(0.004, 0.003))
    elsewhere = at(1.0, 0.8, 0.0)
    found = of_estimate(problem, report(problem, near, ROOT, elsewhere))
    assert len(found.modes) == 1 and found.modes[0].weight == 1.0
    assert np.all(found.mode == 0) and np.exp(found.log_weights).sum() == pytest.approx(1.0)


@pytest.mark.parametrize(("weight", "count"), [(0.03, 2), (0.004, 1)])
def test_what_keeps_nobody_from_being_certain_is_no_mode(
    problem: Problem, monkeypatch: pytest.MonkeyPatch, weight: float, count: int
) -> None:
    """0.4 % of the draws half a metre away would else be a deviation of three centimetres."""
    monkeypatch.setattr(mixture, "_log_weights", lambda places: np.log([1 - weight, weight]))
    found = of_estimate(problem, report(problem, TURNED))
    told = spread(problem, found, ROOT, SHUT)
    assert len(found.modes) == count and sum(mode.weight for mode in found.modes) == pytest.approx(1.0)
    assert told.certain(found, 0.02).all() == (count == 1)
    assert np.sqrt(told.covariances[0, 0, 0]) < 0.002 or count == 2


def fitted_report(problem: Problem, root: Array, joints: Array) -> tuple[Problem, IterationReport]:
    """The problem with its nuisances fitted near a configuration, and the report of an iteration that ends there."""
    _, made = run.begin(problem)
    for seed in range(3):
        rng = np.random.default_rng(seed)
        root, joints, nuisances, _ = fitted(rng, problem, root, joints, problem.schedule(100), problem.tolerance_end)
        problem = problem.taking(nuisances)
    placed = problem.mrf.part_poses(root, joints)
    last = {"iteration": 12, "stage": "belief propagation"}
    return problem, replace(made, map_poses=placed, map_joints=joints, nuisances=nuisances, **last)


def test_sizes_that_are_not_known_are_drawn_with_the_rest() -> None:
    """A cupboard 2 or 3 % larger and smaller than its model: every draw is one of some size, and where the parts are
    lies within the draws' spread. That their best explanation is off by more than four deviations has odds of a
    thousand to one against, part by part."""
    model, (root, joints) = worlds.cupboard(), worlds.cupboard_truth()
    there = worlds.larger(model, np.array([0.02, -0.02, 0.03]))
    problem = problems.build(
        model,
        worlds.seen(there, root, joints),
        UniformPrior("upright"),
        worlds.settings(size_std=0.02),
        particles=20,
        seed=5,
    )
    problem, told = fitted_report(problem, root, joints)
    found = of_estimate(problem, told)
    assert found.drawn_sizes is not None and found.effective_sample_size > FEWEST_DRAWS
    one = int(found.even_draws(1)[0])
    alone = resized(model, found.drawn_sizes[one])
    expected = alone.link_poses(
        alone.part_poses(found.drawn_roots[one], found.drawn_joints[one]), found.drawn_joints[one]
    )
    np.testing.assert_allclose(found.link_poses(model)[one], expected, atol=1e-12)
    assert told.map_joints is not None
    covariances = spread(problem, found, told.map_poses[0], told.map_joints).covariances[:, :3, :3]
    off = there.part_poses(root, joints)[:, :3] - told.map_poses[:, :3]
    assert np.all(np.einsum("li,lij,lj->l", off, np.linalg.inv(covariances), off) < 16)
    assert np.sqrt(np.trace(covariances, axis1=1, axis2=2)).max() < 0.008
    # and so do the sizes that are told, and are told to be known
    stands, weights = standing(problem, told, found), np.exp(found.log_weights)
    assert stands.problem.nuisances is not None and len(found.modes) == 1
    stds, drawn = stands.nuisance_stds[-3:], found.drawn_sizes
    np.testing.assert_allclose(stds**2, weights @ drawn**2 - (weights @ drawn) ** 2, rtol=1e-6)
    assert np.all(np.abs(stands.problem.nuisances[-3:] - [0.02, -0.02, 0.03]) < 4 * stds) and stds.max() < 0.01


def test_rivals_appear_where_they_were_found_whatever_the_scale_of_depth(rng: np.random.Generator) -> None:
    """Their middles do, in the mean of the views; without a scale they stay."""
    model, (root, joints) = worlds.cupboard(), worlds.cupboard_truth()
    cameras = [worlds.camera_at(eye, root[:3] + [0, 0, 0.2]) for eye in ((0.0, 0.0, 0.7), (0.4, -0.8, 0.8))]
    observation = worlds.seen(model, root, joints, cameras[0])
    second = worlds.seen(model, root, joints, cameras[1])
    both = replace(observation, views=(*observation.views, *second.views), showing=None)
    roots = np.array([poses.multiply(root, at(yaw=turn)) for turn in (0.0, 1.5, 3.0)])
    others = rng.uniform(model.lower, model.upper, (3, model.dof))
    settings = worlds.settings(depth_scale_std=0.02, camera_std=0.0)
    problem = problems.build(model, both, UniformPrior("upright"), settings, particles=20)
    assert problem.nuisances is not None
    values = problem.nuisances.copy()
    np.testing.assert_array_equal(places.scaled(problem, roots, others), roots)
    values[:2] = [0.02, -0.005]
    found = places.scaled(problem.taking(values), roots, others)
    before, after = (
        poses.transform_points(model.part_poses(each, others), problem.mrf.centres).mean(axis=1)
        for each in (roots, found)
    )
    seen = []
    for view in range(2):
        maps = apparent(
            values,
            view,
            2,
            both.views[view].pose_world_scan,
            np.concatenate([after, np.tile(at()[3:], (3, 1))], axis=1)[:, None],
            np.eye(3)[None],
        )
        seen.append(maps[:, 0, 9:])
    np.testing.assert_allclose(np.mean(seen, axis=0), before, atol=1e-12)
    assert np.linalg.norm(found[:, :3] - roots[:, :3], axis=1).min() > 0.005


def test_where_a_further_camera_stands_is_told_in_the_frame_of_its_scan() -> None:
    """Scans of 640 by 480 pixels, whose working images are turned against them. Six numbers within four deviations,
    once in 2,500 not; in the turned frame they are off by a third of themselves."""
    model, (root, joints) = worlds.cupboard(), worlds.cupboard_truth()
    parts, offset = model.part_poses(root, joints), np.array([0.006, -0.008, 0.004, 0.004, -0.003, 0.005])
    first, given = (worlds.camera_at(eye, root[:3] + [0, 0, 0.2], 640, 480) for eye in ((0, 0, 0.7), (0.5, -0.9, 0.8)))
    stands = poses.multiply(given.pose_world_camera, np.append(offset[:3], poses.from_rotation_vector(offset[3:])))
    second = worlds.scan(model, parts, replace(given, pose_world_camera=stands))
    roi = np.array([*(root[:3] - 0.5), *(root[:3] + [0.5, 0.5, 0.8])])
    observation = observe([worlds.scan(model, parts, first), replace(second, camera=given)], roi, up=worlds.UP)
    assert all(view.turn > 0.1 for view in observation.views)
    settings = worlds.settings(camera_std=0.008)
    problem = problems.build(model, observation, UniformPrior("upright"), settings, particles=20, seed=5)
    problem, told = fitted_report(problem, root, joints)
    found = estimate(problem, told, place(problem, told, of_estimate(problem, told)))
    assert [one.name for one in found.nuisances] == [f"camera/1/{axis}" for axis in ("x", "y", "z", "rx", "ry", "rz")]
    for one, true in zip(found.nuisances, offset, strict=True):
        assert abs(one.value - true) < 4 * one.std < 2 * one.prior_std


def test_rivals_are_polished_as_long_as_they_may_be_modes(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    """One is among what is drawn about the estimate, and one looks the same from behind, until more is asked of it."""
    polished: list[tuple[int, int, bool]] = []
    real = places.polish

    def noted(*arguments: Any, draws: bool) -> tuple[Array, Array, Array]:
        polished.append((len(arguments[2]), arguments[-1], draws))
        return real(*arguments, draws=draws)

    monkeypatch.setattr(places, "polish", noted)
    near = poses.multiply(ROOT, at(0.0005))
    of_estimate(problem, report(problem, near))
    assert not polished
    of_estimate(problem, report(problem, near, TURNED))
    whole, registered = (1, 1, True), (1, 1, False)
    assert polished == [whole]  # it rests
    polished.clear()
    aside = poses.multiply(TURNED, at(0.003))
    assert len(of_estimate(problem, report(problem, near, aside)).modes) == 2
    assert polished[:2] == [registered, whole]  # it comes nearer
    # one that does not, one that is far off and comes no nearer, or is too far, and one that would have to be better
    asked = (
        ("LITTLE", -np.inf, [whole] * POLISH_ROUNDS, 2),
        ("SLOW", -1e6, [registered], 2),
        ("FAR", -1e6, [], 2),
        ("NATS", -1e6, [], 1),
    )
    for name, value, rounds, modes in asked:
        polished.clear()
        monkeypatch.setattr(places, name, value)
        assert len(of_estimate(problem, report(problem, near, TURNED)).modes) == modes
        assert polished == rounds


def test_a_spread_is_that_of_the_draws_about_the_estimate(problem: Problem) -> None:
    found = of_estimate(problem, report(problem, TURNED))
    told = spread(problem, found, ROOT, SHUT)
    model, weights = problem.mrf.model, np.exp(found.log_weights)
    drawn = zip(found.drawn_roots, found.drawn_joints, strict=True)
    placed = np.array([model.link_poses(model.part_poses(root, q), q) for root, q in drawn])
    here = model.link_poses(model.part_poses(ROOT, SHUT), SHUT)
    for row in range(len(here)):
        np.testing.assert_allclose(told.covariances[row], covariance(here[row], placed[:, row], weights), atol=1e-12)
    assert told.joint_stds[0] == pytest.approx(np.sqrt(weights @ found.drawn_joints[:, 0] ** 2))
    low, high = told.joint_intervals[:, 0]
    inside = weights[(found.drawn_joints[:, 0] >= low) & (found.drawn_joints[:, 0] <= high)].sum()
    assert 0.88 < inside < 0.97 and low >= 0
    # half of the weight is turned by half about the middle of the root's surface: that moves it by its half width
    assert 0.05 < told.expected_add[0] < 0.4
    assert told.moved[0].max() < 1e-6 or told.moved[1].max() < 1e-6


def test_draws_are_taken_as_often_as_they_weigh(problem: Problem) -> None:
    found = of_estimate(problem, report(problem, TURNED))
    chosen = found.even_draws(1000)
    expected = 1000 * np.exp(found.log_weights)
    assert np.abs(np.bincount(chosen, minlength=len(expected)) - expected).max() <= 1


def test_the_search_has_no_posterior_and_rest_keeps_its_first_one(problem: Problem) -> None:
    assert read_out(problem, replace(report(problem), stage="search")) is None
    first = at_rest(problem, report(problem), None)
    assert isinstance(first, Posterior) and first.iteration == 12
    still = report(problem, root=poses.multiply(ROOT, at(0.0005)), iteration=13)
    assert at_rest(problem, still, first) is first
    gone = report(problem, root=poses.multiply(ROOT, at(0.005)), iteration=14)
    again = at_rest(problem, gone, first)
    assert again is not None and again.iteration == 14


def test_the_same_report_gives_the_same_posterior(problem: Problem) -> None:
    once, again = (of_estimate(problem, report(problem, TURNED)) for _ in range(2))
    for name in ("drawn_roots", "drawn_joints", "log_weights", "mode"):
        np.testing.assert_array_equal(getattr(once, name), getattr(again, name))
    assert [mode.weight for mode in once.modes] == [mode.weight for mode in again.modes]


class Ended(Exception):
    """What a checkpoint raises."""


def ended_after(calls: int) -> Checkpoint:
    """A checkpoint that lets so many calls pass."""
    left = iter(range(calls))

    def checkpoint() -> None:
        if next(left, None) is None:
            raise Ended

    return checkpoint


def test_a_read_out_that_was_ended_anywhere_comes_to_the_same_numbers_anew(problem: Problem) -> None:
    told, passed = report(problem, TURNED), []
    whole = posterior_arrays(of_estimate(problem, told))
    asked = posterior_arrays(of_estimate(problem, told, lambda: passed.append(None)))
    assert len(passed) > 2 * len(whole["posterior.mode_weights"]) > 2  # in every mode, and between them
    for name, values in whole.items():
        np.testing.assert_array_equal(asked[name], values)
    for calls in range(len(passed)):
        with pytest.raises(Ended):
            at_rest(problem, told, None, ended_after(calls))
    anew = at_rest(problem, told, None, ended_after(len(passed)))
    assert anew is not None
    for name, values in posterior_arrays(anew).items():
        np.testing.assert_array_equal(values, whole[name])


def in_a_row(model: ArticulatedObject, joints: Array, *aside: Array) -> tuple[Problem, list[Array], IterationReport]:
    """The same thing where several (7,) have it from the cupboard's place, their poses (7,), and an iteration with the
    first as its estimate and the others as its rivals."""
    root = worlds.cupboard_truth()[0]
    roots = [poses.multiply(root, one) for one in aside]
    camera = worlds.camera_at((0.0, 0.0, 0.7), root[:3] + [0.0, 0.0, 0.2], width=200, height=120)
    scans = [worlds.scan(model, model.part_poses(each, joints), camera) for each in roots]
    scan = replace(scans[0], depth=np.min([one.depth for one in scans], axis=0))
    roi = np.array([*(root[:3] - [0.6, 1.2, 0.2]), *(root[:3] + [0.6, 1.2, 0.8])])
    settings = worlds.settings()
    made = problems.build(model, observe([scan], roi, up=worlds.UP), UniformPrior("upright"), settings, particles=20)
    _, begun = run.begin(made)
    told = replace(
        begun,
        iteration=12,
        stage="belief propagation",
        map_poses=made.mrf.part_poses(roots[0], joints),
        map_joints=joints,
        rivals=np.array([np.append(each, joints) for each in roots[1:]]),
    )
    return made, roots, told


def test_one_of_a_row_is_another_one_like_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of two cupboards the other may be meant, too, though its fit is doubtful: of what stands in a row the scan has
    surfaces that go on in the next."""
    made, roots, told = in_a_row(worlds.cupboard(), worlds.cupboard_truth()[1], at(y=0.5), at(y=-0.1))
    monkeypatch.setattr(places, "assess", lambda seen: replace(assess(seen), verdict="doubtful"))
    found = of_estimate(made, told)
    assert found.fit.verdict == "good" and "as well another one like it" in found.fit.reason
    assert not spread(made, found, roots[0], told.map_joints).certain(found, 0.01).any()


def test_those_whose_fronts_are_flush_are_others_like_it() -> None:
    """Two boxes beside the one that was found, a little behind it and flush: their common front, longer than one of
    them, counts little, so that little is explained of what is confirmed all over."""
    made, roots, told = in_a_row(twin(), np.array([0.08]), at(-0.05, -0.2), at(y=0.202), at(y=0.604))
    row = [confirmation(made, root, told.map_joints) for root in roots[1:]]
    assert [assess(seen).verdict for seen in row] == ["doubtful", "doubtful"]
    found = of_estimate(made, told)
    assert [mode.weight for mode in found.modes] == pytest.approx([1 / 3] * 3)
    assert found.fit.verdict == "good" and "as well 2 others like it" in found.fit.reason


def test_too_few_draws_that_count_or_a_bad_fit_are_nothing_to_build_on(problem: Problem) -> None:
    found = of_estimate(problem, report(problem))
    assert found.effective_sample_size > FEWEST_DRAWS
    told = spread(problem, found, ROOT, SHUT)
    few = replace(found, effective_sample_size=FEWEST_DRAWS / 2)
    doubtful = replace(found, fit=replace(found.fit, verdict="doubtful"))
    for posterior, expected in ((found, set()), (few, {"draws"}), (doubtful, {"fit"})):
        doubts = told.doubts(posterior, 1.0)
        assert {why for why, of in doubts.items() if of.all()} == expected
        assert {why for why, of in doubts.items() if of.any()} == expected
        assert told.certain(posterior, 1.0).all() == (not expected)


def test_an_estimate_that_has_moved_a_little_since_is_not_elsewhere_than_its_own_mode(problem: Problem) -> None:
    """At rest it moves by less than a millimetre, which may be more than the limit that was asked for."""
    found = of_estimate(problem, report(problem))
    moved = poses.multiply(ROOT, at(0.0, 0.0004, 0.0))
    told = spread(problem, found, moved, SHUT)
    limit = max(float(np.sqrt(np.diagonal(told.covariances, axis1=1, axis2=2)[:, :3]).max()), told.expected_add.max())
    assert told.certain(found, limit).all()
    assert not told.certain(found, limit / 3).any()


@pytest.mark.parametrize(("length", "often", "certain"), [(0.3, 2.0, False), (0.3, 0.5, True), (0.08, 2.0, True)])
def test_nobody_is_certain_of_a_slender_link_that_may_be_turned_about_itself(
    length: float, often: float, certain: bool, problem: Problem
) -> None:
    """Its surface hardly moves; of a short one no turn is asked for."""
    bar = block([length, 0.02, 0.02])
    model = articulated([], {"link0": bar})
    alone = problems.build(model, worlds.seen(model, ROOT, np.zeros(0)), UniformPrior("upright"), worlds.settings())
    found, count = of_estimate(problem, report(problem)), 400
    angle = np.where(np.arange(count) % 100 < 100 * OFTEN * often, 1.1, 0.3) * TURN * 0.0025
    roots = poses.multiply(ROOT, poses.from_xyz_rpy(np.zeros((count, 3)), np.outer(angle, [1.0, 0.0, 0.0])))
    found = replace(
        found,
        drawn_roots=roots,
        drawn_joints=np.zeros((count, 0)),
        log_weights=np.full(count, -np.log(count)),
        mode=np.zeros(count, dtype=np.int64),
        modes=(replace(found.modes[0], weight=1.0, root=ROOT, joints=np.zeros(0)),),
    )
    told = spread(alone, found, ROOT, np.zeros(0))
    assert told.expected_add[0] < 0.001 and (length > LONG) == bool(told.turns.any())
    assert told.certain(found, 0.0025)[0] == certain
    # who asks for less is not asked for more
    assert told.certain(found, 0.0125)[0]


def test_a_long_chain_is_told_where_its_draws_have_it() -> None:
    """Joints are loose, but not the parts: the middle of all is a place as good as most draws, its links in place."""
    model = worlds.hinged_chain(12, 0.06)
    root, joints = at(3.0, 0.0, -0.3, 0.3), 0.25 * np.cos(np.arange(model.dof))
    seen = worlds.seen(model, root, joints, worlds.camera_at((0.0, 0.0, 0.3), (3.0, 0.0, 0.1)))
    made = problems.build(model, seen, UniformPrior("any"), worlds.settings(), particles=20, seed=3)
    _, begun = run.begin(made)
    truth = made.mrf.part_poses(root, joints)
    begun = replace(begun, iteration=12, stage="belief propagation", map_poses=truth, map_joints=joints)
    found = of_estimate(made, begun)
    assert made.mrf.depth >= LONG_CHAIN and found.centre is not None
    own = found.mode == 0
    drawn = log_posterior(made, found.drawn_roots[own], found.drawn_joints[own])
    assert log_posterior(made, found.centre.root[None], found.centre.joints[None])[0] > np.median(drawn)
    told = made.mrf.part_poses(found.centre.root, found.centre.joints)
    assert np.linalg.norm(told[:, :3] - truth[:, :3], axis=1).max() < 0.002
    loose = np.sqrt(((found.drawn_joints[own] - joints) ** 2).mean(axis=0))
    assert loose.max() > np.deg2rad(3.0)


def test_a_rival_whose_draws_lead_back_to_a_mode_is_no_other(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is far enough off to be drawn about, and moves to where its draws are better: the estimate's own place."""
    astray = poses.multiply(ROOT, at(0.03, 0.0, 0.0, 0.02))
    seen = confirmation(problem, astray, SHUT)
    monkeypatch.setattr(mixture, "contenders", lambda *_: iter([(astray, SHUT, seen, False)]))
    drawn = []
    monkeypatch.setattr(mixture, "draws_or_better", lambda *given: drawn.append(1) or draws_or_better(*given))
    found = of_estimate(problem, report(problem, astray))
    assert len(drawn) > 2  # about the estimate, the rival, and where that led
    assert len(found.modes) == 1


@pytest.mark.parametrize(("share", "modes"), [(0.6, 1), (0.4, 2)])
def test_a_rival_most_of_whose_draws_are_of_a_mode_is_that_one(
    problem: Problem, monkeypatch: pytest.MonkeyPatch, share: float, modes: int
) -> None:
    """It stood on a ledge beside the estimate's place, and its draws left that."""
    astray = poses.multiply(ROOT, at(0.03, 0.0, 0.0, 0.02))
    seen = confirmation(problem, astray, SHUT)
    monkeypatch.setattr(mixture, "contenders", lambda *_: iter([(astray, SHUT, seen, False)]))

    def drawn(rng: np.random.Generator, problem: Problem, root: Array, *given: Any) -> ModeDraws | Better:
        if np.array_equal(root, ROOT):
            return draws_or_better(rng, problem, root, *given)
        own = draws_or_better(rng, problem, ROOT, *given)
        assert isinstance(own, ModeDraws)
        roots, left = own.roots.copy(), np.cumsum(np.exp(own.log_weights)) > share
        roots[left] = astray
        return replace(own, roots=roots, about=Held(problem.mrf, 0, astray, SHUT))

    monkeypatch.setattr(mixture, "draws_or_better", drawn)
    assert len(of_estimate(problem, report(problem)).modes) == modes


def test_what_is_told_of_a_joint_lies_in_its_interval(problem: Problem) -> None:
    """Also where next to all that is drawn lies elsewhere, as where another mode weighs more."""
    found = of_estimate(problem, report(problem))
    for position in (0.0, 0.25):
        low, high = spread(problem, found, ROOT, np.array([position])).joint_intervals[:, 0]
        assert low <= position <= high
    drawn = np.quantile(found.drawn_joints[:, 0], 0.99)
    assert drawn < 0.2 and high == 0.25


@pytest.mark.parametrize(("deviations", "verdict"), [(4.0, "good"), (12.0, "doubtful")])
def test_a_place_that_a_prior_speaks_against_is_doubtful(deviations: float, verdict: str) -> None:
    """One of them is wrong, and nobody can say which: it was certain with its root turned round by 31 deviations."""
    model, away = twin(), poses.multiply(ROOT, at(0.0, 0.0, 0.0, 0.05 * deviations))
    prior = GaussianPrior("link0", away, np.full(3, 0.05), np.full(3, 0.05), {})
    made = problems.build(model, worlds.seen(model, ROOT, SHUT), prior, worlds.settings(), particles=20, seed=5)
    found = of_estimate(made, report(made))
    assert found.fit.verdict == verdict
    assert ("12 standard deviations from where the prior has it" in found.fit.reason) == (verdict == "doubtful")
    assert spread(made, found, ROOT, SHUT).doubts(found, 0.05)["fit"].all() == (verdict == "doubtful")
