"""A scan arrives: the belief carries on, follows what moved, or begins again, and says which."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import problem, run, tracking
from pmpnbp.inference.arrival import Arrival
from pmpnbp.inference.confirmation import by_last_views, confirmation
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.run import Step
from pmpnbp.readout.mixture import read_out
from pmpnbp.scene.observe import observe
from pmpnbp.scene.prior import UniformPrior
from tests.inference import small_worlds as worlds
from tests.inference.test_run import errors_of
from tests.sameness import assert_same

MODEL = worlds.cupboard()
ROOT, JOINTS = worlds.cupboard_truth()
# Wide enough for all places that the cupboard is moved to.
ROI = np.array([0.7, -1.0, -0.1, 2.3, 1.2, 0.6])
BEFORE = worlds.camera_at((0.0, 0.0, 0.7), (1.4, 0.1, 0.2))
ASIDE = worlds.camera_at((0.3, 0.9, 0.9), (1.4, 0.1, 0.2))
AWAY = worlds.camera_at((0.0, 0.0, 0.7), (-1.0, 0.0, 0.7))
PULLED = np.array([0.03, 0.6])
PUSHED = poses.perturb(ROOT, np.array([0.03, -0.04, 0.0]), np.array([0.0, 0.0, 0.17]))
FAR = worlds.at(1.75, 0.45, 0.0, yaw=np.pi + 0.2)
Scene = tuple[Array, Array, Camera]


def seeing(*scenes: Scene, arrival: Arrival | None = None, method: str = "pmpnbp", **changes: object) -> Problem:
    """The problem of scans of the cupboard at these root poses and joints, by these cameras."""
    scans = [worlds.scan(MODEL, MODEL.part_poses(root, joints), camera) for root, joints, camera in scenes]
    settings = worlds.settings(search_proposals=1500, **changes)
    return problem.build(
        MODEL,
        observe(scans, ROI, up=worlds.UP),
        UniformPrior("upright"),
        settings,
        particles=100,
        method=method,
        arrival=arrival,
    )


FIRST: Scene = (ROOT, JOINTS, BEFORE)


@pytest.fixture(scope="module", params=["pmpnbp", "particle_filter"])
def found(request: pytest.FixtureRequest) -> tuple[str, Step]:
    """A method, and its inference at rest."""
    *_, last = run.steps(seeing(FIRST, method=request.param), 40)
    assert last.converged
    return request.param, last


def gone_on(before: Step, made: Problem, most: int = 40) -> list[Step]:
    """The steps from `before` on, until rest."""
    steps = [run.resumed(before.state, [before.report], made)]
    while len(steps) == 1 or (not steps[-1].converged and len(steps) < most):
        steps.append(run.following(steps[-1], made))
    return steps[1:]


def error(step: Step, root: Array, joints: Array) -> float:
    return float(errors_of(MODEL, step.report.map_poses, MODEL.part_poses(root, joints)).max())


@pytest.mark.parametrize(("root", "joints"), [(ROOT, PULLED), (PUSHED, JOINTS)], ids=["pulled", "pushed"])
def test_what_moved_a_little_is_followed(found: tuple[str, Step], root: Array, joints: Array) -> None:
    method, before = found
    assert error(before, root, joints) > 0.02
    scene = (root, joints, BEFORE)
    steps = gone_on(before, seeing(scene, arrival=Arrival(before.iteration, 0, 1), method=method))
    assert steps[0].report.stage == "tracking"
    assert "search" not in [step.report.stage for step in steps]
    assert steps[-1].converged and error(steps[-1], root, joints) < 0.005
    (note,) = steps[0].report.notes
    assert note.startswith("the scene has changed; near where it was ") and note.endswith("is confirmed")
    assert [step.report.notes for step in steps[1:]] == [()] * (len(steps) - 1)
    # a new session would search first
    assert len(steps) < before.iteration


def test_what_moved_far_is_searched_for(found: tuple[str, Step]) -> None:
    method, before = found
    made = seeing((FAR, JOINTS, BEFORE), arrival=Arrival(before.iteration, 0, 1), method=method)
    steps = gone_on(before, made)
    searched = made.search_iterations
    assert [step.report.stage for step in steps[: searched + 1]] == [*["search"] * searched, steps[-1].report.stage]
    assert steps[0].report.notes[0].startswith("the scene has changed, and the new scan contradicts the belief: ")
    assert steps[0].report.notes[0].endswith("the search begins again")
    assert {step.state.search_after for step in steps} == {before.iteration}
    # as in a first search nobody is sure of anything, and tolerances shrink again
    assert [read_out(made, step.report) for step in steps[:searched]] == [None] * searched
    fresh = [made.schedule(number).tolerance for number in range(1, len(steps) + 1)]
    assert [step.report.tolerance for step in steps] == fresh
    assert steps[-1].converged and error(steps[-1], FAR, JOINTS) < 0.005
    assert not any(step.converged for step in steps[: searched + made.settings.anneal_iterations])


def test_a_view_that_agrees_changes_nothing_else(found: tuple[str, Step]) -> None:
    """Bit for bit what a problem gives that asks no view anything."""
    method, before = found
    scenes = FIRST, (ROOT, JOINTS, ASIDE)
    asked = run.advance(before.state, seeing(*scenes, arrival=Arrival(before.iteration, 1), method=method))
    plain = run.advance(before.state, seeing(*scenes, method=method))
    assert_same(asked[0], plain[0])
    assert_same(asked[1], plain[1], without=("seconds",))


def test_a_view_of_the_object_elsewhere_begins_the_search_again(found: tuple[str, Step]) -> None:
    method, before = found
    made = seeing(FIRST, (FAR, JOINTS, ASIDE), arrival=Arrival(before.iteration, 1), method=method)
    state, report = run.advance(before.state, made)
    assert report.stage == "search" and state.search_after == report.search_after == before.iteration
    assert report.notes[0].startswith("view 1 contradicts the belief: ")
    # the places near the estimate are still in the race
    assert state.belief.origin.ancestor.max() >= 0
    again = run.advance(before.state, made)
    assert_same(again[0], state)
    off = replace(made, settings=replace(made.settings, view_explained=0.0))
    assert run.advance(before.state, off)[1].stage != "search"


def test_a_view_that_the_object_is_not_in_says_nothing(found: tuple[str, Step]) -> None:
    method, before = found
    made = seeing(FIRST, (ROOT, JOINTS, AWAY), arrival=Arrival(before.iteration, 1), method=method)
    # but that it says nothing
    assert run.advance(before.state, made)[1].notes == ("view 1 shows nothing of the region of interest",)


def test_what_a_view_shows_of_a_hidden_part_is_no_contradiction(found: tuple[str, Step]) -> None:
    """The estimate has the drawer in the wrong place, as one does that it could not see: only that joint is wrong."""
    method, before = found
    assert before.state.joints is not None
    wrong = replace(before.state, joints=np.array([0.01, before.state.joints[1]]))
    made = seeing(FIRST, (ROOT, JOINTS, ASIDE), arrival=Arrival(before.iteration, 1), method=method)
    assert wrong.root is not None and wrong.joints is not None
    assert confirmation(by_last_views(made, 1), wrong.root, wrong.joints).missed == ("link1",)
    state, report = run.advance(wrong, made)
    assert report.stage == "tracking"
    assert report.notes[0].startswith("view 1 contradicts the estimate, but not the belief: near it ")
    np.testing.assert_allclose(state.joints, JOINTS, atol=0.005)


def test_a_scan_that_replaces_amid_a_search_begins_it_again() -> None:
    early = list(run.steps(seeing(FIRST), 2))[-1]
    assert early.report.stage == "search"
    steps = gone_on(early, seeing((FAR, JOINTS, BEFORE), arrival=Arrival(2, 0, 1)))
    assert steps[0].report.notes == ("the scene has changed; the search begins again",)
    assert steps[0].state.search_after == 2 and error(steps[-1], FAR, JOINTS) < 0.005
    joined = run.advance(early.state, seeing(FIRST, (FAR, JOINTS, ASIDE), arrival=Arrival(2, 1)))[0]
    assert joined.search_after == 0


def test_few_proposals_are_half_moved_ones(found: tuple[str, Step]) -> None:
    """Though there are more rivals than proposals."""
    method, before = found
    assert before.state.root is not None and before.state.joints is not None
    here = np.concatenate([before.state.root, before.state.joints])
    many = replace(before.state, rivals=np.tile(here, (30, 1)))
    made = seeing((ROOT, PULLED, BEFORE), arrival=Arrival(before.iteration, 0, 1), method=method)
    made = replace(made, settings=replace(made.settings, search_proposals=10))
    proposals, kept = tracking._diffused(np.random.default_rng(0), many, made, made.schedule(4))
    assert len(proposals.roots) == made.search_proposals == 2 * kept.stop
    # a root goes to its centre and back: to rounding
    np.testing.assert_allclose(proposals.roots[kept], np.tile(here[:7], (kept.stop, 1)), rtol=0, atol=1e-15)
    np.testing.assert_allclose(proposals.joints[kept], np.tile(here[7:], (kept.stop, 1)))
    assert not np.any(np.all(np.isclose(proposals.roots[kept.stop :], here[:7], rtol=0, atol=1e-15), axis=1))


def test_process_noise_is_that_of_the_settings(found: tuple[str, Step]) -> None:
    """Upright, without rivals: x, y, z and the turn about up with their standard deviations, about the root's middle;
    joints with their share of the range, within it."""
    method, before = found
    state = replace(before.state, rivals=None)
    assert state.root is not None and state.joints is not None
    noise = {"moved_std_xyz": 0.04, "moved_std_rpy": 0.2, "moved_joint_share": 0.05}
    made = seeing((ROOT, PULLED, BEFORE), arrival=Arrival(before.iteration, 0, 1), method=method, **noise)
    made = replace(made, settings=replace(made.settings, search_proposals=6000))
    proposals, _ = tracking._diffused(np.random.default_rng(0), state, made, made.schedule(4))
    middle = made.mrf.centres[0]
    shift = poses.transform_points(proposals.roots, middle) - poses.transform_points(state.root, middle)
    np.testing.assert_allclose(shift.std(axis=0), 0.04, rtol=0.05)
    turn = poses.quaternion_multiply(proposals.roots[:, 3:], poses.quaternion_conjugate(state.root[3:]))
    np.testing.assert_allclose(poses.to_rotation_vector(turn).std(axis=0), [0, 0, 0.2], rtol=0.05, atol=1e-9)
    ranges = MODEL.upper - MODEL.lower
    np.testing.assert_allclose((proposals.joints - state.joints).std(axis=0), 0.05 * ranges, rtol=0.05)
    assert np.all((proposals.joints >= MODEL.lower) & (proposals.joints <= MODEL.upper))


def test_without_a_search_the_start_comes_again() -> None:
    """The paper's preset, told to mind: its parts' best particles are the estimate, and its prior the beginning."""
    minds = {"search_iterations": 0, "object_estimate": False, "view_explained": 0.62}
    *_, last = run.steps(seeing(FIRST, **minds), 3)
    assert last.state.root is None
    made = seeing((FAR, JOINTS, BEFORE), arrival=Arrival(3, 0, 1), **minds)
    state, report = run.advance(last.state, made)
    assert report.notes[0].endswith("the inference begins again") and state.search_after == 3
    assert report.tolerance == made.schedule(1).tolerance


def test_the_last_views_are_asked_alone() -> None:
    """With the nuisances that are theirs, in every view."""
    both = seeing(FIRST, (ROOT, JOINTS, ASIDE), depth_scale_std=0.01, camera_std=0.01)
    rng = np.random.default_rng(4)
    assert both.nuisances is not None
    both = both.taking(0.3 * both.nuisance_std * rng.standard_normal(len(both.nuisances)))
    whole, last = confirmation(both, ROOT, JOINTS), confirmation(by_last_views(both, 1), ROOT, JOINTS)
    np.testing.assert_array_equal(whole.pixels[1][2], last.pixels[0][2])
    alone = confirmation(by_last_views(both, 0), ROOT, JOINTS)
    assert (alone.score, alone.expected) == (whole.score, whole.expected)
    first = np.count_nonzero(whole.pixels[0][2])
    assert whole.confirmed == first + last.confirmed and last.confirmed > 0
    # by the number of their scans, of which some show nothing
    gaps = replace(both, observation=replace(both.observation, showing=(False, True, False, True)))
    for number, wanted in ((1, whole), (2, last), (3, last)):
        assert confirmation(by_last_views(gaps, number), ROOT, JOINTS).confirmed == wanted.confirmed
    assert by_last_views(gaps, 4).observation.views == ()
