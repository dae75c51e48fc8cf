"""The particle filter does what it says: a slow twin agrees, draws have their laws, and objects are found."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from pmpnbp.errors import SettingError
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import particle_filter, problem, run
from pmpnbp.inference.belief import OWN, START, Belief, IterationReport, Origin, State
from pmpnbp.inference.joint_draws import joint_spreads
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.tree_estimate import configuration_scores
from pmpnbp.readout.metrics import add, model_points
from pmpnbp.scene.articulated_object import ArticulatedObject, Joint
from pmpnbp.scene.observe import observe
from pmpnbp.scene.prior import GaussianPrior, UniformPrior
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.scene.urdf import load_model
from tests.inference import small_worlds as worlds
from tests.inference.slow_filter import slow_object_score, slow_objects, slow_temperature

ROOT, JOINTS = worlds.cupboard_truth()


def geared() -> ArticulatedObject:
    """A slide, a hinge that follows it ten times as far and turned round, and a swivel without limits."""
    joints = [
        Joint("slide", "prismatic", "link0", "link1", worlds.at(0.25), worlds.X, -0.03, 0.09, (0,)),
        Joint("follow", "revolute", "link1", "link2", worlds.at(z=0.2), worlds.Y, -0.9, 0.3, (0,), "slide", -10.0, 0.0),
        Joint("swivel", "continuous", "link0", "link3", worlds.at(z=0.3), worlds.Z, -np.pi, np.pi, (1,)),
    ]
    return worlds.articulated(joints, {f"link{k}": worlds.block([0.2, 0.14, 0.1]) for k in range(4)})


def rough(root: Array = ROOT) -> GaussianPrior:
    return worlds.rough_prior(np.random.default_rng(5), root)


def filtering(
    model: ArticulatedObject,
    root: Array,
    joints: Array,
    prior: UniformPrior | GaussianPrior,
    *,
    particles: int = 100,
    width: int = 160,
    **changes: object,
) -> Problem:
    camera = worlds.camera_at((0.0, 0.0, 0.7), root[:3], width, 3 * width // 4)
    settings = worlds.settings(**changes)
    observation = worlds.seen(model, root, joints, camera)
    return problem.build(model, observation, prior, settings, particles=particles, seed=7, method="particle_filter")


def weighted_state(rng: np.random.Generator, made: Problem, root: Array, joints: Array) -> State:
    """Whole objects about a configuration, with random weights, before iteration 6."""
    model, count = made.mrf.model, made.particles
    noise = rng.standard_normal((count, 6))
    roots = poses.perturb(root, 0.03 * noise[:, :3], 0.1 * noise[:, 3:], made.mrf.centres[0])
    drawn = np.clip(joints + 0.05 * rng.standard_normal((count, model.dof)), model.lower, model.upper)
    shape = made.mrf.nodes, count
    weights = np.tile(np.log(rng.dirichlet(np.ones(count))), (made.mrf.nodes, 1))
    belief = Belief(
        poses=np.swapaxes(model.part_poses(roots, drawn), 0, 1),
        log_weights=weights,
        log_unary=np.zeros(shape),
        origin=Origin.of(shape, START),
        joint_positions=drawn,
    )
    return State(iteration=5, belief=belief)


TWINS = {
    "gaussian": (worlds.cupboard(), ROOT, JOINTS, rough(), {}),
    "untempered": (worlds.cupboard(), ROOT, JOINTS, rough(), {"effective_share": 0.0, "unary_scale": 0.03}),
    "forgotten prior": (worlds.cupboard(), ROOT, JOINTS, rough(), {"prior_factor": False}),
    "distance": (worlds.cupboard(), ROOT, JOINTS, UniformPrior("upright"), {"pixel_score": "distance"}),
    "geared": (geared(), worlds.at(1.3, z=0.2, yaw=0.4), np.array([0.05, 3.1]), UniformPrior("any"), {}),
}


@pytest.mark.parametrize("name", TWINS)
def test_a_step_is_what_the_slow_twin_makes_of_the_same_draws(rng: np.random.Generator, name: str) -> None:
    model, root, joints, prior, changes = TWINS[name]
    made = filtering(model, root, joints, prior, particles=24, width=48, **changes)
    state = weighted_state(rng, made, root, joints)
    settings, plan = made.settings, made.schedule(6)
    _, report = particle_filter.step(np.random.default_rng(3), state, made)
    belief = report.belief
    assert (report.stage, report.iteration, report.messages) == ("particle filter", 6, None)

    slow = slow_objects(np.random.default_rng(3), made, state)
    assert belief.joint_positions is not None
    for k, (ancestor, part_poses, q) in enumerate(slow):
        assert np.all(belief.origin.ancestor[:, k] == ancestor)
        np.testing.assert_allclose(belief.joint_positions[k], q, atol=1e-9)
        np.testing.assert_allclose(belief.poses[:, k, :3], part_poses[:, :3], atol=1e-9)
        assert poses.rotation_angle(belief.poses[:, k, 3:], part_poses[:, 3:]).max() < 1e-6
    # pixels on an outline fall to one side or the other, in float32 and in float64: a pixel or two of hundreds
    scores = np.array([slow_object_score(made, part_poses, plan.tolerance) for _, part_poses, _ in slow])
    np.testing.assert_allclose(belief.log_unary[0], scores, rtol=2e-3, atol=2.5)
    assert scores.std() > 1.0

    scores = belief.log_unary[0]
    share = settings.effective_share
    factor = slow_temperature(scores, share) if share else settings.unary_scale
    np.testing.assert_allclose(report.inverse_temperature, factor, rtol=1e-3)
    weighs = made.prior_node >= 0 and settings.prior_factor
    weight = [
        np.exp(
            report.inverse_temperature[0] * (score - scores.max()) + (made.log_prior(part_poses[0]) if weighs else 0.0)
        )
        for score, (_, part_poses, _) in zip(scores, slow, strict=True)
    ]
    for node in range(made.mrf.nodes):
        np.testing.assert_allclose(np.exp(belief.log_weights[node]), np.array(weight) / sum(weight), rtol=1e-5)
        np.testing.assert_array_equal(belief.log_unary[node], scores)
    np.testing.assert_allclose(report.effective_sample_size, sum(weight) ** 2 / np.sum(np.square(weight)), rtol=1e-5)
    assert (
        np.all(belief.origin.source == OWN)
        and np.all(belief.origin.neighbour == -1)
        and np.all(belief.origin.island == 0)
    )
    assert report.log_message_shares.shape == (made.mrf.nodes, 24, 0)


def test_particles_descend_by_weight_and_move_by_the_diffusion(rng: np.random.Generator) -> None:
    """20 000 draws of a state of 3 particles: each has floor or ceil of its share of descendants; the moves about their
    ancestors, in units of the standard deviations asked for, have unit variance: a sum of squares outside of the
    chi-square's innermost 1 - 1e-6, in any of 8 coordinates, comes by chance once in 125 000 seeds. So do the means
    leave ±5 standard errors (8 · 6e-7), and the coordinates' correlations (28 · 6e-7)."""
    model, count = geared(), 20_000
    made = filtering(model, worlds.at(1.3, z=0.2, yaw=0.4), np.array([0.05, 1.0]), UniformPrior("any"), width=48)
    state = weighted_state(rng, replace(made, particles=3), worlds.at(1.3), np.array([0.1, 0.3]))
    # far from any limit
    inside = np.array([[0.0, -1.0], [0.03, 0.5], [0.06, 1.0]])
    state = replace(state, belief=replace(state.belief, joint_positions=inside))
    plan = replace(made.schedule(6), diffusion_position=0.005, diffusion_rotation=0.02)
    roots, joints, ancestor = particle_filter.draw(rng, state, replace(made, particles=count), plan)
    expected = count * np.exp(state.belief.log_weights[0])
    assert np.all(np.abs(np.bincount(ancestor, minlength=3) - expected) <= 1.0)

    before, centre = state.belief.poses[0, ancestor], made.mrf.centres[0]
    shift = poses.transform_points(roots, centre) - poses.transform_points(before, centre)
    turn = poses.to_rotation_vector(poses.quaternion_multiply(roots[:, 3:], poses.quaternion_conjugate(before[:, 3:])))
    step = (joints - inside[ancestor]) / joint_spreads(made, plan)
    unit = np.concatenate([shift / 0.005, turn / 0.02, step], axis=1)
    assert np.all((chi2.ppf(5e-7, count) < np.sum(unit**2, axis=0)) & (np.sum(unit**2, axis=0) < chi2.isf(5e-7, count)))
    assert np.all(np.abs(unit.mean(axis=0)) < 5 / np.sqrt(count))
    assert np.abs(np.triu(np.corrcoef(unit.T), 1)).max() < 5 / np.sqrt(count)


def test_a_joint_moves_its_part_by_the_diffusion() -> None:
    """One that slides as a whole, one that turns at its rim; the follower goes farther than what it follows."""
    model = geared()
    made = filtering(model, worlds.at(1.3, z=0.2), np.array([0.05, 1.0]), UniformPrior("any"), width=48)
    plan = made.schedule(6)
    slide, swivel = joint_spreads(made, plan)
    assert slide * 10.0 * made.mrf.radii[2] == pytest.approx(plan.diffusion_position)
    assert swivel * made.mrf.radii[3] == pytest.approx(plan.diffusion_position)
    cupboard = filtering(worlds.cupboard(), ROOT, JOINTS, rough(), width=48)
    drawer, flap = joint_spreads(cupboard, plan)
    assert drawer == pytest.approx(plan.diffusion_position)
    assert flap * cupboard.mrf.radii[2] == pytest.approx(plan.diffusion_position)


def whole(made: Problem, report: IterationReport) -> None:
    """Particle i of all parts is one object, within its limits, and the estimate is one too."""
    model, belief = made.mrf.model, report.belief
    assert belief.joint_positions is not None
    again = model.part_poses(belief.poses[0], belief.joint_positions)
    np.testing.assert_allclose(np.swapaxes(belief.poses, 0, 1)[..., :3], again[..., :3], atol=1e-9)
    assert poses.rotation_angle(np.swapaxes(belief.poses, 0, 1)[..., 3:], again[..., 3:]).max() < 1e-6
    assert np.all((belief.joint_positions >= model.lower - 1e-9) & (belief.joint_positions <= model.upper + 1e-9))
    assert np.ptp(belief.log_weights, axis=0).max() == 0.0
    np.testing.assert_allclose(np.exp(belief.log_weights[0]).sum(), 1.0)
    if report.iteration:
        assert report.map_joints is not None
        fitting = model.part_poses(report.map_poses[0], report.map_joints)
        np.testing.assert_allclose(report.map_poses[..., :3], fitting[..., :3], atol=1e-9)
        assert np.all((report.map_joints >= model.lower - 1e-9) & (report.map_joints <= model.upper + 1e-9))


QUICK = {"search_iterations": 2, "search_proposals": 200, "anneal_iterations": 3}


@pytest.mark.parametrize(
    "prior", [UniformPrior("upright"), UniformPrior("any"), rough()], ids=["upright", "any", "rough"]
)
@pytest.mark.parametrize("search", [0, 2])
@pytest.mark.parametrize("estimated", [True, False])
def test_every_iteration_is_of_whole_objects_within_limits(
    prior: UniformPrior | GaussianPrior, search: int, estimated: bool
) -> None:
    changes = QUICK | {"search_iterations": search, "object_estimate": estimated, "diffusion_position_end": 0.1}
    made = filtering(worlds.cupboard(), ROOT, JOINTS, prior, particles=40, width=80, **changes)
    reports = list(run.iterate(made, made.search_iterations + 5))
    searched = made.search_iterations
    assert [report.stage for report in reports] == ["start", *["search"] * searched, *["particle filter"] * 5]
    for report in reports:
        whole(made, report)
    at_limit = np.isin(reports[-1].belief.joint_positions, [*made.mrf.model.lower, *made.mrf.model.upper])
    assert at_limit.any()  # some had to be held back
    if not estimated:
        last = reports[-1]
        best = int(last.belief.log_weights[0].argmax())
        np.testing.assert_array_equal(last.map_poses, last.belief.poses[:, best])
        score = configuration_scores(
            made, last.map_poses[:1], last.belief.joint_positions[best : best + 1], last.tolerance
        )
        assert last.map_score == score[0]


def test_limits_and_tree_hold_where_joints_follow_and_turn_freely() -> None:
    made = filtering(geared(), worlds.at(1.3, z=0.2), np.array([0.05, 3.1]), UniformPrior("any"), particles=40, **QUICK)
    for report in run.iterate(made, 8):
        whole(made, report)


def test_an_object_of_one_part_has_no_joints() -> None:
    brick = worlds.articulated([], {"link0": worlds.block([0.3, 0.2, 0.12])})
    root = worlds.at(1.0, 0.1, 0.3, yaw=0.5)
    made = filtering(brick, root, np.zeros(0), rough(root), search_proposals=600)
    report = list(run.iterate(made, 24))[-1]
    whole(made, report)
    assert add(model_points(brick.parts[0].mesh), report.map_poses[0], root) < 0.01


def test_a_uniform_start_lays_roots_on_observed_points_and_a_gaussian_one_is_that_of_pmpnbp() -> None:
    upright = filtering(worlds.cupboard(), ROOT, JOINTS, UniformPrior("upright"))
    belief = run.begin(upright)[0].belief
    away = belief.poses[0, :, None, :3] - upright.observation.points
    assert np.abs(away).sum(axis=-1).min(axis=1).max() == 0.0
    up = poses.rotate(belief.poses[0, :, 3:], worlds.Z)
    np.testing.assert_allclose(up, np.broadcast_to(worlds.UP, up.shape), atol=1e-9)
    assert belief.joint_positions is not None and np.all(np.ptp(belief.joint_positions, axis=0) > 0.1)
    known = filtering(worlds.cupboard(), ROOT, JOINTS, rough())
    mine, theirs = (run.begin(each)[0].belief for each in (known, replace(known, method="pmpnbp")))
    assert mine.poses.tobytes() == theirs.poses.tobytes()


def test_the_search_is_the_same_for_both_methods() -> None:
    """It looks at nothing of the start, and the filter begins where it ends."""
    made = filtering(worlds.cupboard(), ROOT, JOINTS, UniformPrior("upright"), **QUICK)
    mine, theirs = (list(run.iterate(each, 2))[-1] for each in (made, replace(made, method="pmpnbp")))
    assert mine.belief.poses.tobytes() == theirs.belief.poses.tobytes()
    assert mine.map_poses.tobytes() == theirs.map_poses.tobytes()


def test_the_same_seed_gives_the_same_bits_and_another_gives_others() -> None:
    made = filtering(worlds.cupboard(), ROOT, JOINTS, rough(), **QUICK)
    runs = [list(run.iterate(replace(made, seed=seed), 6)) for seed in (3, 3, 4)]
    for first, second in zip(runs[0], runs[1], strict=True):
        assert first.belief.poses.tobytes() == second.belief.poses.tobytes()
        assert first.belief.log_weights.tobytes() == second.belief.log_weights.tobytes()
        assert first.map_poses.tobytes() == second.map_poses.tobytes()
    assert runs[0][-1].belief.poses.tobytes() != runs[2][-1].belief.poses.tobytes()


def test_a_method_that_there_is_none_of() -> None:
    with pytest.raises(SettingError, match="method 'guess' does not exist; there are pmpnbp and particle_filter"):
        problem.build(worlds.cupboard(), worlds.NOTHING_SEEN, UniformPrior(), worlds.settings(), method="guess")


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_sample_cabinet_is_found_from_a_rough_prior(repository: Path, seed: int) -> None:
    folder = repository / "sample_data" / "cabinet"
    scene, model = folder / "open", load_model(folder / "cabinet.urdf", triangle_budget=60)
    links = json.loads((scene / "truth.json").read_text())["links"]
    roi = np.array(json.loads((scene / "roi.json").read_text())["roi"])
    observation = observe([load_scan(scene / "depth.png", scene / "camera.json")], roi, width=80)
    truth = np.stack([poses.from_matrix(np.array(links[part.links[0]]).reshape(4, 4)) for part in model.parts])
    prior = worlds.rough_prior(np.random.default_rng(seed), truth[0], model.parts[0].links[0])
    made = problem.build(
        model,
        observation,
        prior,
        worlds.settings(search_proposals=2000),
        particles=100,
        seed=seed,
        method="particle_filter",
    )
    reports = list(run.iterate(made, 20))
    assert reports[-1].stage == "particle filter"
    for part, found, true in zip(model.parts, reports[-1].map_poses, truth, strict=True):
        assert add(model_points(part.mesh), found, true) < 0.01
