"""What a scan that is not made yet would tell, against one that is made."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import problem as problems
from pmpnbp.inference import registration
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.registration import curvature, moved
from pmpnbp.readout import image_grain
from pmpnbp.readout.expected_scan import GRAZING, PROBE, Probed, expected_scan, information, told_about, told_apart
from pmpnbp.readout.log_posterior import confidence, log_posterior
from pmpnbp.scene.prior import UniformPrior
from tests.inference import small_worlds as worlds

MODEL = worlds.cupboard()
ROOT, JOINTS = worlds.cupboard_truth()
MIDDLE = poses.transform_points(ROOT, np.array([0.0, 0.0, 0.2]))
# from where no surface is aslant
FRONT = poses.rotate(ROOT[3:], np.array([0.7, 0.4, 0.6]))
NOTHING = np.zeros((0, 3))


def camera(distance: float = 1.3, width: int = 160) -> Camera:
    return worlds.camera_at(MIDDLE + distance * FRONT, MIDDLE, width, width * 3 // 4)


def made(seen_from: Camera, **settings: object) -> Problem:
    """With further cameras where they are said to be, if the settings do not say otherwise."""
    settings = {"camera_std": 0.0} | settings
    observation = worlds.seen(MODEL, ROOT, JOINTS, seen_from)
    return problems.build(MODEL, observation, UniformPrior("upright"), worlds.settings(**settings), particles=20)


def told(problem: Problem, by: Camera, planes: Array | None = None, *, grain: bool = False) -> Array:
    """(8, 8): what a scan of the truth by a camera is expected to tell of root and joints; with `grain`, by
    outlines, too, and no sharper than its image shows it."""
    if planes is not None:
        problem = replace(problem, observation=replace(problem.observation, planes=planes))
    scan = expected_scan(problem, by, MIDDLE, NOTHING)
    steps = np.full((1, 8), PROBE)
    roots, joints = moved(
        problem, ROOT[None], JOINTS[None], np.concatenate([np.zeros((1, 8)), np.diag(steps[0])])[None]
    )
    parts = problem.mrf.part_poses(roots, joints)
    probed = Probed(
        roots=ROOT[None], joints=JOINTS[None], parts=parts, steps=steps, strided=parts[:, 1:], strides=np.zeros((1, 8))
    )
    return (told_about if grain else information)(scan, probed)[0]


@pytest.mark.parametrize("width", [64, 160])
def test_it_tells_what_the_score_of_the_scan_that_is_made_is_curved_by(
    width: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever the images' size is: in the working image the camera would have as many pixels as the first."""
    monkeypatch.setattr(registration, "STEEPEST", 1 / np.cos(GRAZING))
    problem = made(camera())
    found = told(problem, camera(width=width))
    score = 2 * confidence(problem) * curvature(problem, ROOT, JOINTS, problem.tolerance_end)
    np.testing.assert_allclose(np.diag(found), np.diag(score), rtol=0.25)
    ratios = np.linalg.eigvals(np.linalg.solve(score, found)).real
    assert ratios.min() > 0.5 and ratios.max() < 2.0


def test_draws_are_told_apart_by_what_the_scan_would_have_scored_them_less() -> None:
    problem = made(camera())
    joints = JOINTS + np.array([[0.0, 0.0], [0.004, 0.0], [0.03, 0.0]])
    parts = MODEL.part_poses(np.tile(ROOT, (3, 1)), joints)
    apart = told_apart(expected_scan(problem, camera(), MIDDLE, NOTHING), parts)
    score = log_posterior(problem, np.tile(ROOT, (3, 1)), joints)
    assert np.diag(apart).max() == 0.0
    assert 0.6 < apart[0, 1] / (score[0] - score[1]) < 1.4
    assert apart[0, 2] > 3 * apart[0, 1]


def test_from_behind_a_wall_nothing_is_told() -> None:
    problem = made(camera())
    wall = np.array([[*FRONT, -float(FRONT @ (MIDDLE + 0.9 * FRONT))]])
    assert np.all(told(problem, camera(), wall) == 0.0) == (wall[0, :3] @ (MIDDLE + 1.3 * FRONT) + wall[0, 3] < 0)
    assert np.all(told(problem, camera(), -wall) == 0.0)
    assert np.any(told(problem, camera(0.8), -wall) != 0.0)


def test_what_the_further_camera_has_wrong_is_not_told() -> None:
    """A camera whose place is unknown to 1 cm tells the object's no better, and its joints as well as before."""
    sharp = np.linalg.inv(told(made(camera()), camera(), grain=True))
    stated = np.linalg.inv(told(made(camera(), camera_std=0.01), camera(), grain=True))
    assert np.linalg.eigvalsh(stated - sharp).min() > -1e-9
    assert np.sqrt(np.diag(sharp)[:3]).max() < 0.002
    assert np.sqrt(np.diag(stated)[:3]).min() > 0.009
    np.testing.assert_allclose(np.diag(stated)[6:], np.diag(sharp)[6:], rtol=0.2)


def test_what_smooth_errors_of_depth_have_wrong_of_the_object_as_one_is_not_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    problem = made(camera())
    (view,) = problem.observation.views
    wavy = replace(problem, observation=replace(problem.observation, views=(replace(view, distortion=0.003),)))
    left = np.linalg.inv(told(wavy, camera(), grain=True))
    middles = poses.transform_points(problem.mrf.part_poses(ROOT, JOINTS), problem.mrf.centres)
    as_one = image_grain.distorted_as_one(camera(), 0.003, middles, problem.mrf.radii, 0, len(left))
    monkeypatch.setattr(image_grain, "AS_ONE", 0.0)
    more = left - np.linalg.inv(told(wavy, camera(), grain=True))
    # outlines are told less sharply for it, too
    assert np.linalg.eigvalsh(more - as_one).min() > -1e-6 * as_one.max()


def test_an_object_of_unknown_size_is_told_less_sharply(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where it is, as far as a wider object would be nearer; its turns as well as before. The score of the scan that is
    made, which is curved by some edges, too, tells no less."""
    monkeypatch.setattr(registration, "STEEPEST", 1 / np.cos(GRAZING))
    monkeypatch.setattr(registration, "PROBE", PROBE)
    problem = made(camera(), size_std=0.02)
    free = np.flatnonzero(problem.nuisance_std)
    assert len(free) == 3
    fixed, found = (np.linalg.inv(told(given, camera())) for given in (made(camera()), problem))
    assert np.linalg.eigvalsh(found - fixed).min() > -1e-9
    stds = np.sqrt(np.diag(found))
    assert np.all(stds[:3] > 5 * np.sqrt(np.diag(fixed))[:3])
    assert np.all(stds[:3] < 0.02 * problem.nuisance_levers[free])
    np.testing.assert_allclose(stds[3:6], np.sqrt(np.diag(fixed))[3:6], rtol=0.2)
    score = 2 * confidence(problem) * curvature(problem, ROOT, JOINTS, problem.tolerance_end, free)
    score[range(8, 11), range(8, 11)] += problem.nuisance_std[free] ** -2.0
    ratios = stds / np.sqrt(np.diag(np.linalg.inv(score)))[:8]
    assert ratios.min() > 0.9 and ratios.max() < 4.0


def test_a_farther_view_tells_less_where_the_depths_are_noisy() -> None:
    problem = replace(made(camera()), noise=np.array([0.01]))
    near, far = told(problem, camera(1.3)), told(problem, camera(2.6))
    assert np.all(np.diag(far) < 0.5 * np.diag(near))
