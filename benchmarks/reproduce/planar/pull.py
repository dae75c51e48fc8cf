"""PMPNBP on the figure: boxes 1 and 2 of Desingh et al. 2019 as written, in the plane.

A message's samples are drawn from the receiver's belief and weighed by what the sender's picture and the sender's
other messages say of them. An iteration costs a sum over M components for each of M samples, for every pair of
messages that follow one another: M² in all.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from benchmarks.reproduce.planar.pattern import across, hinge_frame
from benchmarks.reproduce.planar.problem import Plan, PlanarProblem, Report, Samples, resample, uniform
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import log_weights as lw

# ψ is cut off at exp(-40) of its top, which leaves out most of the exponentials, and no sum is taken for less: a sample
# that no component of a message is near is as unlikely as the farthest one that is, not impossible.
FARTHEST = 40.0


@dataclass(frozen=True)
class State:
    """After `iteration` iterations: a belief per node and, but for the first, a message per directed edge."""

    iteration: int
    beliefs: tuple[Samples, ...]
    messages: tuple[Samples, ...]


def start(rng: np.random.Generator, problem: PlanarProblem) -> State:
    """Uniform beliefs and no messages (box 1, step 1a)."""
    return State(0, uniform(rng, problem), ())


@njit(cache=True, nogil=True)
def _pair_sums(ours, theirs, weights, limit, sigma_position, sigma_angle, out):  # type: ignore[no-untyped-def]
    by_position, by_angle = 0.5 / sigma_position**2, 0.5 / sigma_angle**2
    turn = 2 * np.pi
    for i in range(len(ours)):
        total = 0.0
        x, y, theta = ours[i, 0], ours[i, 1], ours[i, 2]
        for j in range(len(theirs)):
            dx, dy = theirs[j, 0] - x, theirs[j, 1] - y
            cost = by_position * (dx * dx + dy * dy)
            if cost < FARTHEST:
                apart = theirs[j, 2] - theta
                beyond = abs(apart - turn * np.rint(apart / turn)) - limit
                if beyond > 0.0:
                    cost += by_angle * beyond * beyond
                if cost < FARTHEST:
                    total += weights[j] * np.exp(-cost)
        out[i] = max(np.log(total), -FARTHEST) if total > 0.0 else -FARTHEST


def log_pair_sums(problem: PlanarProblem, message: int, received: Array, feed: Samples, plan: Plan) -> Array:
    """log W_u (M,) of box 1, step 2c(i): for each pose (M, 3) of the receiver, Σ_j w_ut^(j) ψ(X_s, X_t = μ_ut^(j))."""
    pattern = problem.pattern
    out = np.empty(len(received))
    _pair_sums(
        hinge_frame(pattern, message, received, at_sender=False),
        hinge_frame(pattern, message, feed.poses, at_sender=True),
        np.exp(feed.log_weights),
        pattern.hinges[message // 2].limit,
        plan.sigma_position,
        plan.sigma_angle,
        out,
    )
    return out


def update_message(
    rng: np.random.Generator, problem: PlanarProblem, message: int, state: State, plan: Plan
) -> tuple[Samples, int]:
    """Box 1, and the number of terms summed."""
    pattern = problem.pattern
    sender, receiver = int(pattern.sender[message]), int(pattern.receiver[message])
    noise = plan.diffusion if state.iteration else np.zeros(3)
    received = resample(rng, state.beliefs[receiver], problem.settings.components, noise)  # step 1
    sent = across(rng, pattern, message, received, True, plan.sigma_position, plan.sigma_angle)  # 2a
    log_weights = problem.log_unary(sender, sent, plan.sharpness)  # 2b
    feeding = pattern.feeding[message] if state.messages else ()
    for other in feeding:
        log_weights = log_weights + log_pair_sums(problem, message, received, state.messages[other], plan)  # 2c, 2d
    return Samples(received, lw.normalise(log_weights)), len(feeding) * len(received) ** 2


def update_belief(problem: PlanarProblem, node: int, messages: tuple[Samples, ...], plan: Plan) -> Samples:
    """Box 2, steps 1 to 3: the incoming messages' samples in one set, T = M times their number."""
    incoming = [messages[message] for message in problem.pattern.incoming[node]]
    updated = [
        lw.normalise(message.log_weights + problem.log_unary(node, message.poses, plan.sharpness))
        for message in incoming
    ]
    return Samples(np.concatenate([m.poses for m in incoming]), np.concatenate(updated) - np.log(len(incoming)))


def step(rng: np.random.Generator, state: State, problem: PlanarProblem) -> tuple[State, Report]:
    """Iteration `state.iteration + 1`: all messages from the last iteration's, then all beliefs."""
    number = state.iteration + 1
    plan = problem.plan(number)
    pattern = problem.pattern
    updated = [update_message(rng, problem, message, state, plan) for message in range(pattern.messages)]
    messages = tuple(message for message, _ in updated)
    beliefs = tuple(update_belief(problem, node, messages, plan) for node in range(pattern.nodes))
    # every message asks φ of its sender at M poses and of its receiver at M
    unary = 2 * pattern.messages * problem.settings.components
    return State(number, beliefs, messages), Report(unary, sum(terms for _, terms in updated))
