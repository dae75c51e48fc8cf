"""A closed four-bar chain: the graph has a loop, and the messages go round it as they stand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import belief_propagation, mrf, problem, run
from pmpnbp.potentials.joint_projection import project
from pmpnbp.readout.metrics import add, model_points
from tests.inference import small_worlds as worlds
from tests.inference.recorded_steps import recorded_steps, scattered_state, slow_twin
from tests.inference.slow_boxes import Weighted

ROOT, ANGLES = worlds.at(1.2, -0.1, 0.4, yaw=0.3), np.array([0.4, -0.4, 0.4])


def test_the_object_is_closed() -> None:
    model = worlds.four_bar()
    assert len(model.parts) == 4 and len(model.edges) == 4 and model.dof == 3
    part_poses = model.part_poses(ROOT, ANGLES)
    closing = model.edges[3]
    relative = poses.multiply(poses.inverse(part_poses[closing.parent]), part_poses[closing.child])
    _, translation, rotation = project(closing, relative)
    np.testing.assert_allclose(np.concatenate([translation, rotation]), 0.0, atol=1e-9)


def test_the_graph_lists_every_message_once_and_nobody_answers_himself() -> None:
    model = worlds.four_bar()
    field = mrf.build(model)
    names = [part.name for part in model.parts]
    sent = [f"{names[t]} to {names[s]}" for t, s in zip(field.sender.tolist(), field.receiver.tolist(), strict=True)]
    pairs = ["link0 link1", "link1 link2", "link0 link3", "link3 link2"]
    both = [f"{a} to {b}" for pair in pairs for a, b in (pair.split(), pair.split()[::-1])]
    assert sent == both
    # every part of the ring hears from its two neighbours, and passes on to one what the other says
    assert all(len(incoming) == 2 for incoming in field.incoming)
    for e, feeding in enumerate(field.feeding):
        assert len(feeding) == 1
        assert field.receiver[feeding[0]] == field.sender[e]
        assert field.sender[feeding[0]] != field.receiver[e]
    # and so a message comes round after four steps, in either direction
    for e in range(8):
        seen, at = [], e
        for _ in range(4):
            at = field.feeding[at][0]
            seen.append(at)
        assert seen[-1] == e and len(set(seen)) == 4


def test_a_tree_has_no_such_way_round() -> None:
    field = mrf.build(worlds.hinged_chain(4))
    for e in range(len(field.sender)):
        at: list[int] = [e]
        for _ in range(4):
            at = [f for g in at for f in field.feeding[g]]
        assert at == []


def test_two_iterations_round_the_loop_agree_with_the_boxes(
    monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    def bump(node: Array, part_poses: Array) -> Array:
        return -np.sum((part_poses[..., :3] - 0.1 * node[..., None]) ** 2, axis=-1) / 0.1

    chosen = worlds.settings("paper", sigma_position=0.05, sigma_orientation=0.1, diffusion_position_end=0.02)
    model = worlds.four_bar()
    small = worlds.given_unary(model, bump, chosen)
    before: dict[tuple[int, int], Weighted] = {}
    for step in recorded_steps(monkeypatch, small, scattered_state(rng, small), steps=2):
        twin = slow_twin(small, model, step.report.iteration)
        fast = step.report.messages
        assert fast is not None
        sent = {}
        for e, (t, s) in enumerate(zip(fast.sender.tolist(), fast.receiver.tolist(), strict=True)):
            mu = step.samples.poses[e]
            weights = twin.message(*twin.factors(t, s, mu, step.axes[e], before))
            np.testing.assert_allclose(np.exp(fast.log_weights[e]), weights, rtol=4e-3)
            sent[t, s] = mu, twin.updated(s, (mu, weights))
        before = sent


@pytest.fixture(scope="module")
def scene() -> problem.Problem:
    model = worlds.four_bar()
    observation = worlds.seen(model, ROOT, ANGLES)
    prior = worlds.rough_prior(np.random.default_rng(1), ROOT)
    return problem.build(model, observation, prior, worlds.settings(search_proposals=600), particles=200)


@pytest.mark.parametrize("seed", [0, 1])
def test_it_finds_the_truth_from_a_rough_prior(scene: problem.Problem, seed: int) -> None:
    model = scene.mrf.model
    truth = model.part_poses(ROOT, ANGLES)
    report = list(run.iterate(replace(scene, seed=seed), 24))[-1]
    errors = [
        add(model_points(part.mesh), pose, true)
        for part, pose, true in zip(model.parts, report.map_poses, truth, strict=True)
    ]
    assert max(errors) < 0.01
    # the loop closes in the estimate although the tree does not ask for it
    closing = model.edges[3]
    relative = poses.multiply(poses.inverse(report.map_poses[closing.parent]), report.map_poses[closing.child])
    _, translation, _ = project(closing, relative)
    assert np.linalg.norm(translation) < 0.01


def test_the_beliefs_agree_with_the_joint_that_closes_the_loop(scene: problem.Problem) -> None:
    """Started from a wide belief about the truth, belief propagation alone brings the bars' best particles together."""
    model = scene.mrf.model
    alone = replace(scene, settings=worlds.settings(search_iterations=0, object_estimate=False))
    truth = model.part_poses(ROOT, ANGLES)
    rng = np.random.default_rng(3)
    start = scattered_state(rng, alone).belief
    noise = rng.standard_normal((2, *start.poses.shape[:2], 3))
    wide = poses.perturb(truth[:, None], 0.03 * noise[0], 0.1 * noise[1], alone.mrf.centres[:, None])
    flat = np.full(start.log_weights.shape, -np.log(start.log_weights.shape[1]))
    state = replace(run.begin(alone)[0], belief=replace(start, poses=wide, log_weights=flat))
    for number in range(1, 15):
        state, report = belief_propagation.step(np.random.default_rng([4, number]), state, alone)
        assert np.all(np.isfinite(report.belief.poses)) and not np.any(np.isnan(report.belief.log_weights))
    closing = model.edges[3]
    relative = poses.multiply(poses.inverse(report.map_poses[closing.parent]), report.map_poses[closing.child])
    _, translation, _ = project(closing, relative)
    assert np.linalg.norm(translation) < 0.02
    distance = np.linalg.norm(report.map_poses[:, :3] - truth[:, :3], axis=1)
    assert distance.max() < 0.02
