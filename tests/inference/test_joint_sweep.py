"""The sweep of single joints: a joint in a wrong place is found again, and nothing is lost by looking."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import joint_sweep
from pmpnbp.inference import problem as problems
from pmpnbp.inference.joint_sweep import (
    ANEW,
    FIRST,
    PLACES,
    elsewhere,
    sweep,
    with_those_before_anew,
    with_those_behind_anew,
)
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.tree_estimate import configuration_scores, polish, profile_scores
from pmpnbp.scene.articulated_object import ArticulatedObject, Joint
from pmpnbp.scene.prior import UniformPrior
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.scene.urdf import load_model
from pmpnbp.settings import Schedule, schedule
from tests.inference import small_worlds as worlds

TOLERANCE = 0.024


@pytest.fixture(scope="module")
def chain() -> tuple[Problem, np.ndarray, np.ndarray]:
    """A hinged chain of four, seen folded, and its true configuration."""
    model = worlds.hinged_chain(4)
    root, joints = worlds.at(1.3, z=0.4), np.array([0.6, -0.9, 0.7])
    observation = worlds.seen(model, root, joints)
    built = problems.build(model, observation, UniformPrior("upright"), worlds.settings(), particles=40)
    return built, root, joints


def search_end(problem: Problem) -> Schedule:
    return schedule(problem.settings, problem.search_iterations, problem.search_iterations)


@pytest.mark.parametrize("joint", [0, 1, 2])
def test_a_joint_in_a_wrong_place_is_found(chain: tuple[Problem, np.ndarray, np.ndarray], joint: int) -> None:
    """Where small moves alone do not find it."""
    problem, root, truth = chain
    plan = search_end(problem)
    wrong = truth.copy()
    wrong[joint] = -truth[joint]
    local = polish(np.random.default_rng(0), problem, root[None], wrong[None], plan, TOLERANCE, 10)
    _, found, score = sweep(np.random.default_rng(0), problem, root, wrong, plan, 3)
    np.testing.assert_allclose(found, truth, atol=0.15)  # its wrong place is 1.2 away and more
    assert score > profile_scores(problem, *local[:2])[0]


def test_the_truth_stays(chain: tuple[Problem, np.ndarray, np.ndarray]) -> None:
    problem, root, truth = chain
    before = profile_scores(problem, root[None], truth[None])[0]
    _, found, score = sweep(np.random.default_rng(0), problem, root, truth, search_end(problem), 3)
    assert score >= before
    np.testing.assert_allclose(found, truth, atol=0.15)  # its wrong place is 1.2 away and more


def test_joints_behind_a_moved_one_are_put_anew(chain: tuple[Problem, np.ndarray, np.ndarray]) -> None:
    """Two in a row that are wrong are nearer to their place than any one moved alone."""
    problem, root, truth = chain
    plan, wrong = search_end(problem), np.array([truth[0], 1.1, -1.1])
    found, score = with_those_behind_anew(np.random.default_rng(0), problem, root, wrong, plan)
    assert len(found) == ANEW and np.all(np.diff(score) <= 0)
    again = configuration_scores(problem, np.tile(root, (ANEW, 1)), found, plan.tolerance)
    np.testing.assert_allclose(score, again)
    model = problem.mrf.model
    assert np.all((found >= model.lower) & (found <= model.upper))
    # the last joint has none behind it, and one before the moved one stays
    assert np.all(np.any(found[:, :2] != wrong[:2], axis=1))
    _, alone = elsewhere(np.random.default_rng(0), problem, root[None], wrong[None], plan)
    assert score[0] > alone.max() + 0.1 * abs(alone.max())


def test_what_hangs_elsewhere_stays(rng: np.random.Generator) -> None:
    """Of two arms on one block one moves, from its first joint or its second on."""
    bars, block = worlds.hinged_chain(5), worlds.block([0.06, 0.05, 0.2], worlds.at(z=0.1))
    joints = list(bars.joints)
    joints[2] = replace(joints[2], parent="link0", pose_parent_joint=worlds.at(0.25, z=0.1))
    model = worlds.articulated(joints, {f"link{k}": block for k in range(5)})
    root, truth = worlds.at(1.3, z=0.4), np.full(model.dof, 0.3)
    problem = problems.build(
        model, worlds.seen(model, root, truth), UniformPrior("upright"), worlds.settings(), particles=40
    )
    found, _ = with_those_behind_anew(rng, problem, root, truth, search_end(problem))
    assert len(found) == ANEW
    moved = found != truth
    assert np.all(moved[:, :2].any(axis=1) ^ moved[:, 2:].any(axis=1))
    assert np.all(moved[:, [0, 2]].any(axis=1))


def before_its_pole(links: int) -> ArticulatedObject:
    """A screen, the last of some links in a row that swing about z, which hides all before it but a pole's tip."""
    up, turns = np.array([0.0, 0.0, 1.0]), 0.9
    joints = [
        Joint(f"swing{k}", "revolute", f"link{k}", f"link{k + 1}", worlds.at(0.15 * (k > 0)), up, -turns, turns, (k,))
        for k in range(links - 1)
    ]
    arms = {f"link{k}": worlds.block([0.15, 0.03, 0.03], worlds.at(0.075)) for k in range(1, links - 1)}
    pole, screen = worlds.block([0.06, 0.06, 0.9]), worlds.block([0.02, 0.6, 0.74], worlds.at(0.02))
    return worlds.articulated(joints, {"link0": pole, **arms, f"link{links - 1}": screen})


def from_the_front(links: int, joints: np.ndarray) -> tuple[Problem, np.ndarray]:
    """The screen as it is seen, and where its root is."""
    model, root = before_its_pole(links), worlds.at(1.6, 0.1, 0.1, yaw=np.pi)
    camera = worlds.camera_at((0.0, 0.0, 0.1), root[:3])
    seen = worlds.seen(model, root, joints, camera)
    return problems.build(model, seen, UniformPrior("upright"), worlds.settings(), particles=40), root


def test_joints_before_the_best_seen_part_are_put_anew(rng: np.random.Generator) -> None:
    """Of five the first FIRST, while all from there on stays."""
    truth = np.array([0.3, -0.5, 0.4, 0.1, -0.3])
    problem, root = from_the_front(6, truth)
    roots, found, score = with_those_before_anew(rng, problem, root, truth, search_end(problem))
    assert len(found) == ANEW and np.all(np.diff(score) <= 0)
    np.testing.assert_allclose(score, configuration_scores(problem, roots, found, search_end(problem).tolerance))
    model = problem.mrf.model
    assert np.all((found >= model.lower) & (found <= model.upper))
    assert np.all(found[:, :FIRST] != truth[:FIRST])
    np.testing.assert_array_equal(found[:, FIRST:], np.tile(truth[FIRST:], (ANEW, 1)))
    stays = model.part_poses(roots, found)[:, FIRST:]
    np.testing.assert_allclose(stays, np.tile(model.part_poses(root, truth)[FIRST:], (ANEW, 1, 1)), atol=1e-9)


def test_none_is_put_anew_before_a_root_that_is_seen(chain: tuple[Problem, np.ndarray, np.ndarray]) -> None:
    problem, root, truth = chain
    roots, found, score = with_those_before_anew(np.random.default_rng(0), problem, root, truth, search_end(problem))
    assert roots.shape == (0, 7) and found.shape == (0, 3) and score.shape == (0,)
    lone, root = from_the_front(2, np.array([0.3]))
    assert not len(with_those_before_anew(np.random.default_rng(0), lone, root, np.array([0.3]), search_end(lone))[0])


def test_a_pole_behind_a_screen_is_found_by_its_tip(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no joint that moves alone leads to it."""
    truth = np.array([0.2, -0.7])
    problem, root = from_the_front(3, truth)
    wrong, plan = np.array([-0.4, 0.6]), search_end(problem)
    screen = problem.mrf.part_poses(root, truth)[2]
    there = poses.multiply(screen, poses.inverse(problem.mrf.part_poses(poses.IDENTITY, wrong)[2]))
    assert np.linalg.norm(there[:3] - root[:3]) > 0.15

    def off() -> float:
        """Metres that the pole is off then, the most of six runs."""
        found = [sweep(np.random.default_rng(seed), problem, there, wrong, plan, 3)[0] for seed in range(6)]
        return float(np.linalg.norm(np.array(found)[:, :3] - root[:3], axis=1).max())

    assert off() < 0.02
    monkeypatch.setattr(joint_sweep, "FIRST", 0)
    assert off() > 0.05


def test_two_places_that_the_search_takes_for_one_are_told_apart() -> None:
    """The sample's lowest drawer, of which the region leaves out all that is seen, is in a place 7 cm before its own
    one."""
    scene = Path(__file__).parents[2] / "sample_data" / "cabinet" / "open"
    model = load_model(scene.parent / "cabinet.urdf")
    truth = json.loads((scene / "truth.json").read_text())
    region = np.array([-0.0822, -0.1926, 0.4, 0.8932, 0.7035, 0.85])
    settings = worlds.settings()
    observation = problems.look(model, [load_scan(scene / "depth.png", scene / "camera.json")], region, settings)
    problem = problems.build(model, observation, UniformPrior("upright"), settings, particles=40)
    root = poses.from_matrix(np.array(truth["links"]["frame"]))
    right = np.array([truth["joints"][name] for name in ("slide1", "slide2", "slide3")])
    wrong = right + np.array([0.0, 0.0, 0.071])
    plan = search_end(problem)
    local = polish(np.random.default_rng(0), problem, root[None], wrong[None], plan, problem.tolerance_end, 10)
    assert local[1][0, 2] > right[2] + 0.05  # where small moves alone leave it
    _, found, score = sweep(np.random.default_rng(0), problem, local[0][0], local[1][0], plan, 3)
    np.testing.assert_allclose(found, right, atol=0.004)
    assert score > profile_scores(problem, *local[:2])[0]


def test_a_step_that_finds_no_better_place_is_the_last(
    chain: tuple[Problem, np.ndarray, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Even where every other place is polished before it is dropped."""
    problem, root, truth = chain
    steps = []

    def counted(*arguments: object) -> object:
        steps.append(arguments)
        return every(*arguments)

    every = joint_sweep._elsewhere_at_either_tolerance
    monkeypatch.setattr(joint_sweep, "_elsewhere_at_either_tolerance", counted)
    monkeypatch.setattr(joint_sweep, "LOSS_BEFORE", 100.0)
    monkeypatch.setattr(joint_sweep, "LOSS_AFTER", 100.0)
    sweep(np.random.default_rng(0), problem, root, truth, search_end(problem), 3)
    assert len(steps) == 1


def test_no_joint_may_move_when_none_is_asked_for(chain: tuple[Problem, np.ndarray, np.ndarray]) -> None:
    problem, root, truth = chain
    same, joints, score = sweep(np.random.default_rng(0), problem, root, truth, search_end(problem), 0)
    np.testing.assert_array_equal(same, root)
    np.testing.assert_array_equal(joints, truth)
    assert score == profile_scores(problem, root[None], truth[None])[0]


def test_elsewhere_is_not_here_and_worth_what_it_says(chain: tuple[Problem, np.ndarray, np.ndarray]) -> None:
    """For several configurations at once, the best places of each joint in turn."""
    problem, root, truth = chain
    model, plan = problem.mrf.model, search_end(problem)
    here = np.stack([truth, -truth, 0.5 * truth])
    roots = np.tile(root, (3, 1))
    found, score = elsewhere(np.random.default_rng(0), problem, roots, here, plan)
    # no joint here has room for half a turn
    assert found.shape == (3, 3 * PLACES + 1, 3) and np.all(score[:, 3 * PLACES] == -np.inf)
    for joint in range(3):
        places = slice(joint * PLACES, (joint + 1) * PLACES)
        some = np.isfinite(score[:, places])
        moved = np.abs(found[:, places, joint] - here[:, None, joint])
        assert some.any() and np.all(moved[some] > 0.01 * (model.upper[joint] - model.lower[joint]))
        for place in range(places.start, places.stop):
            expected = configuration_scores(problem, roots, found[:, place], plan.tolerance)
            one = np.isfinite(score[:, place])
            np.testing.assert_allclose(score[one, place], expected[one])
        assert np.all(score[:, places.start] >= score[:, places.stop - 1])


def test_a_part_that_nothing_hangs_on_is_moved_once(
    chain: tuple[Problem, np.ndarray, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """And comes to the same places as where both ways are looked at."""
    problem, root, truth = chain
    plan, rows = search_end(problem), []

    def counted(problem: Problem, roots: Array, joints: Array, tolerance: float) -> Array:
        rows.append(len(roots))
        return configuration_scores(problem, roots, joints, tolerance)

    monkeypatch.setattr(joint_sweep, "configuration_scores", counted)
    once = elsewhere(np.random.default_rng(0), problem, root[None], truth[None], plan)
    of_joints, rows = rows[1:4], []
    monkeypatch.setattr(joint_sweep, "_moved_behind", lambda mrf: np.ones((mrf.nodes, mrf.model.dof), dtype=bool))
    twice = elsewhere(np.random.default_rng(0), problem, root[None], truth[None], plan)
    assert rows[1:3] == of_joints[:2] and rows[3] == 2 * of_joints[2] > 0
    for one, both in zip(once, twice, strict=True):
        np.testing.assert_allclose(one, both, atol=1e-6, rtol=1e-6)


def slow_basin(score: list[float], start: int, value: float, most: float, wraps: bool) -> set[int]:
    """One step after another, each way, until one leads up by more than `most` from the lowest so far."""
    inside = set()
    for way in (1, -1):
        place, lowest = start if way == 1 else start - 1, value
        for _ in range(len(score)):
            if not wraps and not 0 <= place < len(score):
                break
            there = score[place % len(score)]
            lowest = min(lowest, there)
            if there > lowest + most:
                break
            inside.add(place % len(score))
            place += way
    return inside


@pytest.mark.parametrize("wraps", [False, True])
def test_a_place_ends_where_a_rise_begins(rng: np.random.Generator, wraps: bool) -> None:
    score = rng.normal(size=(200, 9)).round(1)
    start, value, most = rng.integers(0, 10, 200), rng.normal(size=200), rng.uniform(0, 1.5, 200)
    found = joint_sweep._basin(score, start, value, most, wraps)
    for row in range(200):
        expected = slow_basin(list(score[row]), int(start[row]), value[row], most[row], wraps)
        assert set(np.flatnonzero(found[row])) == expected


def test_a_place_that_is_wide_does_not_hide_the_second_best(
    chain: tuple[Problem, np.ndarray, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A joint that may be anywhere in most of its range, and in a narrow place that is nearly as good."""
    problem, root, truth = chain
    model, plan = problem.mrf.model, search_end(problem)
    lower, span = model.lower[0], model.upper[0] - model.lower[0]

    def scores(problem: Problem, roots: np.ndarray, joints: np.ndarray, tolerance: float) -> np.ndarray:
        share = (joints[:, 0] - lower) / span
        return np.where(share > 0.4, 100.0 + share, np.where(abs(share - 0.12) < 0.06, 95.0, 0.0))

    monkeypatch.setattr(joint_sweep, "configuration_scores", scores)
    here = truth.copy()
    here[0] = lower + 0.7 * span
    found, score = elsewhere(np.random.default_rng(0), problem, root[None], here[None], plan)
    assert score[0, 0] == 95.0 and abs((found[0, 0, 0] - lower) / span - 0.12) < 0.06
    found, score = elsewhere(np.random.default_rng(0), problem, root[None], here[None], plan, anywhere=True)
    assert score[0, 0] > 100.0 and score[0, 1] == 95.0


def test_elsewhere_of_nothing_is_nothing(chain: tuple[Problem, np.ndarray, np.ndarray]) -> None:
    problem, _, _ = chain
    found, score = elsewhere(np.random.default_rng(0), problem, np.zeros((0, 7)), np.zeros((0, 3)), search_end(problem))
    assert found.shape == (0, 3 * PLACES + 1, 3) and score.shape == found.shape[:2]
