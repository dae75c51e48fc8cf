"""Whether what should be seen is seen: on a cupboard in the air, at its place and away from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import problem as problems
from pmpnbp.inference.confirmation import confirmation
from pmpnbp.inference.problem import Problem
from pmpnbp.readout.fit import Fit
from pmpnbp.readout.fit import assess as judged
from pmpnbp.scene.depth_noise import NORMAL_MEDIAN, told_noise
from pmpnbp.scene.observation import CONTINUED, OBJECT, View
from pmpnbp.scene.observe import observe
from pmpnbp.scene.prior import UniformPrior
from tests.inference import small_worlds as worlds

MODEL = worlds.cupboard()
ROOT, JOINTS = worlds.cupboard_truth()
CAMERA = worlds.camera_at((0.0, 0.0, 0.7), ROOT[:3] + [0, 0, 0.2])


def built(
    *,
    root: Array = ROOT,
    joints: Array = JOINTS,
    nearer: float | None = None,
    add: Array | None = None,
    top: float = 0.7,
) -> Problem:
    """A cupboard as it is seen; `nearer` : depth in metres of a board before the left three quarters of it; `add` : the
    pose of another cupboard beside it; `top` : metres above its own that the region reaches."""
    scan = worlds.scan(MODEL, MODEL.part_poses(root, joints), CAMERA)
    depth = scan.depth.copy()
    if add is not None:
        depth = np.minimum(depth, worlds.scan(MODEL, MODEL.part_poses(add, joints), CAMERA).depth)
    if nearer is not None:
        columns = np.nonzero(depth < 3.9)[1]
        depth[:, : int(np.quantile(columns, 0.75))] = nearer
    box = np.array([*(ROOT[:3] - [0.6, 0.6, 0.1]), *(ROOT[:3] + [0.6, 0.6, top])])
    observation = observe([replace(scan, depth=depth)], box, up=worlds.UP)
    return problems.build(MODEL, observation, UniformPrior("upright"), worlds.settings(), particles=20)


def assess(problem: Problem, root: Array, joints: Array) -> Fit:
    return judged(confirmation(problem, root, joints))


def test_where_it_is_the_fit_is_good_and_says_how_much_is_confirmed() -> None:
    fit = assess(built(), ROOT, JOINTS)
    assert fit.verdict == "good" and fit.missed == ()
    assert 0.9 < fit.explained <= 1
    assert fit.reason == f"the scan confirms {100 * fit.explained:.0f} % of what should be seen"


@pytest.mark.parametrize("away", [[0.0, 0.0, 0.25], [-0.3, 0.0, 0.0], [0.0, 0.45, 0.0]])
def test_where_it_is_not_there_is_no_fit(away: list[float]) -> None:
    elsewhere = np.concatenate([ROOT[:3] + away, ROOT[3:]])
    fit = assess(built(), elsewhere, JOINTS)
    assert fit.verdict == "none" and fit.explained < 0.35


def test_out_of_the_picture_nothing_is_confirmed() -> None:
    behind = np.concatenate([[-1.0, 0.0, 0.0], ROOT[3:]])
    fit = assess(built(), behind, JOINTS)
    assert (fit.verdict, fit.explained) == ("none", 0.0)


def test_a_part_that_is_not_where_it_should_be_seen_is_named() -> None:
    shut = JOINTS * [1.0, 0.0]
    fit = assess(built(), ROOT, shut)  # the flap is open
    assert fit.verdict == "doubtful" and fit.missed == ("link2",)
    assert "but not link2" in fit.reason


def test_what_hides_most_of_it_leaves_doubt() -> None:
    fit = assess(built(nearer=0.85), ROOT, JOINTS)
    assert fit.verdict == "doubtful" and "something in front hides" in fit.reason


def test_surfaces_that_go_on_around_a_half_hidden_object_leave_doubt() -> None:
    """A small model within a large thing: here the cupboard where another, turned, stands half in front of it."""
    other = poses.multiply(ROOT, worlds.at(0.05, -0.22))
    fit = assess(built(add=other), ROOT, JOINTS)
    assert fit.verdict == "doubtful" and "explained by nothing" in fit.reason


@pytest.mark.parametrize(("share", "verdict"), [(0.05, "good"), (0.2, "doubtful")])
def test_a_longer_surface_leaves_doubt_if_the_object_lies_on_it(share: float, verdict: str) -> None:
    """A plate before a wall, of which a share of what is confirmed is the wall's: some at an outline always is."""
    depth = np.full((60, 80), 3.0, np.float32)
    plate = np.zeros(depth.shape, dtype=bool)
    plate[20:40, 30:54] = True
    depth[plate] = 2.8
    category = np.where(plate, OBJECT, CONTINUED).astype(np.uint8)
    view = View(CAMERA, depth, category, np.zeros((*depth.shape, 3), np.float32))
    confirmed = plate.copy()
    confirmed[2:4, :48] = np.arange(96).reshape(2, 48) < share * np.count_nonzero(plate)
    assert view.patches[30, 40] != view.patches[30, 10] == view.patches[3, 20] > 0
    seen = replace(confirmation(built(), ROOT, JOINTS), pixels=((view, confirmed, confirmed),))
    fit = judged(replace(seen, confirmed=int(np.count_nonzero(confirmed))))
    assert fit.verdict == verdict and ("explained by nothing" in fit.reason) == (verdict == "doubtful"), fit


@pytest.mark.parametrize(("confirmed", "said"), [(1, "but that is 1 pixel"), (2, "but that is 2 pixels")])
def test_too_few_pixels_are_counted(confirmed: int, said: str) -> None:
    fit = judged(replace(confirmation(built(), ROOT, JOINTS), score=1.0, expected=1.0, confirmed=confirmed))
    assert fit.verdict == "doubtful" and fit.reason.endswith(said)


def test_a_look_alike_apart_from_it_leaves_none() -> None:
    other = np.concatenate([ROOT[:3] + [0.1, -0.75, 0.0], ROOT[3:]])
    assert assess(built(add=other), ROOT, JOINTS).verdict == "good"


@pytest.mark.parametrize(
    ("outside", "denied_share", "root_denied", "good", "said"),
    [
        (0.29, 0.0, False, True, ""),
        (0.31, 0.0, False, False, "outside the region of interest"),
        (0.0, 0.49, False, True, ""),
        (0.0, 0.51, False, False, "seen through"),
        (0.0, 0.0, True, False, "seen through"),
    ],
)
def test_what_leaves_the_region_or_is_seen_through_is_doubted(
    outside: float, denied_share: float, root_denied: bool, good: bool, said: str
) -> None:
    seen = confirmation(built(), ROOT, JOINTS)
    denied = ("left door",) if denied_share or root_denied else ()
    seen = replace(seen, outside=int(outside * seen.covered), denied=denied)
    fit = judged(replace(seen, denied_share=denied_share, root_denied=root_denied))
    assert (fit.verdict == "good") == good and said in fit.reason, fit


@pytest.mark.parametrize(
    ("denied", "said"),
    [
        (("lid",), "lid is seen through in places, so that it may"),
        (("lid", "pin"), "lid, pin are seen through in places, so that they may"),
    ],
)
def test_parts_that_are_seen_through_are_named(denied: tuple[str, ...], said: str) -> None:
    fit = judged(replace(confirmation(built(), ROOT, JOINTS), denied=denied, denied_share=0.1, root_denied=False))
    assert fit.verdict == "good" and fit.reason.endswith(f"; {said} be elsewhere")


@pytest.mark.parametrize(
    ("off", "noise", "good"),
    [
        (0.0015, 0.0, True),
        (0.0017, 0.0, False),
        (0.0023, 0.0012, True),
        (0.0024, 0.0012, False),
        (0.0096, 0.005, True),
        (0.0099, 0.005, False),
    ],
)
def test_depths_that_are_off_by_more_than_the_scans_own_errors_are_doubted(
    off: float, noise: float, good: bool
) -> None:
    fit = judged(replace(confirmation(built(), ROOT, JOINTS), off=off, noise=noise))
    assert (fit.verdict == "good") == good, fit
    said = f"but its depths are off by {1000 * off:.1f} mm, where {1000 * noise:.1f} mm are expected: are "
    assert good or said in fit.reason


def test_how_far_depths_are_off_is_counted_within_the_outline() -> None:
    problem = built()
    seen = confirmation(problem, ROOT, JOINTS)
    told = float(told_noise(problem.noise, problem.noise_area).max())
    assert seen.off < 0.001 and seen.noise == pytest.approx(told, abs=1e-9)
    back = poses.multiply(worlds.at(0.006, 0.0, 0.0), ROOT)
    assert confirmation(problem, back, JOINTS).off == pytest.approx(0.006 / NORMAL_MEDIAN, abs=0.002)


def test_parts_beyond_the_region_are_named_but_for_what_is_held_or_denied() -> None:
    seen = replace(confirmation(built(), ROOT, JOINTS), denied=(), beyond=("lid", "pin"))
    fit = judged(seen)
    assert fit.beyond == ("lid", "pin") and fit.verdict == "good"
    assert fit.reason.endswith("; lid, pin are outside the region of interest, and may be elsewhere")
    fit = judged(replace(seen, held=("pin",)))
    assert fit.beyond == ("lid",)
    assert fit.reason.endswith("; lid is outside the region of interest, and may be elsewhere")
    assert judged(replace(seen, denied=("lid",), denied_share=0.1)).beyond == ("pin",)


def test_what_is_held_where_it_is_may_not_be_elsewhere() -> None:
    seen = replace(confirmation(built(), ROOT, JOINTS), denied=("lid", "pin"), denied_share=0.1, root_denied=False)
    fit = judged(replace(seen, held=("pin",)))
    assert fit.denied == ("lid",) and fit.reason.endswith(
        "; lid is seen through in places, so that it may be elsewhere"
    )
    assert judged(replace(seen, held=("lid", "pin"))).denied == ()
    # where that is why the fit is doubtful, they are named all the same
    doubted = judged(replace(seen, denied_share=0.6, held=("lid", "pin")))
    assert doubted.verdict == "doubtful" and doubted.reason.endswith("but lid, pin are seen through in places")


def test_an_object_that_reaches_out_of_the_region_is_counted_there() -> None:
    assert confirmation(built(), ROOT, JOINTS).outside == 0
    seen = confirmation(built(top=0.2), ROOT, JOINTS)
    assert 0.2 * seen.covered < seen.outside < 0.9 * seen.covered
