"""Which of the search's hypotheses is the best, once each is in its best place? The last word of the search.

Until here a good hypothesis a little out of place may have been worth less than a wrong one in its best place. So those
that are left are polished, what looks like them and what has a joint elsewhere beside, and compared each at the
spread that its own depths have.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry.poses import Array
from pmpnbp.inference.hypotheses import Hypotheses, distinct
from pmpnbp.inference.joint_sweep import elsewhere, sweep
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.rivals import look_alikes, shifted
from pmpnbp.inference.tree_estimate import polish, profile_scores
from pmpnbp.settings import Schedule

# The tight tolerance, at which rivals are polished, is this many times the one that annealing ends at.
FINAL_TOLERANCE = 2.0
# Joints of the winner that may be put elsewhere after that.
SWEEPS = 3
# Finalists go on unless their score is worse than the best by a larger share; right ones were by a third at most.
HOPELESS = 0.5
# Rivals contest the best one where their score is worse by a smaller share.
CLOSE = 0.15
# What looks like a best one that nothing contests; for how many rounds that is polished, at so many times the last
# tolerance and then at that.
UNCONTESTED, UNCONTESTED_ROUNDS, LOOSE = 2, 4, 2.0
# Rounds after which what contests the best is compared with it, so that the hopeless are polished no longer.
HEAT = 2
# How long those that come near the best are polished, at the tolerance that annealing ends at, before one is chosen.
DECIDING_ROUNDS = 4


@dataclass(frozen=True)
class Settling:
    """How much is spent on the last word of the search.

    finalists : hypotheses that are registered once; mistaken : those of them that others of the same look are made
    of; alike : how many of these are polished with them; stay : how many are left after it, and of these and as many
    with a joint elsewhere after another round; rounds : that those are polished for then; rivals, last_rounds : the
    distinct ones among them that are polished at the tight tolerance, and for how long
    """

    finalists: int
    mistaken: int
    alike: int
    stay: int
    rounds: int
    rivals: int
    last_rounds: int


# Without a narrow prior places of the same look compete, which differ by little until they are exact; one leaves mostly
# one.
SETTLE_UNINFORMED = Settling(finalists=40, mistaken=6, alike=20, stay=16, rounds=2, rivals=6, last_rounds=8)
SETTLE_INFORMED = Settling(finalists=20, mistaken=0, alike=0, stay=8, rounds=2, rivals=2, last_rounds=4)


def settled(
    rng: np.random.Generator, problem: Problem, finalists: Hypotheses, plan: Schedule, effort: Settling
) -> tuple[Hypotheses, Array]:
    """Finalists and what looks like them, polished, and their profile scores; `plan` is that of the iteration."""
    finalists = finalists.taken(np.arange(min(effort.finalists, len(finalists.roots))))
    if effort.mistaken:
        first = finalists.taken(np.arange(min(effort.mistaken, len(finalists.roots))))
        finalists = finalists.joined(look_alikes(rng, problem, first, plan, effort.alike))
    finalists, score = _polished(rng, problem, finalists, plan, plan.tolerance, 1, draws=False)
    finalists = _promising(problem, finalists, score, plan, effort.stay)
    finalists = finalists.joined(_with_a_joint_elsewhere(rng, problem, finalists, plan, effort.stay))
    finalists, score = _polished(rng, problem, finalists, plan, plan.tolerance, 1)
    finalists = _promising(problem, finalists, score, plan, effort.stay)
    finalists, score = _polished(rng, problem, finalists, plan, plan.tolerance, effort.rounds)
    rivals = _promising(problem, finalists, score, plan, effort.stay)
    rivals = rivals.taken(np.arange(min(effort.rivals, len(rivals.roots))))
    tight = tight_tolerance(problem)
    rivals, score = _polished(rng, problem, rivals, plan, tight, effort.last_rounds)
    if effort.mistaken:
        rivals, score = _contested(rng, problem, rivals, score, replace(plan, tolerance=tight), effort)
    roots, joints, score = _decided(rng, problem, rivals, plan)
    best = int(score.argmax())
    roots[best], joints[best], score[best] = sweep(rng, problem, roots[best], joints[best], plan, SWEEPS)
    return replace(rivals, roots=roots, joints=joints, part_poses=problem.mrf.part_poses(roots, joints)), score


def _decided(
    rng: np.random.Generator, problem: Problem, rivals: Hypotheses, plan: Schedule
) -> tuple[Array, Array, Array]:
    """Roots (H, 7), joints (H, D) and profile scores (H,) of the rivals, of which those that come near the best are
    polished until millimetres tell them apart."""
    roots, joints = rivals.roots.copy(), rivals.joints.copy()
    score = profile_scores(problem, roots, joints)
    close = _near_best(problem, rivals, score, plan, CLOSE, len(score))
    if len(close) > 1:
        last = problem.tolerance_end
        roots[close], joints[close], _ = polish(rng, problem, roots[close], joints[close], plan, last, DECIDING_ROUNDS)
        score[close] = profile_scores(problem, roots[close], joints[close])
    return roots, joints, score


def _promising(problem: Problem, tried: Hypotheses, score: Array, plan: Schedule, most: int) -> Hypotheses:
    """Of the `most` best of those tried, best first, one for each place they came to, and none far behind the best."""
    return tried.taken(_near_best(problem, tried, score, plan, HOPELESS, most))


def _near_best(
    problem: Problem, tried: Hypotheses, score: Array, plan: Schedule, behind: float, most: int
) -> NDArray[np.int64]:
    """Rows of those of the `most` best, best first, that are not `behind` the best by a larger share of its score, one
    for each place."""
    order = np.argsort(-score, kind="stable")[:most]
    order = order[_keeps_up(score[order], score.max(), behind)]
    chosen, _ = distinct(problem, tried, order, len(order), plan.diffusion_position)
    return chosen


def _keeps_up(score: Array, best: float, behind: float) -> NDArray[np.bool_]:
    """(H,): which of the scores (H,) are not behind the best by a larger share of it."""
    return score >= best - behind * abs(best)


def _contested(
    rng: np.random.Generator, problem: Problem, rivals: Hypotheses, score: Array, plan: Schedule, effort: Settling
) -> tuple[Hypotheses, Array]:
    """Rivals and their profile scores (H,), and what looks like the best of them, and this with a part where another
    was, polished as well: of two places that look the same the right one may have been lost on the way. Where several
    places of the root come near the best, the same of each, and these with a joint elsewhere: none of them may be the
    right one."""
    order = np.argsort(-score, kind="stable")
    by_root = replace(rivals, unary=np.where(np.arange(problem.mrf.nodes) == 0, rivals.unary, 0.0))
    apart, _ = distinct(problem, by_root, order, len(order), plan.diffusion_position)
    close = apart[_keeps_up(score[apart], score.max(), CLOSE)]
    near = rivals.taken(close)
    others = _with_a_joint_elsewhere(rng, problem, shifted(rng, problem, near), plan, effort.rivals, anywhere=True)
    if len(close) == 1:
        alike = look_alikes(rng, problem, near, plan, UNCONTESTED)
        alike, _ = _polished(rng, problem, alike, plan, LOOSE * plan.tolerance, UNCONTESTED_ROUNDS)
        others, rounds = others.joined(alike), UNCONTESTED_ROUNDS
    else:
        others = others.joined(look_alikes(rng, problem, near, plan, effort.rivals))
        others = others.joined(_with_a_joint_elsewhere(rng, problem, near, plan, effort.rivals))
        rounds = effort.last_rounds
    others, reached = _raced(rng, problem, others, plan, rounds, score.max())
    return rivals.joined(others), np.concatenate([score, reached])


def _with_a_joint_elsewhere(
    rng: np.random.Generator,
    problem: Problem,
    finalists: Hypotheses,
    plan: Schedule,
    most: int,
    *,
    anywhere: bool = False,
) -> Hypotheses:
    """At most `most` of the finalists with one joint in the best of its other places, or `anywhere`, those with the
    best whole-object scores: a part that hides behind another was put where it explains that one's pixels once more."""
    joints, score = elsewhere(rng, problem, finalists.roots, finalists.joints, plan, anywhere=anywhere)
    best = np.argsort(-score, axis=None, kind="stable")[: min(most, np.isfinite(score).sum())]
    row, moved = np.unravel_index(best, score.shape)
    others, chosen = finalists.taken(row), joints[row, moved]
    return replace(others, joints=chosen, part_poses=problem.mrf.part_poses(others.roots, chosen))


def tight_tolerance(problem: Problem) -> float:
    """Metres: at which the search's rivals are polished, and what it found has to be confirmed."""
    return FINAL_TOLERANCE * problem.tolerance_end


def _raced(
    rng: np.random.Generator, problem: Problem, tried: Hypotheses, plan: Schedule, rounds: int, known: float
) -> tuple[Hypotheses, Array]:
    """As `_polished` at the tolerance of `plan`, without those that after HEAT rounds are hopeless beside the best of
    them and of others, the best of which has the profile score `known`."""
    tried, score = _polished(rng, problem, tried, plan, plan.tolerance, HEAT)
    left = tried.taken(np.flatnonzero(_keeps_up(score, score.max(initial=known), HOPELESS)))
    if not len(left.roots):
        return left, np.zeros(0)
    return _polished(rng, problem, left, plan, plan.tolerance, rounds - HEAT)


def _polished(
    rng: np.random.Generator,
    problem: Problem,
    tried: Hypotheses,
    plan: Schedule,
    tolerance: float,
    rounds: int,
    *,
    draws: bool = True,
) -> tuple[Hypotheses, Array]:
    """Hypotheses moved to their best places at a tolerance (`draws` as in `polish`), and their profile scores there."""
    roots, joints, _ = polish(rng, problem, tried.roots, tried.joints, plan, tolerance, rounds, draws=draws)
    found = replace(tried, roots=roots, joints=joints, part_poses=problem.mrf.part_poses(roots, joints))
    return found, profile_scores(problem, roots, joints)
