"""Marginals are weighted histograms: known weights give known densities, angles are those of another library."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pmpnbp.geometry import poses
from pmpnbp.inference import run
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.problem import Problem, build
from pmpnbp.readout.estimate import estimate, place
from pmpnbp.readout.marginals import NARROWEST, Marginal, histogram, marginals
from pmpnbp.scene.prior import UniformPrior
from pmpnbp.scene.urdf import load_model
from tests.inference.small_worlds import cupboard, cupboard_truth, seen, settings


@pytest.fixture(scope="module")
def made() -> tuple[Problem, list[IterationReport]]:
    """A cupboard with a slide and a hinge, from the start over the search to belief propagation."""
    model = cupboard()
    quick = settings(search_iterations=2, search_iterations_per_joint=0, search_proposals=300, splat_points=64)
    built = build(model, seen(model, *cupboard_truth()), UniformPrior("upright"), quick, particles=60, seed=3)
    return built, list(run.iterate(built, 5))


def mass(found: Marginal) -> float:
    return float(found.density @ np.diff(found.edges))


def mean(found: Marginal) -> float:
    """By the middles of the bars, so right to half a bar."""
    return float((found.density * np.diff(found.edges)) @ ((found.edges[:-1] + found.edges[1:]) / 2)) / mass(found)


def test_known_weights_make_known_densities() -> None:
    """Three particles on [0, 4]: a half, a quarter and a quarter of the weight in bars 1 wide."""
    found = histogram("x", "m", np.array([4.0, 0.0, 2.5]), np.array([1.0, 2.0, 1.0]), 1.0, 4)
    np.testing.assert_allclose(found.edges, [0, 1, 2, 3, 4])
    np.testing.assert_allclose(found.density, [0.5, 0, 0.25, 0.25])
    assert found.estimate == 1.0


def test_density_is_per_unit() -> None:
    found = histogram("x", "m", np.array([0.0, 0.5]), np.array([3.0, 1.0]), 0.2, 2)
    np.testing.assert_allclose(found.density, [3.0, 1.0])
    assert mass(found) == pytest.approx(1)


def test_light_particles_far_away_do_not_widen_it() -> None:
    values = np.concatenate([np.linspace(0, 1, 1001), [1e3, -1e3]])
    weights = np.concatenate([np.ones(1001), [1e-3, 1e-3]])
    found = histogram("x", "m", values, weights, 0.5, 10)
    assert -0.01 < found.edges[0] < found.edges[-1] < 1.01
    assert 0.998 <= mass(found) <= 1


def test_the_estimate_is_always_in_it() -> None:
    found = histogram("x", "m", np.array([0.0, 1.0]), np.ones(2), 5.0, 5)
    assert (found.edges[0], found.edges[-1]) == (0.0, 5.0)
    np.testing.assert_allclose(found.density, [0.5, 0.5, 0, 0, 0])


def test_particles_in_one_place_have_a_histogram() -> None:
    found = histogram("x", "m", np.full(5, 2.0), np.ones(5), 2.0, 4)
    assert found.edges[-1] - found.edges[0] == pytest.approx(NARROWEST)
    assert mass(found) == pytest.approx(1)


def test_angles_are_scipys(made: tuple[Problem, list[IterationReport]]) -> None:
    """Roll, pitch, yaw about fixed axes, weighted; also near the end of a turn."""
    problem, reports = made
    links = problem.mrf.model.links
    report = reports[-1]
    for link in links:
        particles = place(problem, report).particles[:, links.index(link)]
        node = next(n for n, part in enumerate(problem.mrf.model.parts) if link in part.links)
        weights = np.exp(report.belief.log_weights[node])
        found = {one.name: one for one in marginals(problem, report, link, 64)}
        turns = Rotation.from_quat(particles[:, [4, 5, 6, 3]]).as_euler("xyz")
        at = next(one.pose for one in estimate(problem, report).links if one.name == link)
        true = Rotation.from_quat(at[[4, 5, 6, 3]]).as_euler("xyz")
        for axis, name in enumerate(("roll", "pitch", "yaw")):
            one = found[name]
            assert one.estimate == pytest.approx(true[axis], abs=1e-9) and one.unit == "rad"
            near = true[axis] + np.angle(np.exp(1j * (turns[:, axis] - true[axis])))
            inside = (near >= one.edges[0] - 1e-9) & (near <= one.edges[-1] + 1e-9)
            assert weights[inside].sum() == pytest.approx(mass(one), abs=1e-9) and mass(one) > 0.99
            bar = one.edges[1] - one.edges[0]
            expected = float(weights[inside] @ near[inside] / weights[inside].sum())
            assert mean(one) == pytest.approx(expected, abs=bar / 2 + 1e-9)


def test_an_angle_is_not_torn_apart_at_the_end_of_a_turn(made: tuple[Problem, list[IterationReport]]) -> None:
    """The whole object turned about world's z until its yaw is half a turn: the histogram stays as narrow."""
    problem, reports = made
    report = reports[-1]
    root = problem.mrf.model.parts[0].links[0]
    plain = next(one for one in marginals(problem, report, root) if one.name == "yaw")
    turn = poses.from_xyz_rpy(np.zeros(3), np.array([0.0, 0.0, np.pi - plain.estimate]))
    belief = replace(report.belief, poses=poses.multiply(turn, report.belief.poses))
    turned = replace(report, belief=belief, map_poses=poses.multiply(turn, report.map_poses))
    found = next(one for one in marginals(problem, turned, root) if one.name == "yaw")
    assert np.cos(found.estimate) == pytest.approx(-1)
    assert found.edges[-1] - found.edges[0] == pytest.approx(plain.edges[-1] - plain.edges[0], abs=1e-9)


def test_joints_are_those_of_the_part(made: tuple[Problem, list[IterationReport]]) -> None:
    """Whole-object hypotheses have joint positions; afterwards pairs of particles do; the root hangs on nothing."""
    problem, reports = made
    model = problem.mrf.model
    assert reports[1].belief.joint_positions is not None and reports[-1].belief.joint_positions is None
    for report in (reports[1], reports[-1]):
        told = estimate(problem, report)
        positions = {one.joint.name: one for one in told.joints}
        for edge in model.edges:
            (joint,) = model.edge_joints(edge)
            link = model.parts[edge.child].links[0]
            (found,) = [one for one in marginals(problem, report, link) if one.name.startswith("joint")]
            assert found.name == f"joint {joint.name}"
            assert found.unit == ("m" if joint.kind == "prismatic" else "rad")
            assert found.estimate == pytest.approx(positions[joint.name].position[0])
            assert positions[joint.name].lower[0] - 1e-9 <= found.edges[0]
            assert found.edges[-1] <= positions[joint.name].upper[0] + NARROWEST
        root = marginals(problem, report, model.parts[0].links[0])
        assert [one.name for one in root] == ["x", "y", "z", "roll", "pitch", "yaw"]


def test_joint_weights_count(made: tuple[Problem, list[IterationReport]]) -> None:
    """Of whole-object hypotheses the heavy one's joint position has its weight."""
    problem, reports = made
    report = reports[1]
    belief = report.belief
    assert belief.joint_positions is not None
    weights = np.full(belief.log_weights.shape[1], 0.1 / (belief.log_weights.shape[1] - 1))
    weights[3] = 0.9
    heavy = replace(report, belief=replace(belief, log_weights=np.tile(np.log(weights), (len(belief.log_weights), 1))))
    edge = problem.mrf.model.edges[0]
    found = marginals(problem, heavy, problem.mrf.model.parts[edge.child].links[0])[-1]
    at = edge.axis_positions(belief.joint_positions)[3, 0]
    bar = min(int(np.searchsorted(found.edges, at, side="right")) - 1, len(found.density) - 1)
    assert found.density[bar] * np.diff(found.edges)[bar] >= 0.9 - 1e-9


URDF = """
<robot name="cart">
  <link name="floor"><visual><geometry><box size="1 1 0.1"/></geometry></visual></link>
  <link name="stage"/>
  <link name="arm"><visual><geometry><box size="0.1 0.1 0.4"/></geometry></visual></link>
  <joint name="roam" type="planar"><parent link="floor"/><child link="stage"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="lift" type="prismatic"><parent link="stage"/><child link="arm"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.5" effort="1" velocity="1"/></joint>
</robot>
"""


def test_an_edge_of_several_joints_names_them_all(tmp_path: Path) -> None:
    (tmp_path / "cart.urdf").write_text(URDF)
    model = load_model(tmp_path / "cart.urdf")
    (edge,) = model.edges
    assert [joint.name for joint in model.edge_joints(edge)] == ["roam", "lift"]
    assert len(edge.axes) == sum(len(joint.elementary_axes()[0]) for joint in model.edge_joints(edge))
