"""Where to look next: a drawer that is hidden from here is best seen from where its side shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import problem as problems
from pmpnbp.inference import run
from pmpnbp.inference.problem import Problem
from pmpnbp.readout.fit import Fit
from pmpnbp.readout.image_grain import blunted
from pmpnbp.readout.mixture import of_estimate
from pmpnbp.readout.object_posterior import ModeDraws, mode_draws
from pmpnbp.readout.posterior import ObjectMode, Posterior
from pmpnbp.readout.view_planning import PlannedView, _neighbourhoods, _what_is_open, around, looking_at, ranked
from pmpnbp.scene.observe import observe
from pmpnbp.scene.parts import LinkSurface
from pmpnbp.scene.prior import UniformPrior
from tests.inference import small_worlds as worlds

MODEL = worlds.cupboard()
ROOT, JOINTS = worlds.cupboard_truth()
MIDDLE = poses.transform_points(ROOT, np.array([0.0, 0.0, 0.2]))
DRAWER, FLAP = MODEL.links.index("link1"), MODEL.links.index("link2")
# its front, and the closed back behind which the drawer may be anywhere
FRONT, BACK = (poses.rotate(ROOT[3:], np.array([side, 0.2, 0.3])) for side in (1.0, -1.0))
# from where its front is an edge
ABOVE = np.array([0.0, 0.1, 1.0])


@pytest.fixture(scope="module")
def problem() -> Problem:
    camera = worlds.camera_at(MIDDLE + 1.3 * BACK, MIDDLE)
    return problems.build(
        MODEL, worlds.seen(MODEL, ROOT, JOINTS, camera), UniformPrior("upright"), worlds.settings(), particles=20
    )


@pytest.fixture(scope="module")
def posterior(problem: Problem) -> Posterior:
    return drawn(problem)


@pytest.fixture(scope="module")
def posteriors(problem: Problem) -> list[Posterior]:
    """Of several seeds: two of forty draws that a view does not tell apart widen what is expected of it."""
    return [drawn(replace(problem, seed=seed)) for seed in range(5)]


def drawn(problem: Problem) -> Posterior:
    _, made = run.begin(problem)
    report = replace(
        made, iteration=9, stage="belief propagation", map_poses=MODEL.part_poses(ROOT, JOINTS), map_joints=JOINTS
    )
    return of_estimate(problem, report)


def view(direction: Array, distance: float = 1.3, cost: float = 1.0) -> PlannedView:
    return PlannedView(looking_at(MIDDLE + distance * direction, MIDDLE, worlds.UP), cost)


def test_the_view_that_shows_the_hidden_drawer_comes_first(problem: Problem, posterior: Posterior) -> None:
    best, worst = ranked(problem, posterior, [DRAWER], [view(BACK), view(FRONT)])
    np.testing.assert_array_equal(best.view.pose, view(FRONT).pose)
    assert best.gain > 2.0 > 0.5 > worst.gain
    hidden = posterior.drawn_joints[:, 0].std()
    assert hidden > 0.03
    assert best.std_xyz.max() < 0.02 < worst.std_xyz.max()


def test_what_is_known_follows_what_is_open_where_that_tells_of_it(problem: Problem, posterior: Posterior) -> None:
    """Else it is where the mode has it: the slide is known to 2 mm, and the hinge is open."""
    rng, count = np.random.default_rng(4), 400
    hinge, apart = 0.6 + 0.2 * rng.standard_normal(count), 0.002 * rng.standard_normal(count)
    chosen = np.arange(40)
    for slide, expected in (
        (0.18 + 0.01 * (hinge - 0.6), 0.18 + 0.01 * (hinge[chosen] - 0.6)),
        (0.18 + apart, np.full(len(chosen), 0.18)),
    ):
        made = replace(
            posterior,
            drawn_roots=np.tile(ROOT, (count, 1)),
            drawn_joints=np.stack([slide, hinge], axis=1),
            log_weights=np.full(count, -np.log(count)),
            mode=np.zeros(count, dtype=np.int64),
            modes=(replace(posterior.modes[0], weight=1.0, root=ROOT, joints=JOINTS),),
        )
        _, is_open, following = _neighbourhoods(problem, made, chosen)
        assert is_open[0].tolist() == 7 * [False] + [True]
        roots, joints = _what_is_open(problem, made, chosen, following)
        np.testing.assert_allclose(joints, np.stack([expected, hinge[chosen]], axis=1), atol=1e-6)
        np.testing.assert_allclose(roots, np.tile(ROOT, (len(chosen), 1)), atol=1e-9)


def spread(draws: ModeDraws) -> float:
    """Metres, the largest standard deviation of the drawer's position along an axis."""
    places = MODEL.link_poses(MODEL.part_poses(draws.roots, draws.joints), draws.joints)[:, DRAWER, :3]
    weights = np.exp(draws.log_weights)
    return float(np.sqrt((weights @ (places - weights @ places) ** 2).max()))


@pytest.mark.parametrize("direction", [FRONT + 0.3 * worlds.UP, FRONT + 0.6 * worlds.UP, ABOVE])
def test_the_deviation_that_is_expected_is_what_the_scan_then_gives(
    problem: Problem, posteriors: list[Posterior], direction: Array
) -> None:
    """Also from above, where only outlines tell how far the drawer is open."""
    planned = view(direction)
    expected = np.median([ranked(problem, each, [DRAWER], [planned])[0].std_xyz.max() for each in posteriors])
    parts, first = MODEL.part_poses(ROOT, JOINTS), worlds.camera_at(MIDDLE + 1.3 * BACK, MIDDLE)
    scans = [worlds.scan(MODEL, parts, camera) for camera in (first, replace(first, pose_world_camera=planned.pose))]
    both = observe(scans, problem.observation.roi, up=worlds.UP)
    after = problems.build(MODEL, both, UniformPrior("upright"), worlds.settings(), particles=20)
    got = np.median([spread(mode_draws(np.random.default_rng(k), after, ROOT, JOINTS)) for k in range(9)])
    assert 0.5 < expected / got < 2.0


def test_of_views_that_tell_as_much_as_is_asked_the_sharper_one_comes_first(
    problem: Problem, posterior: Posterior
) -> None:
    noisy = replace(problem, noise=np.array([0.01]))
    found = ranked(noisy, posterior, [DRAWER], [view(FRONT, 2.6), view(FRONT)], 0.01)
    assert found[0].gain == pytest.approx(found[1].gain, rel=0.01)
    np.testing.assert_array_equal(found[0].view.pose, view(FRONT).pose)
    assert found[0].std_xyz.max() < 0.97 * found[1].std_xyz.max()


def test_a_flap_whose_origin_is_on_its_hinge_is_told_by_where_its_middle_is(
    problem: Problem, posterior: Posterior
) -> None:
    flap = posterior.link_poses(MODEL)[:, FLAP]
    assert flap[:, :3].std(axis=0).max() < 0.002 and posterior.drawn_joints[:, 1].std() > 0.05
    best, worst = ranked(problem, posterior, [FLAP], [view(BACK), view(FRONT)])
    np.testing.assert_array_equal(best.view.pose, view(FRONT).pose)
    assert best.gain > 1.0 > 0.5 > worst.gain


def test_what_is_known_well_enough_needs_not_be_told(problem: Problem, posterior: Posterior) -> None:
    (strict,), (lenient,) = (ranked(problem, posterior, [DRAWER], [view(FRONT)], max_std) for max_std in (1e-3, 0.02))
    (idle,) = ranked(problem, posterior, [DRAWER], [view(FRONT)], 1.0)
    assert strict.gain > lenient.gain + 1.0 > 1.0 and idle.gain == 0.0
    np.testing.assert_array_equal(strict.std_xyz, idle.std_xyz)


def test_of_equal_views_the_cheaper_one_comes_first_then_the_one_that_turns_less(
    problem: Problem, posterior: Posterior
) -> None:
    """All of them behind a wall, with which the camera sees nothing at all."""
    wall = np.array([[*BACK, -float(BACK @ (MIDDLE - 0.5 * BACK))]])
    walled = replace(problem, observation=replace(problem.observation, planes=wall))
    aslant = (FRONT + 0.4 * worlds.UP) / np.linalg.norm(FRONT + 0.4 * worlds.UP)
    turned = [poses.rotation_angle(view(each).pose[3:], view(BACK).pose[3:]) for each in (FRONT, aslant)]
    nearer, farther = (FRONT, aslant) if turned[0] < turned[1] else (aslant, FRONT)
    views = [view(farther), view(nearer), view(farther, cost=0.5)]
    for given in (views, views[::-1]):
        found = ranked(walled, posterior, [DRAWER], given)
        assert [one.view for one in found] == [views[2], views[1], views[0]]
        assert all(one.gain == 0.0 for one in found)


def test_a_view_is_worth_less_the_more_it_costs(problem: Problem, posterior: Posterior) -> None:
    cheap, dear = ranked(problem, posterior, [DRAWER], [view(FRONT, cost=50.0), view(FRONT, 1.5)])
    assert (cheap.view.cost, dear.view.cost) == (1.0, 50.0)
    assert cheap.gain == pytest.approx(dear.gain, rel=0.3)


def test_what_stands_before_it_blocks_the_sight(problem: Problem, posterior: Posterior) -> None:
    """A board between the camera and the drawer, measured by another camera: as points of the scan."""
    eye = MIDDLE + 1.3 * FRONT
    other = worlds.camera_at(eye + 0.4 * FRONT, MIDDLE)
    board = np.full((other.height, other.width), 0.8, dtype=np.float32)
    seen = problem.observation.views[0]
    normals = np.zeros((*board.shape, 3), dtype=np.float32)
    blocking = replace(seen, camera=other, depth=board, category=np.ones_like(board, dtype=np.uint8), normals=normals)
    both = replace(problem, observation=replace(problem.observation, views=(seen, blocking)))
    (open_view,) = ranked(problem, posterior, [DRAWER], [view(FRONT)])
    (blocked,) = ranked(both, posterior, [DRAWER], [view(FRONT)])
    assert open_view.gain > 2.0 and blocked.gain < 1e-9


def test_views_around_look_at_the_object_from_the_camera_s_distance(problem: Problem, posterior: Posterior) -> None:
    views = around(problem, posterior)
    eyes = np.array([one.pose[:3] for one in views])
    middle = (eyes.max(axis=0) + eyes.min(axis=0)) / 2
    # about the middle of all parts, the open drawer's too
    assert np.linalg.norm(middle[:2] - MIDDLE[:2]) < 0.25 and len(views) >= 20
    distances = np.linalg.norm(eyes - MIDDLE, axis=1)
    assert np.ptp(distances) < 0.5 and np.all(eyes[:, 2] > MIDDLE[2])
    for one in views:
        ahead = poses.rotate(one.pose[3:], np.array([0.0, 0.0, 1.0]))
        aside = (MIDDLE - one.pose[:3]) - ((MIDDLE - one.pose[:3]) @ ahead) * ahead
        assert np.linalg.norm(aside) < 0.25
        right = poses.rotate(one.pose[3:], np.array([1.0, 0.0, 0.0]))
        assert abs(right @ worlds.UP) < 1e-9  # level


# A block beside its origin; and one whose foot and back have it in their middle, so that turned it only lies otherwise.
BESIDE = worlds.block([0.3, 0.2, 0.2], worlds.at(0.05))
FOOT, SEAT_BACK = (
    worlds.block(size, worlds.at(x, z=z)) for size, x, z in (([0.3, 0.2, 0.02], 0, -0.09), ([0.1, 0.2, 0.2], 0.1, 0))
)
SEAT = LinkSurface(exact=(*FOOT.exact, *SEAT_BACK.exact))


@pytest.mark.parametrize("weight", [0.5, 0.98])
@pytest.mark.parametrize("surface", [BESIDE, SEAT], ids=["beside", "in the middle"])
def test_a_thing_without_joints_that_may_be_turned_either_way_is_told_by_its_side(
    surface: LinkSurface, weight: float
) -> None:
    """Also where that is so unlikely that no draw of forty is turned: nobody is certain of it then."""
    model = worlds.articulated([], {"link0": surface})
    middle = np.array([1.4, 0.0, 0.3])
    root, turned = worlds.at(*middle), worlds.at(*middle, yaw=np.pi)
    camera = worlds.camera_at((0.0, 0.0, 0.3), middle)
    problem = problems.build(
        model, worlds.seen(model, root, np.zeros(0), camera), UniformPrior("upright"), worlds.settings(), particles=20
    )
    rng = np.random.default_rng(0)
    roots = np.concatenate(
        [poses.perturb(each, 0.001 * rng.standard_normal((30, 3)), np.zeros((30, 3))) for each in (root, turned)]
    )
    weights = weight, 1 - weight
    modes = tuple(
        ObjectMode(weight=own, root=each, joints=np.zeros(0)) for own, each in zip(weights, (root, turned), strict=True)
    )
    either = Posterior(
        iteration=9,
        root=root,
        joints=np.zeros(0),
        drawn_roots=roots,
        drawn_joints=np.zeros((60, 0)),
        log_weights=np.log(np.repeat(weights, 30) / 30),
        mode=np.repeat([0, 1], 30),
        modes=modes,
        effective_sample_size=60.0,
        fit=Fit(verdict="good", reason="", explained=1.0, missed=(), denied=()),
    )
    side = PlannedView(looking_at(middle + np.array([0.0, 1.3, 0.3]), middle, worlds.UP))
    (told,) = ranked(problem, either, [0], [side])
    assert told.gain > 2.0 and told.std_xyz.max() < 0.002


def test_the_same_posterior_gives_the_same_ranking(problem: Problem, posterior: Posterior) -> None:
    once, again = (ranked(problem, posterior, [DRAWER], around(problem, posterior)) for _ in range(2))
    assert [one.gain for one in once] == [one.gain for one in again]


def test_what_the_image_hides_is_added_to_what_the_scan_leaves_open(rng: np.random.Generator) -> None:
    root = rng.standard_normal((3, 5, 5))
    other = rng.standard_normal((3, 5, 2))
    known, covariance = root @ np.swapaxes(root, 1, 2), other @ np.swapaxes(other, 1, 2)
    left = np.linalg.inv(blunted(known, covariance))
    np.testing.assert_allclose(left, np.linalg.inv(known) + covariance, rtol=1e-6, atol=1e-8)
    known[:, 0] = known[:, :, 0] = 0.0  # of which nothing is told
    np.testing.assert_allclose(blunted(known, covariance)[:, 0], 0.0, atol=1e-12)
