"""Runs from beginning to end: the sample cabinet, one part, many parts, unseen parts, several views; and stopping."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import problem, run
from pmpnbp.inference.arrival import Arrival
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.problem import Problem
from pmpnbp.readout.metrics import add, model_points
from pmpnbp.scene.articulated_object import ArticulatedObject, Joint
from pmpnbp.scene.observation import Observation
from pmpnbp.scene.observe import observe
from pmpnbp.scene.prior import GaussianPrior, UniformPrior, load_prior
from pmpnbp.scene.reach import FARTHEST
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.scene.urdf import load_model
from tests.inference import small_worlds as worlds


def errors_of(model: ArticulatedObject, mle: Array, truth: Array) -> Array:
    """ADD of every visible part, metres; zero for the others."""
    return np.array(
        [
            add(model_points(part.mesh), pose, true) if part.visible else 0.0
            for part, pose, true in zip(model.parts, mle, truth, strict=True)
        ]
    )


def last(made: Problem, iterations: int) -> IterationReport:
    """The last report, after every report was checked to be sound."""
    report = None
    for number, report in enumerate(run.iterate(made, iterations)):
        assert report.iteration == number
        assert np.all(np.isfinite(report.belief.poses)) and np.all(np.isfinite(report.map_poses))
        np.testing.assert_allclose(np.linalg.norm(report.belief.poses[..., 3:], axis=-1), 1.0, atol=1e-6)
        np.testing.assert_allclose(np.exp(report.belief.log_weights).sum(axis=1), 1.0, rtol=1e-6)
        limit = report.belief.log_weights.shape[1] * (1 + 1e-9)
        assert np.all((report.effective_sample_size >= 1 - 1e-9) & (report.effective_sample_size <= limit))
    assert report is not None
    return report


@pytest.fixture(scope="module")
def cabinet(repository: Path) -> tuple[ArticulatedObject, Observation, Array, Array]:
    """The cabinet, its open scene, the true part poses (N, 7), and each part's visible fraction (N,)."""
    folder = repository / "sample_data" / "cabinet"
    model = load_model(folder / "cabinet.urdf")
    scene = folder / "open"
    truth = json.loads((scene / "truth.json").read_text())
    roi = np.array(json.loads((scene / "roi.json").read_text())["roi"])
    observation = observe([load_scan(scene / "depth.png", scene / "camera.json")], roi)
    true_poses = np.stack(
        [poses.from_matrix(np.array(truth["links"][part.links[0]]).reshape(4, 4)) for part in model.parts]
    )
    visible = np.array([max(truth["visible_fraction"].get(link, 0.0) for link in part.links) for part in model.parts])
    return model, observation, true_poses, visible


Cabinet = tuple[ArticulatedObject, Observation, Array, Array]


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_sample_cabinet_from_no_prior(cabinet: Cabinet, seed: int) -> None:
    model, observation, truth, visible = cabinet
    made = problem.build(model, observation, UniformPrior("upright"), worlds.settings(), seed=seed)
    error = errors_of(model, last(made, 24).map_poses, truth)
    assert np.all(error[visible >= 0.1] < 0.01)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_sample_cabinet_from_a_rough_prior(cabinet: Cabinet, seed: int) -> None:
    model, observation, truth, visible = cabinet
    prior = worlds.rough_prior(np.random.default_rng(seed), truth[0], model.parts[0].links[0])
    made = problem.build(model, observation, prior, worlds.settings(), seed=seed)
    error = errors_of(model, last(made, 20).map_poses, truth)
    assert np.all(error[visible >= 0.1] < 0.01)


def test_the_preset_paper_runs_on_the_cabinet_and_stays_finite(cabinet: Cabinet, repository: Path) -> None:
    model, observation, _, _ = cabinet
    prior = load_prior(repository / "sample_data" / "cabinet" / "prior.json", model)
    made = problem.build(model, observation, prior, worlds.settings("paper"), particles=100)
    report = last(made, 15)
    # box 2 pools the sets of all incoming messages: the frame hears from three drawers
    assert report.belief.poses.shape == (4, 300, 7)
    assert np.all(report.inverse_temperature == 1.0)
    assert report.map_joints is None  # its parts need not agree with a tree


MODEL = worlds.cupboard()
ROOT, JOINTS = worlds.cupboard_truth()


def quick(
    model: ArticulatedObject, observation: Observation, root: Array, *, particles: int = 100, **changes: object
) -> Problem:
    prior = worlds.rough_prior(np.random.default_rng(5), root, model.parts[0].links[0])
    chosen = worlds.settings(**({"search_proposals": 600} | changes))
    return problem.build(model, observation, prior, chosen, particles=particles)


def test_an_object_of_one_part() -> None:
    brick = worlds.articulated([], {"link0": worlds.block([0.3, 0.2, 0.12])})
    root = worlds.at(1.0, 0.1, 0.3, yaw=0.5)
    observation = worlds.seen(brick, root, np.zeros(0))
    report = last(quick(brick, observation, root), 24)
    assert report.map_joints is not None and report.map_joints.shape == (0,)
    assert report.messages is not None and report.messages.poses.shape[0] == 0
    assert errors_of(brick, report.map_poses, root[None])[0] < 0.01


def test_an_object_of_one_part_by_the_paper() -> None:
    brick = worlds.articulated([], {"link0": worlds.block([0.3, 0.2, 0.12])})
    root = worlds.at(1.0, 0.1, 0.3, yaw=0.5)
    prior = worlds.rough_prior(np.random.default_rng(5), root)
    observation = worlds.seen(brick, root, np.zeros(0))
    made = problem.build(brick, observation, prior, worlds.settings("paper"), particles=50)
    assert last(made, 5).belief.poses.shape == (1, 50, 7)


def test_a_chain_of_24_parts_runs() -> None:
    snake = worlds.hinged_chain(24, length=0.05)
    root, joints = worlds.at(1.6, 0.0, 0.2), np.tile([0.15, -0.1], 12)[:23]
    observation = worlds.seen(snake, root, joints)
    short = {"search_iterations_per_joint": 0, "search_proposals": 30, "search_islands": 1, "search_restarts": 0}
    short |= {"search_iterations": 2, "anneal_iterations": 2}
    report = last(quick(snake, observation, root, **short), 6)
    assert report.map_poses.shape == (24, 7)
    assert report.map_joints is not None and report.map_joints.shape == (23,)
    assert report.messages is not None and report.messages.poses.shape[0] == 46


def test_a_part_without_geometry_is_carried_by_its_neighbours() -> None:
    """A hub that is not seen, with two arms that are: where the hub is follows from them."""
    joints = [
        Joint("turn", "revolute", "link0", "hub", worlds.at(0.2), worlds.Z, -0.8, 0.8, (0,)),
        Joint("upper", "revolute", "hub", "link1", worlds.at(0.1, 0.0, 0.1), worlds.Y, -0.8, 0.8, (1,)),
        Joint("lower", "revolute", "hub", "link2", worlds.at(0.1, 0.0, -0.1), worlds.Y, -0.8, 0.8, (2,)),
    ]
    shapes = {
        "link0": worlds.block([0.2, 0.25, 0.3]),
        "link1": worlds.block([0.25, 0.12, 0.05], worlds.at(0.15)),
        "link2": worlds.block([0.25, 0.12, 0.05], worlds.at(0.15)),
    }
    model = worlds.articulated(joints, shapes)
    assert [part.visible for part in model.parts] == [True, False, True, True]
    root, at = worlds.at(1.4, 0.0, 0.4, yaw=-2.0), np.array([0.3, -0.5, 0.2])
    report = last(quick(model, worlds.seen(model, root, at), root, particles=200), 24)
    truth = model.part_poses(root, at)
    assert np.all(errors_of(model, report.map_poses, truth) < 0.01)
    assert np.linalg.norm(report.map_poses[1, :3] - truth[1, :3]) < 0.02


def test_two_views_see_what_one_does_not() -> None:
    """A drawer on the far side: hidden from the one camera, found with a second one behind. Of a guess both hidden
    parts are within 2 cm about one time in twenty, of four guesses all in 1 of 100,000."""
    root, joints = worlds.at(1.4, 0.1, 0.0, yaw=0.2), np.array([0.2, 0.6])
    truth = MODEL.part_poses(root, joints)
    front = worlds.seen(MODEL, root, joints)
    assert front.roi is not None
    behind = worlds.camera_at((2.9, 0.6, 0.7), (1.5, 0.1, 0.2))
    scans = [worlds.scan(MODEL, truth, view.camera) for view in (worlds.seen(MODEL, root, joints).views[0],)]
    scans.append(worlds.scan(MODEL, truth, behind))
    both = observe(scans, front.roi, up=worlds.UP)
    assert len(both.views) == 2

    def worst(seen: Observation, seed: int) -> float:
        made = replace(quick(MODEL, seen, root, particles=150), seed=seed)
        return float(errors_of(MODEL, last(made, 24).map_poses, truth).max())

    assert max(worst(front, seed) for seed in range(4)) > 0.02
    assert max(worst(both, seed) for seed in range(2)) < 0.01


def test_the_score_of_two_views_is_the_sum_of_theirs() -> None:
    truth = MODEL.part_poses(ROOT, JOINTS)
    cameras = [worlds.camera_at(eye, (1.4, 0.1, 0.2)) for eye in ((0.0, 0.0, 0.7), (0.3, 0.9, 0.6))]
    scans = [worlds.scan(MODEL, truth, camera) for camera in cameras]
    roi = np.array([0.9, -0.5, -0.1, 1.9, 0.7, 0.6])
    made = [
        problem.build(MODEL, observe(some, roi, up=worlds.UP), UniformPrior(), worlds.settings())
        for some in (scans[:1], scans[1:], scans)
    ]
    near = poses.perturb(truth, np.array([0.01, 0.0, 0.01]), np.array([0.0, 0.02, 0.0]))
    # a pixel counts 1 at the median distance of what is seen, which is another for each of these
    made = [replace(each, unit_distance=1.5) for each in made]
    one, other, both = (each.unary(np.arange(3, dtype=np.int32), near, 0.03, "rasteriser") for each in made)
    np.testing.assert_allclose(both, one + other, atol=1e-9)
    assert np.all(one != 0)


def test_parts_outside_the_picture_do_no_harm() -> None:
    """Only the foot of the cupboard is in the picture: nothing is said of the rest, and the run goes through."""
    camera = worlds.camera_at((0.4, 0.0, 0.3), (1.2, 0.1, -0.35))
    observation = worlds.seen(MODEL, ROOT, JOINTS, camera)
    report = last(quick(MODEL, observation, ROOT), 12)
    truth = MODEL.part_poses(ROOT, JOINTS)
    assert errors_of(MODEL, report.map_poses, truth)[0] < 0.2


@pytest.mark.parametrize("method", ["pmpnbp", "particle_filter"])
def test_what_is_as_far_away_as_may_be_harms_nothing(method: str) -> None:
    """A camera, a prior's mean and its deviations, and parts with their surfaces far from their frames."""
    slide = Joint(
        "slide", "prismatic", "link0", "link1", worlds.at(0, 0, FARTHEST / 4), worlds.X, 0, FARTHEST / 4, (0,)
    )
    surface = worlds.block([0.3, 0.4, 0.4], worlds.at(FARTHEST / 2))
    model = worlds.articulated([slide], {"link0": surface, "link1": surface})
    root = worlds.at(FARTHEST / 2, 0.0, 0.1)
    corner = root[:3] + [FARTHEST / 2, 0.0, 0.0]
    observation = worlds.seen(model, root, np.zeros(1), worlds.camera_at(corner + [-1.5, 0.0, 0.5], corner), margin=0.3)
    turned = poses.from_xyz_rpy([-FARTHEST, FARTHEST, -FARTHEST], [1.0, 2.0, 3.0])
    prior = GaussianPrior("link1", turned, np.full(3, FARTHEST), np.full(3, FARTHEST))
    settings = worlds.settings(search_iterations=2, moved_std_xyz=FARTHEST)
    last(problem.build(model, observation, prior, settings, particles=20, method=method), 4)
    # a prior is not widened beyond what one may say
    made = problem.build(model, observation, prior, settings, arrival=Arrival(after_iteration=4, first=0, moves=50))
    assert isinstance(made.prior, GaussianPrior) and made.prior.std_xyz.max() == FARTHEST


@pytest.fixture(scope="module")
def made() -> Problem:
    return quick(MODEL, worlds.seen(MODEL, ROOT, JOINTS), ROOT)


def test_converged_means_that_the_schedule_is_over_and_nothing_moved(made: Problem) -> None:
    settings = made.settings
    over = made.annealed + settings.refine_iterations
    needed = settings.converged_iterations
    report = last(made, 1)

    def at(iteration: int, shift: float = 0.0, turn: float = 0.0) -> IterationReport:
        moved = poses.perturb(report.map_poses, np.array([shift, 0, 0]), np.array([0, 0, turn]), made.mrf.centres)
        return replace(report, iteration=iteration, map_poses=moved)

    def history(end: int, *shifts: float) -> list[IterationReport]:
        return [at(end - len(shifts) + 1 + k, shift) for k, shift in enumerate(shifts)]

    rest = [0.0] * (needed + 1)
    assert run.converged(history(over + needed, *rest), made)
    assert not run.converged(history(over + needed - 1, *rest), made)  # one of the steps was still in the schedule
    assert not run.converged(history(over + needed, *rest[1:]), made)  # too few to tell
    step = settings.converged_motion
    assert run.converged(history(over + 9, *[0.9 * step * k for k in range(needed + 1)]), made)
    assert not run.converged(history(over + 9, *rest[:-1], 1.1 * step), made)
    assert not run.converged(history(over + 9, 1.1 * step, *rest[1:]), made)
    # what moved before does not count
    assert run.converged(history(over + 9, 1.0, *rest), made)
    # a turn moves the rim, by the radius times the angle
    largest = made.mrf.radii.max()
    turned = [at(over + 9 - needed + k) for k in range(needed)]
    assert run.converged([*turned, at(over + 9, turn=0.9 * step / largest)], made)
    assert not run.converged([*turned, at(over + 9, turn=1.1 * step / largest)], made)


def test_a_run_stops_once_converged_and_not_before(made: Problem) -> None:
    reports = list(run.iterate(made, 60))
    needed = made.settings.converged_iterations
    assert reports[-1].iteration < 60
    assert run.converged(reports, made)
    assert not run.converged(reports[:-1], made)
    moved = [run.motion(made, a.map_poses, b.map_poses) for a, b in pairwise(reports)]
    assert max(moved[-needed:]) <= made.settings.converged_motion
    assert [report.stage for report in reports[:2]] == ["start", "search"]


def test_a_run_goes_no_further_than_it_is_told(made: Problem) -> None:
    restless = replace(made, settings=replace(made.settings, converged_motion=0.0))
    assert [report.iteration for report in run.iterate(restless, 3)] == [0, 1, 2, 3]
    assert [report.iteration for report in run.iterate(made, 0)] == [0]


def test_the_whole_run_is_determined_by_its_seed(made: Problem) -> None:
    small = replace(made, settings=replace(made.settings, search_proposals=200))
    runs = [list(run.iterate(replace(small, seed=seed), 8)) for seed in (3, 3, 4)]
    for first, second in zip(runs[0], runs[1], strict=True):
        assert first.belief.poses.tobytes() == second.belief.poses.tobytes()
        assert first.belief.log_weights.tobytes() == second.belief.log_weights.tobytes()
        assert first.map_poses.tobytes() == second.map_poses.tobytes()
    assert runs[0][-1].map_poses.tobytes() != runs[2][-1].map_poses.tobytes()
