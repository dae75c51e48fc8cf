"""Preset `paper` is algorithm boxes 1 and 2: it agrees with their slow transcription, sample for sample."""

from __future__ import annotations

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import belief_propagation
from pmpnbp.inference.belief import OWN
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.settings import schedule
from tests.inference import small_worlds as worlds
from tests.inference.recorded_steps import recorded_steps, scattered_state, slow_twin
from tests.inference.slow_boxes import Weighted

MODELS = {"sliding chain": worlds.sliding_chain(3), "hinged chain": worlds.hinged_chain(3), "star": worlds.star(3)}
# The pairwise sums promise a logarithm within 1e-3; three of them meet in a weight.
TOLERANCE = 4e-3


def bump(node: Array, part_poses: Array) -> Array:
    """A smooth log unary potential, different for every node."""
    place = np.stack([0.1 * np.cos(node), 0.1 * np.sin(2.0 * node), 0.05 * node], axis=-1)
    turn = poses.rotation_angle(part_poses[..., 3:], poses.IDENTITY[3:])
    return -np.sum((part_poses[..., :3] - place) ** 2, axis=-1) / 0.1 - 0.3 * turn**2


def paper(model: ArticulatedObject, **changes: object) -> worlds.GivenUnary:
    # sigmas wide enough for six scattered particles to have something to say to each other
    wide = {"sigma_position": 0.05, "sigma_orientation": 0.1, "diffusion_position_end": 0.02}
    return worlds.given_unary(model, bump, worlds.settings("paper", **(wide | changes)))


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("keep", [True, False], ids=["to the letter", "without the receiver's unary"])
def test_two_iterations_agree_with_the_boxes(
    monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator, name: str, keep: bool
) -> None:
    model = MODELS[name]
    problem = paper(model, messages_keep_unary=keep)
    state = scattered_state(rng, problem)
    before: dict[tuple[int, int], Weighted] = {}
    neighbour_factors = []
    for step in recorded_steps(monkeypatch, problem, state, steps=2):
        twin = slow_twin(problem, model, step.report.iteration)
        messages: dict[tuple[int, int], Weighted] = {}
        fast = step.report.messages
        assert fast is not None and step.state.messages is not None
        for e, (t, s) in enumerate(zip(fast.sender.tolist(), fast.receiver.tolist(), strict=True)):
            mu = step.samples.poses[e]  # box 1 draws anew for every message
            unary, neighbouring = twin.factors(t, s, mu, step.axes[e], before)
            messages[t, s] = mu, twin.message(unary, neighbouring)
            np.testing.assert_allclose(fast.log_unary[e], np.log(unary), atol=1e-9)
            np.testing.assert_allclose(fast.log_neighbour[e], np.log(neighbouring), atol=2 * TOLERANCE)
            np.testing.assert_allclose(np.exp(fast.log_weights[e]), messages[t, s][1], rtol=TOLERANCE)
            neighbour_factors.append(np.ptp(np.log(neighbouring)))
        sent = {}
        for e, (t, s) in enumerate(zip(fast.sender.tolist(), fast.receiver.tolist(), strict=True)):
            weights = twin.updated(s, messages[t, s]) if keep else messages[t, s][1]
            sent[t, s] = messages[t, s][0], weights
            np.testing.assert_allclose(np.exp(step.state.messages.log_weights[e]), weights, rtol=TOLERANCE)
        for s, neighbours in twin.neighbours.items():
            samples, weights = twin.pooled(s, [messages[t, s] for t in neighbours])
            filled = len(samples)
            belief = step.report.belief
            np.testing.assert_array_equal(belief.poses[s, :filled], samples)
            np.testing.assert_allclose(np.exp(belief.log_weights[s, :filled]), weights, rtol=TOLERANCE)
            assert np.all(belief.log_weights[s, filled:] == -np.inf)
        before = sent
    assert max(neighbour_factors) > 0.1  # else the sums of step 2c were put to no test


def test_keeping_the_receivers_unary_changes_the_second_iteration(rng: np.random.Generator) -> None:
    beliefs = []
    for keep in (True, False):
        problem = paper(MODELS["hinged chain"], messages_keep_unary=keep)
        state = scattered_state(np.random.default_rng(4), problem)
        for number in (1, 2):
            state, _ = belief_propagation.step(np.random.default_rng([5, number]), state, problem)
        beliefs.append(state.belief.log_weights)
    assert not np.allclose(beliefs[0], beliefs[1])


def test_samples_are_the_beliefs_particles_where_nothing_diffuses(rng: np.random.Generator) -> None:
    problem = paper(MODELS["star"], diffusion_position_end=0.0, diffusion_rotation_end=0.0)
    state = scattered_state(rng, problem)
    node = problem.mrf.receiver
    samples = belief_propagation.draw(rng, state, problem, node, schedule(problem.settings, 1))
    assert np.all(samples.origin.source == OWN) and np.all(samples.origin.neighbour == -1)
    expected = np.take_along_axis(state.belief.poses[node], samples.origin.ancestor[..., None], axis=1)
    np.testing.assert_allclose(samples.poses, expected, atol=1e-12)


def test_ancestors_are_drawn_in_proportion_to_the_weights(rng: np.random.Generator) -> None:
    """Counts of 6 particles over 3000 draws; beyond 4.5 standard deviations of independent draws in any of 24 counts:
    under 2e-4 by chance (systematic draws vary less than independent ones)."""
    problem = paper(MODELS["star"])
    state = scattered_state(rng, problem)
    nodes = np.arange(4, dtype=np.int32)
    repeats, count = 500, problem.particles
    counts = np.zeros((4, count))
    for _ in range(repeats):
        drawn = belief_propagation.draw(rng, state, problem, nodes, schedule(problem.settings, 1))
        for node in nodes:
            counts[node] += np.bincount(drawn.origin.ancestor[node], minlength=count)
    weights = np.exp(state.belief.log_weights)
    total = repeats * count
    deviation = np.sqrt(total * weights * (1 - weights))
    assert np.abs(counts - total * weights).max() < 4.5 * deviation.max()
    assert np.all(np.abs(counts - total * weights) < 4.5 * deviation + 1)


def test_diffusion_has_the_spread_it_says(rng: np.random.Generator) -> None:
    """Standard deviations of 4 × 3000 displacements, known to 0.7 %; 4 % off has a chance under 1e-7."""
    model = MODELS["star"]
    problem = worlds.given_unary(
        model, bump, worlds.settings("paper", diffusion_position_end=0.02, diffusion_rotation_end=0.05), particles=3000
    )
    state = scattered_state(rng, problem, count=50)
    nodes = np.arange(4, dtype=np.int32)
    drawn = belief_propagation.draw(rng, state, problem, nodes, schedule(problem.settings, 1))
    origin = np.take_along_axis(state.belief.poses, drawn.origin.ancestor[..., None], axis=1)
    centre = problem.mrf.centres[:, None]
    shift = poses.transform_points(drawn.poses, centre) - poses.transform_points(origin, centre)
    turn = poses.quaternion_multiply(drawn.poses[..., 3:], poses.quaternion_conjugate(origin[..., 3:]))
    np.testing.assert_allclose(shift.std(axis=(0, 1)), 0.02, rtol=0.04)
    np.testing.assert_allclose(poses.to_rotation_vector(turn).std(axis=(0, 1)), 0.05, rtol=0.04)


def test_the_best_particles_are_the_estimate(monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator) -> None:
    problem = paper(MODELS["hinged chain"])
    (step,) = recorded_steps(monkeypatch, problem, scattered_state(rng, problem), steps=1)
    belief = step.report.belief
    best = belief.log_weights.argmax(axis=1)
    np.testing.assert_array_equal(step.report.map_poses, belief.poses[np.arange(3), best])
    assert np.isnan(step.report.map_score)
