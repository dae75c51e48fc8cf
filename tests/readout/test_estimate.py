"""What is read out of a belief: covariances against their definition, and a result that fits the kinematic tree."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.inference import problem as problem_module
from pmpnbp.inference.belief import START, Belief, IterationReport, Origin, State
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.tree_estimate import agreeing
from pmpnbp.readout import estimate as readout
from pmpnbp.readout import particle_statistics
from pmpnbp.readout.fit import Fit
from pmpnbp.readout.posterior import ObjectMode, Posterior
from pmpnbp.readout.result import to_result
from pmpnbp.readout.truth_errors import errors as truth_errors
from pmpnbp.scene.observation import Observation
from pmpnbp.scene.observe import observe
from pmpnbp.scene.prior import UniformPrior
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.scene.urdf import load_model
from pmpnbp.settings import preset

Array = np.ndarray

# A chest on a wheeled foot nobody sees: a lid on a hinge, a second lid that follows it, a loose plate that slides and
# turns on top, and behind a last hinge a tip without a surface.
URDF = """<robot name="chest">
  <link name="foot"/>
  <joint name="roll" type="prismatic"><parent link="foot"/><child link="body"/><origin xyz="0 0 0.1"/>
    <axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <link name="body"><visual><geometry><box size="0.4 0.3 0.2"/></geometry></visual></link>
  <joint name="hinge" type="revolute"><parent link="body"/><child link="lid"/><origin xyz="0 0.15 0.1"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="2" effort="1" velocity="1"/></joint>
  <link name="lid"><visual><origin xyz="0 -0.15 0"/><geometry><box size="0.4 0.3 0.02"/></geometry></visual></link>
  <joint name="follow" type="revolute"><parent link="body"/><child link="flap"/><origin xyz="0 -0.15 0"/>
    <axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/>
    <mimic joint="hinge" multiplier="-0.5" offset="0.1"/></joint>
  <link name="flap"><visual><origin xyz="0 0 0.1"/><geometry><box size="0.3 0.02 0.2"/></geometry></visual></link>
  <joint name="float" type="planar"><parent link="lid"/><child link="plate"/><axis xyz="0 0 1"/></joint>
  <link name="plate"><visual><geometry><box size="0.1 0.1 0.02"/></geometry></visual></link>
  <joint name="last" type="continuous"><parent link="lid"/><child link="tip"/><origin xyz="0.2 0 0"/>
    <axis xyz="0 0 1"/></joint>
  <link name="tip"/>
  <joint name="glue" type="fixed"><parent link="lid"/><child link="knob"/>
    <origin xyz="0 -0.3 0.02" rpy="0 0 1"/></joint>
  <link name="knob"><visual><geometry><sphere radius="0.02"/></geometry></visual></link>
</robot>"""


@pytest.fixture(scope="module")
def observation(repository_root: Path) -> Observation:
    scene = repository_root / "sample_data" / "cabinet" / "open"
    roi = json.loads((scene / "roi.json").read_text())["roi"]
    return observe([load_scan(scene / "depth.png", scene / "camera.json")], np.array(roi))


@pytest.fixture(scope="module")
def repository_root() -> Path:
    return Path(__file__).resolve().parent.parent.parent


@pytest.fixture(scope="module")
def problem(observation: Observation, tmp_path_factory: pytest.TempPathFactory) -> Problem:
    path = tmp_path_factory.mktemp("model") / "chest.urdf"
    path.write_text(URDF)
    return problem_module.build(load_model(path), observation, UniformPrior(), preset("robust"), particles=300, seed=3)


def report_of(
    problem: Problem, part_poses: Array, joints: Array | None, particles: Array, log_weights: Array | None = None
) -> IterationReport:
    """A report of iteration 7 whose belief is `particles` (N, T, 7)."""
    nodes, count = particles.shape[:2]
    weights = np.full((nodes, count), -np.log(count)) if log_weights is None else log_weights
    belief = Belief(
        poses=particles,
        log_weights=weights,
        log_unary=np.zeros((nodes, count)),
        origin=Origin.of((nodes, count), START),
    )
    return IterationReport.of(
        State(iteration=7, belief=belief, joints=joints),
        "belief propagation",
        inverse_temperature=1.0,
        tolerance=0.012,
        map_poses=part_poses,
        map_score=0.0,
        seconds=0.1,
    )


def standing(problem: Problem) -> tuple[Array, Array]:
    """Part poses and a joint vector within limits of the chest before the camera."""
    model = problem.mrf.model
    joints = np.clip(0.3 * np.arange(1, model.dof + 1), model.lower, model.upper)
    root = np.array([0.4, 0.2, 0.3, *poses.from_rpy([0.0, 0.0, 0.5])])
    return model.part_poses(root, joints), joints


def scattered(rng: np.random.Generator, part_poses: Array, count: int, position: float, rotation: float) -> Array:
    noise = rng.standard_normal((len(part_poses), count, 6))
    return poses.perturb(part_poses[:, None], position * noise[..., :3], rotation * noise[..., 3:])


def test_covariance_is_the_second_moment_in_ros_order(rng: np.random.Generator) -> None:
    centre = np.array([1.0, 2.0, 3.0, *poses.random_quaternions(rng, ())])
    shift, turn = 0.1 * rng.standard_normal((50, 3)), 0.1 * rng.standard_normal((50, 3))
    weights = rng.random(50)
    deviation = np.hstack([shift, turn])
    expected = (deviation * (weights / weights.sum())[:, None]).T @ deviation
    found = particle_statistics.covariance(centre, poses.perturb(centre, shift, turn), weights)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert np.linalg.eigvalsh(found).min() > -1e-15


def test_covariance_does_not_see_the_sign_of_a_quaternion(rng: np.random.Generator) -> None:
    centre = poses.IDENTITY
    particles = poses.perturb(centre, 0.1 * rng.standard_normal((20, 3)), 0.3 * rng.standard_normal((20, 3)))
    flipped = particles * np.where(rng.random((20, 1)) < 0.5, 1.0, [1.0, 1.0, 1.0, -1.0, -1.0, -1.0, -1.0])
    expected = particle_statistics.covariance(centre, particles, np.ones(20))
    np.testing.assert_allclose(particle_statistics.covariance(centre, flipped, np.ones(20)), expected, atol=1e-12)


def test_a_link_far_from_its_part_has_the_covariance_carried_over_by_the_adjoint(
    problem: Problem, rng: np.random.Generator
) -> None:
    """Exact for small turns; at 1 mrad what the adjoint leaves out is of the order of 1e-3 of the entries."""
    part_poses, joints = standing(problem)
    particles = scattered(rng, part_poses, 300, 0.004, 0.001)
    placed = readout.place(problem, report_of(problem, part_poses, joints, particles))
    lid, knob = (placed.particle_covariances[problem.mrf.model.links.index(name)] for name in ("lid", "knob"))
    at = {name: placed.link_poses[problem.mrf.model.links.index(name)] for name in ("lid", "knob")}
    x, y, z = at["knob"][:3] - at["lid"][:3]
    adjoint = np.eye(6)
    adjoint[:3, 3:] = -np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    np.testing.assert_allclose(knob, adjoint @ lid @ adjoint.T, rtol=0.02, atol=1e-8)


def test_modes_are_the_separate_hypotheses_heaviest_first(rng: np.random.Generator) -> None:
    places = np.zeros((7, 7))
    places[:, 3] = 1.0
    places[:, 0] = np.arange(7)
    share = np.array([0.05, 0.3, 0.1, 0.2, 0.25, 0.005, 0.095])
    particles = poses.perturb(np.repeat(places, 40, axis=0), 0.005 * rng.standard_normal((280, 3)), np.zeros((280, 3)))
    modes = particle_statistics.modes(particles, np.repeat(share / 40, 40), np.zeros(3))
    np.testing.assert_allclose([mode.weight for mode in modes], [0.3, 0.25, 0.2, 0.1, 0.095], atol=1e-12)
    assert [int(np.flatnonzero(mode.members)[0]) // 40 for mode in modes] == [1, 4, 3, 2, 6]
    assert not np.any(np.sum([mode.members for mode in modes], axis=0) > 1)


def test_a_turn_over_twenty_degrees_is_another_mode() -> None:
    apart = np.stack([poses.IDENTITY, np.r_[0.0, 0, 0, poses.from_rpy([0, 0, np.radians(25)])]])
    near = np.stack([poses.IDENTITY, np.r_[0.0, 0, 0, poses.from_rpy([0, 0, np.radians(15)])]])
    assert len(particle_statistics.modes(apart, np.array([0.6, 0.4]), np.zeros(3))) == 2
    assert len(particle_statistics.modes(near, np.array([0.6, 0.4]), np.zeros(3))) == 1


def test_joint_std_of_exact_particles_is_zero_and_of_unseen_joints_that_of_the_range(
    problem: Problem, rng: np.random.Generator
) -> None:
    part_poses, joints = standing(problem)
    particles = np.repeat(part_poses[:, None], 50, axis=1)
    belief = report_of(problem, part_poses, joints, particles).belief
    model = problem.mrf.model
    stds = dict(zip(model.coordinate_names, particle_statistics.joint_stds(rng, model, belief, joints), strict=True))
    assert stds["hinge"] < 1e-6
    assert stds["float/x"] < 1e-6
    assert stds["roll"] == pytest.approx(2 / np.sqrt(12))
    assert stds["last"] == pytest.approx(2 * np.pi / np.sqrt(12))


def test_joint_std_is_that_of_both_parts_turns(problem: Problem) -> None:
    """Independent turns of both parts by 0.02 rad about every axis: 0.02 √2 about the hinge's. The standard error of a
    standard deviation from n pairs is 1/√(2n), here 3.5 %; five of them are missed once in a million runs."""
    rng = np.random.default_rng(5)
    part_poses, joints = standing(problem)
    model = problem.mrf.model
    joints[model.coordinate_names.index("hinge")] = 1.0
    part_poses = model.part_poses(part_poses[0], joints)
    belief = report_of(problem, part_poses, joints, scattered(rng, part_poses, 400, 0.0, 0.02)).belief
    # the flap follows the hinge at half its pace, so that it knows the hinge half as well
    std = particle_statistics.joint_stds(rng, model, belief, joints)[model.coordinate_names.index("hinge")]
    assert std == pytest.approx(0.02 * np.sqrt(2), rel=0.18)


def test_joint_std_of_whole_objects_is_that_of_their_joints(problem: Problem, rng: np.random.Generator) -> None:
    part_poses, joints = standing(problem)
    model = problem.mrf.model
    particles = np.repeat(part_poses[:, None], 2, axis=1)
    plain = report_of(problem, part_poses, joints, particles, np.log([[0.75, 0.25]] * len(part_poses))).belief
    both = np.stack([joints, joints])
    turning = model.coordinate_names.index("float/turn")
    both[1, turning] += 2 * np.pi - 0.1  # the short way round
    belief = replace(plain, joint_positions=both)
    stds = particle_statistics.joint_stds(rng, model, belief, joints)
    assert stds[turning] == pytest.approx(0.05)
    # nothing is seen of these two, however alike the particles are in them
    unseen = [model.coordinate_names.index(name) for name in ("roll", "last")]
    np.testing.assert_allclose(stds[unseen], np.array([2, 2 * np.pi]) / np.sqrt(12))
    assert np.delete(stds, [turning, *unseen]).max() == 0.0


def test_every_link_and_moving_joint_is_reported_and_fits_the_tree(problem: Problem, rng: np.random.Generator) -> None:
    part_poses, joints = standing(problem)
    report = report_of(problem, part_poses, joints, scattered(rng, part_poses, 300, 0.001, 0.002))
    posterior = drawn_about(rng, problem, part_poses, joints, 0.001)
    found = readout.estimate(problem, report, readout.place(problem, report, posterior), max_std=0.004)
    result = to_result(found)
    model = problem.mrf.model
    assert list(result["links"]) == list(model.links)
    assert set(result["joints"]) == {"roll", "hinge", "follow", "float", "last"}
    follow, hinge = result["joints"]["follow"], result["joints"]["hinge"]
    assert follow["position"] == pytest.approx(-0.5 * hinge["position"] + 0.1)
    assert follow["std"] == pytest.approx(0.5 * hinge["std"])
    assert (follow["lower"], follow["upper"]) == pytest.approx((-0.9, 0.1))
    names = ("position", "std", "interval", "lower", "upper")
    assert [len(result["joints"]["float"][name]) for name in names] == [3] * 5
    assert follow["interval"] == pytest.approx([-0.5 * end + 0.1 for end in reversed(hinge["interval"])])
    assert [entry["weight"] for entry in result["alternatives"]] == [1.0]
    assert result["alternatives"][0]["joints"]["hinge"] == pytest.approx(hinge["position"])
    assert result["joints"]["float"]["upper"] == pytest.approx([1.0, 1.0, np.pi])
    poses_of = {link.name: link.pose for link in found.links}
    for joint in model.joints:
        child = poses.multiply(poses_of[joint.parent], joint.pose_parent_child(found.joint_positions))
        np.testing.assert_allclose(poses.to_matrix(child), poses.to_matrix(poses_of[joint.child]), atol=1e-9)
    json.dumps(result, allow_nan=False)


def test_what_is_seen_of_a_link_is_none_where_no_surface_moves_with_it(
    problem: Problem, rng: np.random.Generator
) -> None:
    part_poses, joints = standing(problem)
    report = report_of(problem, part_poses, joints, scattered(rng, part_poses, 20, 0.001, 0.0))
    for link in readout.estimate(problem, report).links:
        unseen = link.name in ("foot", "tip")
        assert (link.visible_fraction is None) == (link.log_likelihood is None) == unseen


def drawn_about(
    rng: np.random.Generator,
    problem: Problem,
    part_poses: Array,
    joints: Array,
    std: float,
    *,
    rival: float = 0.0,
    verdict: str = "good",
) -> Posterior:
    """Five hundred draws of a posterior about a configuration, the root's position and the joint `roll` spread by
    `std`, metres; and `rival` of its weight half a metre to the side."""
    model, count = problem.mrf.model, 500
    roots = poses.perturb(part_poses[0], std * rng.standard_normal((count, 3)), np.zeros((count, 3)))
    vectors = np.tile(joints, (count, 1))
    roll = model.coordinate_names.index("roll")
    vectors[:, roll] = np.clip(joints[roll] + std * rng.standard_normal(count), -1, 1)
    aside = part_poses[0] + np.r_[0.0, 0.5, 0, 0, 0, 0, 0]
    beside = np.arange(count) >= count // 2
    roots[beside] = roots[beside] + (aside - part_poses[0]) * (rival > 0)
    shares = (1 - rival, rival) if rival else (1.0,)
    weights = np.where(beside, rival or 0.5, 1 - rival if rival else 0.5) / (count // 2)
    places = (part_poses[0], aside)[: len(shares)]
    return Posterior(
        iteration=7,
        root=part_poses[0],
        joints=joints,
        drawn_roots=roots,
        drawn_joints=vectors,
        log_weights=np.log(weights),
        mode=beside.astype(np.int64) * (rival > 0),
        modes=tuple(ObjectMode(weight=w, root=r, joints=joints) for w, r in zip(shares, places, strict=True)),
        effective_sample_size=100.0,
        fit=Fit(verdict=verdict, reason="as a test says", explained=0.9),  # type: ignore[arg-type]
    )


def test_before_there_is_a_posterior_nothing_is_certain_and_its_members_are_null(
    problem: Problem, rng: np.random.Generator
) -> None:
    part_poses, joints = standing(problem)
    report = report_of(problem, part_poses, joints, scattered(rng, part_poses, 300, 1e-5, 0.0))
    result = to_result(readout.estimate(problem, report, max_std=10.0))
    assert not result["certain"] and result["fit"] is None and result["alternatives"] == []
    for link in result["links"].values():
        nulls = (link["std_xyz"], link["covariance"], link["expected_add"])
        assert nulls == (None, None, None) and link["modes"] == [] and not link["certain"]
    # what is spread is the particles, and the foot as the joint that nothing is seen of
    spread = {name: max(link["particle_std_xyz"]) for name, link in result["links"].items()}
    assert spread["lid"] < 2e-5 and spread["foot"] > 0.1
    assert all(joint["std"] is None and joint["interval"] is None for joint in result["joints"].values())


def test_certain_is_what_it_says(problem: Problem, rng: np.random.Generator) -> None:
    part_poses, joints = standing(problem)
    report = report_of(problem, part_poses, joints, scattered(rng, part_poses, 300, 0.1, 0.0))

    def told(std: float, max_std: float, **more: object) -> dict:
        posterior = drawn_about(rng, problem, part_poses, joints, std, **more)
        return to_result(readout.estimate(problem, report, readout.place(problem, report, posterior), max_std=max_std))

    strict = told(0.002, 0.004)
    assert strict["certain"]
    for link in strict["links"].values():
        assert link["certain"] == all(std <= 0.004 for std in link["std_xyz"])
        np.testing.assert_allclose(np.sqrt(np.diag(np.reshape(link["covariance"], (6, 6)))[:3]), link["std_xyz"])
    body = strict["links"]["body"]
    # the mean length of a gaussian in space is 2 sqrt(2 / pi) of its standard deviation
    assert body["expected_add"] == pytest.approx(2 * np.sqrt(2 / np.pi) * 0.002, rel=0.1)
    # of a link without a surface it is that of the part it is reached from
    assert strict["links"]["foot"]["expected_add"] == pytest.approx(body["expected_add"])
    assert not told(0.002, 0.0028)["certain"]  # each axis is, the surface is not
    assert not told(0.002, 0.004, verdict="doubtful")["certain"]


@pytest.mark.parametrize(("rival", "certain"), [(0.005, True), (0.02, False)])
def test_nobody_is_certain_of_a_link_that_another_mode_has_elsewhere(
    problem: Problem, rng: np.random.Generator, rival: float, certain: bool
) -> None:
    part_poses, joints = standing(problem)
    report = report_of(problem, part_poses, joints, scattered(rng, part_poses, 300, 0.001, 0.0))
    posterior = drawn_about(rng, problem, part_poses, joints, 0.0005, rival=rival)
    placed = readout.place(problem, report, posterior)
    assert placed.certain(0.2).all() == certain
    found = to_result(readout.estimate(problem, report, placed, max_std=0.2))
    assert [mode["weight"] for mode in found["links"]["lid"]["modes"]] == pytest.approx([1 - rival, rival])
    assert [other["weight"] for other in found["alternatives"]] == pytest.approx([1 - rival, rival])
    apart = [other["links"]["lid"]["pose"]["position"]["y"] for other in found["alternatives"]]
    assert apart[1] - apart[0] == pytest.approx(0.5)
    # the half metre counts in the standard deviation by its weight
    y = found["links"]["body"]["std_xyz"][1]
    assert y == pytest.approx(0.5 * np.sqrt(rival), rel=0.05)


@pytest.mark.parametrize("told", [False, True])
def test_poses_that_do_not_fit_together_are_brought_onto_the_tree(
    problem: Problem, rng: np.random.Generator, told: bool
) -> None:
    """The paper's estimate: each part's best particle, a joint vector that has nothing to do with it or none."""
    part_poses, _ = standing(problem)
    apart = scattered(rng, part_poses, 1, 0.01, 0.02)[:, 0]
    vector = np.zeros(problem.mrf.model.dof) if told else None
    root, found = agreeing(problem, report_of(problem, apart, vector, np.repeat(apart[:, None], 300, axis=1)))
    model = problem.mrf.model
    assert np.all(found >= model.lower - 1e-12) and np.all(found <= model.upper + 1e-12)
    moved = np.linalg.norm(model.part_poses(root, found)[:, :3] - part_poses[:, :3], axis=1)
    assert moved.max() < 0.08
    kept = np.linalg.norm(model.part_poses(root, found)[:, :3] - apart[:, :3], axis=1)
    assert kept.min() < 1e-9  # one part is taken at its word


def test_an_estimate_on_the_tree_is_taken_as_it_is(problem: Problem) -> None:
    part_poses, joints = standing(problem)
    root, found = agreeing(problem, report_of(problem, part_poses, joints, np.repeat(part_poses[:, None], 300, axis=1)))
    assert np.array_equal(root, part_poses[0]) and np.array_equal(found, joints)


def test_errors_are_those_of_the_part_seen_through_any_of_its_links(problem: Problem) -> None:
    part_poses, joints = standing(problem)
    report = report_of(problem, part_poses, joints, np.repeat(part_poses[:, None], 300, axis=1))
    found = readout.estimate(problem, report)
    truth = {link.name: link.pose + np.r_[0.01, 0, 0, 0, 0, 0, 0] for link in found.links if link.name != "lid"}
    spun = float(joints[problem.mrf.model.coordinate_names.index("last")]) - 2 * np.pi - 0.1
    errors = truth_errors(problem.mrf.model, found, truth, {"last": spun})
    assert set(errors["parts"]) == {"body", "lid", "flap", "plate"}
    assert [entry["add"] for entry in errors["parts"].values()] == pytest.approx([0.01] * 4)
    assert errors["joints"] == {"last": pytest.approx(0.1)}
