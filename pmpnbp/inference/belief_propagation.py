"""PMPNBP: one iteration of pull message passing (algorithm boxes 1 and 2), as a pure step.

An iteration draws samples of every node from its belief, lets each neighbour judge them through the joint between
them (the messages), and weighs them by their own unary potential and the messages. All edges go through a phase
together. Samples come in *slots*: with shared samples a slot is a node and all its messages judge the same samples,
so that the belief is the product of eq. 5; with pooled samples, as the paper's box 2 has it, a slot is a message.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import log_weights as lw
from pmpnbp.inference.belief import NEIGHBOUR, OWN, Belief, IterationReport, Messages, Origin, State
from pmpnbp.inference.joint_draws import draw_axes
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.tree_estimate import improve
from pmpnbp.potentials.pairwise import neighbour_sums
from pmpnbp.potentials.unary import Renderer
from pmpnbp.settings import Schedule

Kind = TypeVar("Kind", bound=np.generic)


@dataclass(frozen=True, kw_only=True)
class Samples:
    """Proposed poses (S, M, 7) of every slot, and where each comes from (S, M)."""

    poses: Array
    origin: Origin


def step(rng: np.random.Generator, state: State, problem: Problem) -> tuple[State, IterationReport]:
    """Iteration `state.iteration + 1`: messages (box 1), then beliefs (box 2), then the whole-object estimate."""
    began = time.perf_counter()
    problem = problem.taking(state.nuisances)
    settings, mrf = problem.settings, problem.mrf
    number = state.iteration + 1
    since = number - state.search_after
    plan = problem.schedule(since)
    refining = problem.annealed < since <= problem.annealed + settings.refine_iterations
    renderer: Renderer = "rasteriser" if refining else settings.renderer
    shared = settings.belief_product == "shared"
    slot_node = np.arange(mrf.nodes, dtype=np.int32) if shared or not len(mrf.sender) else mrf.receiver

    samples = draw(rng, state, problem, slot_node, plan)
    slot_of_message = mrf.receiver if shared else np.arange(len(mrf.sender))
    flat_node = np.repeat(slot_node, problem.particles)
    unary = problem.unary(flat_node, samples.poses.reshape(-1, 7), plan.tolerance, renderer)
    unary = unary.reshape(len(slot_node), -1)
    axes, sender_unary = _judge_by_senders(rng, state, problem, samples.poses[slot_of_message], plan)
    inverse_temperature = _inverse_temperatures(problem, unary, sender_unary.max(axis=2), slot_node, slot_of_message)
    messages = _messages(state, problem, samples.poses[slot_of_message], axes, sender_unary, inverse_temperature, plan)
    own = inverse_temperature[slot_node, None] * unary
    informed = slot_node == problem.prior_node
    own[informed] = problem.plus_prior(own[informed], samples.poses[informed])
    combine = _product if shared else _pool
    belief, shares, kept = combine(problem, samples, own, unary, messages)

    root, joints, map_poses, score, nuisances = improve(rng, problem, state, belief, plan)
    new = replace(state, iteration=number, belief=belief, messages=kept, root=root, joints=joints, nuisances=nuisances)
    report = IterationReport.of(
        new,
        "refine" if refining else "belief propagation",
        messages=messages,
        log_message_shares=shares,
        inverse_temperature=inverse_temperature,
        tolerance=plan.tolerance,
        map_poses=map_poses,
        map_score=score,
        seconds=time.perf_counter() - began,
    )
    return new, report


def draw(
    rng: np.random.Generator, state: State, problem: Problem, slot_node: NDArray[np.int32], plan: Schedule
) -> Samples:
    """Box 1 step 1 after box 2 step 4: samples drawn from the beliefs, diffused; with `neighbour_proposals`, that
    share of them drawn from a neighbour's belief and carried through the joint."""
    mrf, belief, count = problem.mrf, state.belief, problem.particles
    slots = len(slot_node)
    ancestor = lw.systematic(rng, belief.log_weights[slot_node], count).astype(np.int32)
    ancestor = rng.permuted(ancestor, axis=1)
    source = np.full((slots, count), OWN, dtype=np.uint8)
    neighbour = np.full((slots, count), -1, dtype=np.int32)
    drawn = np.take_along_axis(belief.poses[slot_node], ancestor[..., None], axis=1)
    borrowed = round(problem.settings.neighbour_proposals * count)
    lenders = [mrf.incoming[node] for node in slot_node]
    if borrowed and len(mrf.sender):
        # every slot takes its last `borrowed` samples from its neighbours in turn
        rows = np.array([slot for slot in range(slots) if lenders[slot]], dtype=np.int64)
        for turn in range(max(len(lenders[row]) for row in rows)):
            using = np.array([row for row in rows if turn < len(lenders[row])], dtype=np.int64)
            incoming = np.array([lenders[row][turn] for row in using], dtype=np.int32)
            share = [np.arange(count - borrowed + turn, count, len(lenders[row])) for row in using]
            width = max(len(part) for part in share)
            back = incoming ^ 1  # received by the lender, so that `across` leads from the lender to the slot's node
            lender = mrf.sender[incoming]
            taken = rng.permuted(lw.systematic(rng, belief.log_weights[lender], width), axis=1)
            lender_poses = np.take_along_axis(belief.poses[lender], taken[..., None], axis=1)
            axes = draw_axes(rng, state, problem, back, width, 1, problem.settings.joint_memory, plan)
            carried = mrf.across(back, lender_poses, axes)[:, :, 0]
            for row, part, poses_row, taken_row, node in zip(using, share, carried, taken, lender, strict=True):
                drawn[row, part] = poses_row[: len(part)]
                ancestor[row, part], neighbour[row, part] = taken_row[: len(part)], node
                source[row, part] = NEIGHBOUR
    origin = Origin.of(source.shape, source, ancestor=ancestor, neighbour=neighbour)
    return Samples(poses=_diffuse(rng, drawn, mrf.centres[slot_node], plan), origin=origin)


def _diffuse(rng: np.random.Generator, part_poses: Array, centres: Array, plan: Schedule) -> Array:
    noise = rng.standard_normal((*part_poses.shape[:2], 6))
    shift, turn = plan.diffusion_position * noise[..., :3], plan.diffusion_rotation * noise[..., 3:]
    return poses.perturb(part_poses, shift, turn, centres[:, None])


def _judge_by_senders(
    rng: np.random.Generator, state: State, problem: Problem, received: Array, plan: Schedule
) -> tuple[Array, Array]:
    """Box 1 steps 2a and 2b: joint draws (E, M, D, K), and the sender's log unary potential (E, M, D) at each."""
    mrf, settings = problem.mrf, problem.settings
    messages = np.arange(len(mrf.sender), dtype=np.int32)
    axes = draw_axes(
        rng, state, problem, messages, problem.particles, settings.joint_draws, settings.joint_memory, plan
    )
    sender_poses = mrf.across(messages, received, axes)
    node = np.repeat(mrf.sender, problem.particles * settings.joint_draws)
    unary = problem.unary(node, sender_poses.reshape(-1, 7), plan.tolerance, settings.renderer)
    return axes, unary.reshape(axes.shape[:3])


def _inverse_temperatures(
    problem: Problem,
    unary: Array,
    sender_unary: Array,
    slot_node: NDArray[np.int32],
    slot_of_message: NDArray[np.integer],
) -> Array:
    """(N,) the factor on a node's log potentials: `unary_scale`, or what keeps the effective sample size."""
    nodes = problem.mrf.nodes
    if problem.settings.effective_share == 0:
        return np.full(nodes, problem.settings.unary_scale)
    evidence = unary.copy()
    np.add.at(evidence, slot_of_message, sender_unary)
    per_slot = lw.tempering(evidence, problem.settings.effective_share)
    lowest = np.full(nodes, np.inf)
    np.minimum.at(lowest, slot_node, per_slot)
    return lowest


def _messages(
    state: State,
    problem: Problem,
    received: Array,
    axes: Array,
    sender_unary: Array,
    inverse_temperature: Array,
    plan: Schedule,
) -> Messages:
    """Box 1 steps 2c and 2d: the neighbours' factor, and both factors together."""
    mrf, settings = problem.mrf, problem.settings
    tempered = inverse_temperature[mrf.receiver, None, None] * sender_unary
    log_unary = lw.log_sum_exp(tempered) - np.log(axes.shape[2]) if len(mrf.sender) else np.zeros(received.shape[:2])
    log_neighbour = np.zeros_like(log_unary)
    previous = state.messages
    if settings.neighbour_sum and previous is not None:
        jobs = [(e, f) for e in range(len(mrf.sender)) for f in mrf.feeding[e]]
        if jobs:
            into, feed = np.array(jobs).T
            sums = neighbour_sums(
                mrf.table,
                mrf.edge[into],
                into % 2 == 1,
                received[into],
                previous.poses[feed],
                previous.log_weights[feed],
                form=settings.pairwise_form,
                sigma_position=plan.sigma_position,
                sigma_orientation=plan.sigma_orientation,
            )
            np.add.at(log_neighbour, into, sums)
    best = tempered.argmax(axis=2) if len(mrf.sender) else np.zeros(received.shape[:2], dtype=np.int64)
    joint_draw = np.take_along_axis(axes, best[..., None, None], axis=2)[:, :, 0]
    weights = lw.normalise(log_unary + log_neighbour)
    return Messages(
        sender=mrf.sender,
        receiver=mrf.receiver,
        poses=received,
        log_weights=weights,
        log_unary=log_unary,
        log_neighbour=log_neighbour,
        joint_draw=joint_draw,
    )


def _product(
    problem: Problem, samples: Samples, own: Array, unary: Array, messages: Messages
) -> tuple[Belief, Array, Messages]:
    """Eq. 5 on shared samples: unary potential times all incoming messages."""
    mrf = problem.mrf
    widest = max((len(incoming) for incoming in mrf.incoming), default=0)
    shares = np.full((mrf.nodes, problem.particles, widest), np.nan)
    total = own.copy()
    factors = messages.log_unary + messages.log_neighbour
    for node, incoming in enumerate(mrf.incoming):
        for place, message in enumerate(incoming):
            shares[node, :, place] = factors[message]
            total[node] += factors[message]
    belief = Belief(poses=samples.poses, log_weights=lw.normalise(total), log_unary=unary, origin=samples.origin)
    return belief, shares, messages


def _pool(
    problem: Problem, samples: Samples, own: Array, unary: Array, messages: Messages
) -> tuple[Belief, Array, Messages]:
    """Box 2: each incoming message's samples weighed by the unary potential, then all of them in one set.

    Nodes with fewer neighbours than the widest are filled up with particles of weight zero.
    """
    mrf, count = problem.mrf, problem.particles
    if not len(mrf.sender):
        return _product(problem, samples, own, unary, messages)
    updated = lw.normalise(messages.log_weights + own)  # steps 1a and 1b
    widest = max(len(incoming) for incoming in mrf.incoming)
    size = widest * count
    order = np.zeros((mrf.nodes, size), dtype=np.int64)
    log_weights = np.full((mrf.nodes, size), -np.inf)
    shares = np.full((mrf.nodes, size, widest), np.nan)
    for node, incoming in enumerate(mrf.incoming):
        for place, message in enumerate(incoming):
            here = slice(place * count, (place + 1) * count)
            order[node, here] = message * count + np.arange(count)
            log_weights[node, here] = updated[message] - np.log(len(incoming))  # steps 2 and 3
            shares[node, here, place] = messages.log_weights[message]
        order[node, len(incoming) * count :] = incoming[0] * count

    def pooled(values: NDArray[Kind]) -> NDArray[Kind]:
        return values.reshape(-1, *values.shape[2:])[order]

    came = samples.origin
    origin = Origin.of(
        order.shape, pooled(came.source), ancestor=pooled(came.ancestor), neighbour=pooled(came.neighbour)
    )
    belief = Belief(poses=pooled(samples.poses), log_weights=log_weights, log_unary=pooled(unary), origin=origin)
    if problem.settings.messages_keep_unary:
        messages = replace(messages, log_weights=updated)
    return belief, shares, messages
