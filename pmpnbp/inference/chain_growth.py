"""How is a long chain found? Link by link, many chains side by side, of which only the best goes on where some end
alike.

A walk that gives each joint the position at which the next part alone looks best is lost at the first wrong link, and
of many walks through dozens of links none may be right. What the rest of a chain can explain depends on the pose it is
to start from alone, however the chain came there; so of all chains that end in about the same pose the one that
explains most goes on (dynamic programming, Viterbi 1967), and a wrong link costs a chain no more than it explains less.
The best positions of all links together are found without looking ahead.

The root decides on all that follows and is seldom known well at first: a yaw wrong by a few degrees misses the far end.
Chains grow from several places of it at once, each place a lineage with room of its own, from some variants of the
place that compete within it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.hypotheses import SEARCH_POINTS, Hypotheses, Proposals, follows, judged
from pmpnbp.inference.mrf import LEAST_LEVER, Mrf
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.pairwise import stratified_axes
from pmpnbp.settings import Schedule

# Places of the root that chains grow from, variants of each, and chains of each place that go on after a link.
LINEAGES, VARIANTS, CHAINS = 24, 16, 300
# Positions of a joint that each of them is tried at.
DRAWS = 16
# Metres: the tolerance that a link is judged at, at most. At a wider one a chain that winds explains as much as one
# that follows.
TOLERANCE = 0.03
# Chains end alike in a cell of so many tolerances.
CELL = 2 / 3
# How the root's places are chosen: so many metres apart, so many of them, the next ones from so many about each.
ROUNDS = ((0.04, 400), (0.03, 200), (0.03, LINEAGES))
ABOUT = 24
# Any orientation has so many times as many places to grow from.
ANY_ORIENTATION = 4
# Standard deviation in metres of the variants of a place.
VARIED = 0.008


def grow(rng: np.random.Generator, problem: Problem, proposals: Proposals, plan: Schedule) -> Hypotheses:
    """Chains grown from the best places among the proposals' root poses; best ones of every place, in no order."""
    tolerance = min(plan.tolerance, TOLERANCE)
    starts = _starts(rng, problem, proposals, tolerance)
    lineage = np.repeat(np.arange(len(starts.roots)), VARIANTS)
    return grown(rng, problem, _moved(rng, problem, starts, VARIANTS, VARIED), lineage, tolerance)


def grown(
    rng: np.random.Generator, problem: Problem, starts: Proposals, lineage: NDArray[np.int64], tolerance: float
) -> Hypotheses:
    """The best chains that grow from `starts`, at most CHAINS of each `lineage` (P,)."""
    mrf, count = problem.mrf, len(starts.roots)
    unary, part_poses = np.zeros((count, mrf.nodes)), np.zeros((count, mrf.nodes, 7))
    part_poses[:, 0], unary[:, 0] = starts.roots, _root_scores(problem, starts.roots, tolerance)
    chains = Hypotheses(**vars(starts), unary=unary, part_poses=part_poses)
    merit = unary[:, 0]
    start = np.arange(count)
    for place, number in enumerate(mrf.tree):
        edge = mrf.model.edges[number]
        if follows(mrf.model.edges, number):
            axes = edge.axis_positions(chains.joints)[:, None]
        else:
            axes = stratified_axes(rng, edge, (len(chains.roots),), DRAWS)
        tried, score = judged(problem, number, chains.part_poses[:, edge.parent], axes, tolerance)
        others = sorted({0, *(mrf.model.edges[earlier].child for earlier in mrf.tree[:place])} - {edge.parent})
        inside = _inside(mrf, chains.part_poses, others, edge.child, tried)
        total = merit[:, None] + np.where(inside, np.minimum(score, 0.0), score)
        if edge.child == problem.prior_node:
            total = problem.plus_prior(total, tried)
        ends = _cells(rng, mrf, edge.child, tried, CELL * tolerance).ravel() + np.repeat(start, axes.shape[1])
        for part in _open_parts(mrf, place):
            ends += np.repeat(_cells(rng, mrf, part, chains.part_poses[:, part], CELL * tolerance), axes.shape[1])
        best = _best_of_each(total.ravel(), ends, np.repeat(lineage[start], axes.shape[1]), CHAINS)
        row, draw = np.divmod(best, axes.shape[1])
        chains, merit, start = chains.taken(row), total[row, draw], start[row]
        chains.part_poses[:, edge.child], chains.unary[:, edge.child] = tried[row, draw], score[row, draw]
        coordinates, positions = edge.joint_positions(axes[row, draw])
        chains.joints[:, coordinates] = positions
    return chains


def _starts(rng: np.random.Generator, problem: Problem, proposals: Proposals, tolerance: float) -> Proposals:
    """At most LINEAGES proposals whose root poses explain most for themselves, moved to where they do best; for any
    orientation ANY_ORIENTATION times as many."""
    more = ANY_ORIENTATION if problem.any_orientation else 1
    for number, (apart, most) in enumerate(ROUNDS):
        if number:
            proposals = _moved(rng, problem, proposals, ABOUT, apart / 2)
        score = _root_scores(problem, proposals.roots, tolerance)
        ends = _cells(rng, problem.mrf, 0, proposals.roots, apart)
        proposals = proposals.taken(_best_of_each(score, ends, np.zeros(len(score), dtype=np.int64), more * most))
    return proposals


def _moved(rng: np.random.Generator, problem: Problem, chosen: Proposals, count: int, metres: float) -> Proposals:
    """`count` of each: itself, and others whose root is moved by `metres` at its middle and, by turning, at its rim;
    about the upright alone where the object stands."""
    rows = np.repeat(np.arange(len(chosen.roots)), count)
    noise = metres * rng.standard_normal((len(rows), 6))
    noise[::count] = 0.0
    turn = noise[:, 3:] / max(problem.mrf.radii[0], LEAST_LEVER)
    if not problem.any_orientation:
        turn = turn[:, :1] * problem.observation.up
    moved = chosen.taken(rows)
    return replace(moved, roots=poses.perturb(moved.roots, noise[:, :3], turn, problem.mrf.centres[0]))


def _inside(mrf: Mrf, part_poses: Array, others: list[int], part: int, tried: Array) -> NDArray[np.bool_]:
    """(P, draws): whether the middle of `part` at poses (P, draws, 7) is nearer to that of one of the `others`, at
    `part_poses` (P, N, 7), than both are thick: there it would explain once more what that one has explained."""
    middle = poses.transform_points(tried, mrf.centres[part])
    taken = poses.transform_points(part_poses[:, others], mrf.centres[others])
    square = (middle**2).sum(-1)[..., None] + (taken**2).sum(-1)[:, None] - 2 * middle @ np.swapaxes(taken, 1, 2)
    thickness = np.array([each.extents.min() for each in mrf.model.parts])
    thick = thickness[others] + thickness[part]
    return np.any(square < (thick / 2) ** 2, axis=-1)


def _open_parts(mrf: Mrf, place: int) -> list[int]:
    """Parts, other than the root and the part that the tree's edge number `place` adds, from which others hang that
    have no place yet after it."""
    edges = [mrf.model.edges[number] for number in mrf.tree]
    there = {edge.child for edge in edges[:place]}
    return sorted(there & {edge.parent for edge in edges[place + 1 :]})


def _cells(rng: np.random.Generator, mrf: Mrf, part: int, part_poses: Array, width: float) -> NDArray[np.int64]:
    """Numbers (...) of the cells, `width` metres wide for three marks on the part, that poses (..., 7) of it lie in."""
    marks = mrf.centres[part] + max(mrf.radii[part], LEAST_LEVER) * np.eye(3, k=-1)
    there = poses.transform_points(part_poses[..., None, :], marks).reshape(*part_poses.shape[:-1], 9)
    cell = np.floor(there / width + rng.random(9)).astype(np.int64)
    # one number of nine, which two cells have in common once in 2**64
    factors: NDArray[np.int64] = cell @ rng.integers(-(2**62), 2**62, 9)
    return factors


def _best_of_each(score: Array, ends: NDArray[np.int64], lineage: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Rows, best first, of the best `score` (P,) of each of the `ends` (P,), at most `most` of a `lineage` (P,)."""
    order = np.argsort(-score, kind="stable")
    _, first = np.unique(ends[order], return_index=True)
    order = order[np.sort(first)]
    by_lineage = np.argsort(lineage[order], kind="stable")
    sorted_lineage = lineage[order][by_lineage]
    rank = np.arange(len(order)) - np.searchsorted(sorted_lineage, sorted_lineage)
    return order[np.sort(by_lineage[rank < most])]


def _root_scores(problem: Problem, roots: Array, tolerance: float) -> Array:
    """log unary (P,) of the root part at poses (P, 7), and where the prior speaks of it the prior."""
    score = problem.unary(np.zeros(len(roots), dtype=np.int32), roots, tolerance, "splats", SEARCH_POINTS)
    return problem.plus_prior(score, roots) if problem.prior_node == 0 else score
