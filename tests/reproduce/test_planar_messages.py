"""Pull and push messages against slow twins and against exact Gaussian answers."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.reproduce.planar import pull, push
from benchmarks.reproduce.planar.mixture import Mixture
from benchmarks.reproduce.planar.pattern import Hinge, Pattern, across, four_arms, log_pairwise
from benchmarks.reproduce.planar.problem import PlanarProblem, Samples, Settings, Span, resample, uniform

FIGURE = four_arms()
SIZE = 60
# two points held together by a Gaussian and free to turn: every potential and so every answer is Gaussian
PAIR = Pattern((0, 1), (Hinge(0, 1, (0.0, 0.0), (0.0, 0.0), 0.0, np.pi),))
CENTRES = np.array([[25.0, 30.0], [33.0, 26.0]])
UNARY_SIGMA = np.array([3.0, 4.0])
PAIR_SIGMA = 3.0


def gaussian_unary(node: int, poses: np.ndarray, sharpness: float) -> np.ndarray:
    squared = np.sum((poses[..., :2] - CENTRES[node % 2]) ** 2, axis=-1)
    return -0.5 * squared / UNARY_SIGMA[node % 2] ** 2


def problem(pattern: Pattern, components: int) -> PlanarProblem:
    settings = Settings(
        components=components,
        sigma_position=Span(PAIR_SIGMA, PAIR_SIGMA),
        sigma_angle=Span(0.2, 0.2),
        diffusion_position=Span(1.0, 1.0),
        diffusion_angle=Span(0.1, 0.1),
    )
    return PlanarProblem(pattern, gaussian_unary, settings, SIZE)


@pytest.mark.parametrize("message", [0, 1, 2, 3])
def test_pull_weights_are_those_of_loops(message: int) -> None:
    """Box 1 in loops: the message of the circle has three others feeding it, an outer arm's none."""
    task = problem(FIGURE, 30)
    plan = task.plan(2)
    state, _ = pull.step(np.random.default_rng(1), pull.start(np.random.default_rng(0), task), task)
    found, terms = pull.update_message(np.random.default_rng(2), task, message, state, plan)

    rng = np.random.default_rng(2)
    sender, receiver = FIGURE.sender[message], FIGURE.receiver[message]
    received = resample(rng, state.beliefs[receiver], 30, plan.diffusion)
    sent = across(rng, FIGURE, message, received, True, plan.sigma_position, plan.sigma_angle)
    log_weights = []
    for pose, other_end in zip(received, sent, strict=True):
        weight = float(gaussian_unary(sender, other_end, plan.sharpness))
        for feeding in FIGURE.feeding[message]:
            into = state.messages[feeding]
            heard = 0.0
            for log_w, mean in zip(into.log_weights, into.poses, strict=True):
                pairwise = log_pairwise(FIGURE, message, mean, pose, plan.sigma_position, plan.sigma_angle)
                if pairwise > -pull.FARTHEST:
                    heard += np.exp(log_w + pairwise)
            weight += np.log(max(heard, np.exp(-pull.FARTHEST)))
        log_weights.append(weight)
    expected = np.array(log_weights) - np.logaddexp.reduce(log_weights)
    np.testing.assert_array_equal(found.poses, received)
    np.testing.assert_allclose(found.log_weights, expected, atol=1e-9)
    assert terms == len(FIGURE.feeding[message]) * 30**2


def test_a_pulled_belief_is_all_incoming_samples_weighed_by_the_picture() -> None:
    """Box 2: every incoming message has the same share, whatever it is made of."""
    task = problem(FIGURE, 20)
    state, _ = pull.step(np.random.default_rng(1), pull.start(np.random.default_rng(0), task), task)
    for node, incoming in enumerate(FIGURE.incoming):
        weights = np.exp(state.beliefs[node].log_weights).reshape(len(incoming), 20)
        np.testing.assert_allclose(weights.sum(axis=1), 1 / len(incoming))
        for row, message in zip(weights, incoming, strict=True):
            own = np.exp(state.messages[message].log_weights) * np.exp(
                gaussian_unary(node, state.messages[message].poses, 1.0)
            )
            np.testing.assert_allclose(row, own / own.sum() / len(incoming), rtol=1e-9)


def test_pull_finds_the_mean_of_two_gaussians_held_together() -> None:
    """The exact belief of node 0 is Gaussian about the precision-weighted mean of its own centre and of node 1's seen
    through the joint. Samples that come from the last belief and are weighed again are too narrow, but about the same
    mean: eight later beliefs of 1000 samples know it to well under half a pixel."""
    task = problem(PAIR, 1000)
    state = pull.start(np.random.default_rng(5), task)
    means = []
    for iteration in range(12):
        state, _ = pull.step(np.random.default_rng([5, iteration]), state, task)
        means.append([np.exp(b.log_weights) @ b.poses[:, :2] for b in state.beliefs])
    for node in (0, 1):
        own, seen = UNARY_SIGMA[node] ** -2, 1 / (UNARY_SIGMA[1 - node] ** 2 + PAIR_SIGMA**2)
        exact = (own * CENTRES[node] + seen * CENTRES[1 - node]) / (own + seen)
        np.testing.assert_allclose(np.mean(means[4:], axis=0)[node], exact, atol=0.5)


@pytest.mark.parametrize("factors", [1, 2, 3])
def test_push_weighs_the_product_of_mixtures_by_the_picture(factors: int) -> None:
    """Messages that are one Gaussian in many equal parts, times a Gaussian unary potential: the exact product's mean
    and variance in x and y. 20000 draws of effective size above 5000 know the mean to 5 deviations (6e-7 by chance) of
    σ/√5000, and the variance likewise to 5 √(2/5000) = 10 %."""
    task = problem(FIGURE, 20_000)
    plan = task.plan(1)
    centres = np.array([[28.0, 27.0, 0.1], [31.0, 33.0, -0.2], [24.0, 29.0, 0.0]])[:factors]
    sigma = np.array([3.0, 3.0, 0.3])
    messages = [Mixture(np.tile(c, (4, 1)), np.full(4, -np.log(4)), sigma) for c in centres]
    at_means = [gaussian_unary(0, m.means, 1.0) for m in messages]
    draws = push.draw_weighed(np.random.default_rng(6), task, 0, messages, at_means, plan)
    weights = np.exp(draws.log_weights)
    assert 1 / np.sum(weights**2) > 5000
    precision = factors / sigma[0] ** 2 + UNARY_SIGMA[0] ** -2
    exact = (centres[:, :2].sum(axis=0) / sigma[0] ** 2 + CENTRES[0] * UNARY_SIGMA[0] ** -2) / precision
    mean = weights @ draws.poses[:, :2]
    np.testing.assert_allclose(mean, exact, atol=5 * np.sqrt(1 / precision / 5000))
    np.testing.assert_allclose(weights @ (draws.poses[:, :2] - mean) ** 2, 1 / precision, rtol=0.10)


def test_a_pushed_message_is_the_premessage_seen_through_the_joint() -> None:
    """From one pose at the sender: a Gaussian of ψ's deviation about it, and any turn."""
    task = problem(PAIR, 5000)
    poses = np.tile([30.0, 20.0, 0.5], (5000, 1))
    sent = Samples(poses, np.full(5000, -np.log(5000)))
    message = push.push_message(np.random.default_rng(7), task, 0, sent, task.plan(1))
    # five standard deviations of the mean and of the standard deviation
    np.testing.assert_allclose(message.means[:, :2].mean(axis=0), [30.0, 20.0], atol=5 * PAIR_SIGMA / np.sqrt(5000))
    np.testing.assert_allclose(message.means[:, :2].std(axis=0), PAIR_SIGMA, rtol=5 / np.sqrt(2 * 5000))
    assert np.all(message.spread <= task.plan(1).diffusion)


def test_both_begin_with_the_same_uniform_beliefs() -> None:
    task = problem(FIGURE, 10)
    starts = [way.start(np.random.default_rng(9), task) for way in (pull, push)]
    for ours, theirs, alone in zip(
        starts[0].beliefs, starts[1].beliefs, uniform(np.random.default_rng(9), task), strict=True
    ):
        np.testing.assert_array_equal(ours.poses, theirs.poses)
        np.testing.assert_array_equal(ours.poses, alone.poses)


def test_evaluations_are_counted_as_they_are_made() -> None:
    """What a report says of φ is what was asked of it, in first and later iterations of both."""
    asked = 0

    def counted(node: int, poses: np.ndarray, sharpness: float) -> np.ndarray:
        nonlocal asked
        asked += len(poses)
        return gaussian_unary(node, poses, sharpness)

    task = PlanarProblem(FIGURE, counted, Settings(components=8), SIZE)
    for way in (pull, push):
        state = way.start(np.random.default_rng(0), task)
        for iteration in range(3):
            asked = 0
            state, report = way.step(np.random.default_rng(iteration), state, task)
            assert report.unary_evaluations == asked
