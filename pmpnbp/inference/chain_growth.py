"""How is a long chain found? Link by link, many chains side by side, of which only the best goes on where some end
alike.

A walk that gives each joint the position at which the next part alone looks best is lost at the first wrong link, and
of many walks through dozens of links none may be right. What the rest of a chain can explain depends on the pose it is
to start from alone, however the chain came there; so of all chains that end in about the same pose the one that
explains most goes on (dynamic programming, Viterbi 1967), and a wrong link costs a chain no more than it explains less.
The best positions of all links together are found without looking ahead.

What a chain explains is rendered whole after each link, and in the end. By the sum over its links a chain would do best
that folds up: its links explain the same pixels once more, it lags behind the right one and has no link left for the
far end.

The root decides on all that follows and is seldom known well at first: a yaw wrong by a few degrees misses the far end.
Chains grow from several places of it at once, each place a lineage with room of its own, from some variants of the
place that compete within it. The best of each are laid on the scan as they grow, root and joints together: what is
learnt of the root far out comes too late for those that had another one, and the right chain would drift out of what is
seen.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.hypotheses import Hypotheses, Proposals, follows, judged, part_unary, root_unary
from pmpnbp.inference.mrf import LEAST_LEVER, Mrf
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.tree_estimate import polish
from pmpnbp.potentials.pairwise import stratified_axes
from pmpnbp.potentials.unary import object_scores
from pmpnbp.settings import Schedule

# Places of the root that chains grow from, and variants of each.
LINEAGES, VARIANTS = 16, 16
# Positions of a joint that a chain is tried at; chains of each place that go on after a link: as many as two links may
# end in.
DRAWS, CHAINS = 16, 256
# A chain counts less by this share of the best score for each better one that ends in the same cell so many metres
# wide: where a few links are hidden, chains that tell the same would leave no room for others.
REGION, CROWDED = 0.1, 0.002
# After every so many links so many of the best chains of each place are laid on the scan.
LAID_EVERY, LAID = 2, 2
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


def grow(rng: np.random.Generator, problem: Problem, proposals: Proposals, plan: Schedule) -> tuple[Hypotheses, Array]:
    """Chains grown from the best places among the proposals' root poses; best ones of every place, in no order. And
    their log scores (P,), rendered whole."""
    plan = replace(plan, tolerance=min(plan.tolerance, TOLERANCE))
    starts = _starts(rng, problem, proposals, plan.tolerance)
    lineage = np.repeat(np.arange(len(starts.roots)), VARIANTS)
    return grown(rng, problem, _moved(rng, problem, starts, VARIANTS, VARIED), lineage, plan)


def grown(
    rng: np.random.Generator, problem: Problem, starts: Proposals, lineage: NDArray[np.int64], plan: Schedule
) -> tuple[Hypotheses, Array]:
    """The best chains that grow from `starts`, at most CHAINS of each `lineage` (P,) and those laid on the scan last,
    judged at the tolerance of the `plan`; and their log scores (P,), rendered whole."""
    mrf, count, tolerance = problem.mrf, len(starts.roots), plan.tolerance
    unary, part_poses = np.zeros((count, mrf.nodes)), np.zeros((count, mrf.nodes, 7))
    part_poses[:, 0], unary[:, 0] = starts.roots, root_unary(problem, starts.roots, tolerance)
    chains = Hypotheses(**vars(starts), unary=unary, part_poses=part_poses)
    start, placed = np.arange(count), {0}
    merit = explained_together(problem, part_poses, placed, tolerance)
    for place, number in enumerate(mrf.tree):
        edge = mrf.model.edges[number]
        if follows(mrf.model.edges, number):
            axes = edge.axis_positions(chains.joints)[:, None]
        else:
            axes = stratified_axes(rng, edge, (len(chains.roots),), DRAWS)
        tried, score = judged(problem, number, chains.part_poses[:, edge.parent], axes, tolerance)
        total = merit[:, None] + score
        if edge.child == problem.prior_node:
            total = problem.plus_prior(total, tried)
        ends = _cells(rng, mrf, edge.child, tried, CELL * tolerance).ravel() + np.repeat(start, axes.shape[1])
        for part in _open_parts(mrf, place):
            ends += np.repeat(_cells(rng, mrf, part, chains.part_poses[:, part], CELL * tolerance), axes.shape[1])
        best = _going_on(rng, mrf, edge.child, tried, total.ravel(), ends, np.repeat(lineage[start], axes.shape[1]))
        row, draw = np.divmod(best, axes.shape[1])
        chains, start = chains.taken(row), start[row]
        chains.part_poses[:, edge.child], chains.unary[:, edge.child] = tried[row, draw], score[row, draw]
        coordinates, positions = edge.joint_positions(axes[row, draw])
        chains.joints[:, coordinates] = positions
        placed.add(edge.child)
        merit = explained_together(problem, chains.part_poses, placed, tolerance)
        # what is laid on the scan is judged by the prior, too, which speaks of a part that has to be there
        if place % LAID_EVERY == 0 and problem.prior_node in {-1, *placed}:
            best = _best_of_each(merit, np.arange(len(merit)), lineage[start], LAID)
            laid = _laid_on_the_scan(rng, problem, chains.taken(best), placed, plan)
            chains, start = chains.joined(laid), np.concatenate([start, start[best]])
            merit = np.concatenate([merit, explained_together(problem, laid.part_poses, placed, tolerance)])
    return chains, merit


def _laid_on_the_scan(
    rng: np.random.Generator, problem: Problem, chains: Hypotheses, placed: set[int], plan: Schedule
) -> Hypotheses:
    """The chains, of which the parts `placed` count, one step of registration further."""
    gone = _without_a_place(problem, placed)
    seen = replace(problem, surfaces=problem.surfaces.without(gone))
    roots, joints, _ = polish(rng, seen, chains.roots, chains.joints, plan, plan.tolerance, rounds=1, draws=False)
    part_poses = problem.mrf.part_poses(roots, joints)
    unary = part_unary(problem, part_poses, plan.tolerance)
    unary[:, gone] = 0.0
    return replace(chains, roots=roots, joints=joints, part_poses=part_poses, unary=unary)


def explained_together(problem: Problem, part_poses: Array, placed: set[int], tolerance: float) -> Array:
    """Log scores (P,) of objects of which only the parts `placed` are where `part_poses` (P, N, 7) says, and the others
    nowhere; the prior included where it speaks of one of them. What goes on beyond their outline may be the next
    part."""
    surfaces = problem.surfaces.without(_without_a_place(problem, placed))
    pixel_score = replace(problem.plain_score(tolerance), continued_reward=1.0)
    score = object_scores(problem.observation, surfaces, part_poses, pixel_score, problem.nuisances)
    return problem.plus_prior(score, part_poses[:, problem.prior_node]) if problem.prior_node in placed else score


def _without_a_place(problem: Problem, placed: set[int]) -> list[int]:
    """The parts that are not `placed`."""
    return [part for part in range(problem.mrf.nodes) if part not in placed]


def _starts(rng: np.random.Generator, problem: Problem, proposals: Proposals, tolerance: float) -> Proposals:
    """At most LINEAGES proposals whose root poses explain most for themselves, moved to where they do best; for any
    orientation ANY_ORIENTATION times as many."""
    more = ANY_ORIENTATION if problem.any_orientation else 1
    for number, (apart, most) in enumerate(ROUNDS):
        if number:
            proposals = _moved(rng, problem, proposals, ABOUT, apart / 2)
        score = root_unary(problem, proposals.roots, tolerance)
        if problem.prior_node == 0:
            score = problem.plus_prior(score, proposals.roots)
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


def _going_on(
    rng: np.random.Generator,
    mrf: Mrf,
    part: int,
    tried: Array,
    total: Array,
    ends: NDArray[np.int64],
    lineage: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Rows of the best `total` (P,) of each of the `ends` (P,), at most CHAINS of a `lineage` (P,), best first; they
    count less the more better ones place `part`, at poses (..., 7) `tried`, in the same region."""
    best = _best_of_each(total, ends, np.zeros_like(ends), len(ends))
    region = _cells(rng, mrf, part, tried, REGION).ravel()[best] + lineage[best]
    merit = total[best] - CROWDED * abs(total.max()) * _rank_within(region)
    return best[_best_of_each(merit, np.arange(len(best)), lineage[best], CHAINS)]


def _best_of_each(score: Array, ends: NDArray[np.int64], lineage: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Rows, best first, of the best `score` (P,) of each of the `ends` (P,), at most `most` of a `lineage` (P,)."""
    order = np.argsort(-score, kind="stable")
    _, first = np.unique(ends[order], return_index=True)
    order = order[np.sort(first)]
    return order[_rank_within(lineage[order]) < most]


def _rank_within(group: NDArray[np.int64]) -> NDArray[np.int64]:
    """How many of the same `group` (P,) come before each (P,)."""
    by_group = np.argsort(group, kind="stable")
    place = np.empty_like(by_group)
    place[by_group] = np.arange(len(group)) - np.searchsorted(group[by_group], group[by_group])
    return place
