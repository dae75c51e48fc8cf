"""Whole objects as hypotheses: put together part by part along the joints, and told apart.

A hypothesis is a root pose and a joint vector. `walk` gives the joints of many hypotheses the positions that explain
the scan, from the root outwards; `distinct` leaves one of those that say the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.belief import OWN
from pmpnbp.inference.joint_draws import within_limits
from pmpnbp.inference.mrf import LEAST_LEVER, Mrf
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.kernels.grouping import group
from pmpnbp.potentials.pairwise import stratified_axes
from pmpnbp.scene.articulated_object import Edge
from pmpnbp.settings import Schedule

# Splats a part is judged by in the search; a hypothesis that is far off needs no more to be dropped.
SEARCH_POINTS = 64
# Positions near its own that a joint is tried at, and how often offspring try no others.
NEAR = 3
CAUTION = 0.5
# Stratified positions over a joint's range: one for so many tolerances that the part is moved by, within these bounds.
TOLERANCES_APART, FEWEST, MOST = 1.5, 4, 20
# Scale of the Gumbel noise by which half of the hypotheses choose, as a share of the best score.
CHANCE = 0.1


@dataclass(frozen=True, kw_only=True)
class Proposals:
    """P whole objects: roots (P, 7), joints (P, D), source and ancestor (P,) of each, as in `Origin`, and the part
    `held` (P,) that is laid on the scan with the joints as they are, 0 where none is but the root."""

    roots: Array
    joints: Array
    source: NDArray[np.uint8]
    ancestor: NDArray[np.int32]
    held: NDArray[np.int64]

    def taken(self, rows: NDArray[np.int64]) -> Self:
        """Those at `rows`."""
        return replace(self, **{entry.name: getattr(self, entry.name)[rows] for entry in fields(self)})

    def joined(self, other: Self) -> Self:
        """These and then the others."""
        names = [entry.name for entry in fields(self)]
        return replace(self, **{name: np.concatenate([getattr(self, name), getattr(other, name)]) for name in names})


@dataclass(frozen=True, kw_only=True)
class Hypotheses(Proposals):
    """Proposals whose joints have been given positions, with log unary (P, N) and poses (P, N, 7) of their parts."""

    unary: Array
    part_poses: Array


def walk(
    rng: np.random.Generator,
    problem: Problem,
    proposals: Proposals,
    plan: Schedule,
    kept: slice = slice(0),
    left: int | None = None,
) -> Hypotheses:
    """From the root outwards, give each joint the position at which the part behind it explains the scan best.

    Those in `kept` stay as they are, joints up to a part that is held do, and offspring often stay near to theirs, so
    that what was found far out is not lost with every step near the root. Of P proposals `left` arrive, those in `kept`
    and the best of each island's offspring beside: before every joint the same share is left behind, those whose parts
    so far explain least.

    Positions tried: the proposal's own, some near it, and stratified ones over the range, as many as bring the part
    within the tolerance of any place it can reach. Half of the proposals choose with some chance, so that a part that
    is taken in by a wrong surface is not so in all of them.
    """
    offspring = (proposals.source == OWN) & (proposals.ancestor >= 0)
    mrf, count = problem.mrf, len(proposals.roots)
    joints = proposals.joints.copy()
    part_poses = np.zeros((count, mrf.nodes, 7))
    unary = np.zeros((count, mrf.nodes))
    part_poses[:, 0], unary[:, 0] = proposals.roots, root_unary(problem, proposals.roots, plan.tolerance)
    stays = np.zeros(count, dtype=bool)
    stays[kept] = True
    # what hangs on a hidden root would be left behind before the part that is seen had its turn
    holding = np.flatnonzero(proposals.held)
    if len(holding):
        part = proposals.held[holding]
        part_poses[holding] = mrf.part_poses(proposals.roots[holding], joints[holding])
        at = part_poses[holding, part]
        unary[holding, part] = problem.unary(part.astype(np.int32), at, plan.tolerance, "splats", SEARCH_POINTS)
    leads = on_the_way(mrf)
    going = np.arange(count)
    for place, number in enumerate(mrf.tree):
        if left is not None and left < count:
            most = math.ceil(count * (left / count) ** (place / len(mrf.tree)))
            going = _ahead(unary, proposals.ancestor, stays, going, most)
        edge = mrf.model.edges[number]
        settled = edge.axis_positions(joints)
        if follows(mrf.model.edges, number):
            trials = [(going, settled[going, None])]
        else:
            near = offspring[going] & (rng.random(len(going)) < CAUTION)
            trials = [
                (rows, _trials(rng, edge, settled[rows], mrf.radii[edge.child], plan, all_over=all_over))
                for rows, all_over in ((going[near], False), (going[~near], True))
            ]
        for rows, axes in trials:
            tried, score = judged(problem, number, part_poses[rows, edge.parent], axes, plan.tolerance)
            pick = _picked(rng, score, rows % 2 == 1)
            pick[stays[rows] | leads[proposals.held[rows], number]] = 0
            each = np.arange(len(rows))
            part_poses[rows, edge.child], unary[rows, edge.child] = tried[each, pick], score[each, pick]
            coordinates, positions = edge.joint_positions(axes[each, pick])
            joints[rows[:, None], coordinates] = positions
    arrived = Hypotheses(**vars(replace(proposals, joints=joints)), unary=unary, part_poses=part_poses)
    return arrived if left is None else arrived.taken(_ahead(unary, proposals.ancestor, stays, going, left))


def root_unary(problem: Problem, roots: Array, tolerance: float) -> Array:
    """log unary (P,) of the root part at poses (P, 7)."""
    return problem.unary(np.zeros(len(roots), dtype=np.int32), roots, tolerance, "splats", SEARCH_POINTS)


def part_unary(problem: Problem, part_poses: Array, tolerance: float) -> Array:
    """log unary (P, N) of all parts at poses (P, N, 7)."""
    nodes = np.tile(np.arange(problem.mrf.nodes, dtype=np.int32), len(part_poses))
    score = problem.unary(nodes, part_poses.reshape(-1, 7), tolerance, "splats", SEARCH_POINTS)
    return score.reshape(len(part_poses), -1)


def on_the_way(mrf: Mrf) -> NDArray[np.bool_]:
    """(N, E): which edges lead from the root to each part."""
    leads = np.zeros((mrf.nodes, len(mrf.model.edges)), dtype=bool)
    for number in mrf.tree:
        edge = mrf.model.edges[number]
        leads[edge.child] = leads[edge.parent]
        leads[edge.child, number] = True
    return leads


def _ahead(
    unary: Array, ancestor: NDArray[np.int32], stays: NDArray[np.bool_], going: NDArray[np.int64], most: int
) -> NDArray[np.int64]:
    """Of the rows `going` those that go on: as `ranked` has them by their parts so far, and those that stay."""
    ahead = stays[going]
    ahead[ranked(unary[going].sum(axis=1), ancestor[going], most)] = True
    return going[ahead]


def ranked(score: Array, ancestor: NDArray[np.int32], most: int) -> NDArray[np.int64]:
    """Rows of the `most` best (P,), best first; before them the best offspring of each island, so that none is lost
    because the sum over parts ranks it low."""
    order = np.argsort(-score, kind="stable")
    first = np.full(ancestor.max(initial=-1) + 2, len(order))
    np.minimum.at(first, ancestor[order], np.arange(len(order)))
    heir, rest = np.zeros((2, len(order) + 1), dtype=bool)
    heir[first[:-1]] = True  # the last place is of those without an island, -1
    rest[:most] = ~heir[:most]
    return np.concatenate([order[heir[:-1]], order[rest[:-1]]])


def follows(edges: tuple[Edge, ...], number: int) -> bool:
    """Whether the edges before edge `number` move all of its joint coordinates, so that it has no choice."""
    return {int(c) for c in edges[number].coordinates} <= {int(c) for edge in edges[:number] for c in edge.coordinates}


def _trials(
    rng: np.random.Generator, edge: Edge, settled: Array, radius: float, plan: Schedule, *, all_over: bool
) -> Array:
    """Axis positions to try (P, draws, K): the present ones, some near these, and where asked for others all over the
    range."""
    count, depth = settled.shape
    lever = np.where(edge.revolute, radius, 1.0)
    spread = plan.diffusion_position / np.maximum(lever, LEAST_LEVER)
    around = settled[:, None] + spread * rng.standard_normal((count, NEAR, depth))
    near = [settled[:, None], within_limits(around, edge.lower, edge.upper, edge.wraps)]
    if not all_over:
        return np.concatenate(near, axis=1)
    apart = ((edge.upper - edge.lower) * lever).max() / (TOLERANCES_APART * plan.tolerance)
    fresh = int(np.clip(np.ceil(apart), FEWEST, MOST))
    return np.concatenate([*near, stratified_axes(rng, edge, (count,), fresh)], axis=1)


def judged(
    problem: Problem, number: int, parents: Array, axes: Array, tolerance: float
) -> tuple[Array, NDArray[np.float64]]:
    """Poses (P, draws, 7) of the child of edge `number` at axis positions (P, draws, K) of parents (P, 7), and its
    scores (P, draws) there."""
    mrf, (count, draws, depth) = problem.mrf, axes.shape
    padded = np.zeros((1, count, draws, mrf.axes_per_edge))
    padded[0, ..., :depth] = axes
    tried = mrf.across(np.array([2 * number + 1], dtype=np.int32), parents[None], padded)[0]
    node = np.full(count * draws, mrf.model.edges[number].child, dtype=np.int32)
    score = problem.unary(node, tried.reshape(-1, 7), tolerance, "splats", SEARCH_POINTS)
    return tried, score.reshape(count, draws)


def _picked(rng: np.random.Generator, score: Array, by_chance: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Of each row of `score` (P, draws) the best, in rows `by_chance` of scores with Gumbel noise."""
    noisy = score.copy()
    some = score[by_chance]
    scale = CHANCE * np.abs(some).max(axis=1, keepdims=True, initial=0.0) + 1e-9
    noisy[by_chance] += scale * rng.gumbel(size=some.shape)
    picked: NDArray[np.int64] = noisy.argmax(axis=1)
    return picked


def distinct(
    problem: Problem, tried: Hypotheses, order: NDArray[np.int64], most: int, apart: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Greedy choice, in `order`, of hypotheses further than `apart` metres from each other: rows of the chosen, and for
    each of `order` the place of the chosen one it belongs to (-1: none).

    A part counts by what it explains: hidden parts that lie elsewhere do not make another hypothesis.
    """
    centres, radii = problem.mrf.centres, problem.mrf.radii
    corners = np.stack([centres, *(centres + radii[:, None] * axis for axis in np.eye(3))], axis=1)
    marks = poses.transform_points(tried.part_poses[order][:, :, None], corners)
    evidence = np.maximum(tried.unary[order], 0.0) + 1e-6
    leaders, member_of = group(marks, evidence, most, apart)
    return order[leaders], member_of
