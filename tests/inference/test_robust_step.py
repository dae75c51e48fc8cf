"""Preset `robust`: the product over shared samples agrees with a slow transcription, and a step is a pure function."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import belief_propagation, run
from pmpnbp.inference import log_weights as lw
from pmpnbp.inference.belief import NEIGHBOUR, OWN, Belief, Messages
from pmpnbp.potentials.joint_projection import project
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.prior import GaussianPrior
from tests.inference import small_worlds as worlds
from tests.inference.recorded_steps import recorded_steps, scattered_state, slow_twin
from tests.inference.slow_boxes import Weighted

MODELS = {"sliding chain": worlds.sliding_chain(3), "hinged chain": worlds.hinged_chain(3), "star": worlds.star(3)}
TOLERANCE = 4e-3  # the pairwise sums promise a logarithm within 1e-3; three of them meet in a weight


def bump(node: Array, part_poses: Array) -> Array:
    """A smooth log unary potential, different for every node."""
    place = np.stack([0.1 * np.cos(node), 0.1 * np.sin(2.0 * node), 0.05 * node], axis=-1)
    turn = poses.rotation_angle(part_poses[..., 3:], poses.IDENTITY[3:])
    return 20.0 - np.sum((part_poses[..., :3] - place) ** 2, axis=-1) / 0.02 - 0.5 * turn**2


def robust(model: ArticulatedObject, particles: int = 6, **changes: object) -> worlds.GivenUnary:
    chosen = worlds.settings("robust", **({"search_iterations": 0, "object_estimate": False} | changes))
    return worlds.given_unary(model, bump, chosen, particles=particles)


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("share", [0.0, 0.5], ids=["untempered", "tempered"])
def test_two_iterations_agree_with_the_slow_product(
    monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator, name: str, share: float
) -> None:
    model = MODELS[name]
    problem = robust(model, effective_share=share, joint_draws=3)
    before: dict[tuple[int, int], Weighted] = {}
    for step in recorded_steps(monkeypatch, problem, scattered_state(rng, problem), steps=2):
        twin = slow_twin(problem, model, step.report.iteration)
        power = step.report.inverse_temperature
        assert np.all(power < 1) if share else np.all(power == 1)
        fast, belief = step.report.messages, step.report.belief
        assert fast is not None
        together: dict[int, list[list[float]]] = {node: [] for node in twin.neighbours}
        sent: dict[tuple[int, int], Weighted] = {}
        for e, (t, s) in enumerate(zip(fast.sender.tolist(), fast.receiver.tolist(), strict=True)):
            mu = step.samples.poses[s]  # all messages to s judge the same samples
            unary, neighbouring = twin.factors(t, s, mu, step.axes[e], before, power[s])
            together[s] += [unary, neighbouring]
            sent[t, s] = mu, twin.message(unary, neighbouring)
            np.testing.assert_array_equal(fast.poses[e], mu)
            np.testing.assert_allclose(fast.log_unary[e], np.log(unary), atol=1e-8)
            np.testing.assert_allclose(np.exp(fast.log_weights[e]), sent[t, s][1], rtol=TOLERANCE, atol=1e-9)
        for s, factors in together.items():
            weights = twin.product(s, step.samples.poses[s], factors, power[s])
            np.testing.assert_allclose(np.exp(belief.log_weights[s]), weights, rtol=3 * TOLERANCE, atol=1e-9)
        before = sent


@pytest.mark.parametrize("name", MODELS)
def test_shares_add_up_to_the_log_weight(rng: np.random.Generator, name: str) -> None:
    problem = robust(MODELS[name], particles=40)
    state = scattered_state(rng, problem)
    for number in (1, 2, 3):
        state, report = belief_propagation.step(np.random.default_rng([1, number]), state, problem)
        own = report.inverse_temperature[:, None] * report.belief.log_unary
        total = own + np.nansum(report.log_message_shares, axis=2)
        np.testing.assert_allclose(report.belief.log_weights, lw.normalise(total), atol=1e-9)
        messages = report.messages
        assert messages is not None
        for node, incoming in enumerate(problem.mrf.incoming):
            for place, message in enumerate(incoming):
                share = messages.log_unary[message] + messages.log_neighbour[message]
                np.testing.assert_array_equal(report.log_message_shares[node, :, place], share)
            assert np.all(np.isnan(report.log_message_shares[node, :, len(incoming) :]))


def test_a_gaussian_prior_goes_on_weighing_its_part(rng: np.random.Generator) -> None:
    model = MODELS["star"]
    prior = GaussianPrior("link2", worlds.at(0.1), np.full(3, 0.05), np.full(3, 0.2), {})
    chosen = worlds.settings("robust", search_iterations=0, object_estimate=False)
    problem = worlds.given_unary(model, bump, chosen, prior=prior, particles=30)
    assert model.parts[problem.prior_node].name == "link2"
    state = scattered_state(rng, problem)
    _, report = belief_propagation.step(rng, state, problem)
    total = report.inverse_temperature[:, None] * report.belief.log_unary + np.nansum(report.log_message_shares, axis=2)
    total[problem.prior_node] += problem.log_prior(report.belief.poses[problem.prior_node])
    np.testing.assert_allclose(report.belief.log_weights, lw.normalise(total), atol=1e-9)


def test_every_particle_can_be_traced(rng: np.random.Generator) -> None:
    still = {
        "diffusion_position_start": 0.0,
        "diffusion_position_end": 0.0,
        "diffusion_rotation_start": 0.0,
        "diffusion_rotation_end": 0.0,
    }
    problem = robust(MODELS["star"], particles=60, **still)
    state = scattered_state(rng, problem)
    _, report = belief_propagation.step(rng, state, problem)
    belief, before = report.belief, state.belief
    borrowed = round(problem.settings.neighbour_proposals * problem.particles)
    for node in range(problem.mrf.nodes):
        own = belief.origin.source[node] == OWN
        assert np.count_nonzero(belief.origin.source[node] == NEIGHBOUR) == borrowed
        assert np.all(belief.origin.source[node][~own] == NEIGHBOUR)
        assert np.all(belief.origin.neighbour[node][own] == -1)
        assert np.all((belief.origin.ancestor[node] >= 0) & (belief.origin.ancestor[node] < before.poses.shape[1]))
        np.testing.assert_allclose(
            belief.poses[node][own], before.poses[node][belief.origin.ancestor[node][own]], atol=1e-12
        )
        lenders = set(problem.mrf.sender[list(problem.mrf.incoming[node])].tolist())
        assert set(belief.origin.neighbour[node][~own].tolist()) == lenders
        for particle in np.flatnonzero(~own):
            # what came through a joint lies on it
            lender = int(belief.origin.neighbour[node, particle])
            ancestor = before.poses[lender, belief.origin.ancestor[node, particle]]
            edge = next(e for e in problem.mrf.model.edges if {e.parent, e.child} == {node, lender})
            pair = (ancestor, belief.poses[node, particle])
            parent, child = pair if edge.parent == lender else pair[::-1]
            _, translation, rotation = project(edge, poses.multiply(poses.inverse(parent), child))
            np.testing.assert_allclose(np.concatenate([translation, rotation]), 0.0, atol=1e-9)


def arrays_of(value: Belief | Messages) -> dict[str, Array]:
    members = vars(value) | (vars(value.origin) if isinstance(value, Belief) else {})
    return {name: member for name, member in members.items() if isinstance(member, np.ndarray)}


def test_states_and_reports_are_read_only(rng: np.random.Generator) -> None:
    problem = robust(MODELS["star"])
    state, report = belief_propagation.step(rng, scattered_state(rng, problem), problem)
    assert state.messages is not None and report.messages is not None
    for value in (state.belief, state.messages, report.belief, report.messages):
        for array in arrays_of(value).values():
            with pytest.raises(ValueError, match="read-only"):
                array[...] = 0


def test_a_step_leaves_its_state_as_it_was(rng: np.random.Generator) -> None:
    problem = robust(MODELS["star"])
    state = scattered_state(rng, problem)
    copy = {name: array.copy() for name, array in arrays_of(state.belief).items()}
    belief_propagation.step(rng, state, problem)
    for name, array in arrays_of(state.belief).items():
        np.testing.assert_array_equal(array, copy[name])


@pytest.mark.parametrize("preset", ["robust", "paper"])
def test_the_same_seed_gives_the_same_run_and_another_seed_another(preset: str) -> None:
    def beliefs(seed: int) -> list[Array]:
        chosen = worlds.settings(preset, search_iterations=0, object_estimate=False)
        problem = worlds.given_unary(MODELS["hinged chain"], bump, chosen, particles=20, seed=seed)
        return [report.belief.poses for report in run.iterate(problem, 3)]

    for first, second in zip(beliefs(1), beliefs(1), strict=True):
        assert first.tobytes() == second.tobytes()
    assert not np.array_equal(beliefs(1)[-1], beliefs(2)[-1])


@pytest.mark.parametrize("preset", ["robust", "paper"])
def test_an_iteration_done_again_from_its_state_is_the_same(preset: str) -> None:
    chosen = worlds.settings(preset, search_iterations=0, object_estimate=False)
    problem = worlds.given_unary(MODELS["star"], bump, chosen, particles=20)
    state, _ = run.begin(problem)
    states = [state]
    for _ in range(3):
        state, _ = run.advance(state, problem)
        states.append(state)
    # from a copy, as it would come back from a recording
    kept = states[2]
    messages = replace(kept.messages, poses=kept.messages.poses.copy()) if kept.messages else None
    again, _ = run.advance(replace(kept, belief=replace(kept.belief), messages=messages), problem)
    expected = arrays_of(states[3].belief)
    for name, array in arrays_of(again.belief).items():
        assert array.tobytes() == expected[name].tobytes(), name


@pytest.mark.parametrize(("draws", "kept"), [(1, 0.999), (8, 0.5)])
def test_tempering_keeps_the_particles_effective_where_the_evidence_is_overwhelming(
    rng: np.random.Generator, draws: int, kept: float
) -> None:
    """Exactly with one joint draw. Tempering sees of several draws the best, where the message takes their mean: the
    effective sample size then comes out between two thirds of what was asked for and all of it."""
    model, share, particles = MODELS["sliding chain"], 0.2, 100

    def steep(node: Array, part_poses: Array) -> Array:
        return -1e5 * np.abs(part_poses[..., 0])

    effective = {}
    for setting in (0.0, share):
        chosen = worlds.settings(search_iterations=0, object_estimate=False, effective_share=setting, joint_draws=draws)
        problem = worlds.given_unary(model, steep, chosen, particles=particles)
        # the first iteration: no message has a neighbour's factor yet, which tempering leaves alone
        _, report = belief_propagation.step(np.random.default_rng(2), scattered_state(rng, problem), problem)
        effective[setting] = report.effective_sample_size
        expected = lw.effective_sample_size(report.belief.log_weights)
        np.testing.assert_array_equal(report.effective_sample_size, expected)
    assert np.all(effective[0.0] < 2)
    assert np.all(effective[share] > kept * share * particles)


def test_tempering_leaves_weak_evidence_alone(rng: np.random.Generator) -> None:
    chosen = worlds.settings(search_iterations=0, object_estimate=False)
    problem = worlds.given_unary(
        MODELS["star"], lambda node, pose: -np.sum(pose[:, :3] ** 2, axis=1), chosen, particles=50
    )
    _, report = belief_propagation.step(rng, scattered_state(rng, problem), problem)
    np.testing.assert_array_equal(report.inverse_temperature, 1.0)
