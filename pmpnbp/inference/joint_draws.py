"""Joint positions to try: stratified between the limits, and near those that did well in the iteration before."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry.poses import Array
from pmpnbp.inference import log_weights as lw
from pmpnbp.inference.belief import State
from pmpnbp.inference.mrf import LEAST_LEVER, Mrf
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.pairwise import stratified_axes
from pmpnbp.scene.articulated_object import Edge
from pmpnbp.settings import Schedule


def draw_axes(
    rng: np.random.Generator,
    state: State,
    problem: Problem,
    messages: NDArray[np.int32],
    samples: int,
    draws: int,
    memory_share: float,
    plan: Schedule,
) -> Array:
    """Axis positions (G, samples, draws, K) for the joints of `messages` (G,); zero beyond an edge's own axes.

    Of several draws the first ones are stratified between the limits, one in each stratum of the range (the strata of
    further axes in a random order: a Latin hypercube); the last `memory_share` are near remembered positions. A single
    draw is remembered with probability `memory_share`.
    """
    mrf = problem.mrf
    out = np.zeros((len(messages), samples, draws, mrf.axes_per_edge))
    for row, message in enumerate(messages):
        edge = mrf.model.edges[mrf.edge[message]]
        depth = len(edge.axes)
        remembered = _memory(state, mrf, int(mrf.edge[message])) if memory_share > 0 else None
        recall = round(memory_share * draws) if remembered is not None else 0
        fresh = draws if draws == 1 else draws - recall
        out[row, :, :fresh, :depth] = stratified_axes(rng, edge, (samples,), fresh)
        if remembered is None:
            continue
        if draws == 1:
            chosen = rng.random(samples) < memory_share
            near = _recall(rng, remembered, edge, (samples, 1), mrf.radii[edge.child], plan)
            out[row, chosen, :, :depth] = near[chosen]
        elif recall:
            near = _recall(rng, remembered, edge, (samples, recall), mrf.radii[edge.child], plan)
            out[row, :, fresh:, :depth] = near
    return out


def _memory(state: State, mrf: Mrf, edge: int) -> tuple[Array, Array] | None:
    """Axis positions (R, K) that explained the scan along an edge, with their log weights (R,)."""
    depth = len(mrf.model.edges[edge].axes)
    if state.messages is not None:
        both = slice(2 * edge, 2 * edge + 2)
        # a joint draw is as good as the receiver's sample and the sender's part at it
        weights = state.messages.log_weights[both].reshape(-1)
        return state.messages.joint_draw[both, :, :depth].reshape(-1, depth), lw.normalise(weights)
    if state.belief.joint_positions is not None:
        known = mrf.model.edges[edge].axis_positions(state.belief.joint_positions)
        return known, state.belief.log_weights[mrf.model.edges[edge].child]
    return None


def _recall(
    rng: np.random.Generator,
    memory: tuple[Array, Array],
    edge: Edge,
    shape: tuple[int, int],
    radius: float,
    plan: Schedule,
) -> Array:
    """Axis positions (*shape, K) drawn from memory and moved a little, within limits."""
    known, log_weights = memory
    taken = rng.permutation(lw.systematic(rng, log_weights, shape[0] * shape[1])).reshape(shape)
    # an axis that turns moves the part's rim as far as one that slides
    spread = np.where(edge.revolute, plan.diffusion_position / max(radius, LEAST_LEVER), plan.diffusion_position)
    moved = known[taken] + spread * rng.standard_normal((*shape, len(spread)))
    return within_limits(moved, edge.lower, edge.upper, edge.wraps)


def within_limits(positions: Array, lower: Array, upper: Array, wraps: NDArray[np.bool_]) -> Array:
    """Positions (..., K) clipped to their limits, or taken around where an axis wraps."""
    clipped = np.minimum(np.maximum(positions, lower), upper)
    if not np.any(wraps):
        return clipped
    around = lower + np.mod(positions - lower, np.maximum(upper - lower, 1e-12))
    return np.where(wraps, around, clipped)


def short_way_round(difference: Array, wraps: NDArray[np.bool_]) -> Array:
    """Differences (..., K) of positions, the short way round where an axis turns freely."""
    return np.where(wraps, difference - 2 * np.pi * np.round(difference / (2 * np.pi)), difference)


def joint_spreads(problem: Problem, plan: Schedule) -> Array:
    """(D,) standard deviations, metres or radians, that move what the joint coordinates move by about the diffusion: a
    part that slides as a whole, one that turns at its rim. Of several axes that follow one coordinate the one that goes
    farthest counts."""
    farthest = np.zeros(problem.mrf.model.dof)
    for edge in problem.mrf.model.edges:
        lever = np.where(edge.revolute, max(problem.mrf.radii[edge.child], LEAST_LEVER), 1.0)
        np.maximum.at(farthest, edge.coordinates, np.abs(edge.multiplier) * lever)
    # a coordinate that moves no part that could be seen
    return plan.diffusion_position / np.where(farthest > 0, farthest, 1.0)
