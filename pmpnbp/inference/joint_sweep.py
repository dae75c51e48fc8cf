"""Is a joint in the wrong place though all the others are right? One joint at a time, over its whole range.

A wrist found turned by half, or a head that looks up instead of down, is a place from which no small move leads out,
and the search, which puts whole objects together from the root, seldom draws again only that joint. Here each joint
in turn is put to positions all over its range, once with everything behind it carried along and once with it left as
near to its place as the joints allow; and three joints in a row are moved where these leave all behind them in place.
The best positions of each joint are polished before they are compared, as a joint in its right place is worth little
until its neighbours have followed.
"""

from __future__ import annotations

import numpy as np

from pmpnbp.geometry.poses import Array
from pmpnbp.inference.half_turns import half_turns
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.tree_estimate import assemble, configuration_scores, polish, profile_scores
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.settings import Schedule

# Positions over a joint's range, at least and at most: as many as leave the part no farther than the tolerance from one
# of them; and the least share of the range that makes another position of it.
FEWEST, MOST = 12, 36
APART = 0.1
# Places of a joint that are told apart: a part that is hidden in one fits as well into any other that hides it.
PLACES = 2
# Joints whose best other position is polished, those of them that are polished on, and for how many rounds each.
CANDIDATES, FINALISTS = 12, 2
ROUNDS, LAST_ROUNDS = 2, 6
# A position is polished, and then polished on, where its score is worse than the present one by at most these shares.
LOSS_BEFORE, LOSS_AFTER = 0.2, 0.05


def sweep(
    rng: np.random.Generator, problem: Problem, root: Array, joints: Array, plan: Schedule, most: int
) -> tuple[Array, Array, float]:
    """The configuration after at most `most` joints were put elsewhere, each for a better profile score: root pose
    (7,), joint vector (D,) and score."""
    for _ in range(most):
        here = float(configuration_scores(problem, root[None], joints[None], plan.tolerance)[0])
        others, reached = (found[0] for found in elsewhere(rng, problem, root[None], joints[None], plan))
        worth = np.argsort(-reached, kind="stable")[:CANDIDATES]
        worth = worth[reached[worth] > here - LOSS_BEFORE * abs(here)]
        if not len(worth):
            break
        roots = np.tile(root, (len(worth), 1))
        roots, moved, score = polish(rng, problem, roots, others[worth], plan, plan.tolerance, ROUNDS)
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
    rng: np.random.Generator, problem: Problem, roots: Array, joints: Array, plan: Schedule
) -> tuple[Array, Array]:
    """Joint vectors (H, J, D) of each of H configurations (H, 7), (H, D) with one of its joints moved, each to its best
    PLACES, well away from its present one and from each other, then with three of them moved (see `half_turns`); and
    their scores (H, J), -inf where a joint has no such place."""
    model, mrf, many = problem.mrf.model, problem.mrf, len(roots)
    part_poses = mrf.part_poses(roots, joints)
    rows = np.arange(many)
    found, scores = [], []
    for number in mrf.tree:
        edge = model.edges[number]
        for coordinate in edge.coordinates:
            lower, span = model.lower[coordinate], model.upper[coordinate] - model.lower[coordinate]
            if not 0 < span < np.inf:
                continue
            lever = 2 * mrf.radii[edge.child] if problem.joint_turns[coordinate] else 1.0
            count = int(np.clip(np.ceil(span * lever / plan.tolerance), FEWEST, MOST))
            positions = lower + span * (np.arange(count) + rng.random((many, count))) / count
            carried = np.repeat(joints[:, None], count, axis=1)
            carried[..., coordinate] = positions
            moved = np.repeat(part_poses[:, None], count, axis=1)
            moved[:, :, edge.child] = mrf.part_poses(roots[:, None], carried)[:, :, edge.child]
            _, kept = assemble(mrf, moved.reshape(-1, *part_poses.shape[1:]), 0)
            tried = np.concatenate([carried, kept.reshape(carried.shape)], axis=1)
            positions = np.tile(positions, 2)
            far = _gap(model, coordinate, positions, joints[:, coordinate, None]) > APART * span
            score = np.full(far.shape, -np.inf)
            score[far] = configuration_scores(problem, roots[np.nonzero(far)[0]], tried[far], plan.tolerance)
            for _ in range(PLACES):
                best = score.argmax(axis=1)
                found.append(tried[None, rows, best])
                scores.append(score[None, rows, best])
                taken = positions[rows, best, None]
                score[_gap(model, coordinate, positions, taken) <= APART * span] = -np.inf
    turned, possible = half_turns(mrf, part_poses, joints)
    score = np.full(possible.shape, -np.inf)
    which = np.nonzero(possible)
    score[which] = configuration_scores(problem, roots[which[0]], turned[which], plan.tolerance)
    found.append(np.swapaxes(turned, 0, 1))
    scores.append(score.T)
    return np.swapaxes(np.concatenate(found), 0, 1), np.concatenate(scores).T


def _gap(model: ArticulatedObject, coordinate: int, one: Array, other: Array) -> Array:
    """How far a joint coordinate moves from one position to another, metres or radians; full turns count nothing."""
    gap = np.abs(one - other)
    return np.minimum(gap, model.upper[coordinate] - model.lower[coordinate] - gap) if model.wraps[coordinate] else gap
