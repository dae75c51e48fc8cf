"""Where else could the object be? The places that the search compared last, a joint in another place, a wrist or an
elbow bent the other way, and for a long chain those bent otherwise, brought to their best where their score comes near
the estimate's.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.confirmation import Confirmation, confirmation
from pmpnbp.inference.crank_moves import crank_moves
from pmpnbp.inference.joint_draws import short_way_round, within_limits
from pmpnbp.inference.mrf import part_motions
from pmpnbp.inference.problem import LONG_CHAIN, Problem
from pmpnbp.inference.tree_estimate import polish
from pmpnbp.inference.triple_moves import triple_moves
from pmpnbp.potentials.nuisances import split
from pmpnbp.readout.fit import GOOD, NOTHING, assess
from pmpnbp.readout.log_posterior import log_posterior
from pmpnbp.readout.object_posterior import ModeDraws, misfit

# A rival is polished where its score is worse than the estimate's by a smaller share, and drawn from where it is then
# worse by fewer nats, counted as they weigh: a broad mode may make up for some.
CLOSE, NATS = 0.2, 7.0
# Rivals that are worse by SLOW to FAR nats more than that are registered once, without variations drawn at random. A
# round with them is made for those that are then, or were, worse by at most SLOW and AGAIN times what the last round
# brought, and a further one where that was LITTLE or more. Of 463 rivals on even seeds 626 to 632 those that came near
# had been worse by 379 at most, and after a round by 35 where it had brought 130, and by 19 where it had brought 5;
# what rests would have gained 0.3 nats in the mean, and 13 at most. Of 120 runs on even seeds 702 and 722 three had a
# rival more or less for it that was near, none of them with an object that was found.
POLISH_ROUNDS, FAR, LITTLE, SLOW, AGAIN = 3, 500.0, 0.5, 20.0, 3.0
# Two places are one mode where every part's middle and rim are nearer than this, metres, of a long chain than the
# second, or than so many of its standard deviations.
SAME, SAME_BEND, DEVIATIONS = 0.01, 0.003, 4.0
# The best so many places of a long chain that is bent otherwise somewhere are rivals, too.
BENT = 48
# Another thing of the same kind is looked for in the best so many rivals whose middle is farther off than this, in
# radii of the largest part; it explains other pixels, but for this share. Before it is polished it may share twice as
# much, and its score is FAINT of the estimate's at the least: those that were good fits then shared none at all, on
# seeds 44 to 73, and had 0.43, on seeds 44 to 79.
OTHERS, APART, SHARED, FAINT = 2, 0.5, 0.3, 0.15
# Of a thing between others of its kind so much of what is in sight is confirmed at the least, if also on their common
# front, which counts little as it goes on beyond it.
ALL_OVER = 0.9


@dataclass(frozen=True, kw_only=True)
class Place:
    """A mode. seen : what the views say of its best configuration; draws : about that; apart : whether it is another
    thing of the same kind."""

    seen: Confirmation
    draws: ModeDraws
    apart: bool

    @property
    def root(self) -> Array:
        """(7,) of its best configuration."""
        return self.draws.about.root

    @property
    def joints(self) -> Array:
        """(D,) of its best configuration."""
        return self.draws.about.joints

    @property
    def nats(self) -> float:
        """The log posterior at its best configuration."""
        return self.draws.nats


def contenders(
    rng: np.random.Generator, problem: Problem, report: IterationReport, own: Place, reach: Array
) -> Iterator[tuple[Array, Array, Confirmation, bool]]:
    """Root pose (7,) and joint vector (D,) of the rivals at their best, what the views say of each, and whether it is
    another thing of the same kind: those are told first, then those that come near the estimate's mode, of all that are
    not within `reach` (N,) of it."""
    others, possible = triple_moves(problem.mrf, problem.mrf.part_poses(own.root, own.joints)[None], own.joints[None])
    joints = np.concatenate([others[possible], _turned_by_half(problem, own.joints)])
    roots = np.concatenate([np.tile(own.root, (len(joints), 1)), own.draws.elsewhere.roots])
    joints = np.concatenate([joints, own.draws.elsewhere.joints])
    if report.rivals is not None:
        rivals = report.rivals[:, :7], report.rivals[:, 7:]
        roots = np.concatenate([scaled(problem, *rivals), roots])
        joints = np.concatenate([rivals[1], joints])
    left = np.any(strayed(problem, own.root, own.joints, roots, joints) > reach, axis=1)
    roots, joints = roots[left], joints[left]
    score = log_posterior(problem, roots, joints)
    yield from ((*other, True) for other in _others(rng, problem, report, own, roots, joints, score))
    close = score > own.nats - CLOSE * abs(own.nats)
    roots, joints, score = roots[close], joints[close], score[close]
    if problem.mrf.depth >= LONG_CHAIN:
        bent_roots, bent = crank_moves(problem.mrf, own.root, own.joints)
        bent_score = log_posterior(problem, bent_roots, bent)
        top = np.argsort(-bent_score, kind="stable")[:BENT]
        roots, joints = np.concatenate([roots, bent_roots[top]]), np.concatenate([joints, bent[top]])
        score = np.concatenate([score, bent_score[top]])
    for root, q in _polished(rng, problem, report, own, roots, joints, score):
        seen = confirmation(problem, root, q)
        # what is another thing, or leaves the region that the estimate is in, is no place of this one
        if _shared(own.seen, seen) >= SHARED and (own.seen.outside_region or not seen.outside_region):
            yield root, q, seen, False


def scaled(problem: Problem, roots: Array, joints: Array) -> Array:
    """(R, 7) root poses of rivals (R, 7), (R, D), which the search found with depths as they are, where their middles
    are with the scales of depth that the problem takes: none would else come near an estimate that follows these."""
    if problem.nuisances is None:
        return roots
    views = problem.observation.views
    scales = split(problem.nuisances, len(views))[0]
    cameras = np.array([view.pose_world_scan[:3] for view in views])
    middles = _middles(problem, roots, joints)
    # it appears at cameras + (1 + scales) * (middle - cameras), in the mean of the views
    away = ((scales[:, None] * cameras).mean(axis=0) - scales.mean() * middles) / (1 + scales.mean())
    return np.concatenate([roots[:, :3] + away, roots[:, 3:]], axis=1)


def _turned_by_half(problem: Problem, joints: Array) -> Array:
    """(K, D): a configuration (D,) with each joint turned by half whose limits allow it: a bar looks the same then."""
    model = problem.mrf.model
    turns, one = problem.joint_turns, np.eye(model.dof)
    # both ways round lead to the same place where an axis wraps
    turned = joints + np.pi * np.concatenate([one[turns], -one[turns & ~model.wraps]])
    put = within_limits(turned, model.lower, model.upper, model.wraps)
    allowed = np.isclose(short_way_round(turned - put, model.wraps), 0.0).all(axis=1)
    return put[allowed]


def _polished(
    rng: np.random.Generator,
    problem: Problem,
    report: IterationReport,
    own: Place,
    roots: Array,
    joints: Array,
    score: Array,
) -> list[tuple[Array, Array]]:
    """Rivals (R, 7), (R, D) of log posteriors (R,) at their best, best first: those that come near the estimate's."""
    plan, tolerance = problem.schedule(report.iteration), problem.tolerance_end
    near = own.nats - NATS * misfit(own.nats)
    roots, joints, score = roots.copy(), joints.copy(), score.copy()

    def gains(rows: NDArray[np.int64], draws: bool) -> Array:
        """A round for some of them, and the nats that it brought each (C,)."""
        roots[rows], joints[rows], _ = polish(rng, problem, roots[rows], joints[rows], plan, tolerance, 1, draws=draws)
        before, score[rows] = score[rows], log_posterior(problem, roots[rows], joints[rows])
        found: Array = score[rows] - before
        return found

    gain, far = np.zeros(len(score)), np.flatnonzero((score > near - FAR) & (score <= near - SLOW))
    if len(far):
        gain[far] = gains(far, draws=False)
    rows = np.flatnonzero(score > near - SLOW - AGAIN * gain)
    for _ in range(POLISH_ROUNDS):
        if not len(rows):
            break
        gain = gains(rows, draws=True)
        rows = rows[(gain >= LITTLE) & (score[rows] > near - SLOW - AGAIN * gain)]
    order = np.argsort(-score, kind="stable")[: np.count_nonzero(score > near)]
    return list(zip(roots[order], joints[order], strict=True))


def _others(
    rng: np.random.Generator,
    problem: Problem,
    report: IterationReport,
    own: Place,
    roots: Array,
    joints: Array,
    score: Array,
) -> list[tuple[Array, Array, Confirmation]]:
    """Things of the same kind among rivals (R, 7), (R, D), polished: a good fit each, or one that stands beside more,
    in a row, and comes as near the estimate's score as a mode or is confirmed all over; each explains other pixels."""
    middles, least = _middles(problem, roots, joints), APART * float(problem.mrf.radii.max())
    taken, found = [_middles(problem, own.root[None], own.joints[None])[0]], []
    for row in np.argsort(-score, kind="stable"):
        if len(taken) > OTHERS or score[row] <= FAINT * max(own.nats, 0.0):
            break
        if min(float(np.linalg.norm(middles[row] - middle)) for middle in taken) < least:
            continue
        taken.append(middles[row])
        # most rivals explain what the estimate does, and polishing them would be for nothing
        if _shared(own.seen, confirmation(problem, roots[row], joints[row])) > 2 * SHARED:
            continue
        plan = problem.schedule(report.iteration)
        places, q, _ = polish(rng, problem, roots[[row]], joints[[row]], plan, problem.tolerance_end, POLISH_ROUNDS)
        seen = confirmation(problem, places[0], q[0])
        alike = score[row] > own.nats - CLOSE * abs(own.nats) and seen.explained >= GOOD
        if _shared(own.seen, seen) < SHARED and (alike or _in_a_row(seen) or assess(seen).verdict == "good"):
            found.append((places[0], q[0], seen))
    return found


def _in_a_row(seen: Confirmation) -> bool:
    """Whether a place is confirmed all over, though much of it on surfaces that go on, as flush fronts do."""
    in_sight = seen.covered - seen.hidden - seen.outside
    return seen.explained >= NOTHING and not seen.outside_region and seen.confirmed >= ALL_OVER * in_sight


def mode_reach(problem: Problem, place: Place) -> Array:
    """(N,) metres up to which a part is of the same mode as at a place, by what is drawn about it."""
    draws = place.draws
    far = strayed(problem, place.root, place.joints, draws.roots, draws.joints)
    return np.maximum(least_reach(problem), DEVIATIONS * np.sqrt(np.exp(draws.log_weights) @ far**2))


def least_reach(problem: Problem) -> float:
    """Metres up to which all parts are of the same mode, whatever is drawn."""
    return SAME_BEND if problem.mrf.depth >= LONG_CHAIN else SAME


def strayed(problem: Problem, root: Array, joints: Array, roots: Array, others: Array) -> Array:
    """(C, N): metres that each part's middle or rim moves, the most, from (7,), (D,) to (C, 7), (C, D)."""
    mrf = problem.mrf
    return part_motions(mrf, mrf.part_poses(root, joints), mrf.part_poses(roots, others))


def _shared(one: Confirmation, other: Confirmation) -> float:
    """Of the pixels that confirm the one or the other place, whichever are fewer, the share that confirm both."""
    both = sum(np.count_nonzero(a & b) for (_, _, a), (_, _, b) in zip(one.pixels, other.pixels, strict=True))
    return both / max(min(one.confirmed, other.confirmed), 1)


def _middles(problem: Problem, roots: Array, joints: Array) -> Array:
    """(R, 3) of the parts of configurations (R, 7), (R, D) together."""
    found: Array = poses.transform_points(problem.mrf.part_poses(roots, joints), problem.mrf.centres).mean(axis=1)
    return found
