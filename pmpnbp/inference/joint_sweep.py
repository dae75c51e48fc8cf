"""Is a joint in the wrong place though all the others are right? One joint at a time, over its whole range.

A wrist found turned by half, or a head that looks up instead of down, is a place from which no small move leads out,
and the search, which puts whole objects together from the root, seldom draws again only that joint. Here each joint
in turn is put to positions all over its range, once with everything behind it carried along and once with it left as
near to its place as the joints allow; three joints in a row are moved where these leave all behind them in place; and,
without a narrow prior, each is moved with everything behind it put anew, as a walk does: what hides behind something
may hide there because of a joint before it that is wrong. Where hardly any of the root is seen, the joints before the
part that is seen best are put anew, and that part stays: a foot behind a screen may be anywhere that its arm reaches.

The best positions of each joint are polished before they are compared, as a joint in its right place is worth little
until its neighbours have followed.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry.poses import Array
from pmpnbp.inference.belief import OWN
from pmpnbp.inference.held_part import held
from pmpnbp.inference.hypotheses import Proposals, on_the_way, walk
from pmpnbp.inference.initialisation import random_joints
from pmpnbp.inference.mrf import Mrf
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.tree_estimate import assemble, configuration_scores, polish, profile_scores
from pmpnbp.inference.triple_moves import triple_moves
from pmpnbp.settings import Schedule

# Positions over a joint's range, at least and at most: as many as leave the part no farther than the tolerance from one
# of them.
FEWEST, MOST = 12, 36
# Other places of a joint that are tried; and how much lower than both the score has to be between two of them, as a
# share of the present one.
PLACES, DIP = 2, 0.05
# Joints whose best other position is polished, those of them that are polished on, and for how many rounds each.
CANDIDATES, FINALISTS = 12, 2
ROUNDS, LAST_ROUNDS = 2, 6
# Candidates beside them whose parts behind the moved joint are put anew, and as many whose parts before the best seen
# one are: the best of so many, with the first joints from the root on, about so many coordinates, anywhere.
ANEW, BEFORE, FIRST = 6, 256, 3
# A position is polished, and then polished on, where its score is worse than the present one by at most these shares.
LOSS_BEFORE, LOSS_AFTER = 0.2, 0.05


def sweep(
    rng: np.random.Generator, problem: Problem, root: Array, joints: Array, plan: Schedule, most: int
) -> tuple[Array, Array, float]:
    """The configuration after at most `most` joints were put elsewhere, each for a better profile score: root pose
    (7,), joint vector (D,) and score."""
    for _ in range(most):
        here = float(configuration_scores(problem, root[None], joints[None], plan.tolerance)[0])
        others, reached = _elsewhere_at_either_tolerance(rng, problem, root, joints, plan)
        roots = np.tile(root, (len(others), 1))
        if not problem.narrow:
            behind, its = with_those_behind_anew(rng, problem, root, joints, plan)
            places, before, theirs = with_those_before_anew(rng, problem, root, joints, plan)
            roots = np.concatenate([roots, np.tile(root, (len(behind), 1)), places])
            others, reached = np.concatenate([others, behind, before]), np.concatenate([reached, its, theirs])
        worth = np.argsort(-reached, kind="stable")[:CANDIDATES]
        worth = worth[reached[worth] > here - LOSS_BEFORE * abs(here)]
        if not len(worth):
            break
        roots, moved, score = polish(rng, problem, roots[worth], others[worth], plan, plan.tolerance, ROUNDS)
        kept = np.argsort(-score, kind="stable")[:FINALISTS]
        kept = kept[score[kept] > here - LOSS_AFTER * abs(here)]
        if not len(kept):
            break
        roots, moved = np.concatenate([root[None], roots[kept]]), np.concatenate([joints[None], moved[kept]])
        roots, moved, _ = polish(rng, problem, roots, moved, plan, problem.tolerance_end, LAST_ROUNDS)
        best = int(profile_scores(problem, roots, moved).argmax())
        root, joints = roots[best], moved[best]
        if best == 0:  # no other place is better
            break
    return root, joints, float(profile_scores(problem, root[None], joints[None])[0])


def elsewhere(
    rng: np.random.Generator, problem: Problem, roots: Array, joints: Array, plan: Schedule, *, anywhere: bool = False
) -> tuple[Array, Array]:
    """Joint vectors (H, J, D) of each of H configurations (H, 7), (H, D) with one of its joints moved, each to its best
    PLACES, then with three of them moved (see `triple_moves`); and their scores (H, J), -inf where a joint has no such
    place.

    Positions are of one place where no score on the way from one to the other is lower than both by more than a DIP:
    behind another part a joint may be anywhere, and that it is the best of one place must not hide the second best.
    anywhere : whether the place that the joint is in now may be found as well
    """
    model, mrf, many = problem.mrf.model, problem.mrf, len(roots)
    part_poses = mrf.part_poses(roots, joints)
    rows = np.arange(many)
    here = configuration_scores(problem, roots, joints, plan.tolerance)
    dip = DIP * np.abs(here)
    behind, moved_by = _moved_behind(mrf), Counter(int(c) for edge in model.edges for c in edge.coordinates)
    found, scores = [], []
    for number in mrf.tree:
        edge = model.edges[number]
        for coordinate in edge.coordinates:
            positions = _over_its_range(rng, problem, edge.child, coordinate, plan, many)
            count = positions.shape[1]
            if not count:
                continue
            tried = np.repeat(joints[:, None], count, axis=1)[:, None]
            tried[..., coordinate] = positions[:, None]
            # where nothing moves but this part, to carry all along or to leave it is the same
            if behind[edge.child].any() or moved_by[int(coordinate)] > 1:
                moved = np.repeat(part_poses[:, None], count, axis=1)
                moved[:, :, edge.child] = mrf.part_poses(roots[:, None], tried[:, 0])[:, :, edge.child]
                _, kept = assemble(mrf, moved.reshape(-1, *part_poses.shape[1:]), 0)
                tried = np.concatenate([tried, kept.reshape(tried.shape)], axis=1)
            ways = tried.shape[1]
            every = np.repeat(roots, ways * count, axis=0)
            score = configuration_scores(problem, every, tried.reshape(-1, model.dof), plan.tolerance)
            score, tried = score.reshape(ways * many, count), tried.reshape(ways * many, count, model.dof)
            taken = np.zeros(score.shape, dtype=bool)
            wraps = bool(model.wraps[coordinate])
            if not anywhere:
                before = np.repeat((positions < joints[:, coordinate, None]).sum(axis=1), ways)
                taken |= _basin(score, before, np.repeat(here, ways), np.repeat(dip, ways), wraps)
            for _ in range(PLACES):
                left = np.where(taken, -np.inf, score).reshape(many, ways * count)
                which, best = np.divmod(left.argmax(axis=1), count)
                row = ways * rows + which
                found.append(tried[None, row, best])
                scores.append(left[None, rows, which * count + best])
                taken |= np.repeat(_basin(score[row], best, score[row, best], dip, wraps), ways, axis=0)
    turned, possible = triple_moves(mrf, part_poses, joints)
    score = np.full(possible.shape, -np.inf)
    which = np.nonzero(possible)
    score[which] = configuration_scores(problem, roots[which[0]], turned[which], plan.tolerance)
    found.append(np.swapaxes(turned, 0, 1))
    scores.append(score.T)
    return np.swapaxes(np.concatenate(found), 0, 1), np.concatenate(scores).T


def _elsewhere_at_either_tolerance(
    rng: np.random.Generator, problem: Problem, root: Array, joints: Array, plan: Schedule
) -> tuple[Array, Array]:
    """As `elsewhere` of one configuration (7,), (D,), (J, D) and (J,): at the plan's tolerance, or at the last where
    that finds a place of a joint that is better by the plan's. To this two places are one that are some centimetres
    from each other."""
    others, reached = (found[0] for found in elsewhere(rng, problem, root[None], joints[None], plan))
    # a generator of its own: where it finds nothing better all goes on as without it
    own, last = np.random.default_rng(problem.seed), replace(plan, tolerance=problem.tolerance_end)
    finer, its = (found[0] for found in elsewhere(own, problem, root[None], joints[None], last))
    there = np.flatnonzero(np.isfinite(its))
    its[there] = configuration_scores(problem, np.tile(root, (len(there), 1)), finer[there], plan.tolerance)
    better = its > reached
    return np.where(better[:, None], finer, others), np.where(better, its, reached)


def with_those_behind_anew(
    rng: np.random.Generator, problem: Problem, root: Array, joints: Array, plan: Schedule
) -> tuple[Array, Array]:
    """The ANEW best joint vectors (C, D) of a configuration (7,), (D,) with a joint anywhere in its range and those
    behind it where a walk puts them, and their scores (C,). Where a part is hidden the next one has to follow, or
    would be seen."""
    mrf, behind = problem.mrf, _moved_behind(problem.mrf)
    tried, held = [], []
    for edge in (mrf.model.edges[number] for number in mrf.tree):
        for coordinate in edge.coordinates if behind[edge.child].any() else ():
            positions = _over_its_range(rng, problem, edge.child, coordinate, plan, 1)[0]
            tried.append(np.tile(joints, (len(positions), 1)))
            tried[-1][:, coordinate] = positions
            held.append(np.full(len(positions), edge.child, dtype=np.int64))
    count = sum(len(some) for some in tried)
    if not count:
        return np.empty((0, len(joints))), np.empty(0)
    moved, part = np.concatenate(tried), np.concatenate(held)
    proposals = Proposals(
        roots=np.tile(root, (count, 1)),
        joints=moved,
        source=np.full(count, OWN, dtype=np.uint8),
        ancestor=np.full(count, -1, dtype=np.int32),
        held=part,
    )
    moved = np.where(behind[part], walk(rng, problem, proposals, plan).joints, moved)
    score = configuration_scores(problem, proposals.roots, moved, plan.tolerance)
    best = np.argsort(-score, kind="stable")[:ANEW]
    return moved[best], score[best]


def with_those_before_anew(
    rng: np.random.Generator, problem: Problem, root: Array, joints: Array, plan: Schedule
) -> tuple[Array, Array, Array]:
    """The ANEW best root poses (C, 7) and joint vectors (C, D) of a configuration (7,), (D,) with the first joints on
    the way from the root to the part that it is held by anywhere in their ranges, while all from there on stays, and
    their scores (C,). None where the root holds it, or a single joint is before that part."""
    mrf, place = problem.mrf, held(problem, root, joints)
    leads, part, before = on_the_way(mrf)[place.part], 0, np.empty(0, dtype=np.int64)
    for number in (number for number in mrf.tree if leads[number]):
        if len(before) >= FIRST:
            break
        part, before = mrf.model.edges[number].child, np.union1d(before, mrf.model.edges[number].coordinates)
    if len(before) < 2:
        return np.empty((0, 7)), np.empty((0, len(joints))), np.empty(0)
    offsets = np.zeros((BEFORE, 6 + len(joints)))
    offsets[:, 6 + before] = (random_joints(rng, problem, BEFORE) - joints)[:, before]
    roots, moved = replace(place, part=part).placed(offsets)
    score = configuration_scores(problem, roots, moved, plan.tolerance)
    best = np.argsort(-score, kind="stable")[:ANEW]
    return roots[best], moved[best], score[best]


def _moved_behind(mrf: Mrf) -> NDArray[np.bool_]:
    """(N, D): the joint coordinates that move what hangs on each part."""
    behind = np.zeros((mrf.nodes, mrf.model.dof), dtype=bool)
    for number in reversed(mrf.tree):
        edge = mrf.model.edges[number]
        behind[edge.parent] |= behind[edge.child]
        behind[edge.parent, edge.coordinates] = True
    return behind


def _over_its_range(
    rng: np.random.Generator, problem: Problem, part: int, coordinate: int, plan: Schedule, many: int
) -> Array:
    """Stratified positions (many, C) all over the range of a joint that moves a part: as many as leave it no farther
    than the tolerance from one of them, none without a range."""
    model = problem.mrf.model
    lower, span = model.lower[coordinate], model.upper[coordinate] - model.lower[coordinate]
    if not 0 < span < np.inf:
        return np.empty((many, 0))
    lever = 2 * problem.mrf.radii[part] if problem.joint_turns[coordinate] else 1.0
    count = int(np.clip(np.ceil(span * lever / plan.tolerance), FEWEST, MOST))
    found: Array = lower + span * (np.arange(count) + rng.random((many, count))) / count
    return found


def _basin(score: Array, start: NDArray[np.int64], value: Array, most: Array, wraps: bool) -> NDArray[np.bool_]:
    """Which of the scores (R, C), in the order of their positions, belong to the place whose score is `value` (R,) and
    which is at number `start` (R,) or just before it: those to which, both ways, no rise by more than `most` (R,)
    leads."""
    count = score.shape[1]
    rows, steps = np.arange(len(score))[:, None], np.arange(count)
    inside = np.zeros(score.shape, dtype=bool)
    for way in (steps, -1 - steps):
        place = start[:, None] + way
        there = score[rows, place % count]
        lowest = np.minimum(np.minimum.accumulate(there, axis=1), value[:, None])
        reached = (there - lowest <= most[:, None]) & (wraps | ((place >= 0) & (place < count)))
        inside[rows, place % count] |= np.logical_and.accumulate(reached, axis=1)
    return inside
