"""What does the scan leave open? A mixture of modes of the whole object is read out from an iteration, and the belief
that is told.

The estimate is one mode. Others are the places that the search compared last, brought to their best, where their score
comes near the estimate's: a cabinet turned by half, a wrist the other way round. A mode weighs as much as the
posterior's integral over the root's poses (its evidence), not as its best score: a broad mode holds more than a narrow
one of the same height. The room that joints have in a mode is divided out. Else a closed cabinet would rather be seen
from behind: there each drawer may be anywhere within its range, where in front it is shut to a millimetre, and so much
more would such a place weigh for every drawer, though nothing was seen of it. Between two places the score errs by more
than its noise, as no model is quite right, so that evidence is taken the less seriously the more of it there is.

Another thing of the same kind explains other pixels, and as well as it is seen: nothing in the scan says which of them
is meant. Such places weigh as much as each other, whatever their scores are.

Where the object is told to be is the middle of the draws, in all that is known to within the tolerance. The score is
rough, and its highest place a less good guess: on even seeds parts were 2.1 mm from it (root mean square), and 1.3 mm
from that middle.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.confirmation import Confirmation, confirmation
from pmpnbp.inference.joint_draws import within_limits
from pmpnbp.inference.log_weights import normalise
from pmpnbp.inference.mrf import part_motions
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.tree_estimate import agreeing, polish
from pmpnbp.readout.checkpoint import Checkpoint, go_on
from pmpnbp.readout.denied_parts import drawn_anew
from pmpnbp.readout.fit import assess
from pmpnbp.readout.object_posterior import ENOUGH, ModeDraws, log_posterior, mode_draws
from pmpnbp.readout.particle_statistics import short_way_round
from pmpnbp.readout.posterior import Centre, ObjectMode, Posterior

# Modes are told at most, and what weighs less than this is none.
MODES, LEAST_WEIGHT = 6, 1e-4
# Share of its score by which a place may be worth more or less than another for no good reason: on even seeds rivals
# in sight are worse than right estimates by 4 % and more, and those that are taken for each other within 2 %.
MISFIT = 0.007
# A rival is polished where its score is worse than the estimate's by a smaller share, and drawn from where it is then
# worse by fewer nats, counted as they weigh: a broad mode may make up for some.
CLOSE, NATS = 0.2, 7.0
# After one round the others are those that are worse by HOPELESS nats more: of 605 rivals on even seeds none that came
# near was then worse.
POLISH_ROUNDS, HOPELESS = 3, 80.0
# Two places are one mode where every part's middle and rim are nearer than this, metres, or than so many of its
# standard deviations.
SAME, DEVIATIONS = 0.01, 4.0
# Another thing of the same kind is looked for in the best so many rivals whose middle is farther off than this, in
# radii of the largest part; it explains other pixels, but for this share.
OTHERS, APART, SHARED = 2, 0.5, 0.3
# Metres and radians: no joint is taken for better known than this where modes are weighed.
SHUT = 1e-4
# Draws that are more nats better than the place they were drawn about, and too few, are drawn about the best of them.
SURPASSED = 4.0


@dataclass(frozen=True, kw_only=True)
class _Place:
    """A mode: root (7,) and joints (D,), its best configuration; nats : the log posterior there; seen : what the views
    say of it; draws : about it; apart : whether it is another thing of the same kind."""

    root: Array
    joints: Array
    nats: float
    seen: Confirmation
    draws: ModeDraws
    apart: bool


def read_out(problem: Problem, report: IterationReport, checkpoint: Checkpoint = go_on) -> Posterior | None:
    """The posterior about the estimate of an iteration; None during the search, whose estimate is on its way. Raises
    what `checkpoint` does."""
    return None if report.searching else of_estimate(problem, report, checkpoint)


def of_estimate(problem: Problem, report: IterationReport, checkpoint: Checkpoint = go_on) -> Posterior:
    """The posterior about the estimate of an iteration, whatever its stage. The same problem and report give the same
    numbers. Raises what `checkpoint` does, which is called between rounds of draws and between modes."""
    problem = problem.taking(report.nuisances)
    root, joints = agreeing(problem, report)
    rng = np.random.default_rng([problem.seed, report.iteration, 1])
    own = _drawn_about(rng, problem, report, root, joints, confirmation(problem, root, joints), checkpoint)
    places, reaches = [own], [_reach(problem, own)]
    checkpoint()
    for root_there, joints_there, seen, apart in _contenders(rng, problem, report, own, reaches[0]):
        if len(places) < MODES and not any(
            np.all(_part_motions(problem, place.root, place.joints, root_there, joints_there) <= reach)
            for place, reach in zip(places, reaches, strict=True)
        ):
            places.append(_drawn_about(rng, problem, report, root_there, joints_there, seen, checkpoint, apart=apart))
            reaches.append(_reach(problem, places[-1]))
    checkpoint()
    return _told(rng, problem, report.iteration, places, (root, joints))


def at_rest(
    problem: Problem, report: IterationReport, before: Posterior | None, checkpoint: Checkpoint = go_on
) -> Posterior | None:
    """The posterior of an iteration at rest: that of `before`, read out with the same problem, as long as the estimate
    has not moved since by what is rest. Raises what `checkpoint` does."""
    if before is not None:
        problem = problem.taking(report.nuisances)
        root, joints = agreeing(problem, report)
        moved = motions(problem, before.root, before.joints, root[None], joints[None])[0]
        if moved <= problem.settings.converged_motion:
            return before
    return read_out(problem, report, checkpoint)


def motions(problem: Problem, root: Array, joints: Array, roots: Array, others: Array) -> Array:
    """(C,) metres: the largest that any part's middle or rim moves from (7,), (D,) to (C, 7), (C, D)."""
    found: Array = _part_motions(problem, root, joints, roots, others).max(axis=1)
    return found


def _drawn_about(
    rng: np.random.Generator,
    problem: Problem,
    report: IterationReport,
    root: Array,
    joints: Array,
    seen: Confirmation,
    checkpoint: Checkpoint,
    *,
    apart: bool = False,
) -> _Place:
    """The mode about a configuration (7,), (D,); where its draws find a much better one and few of them count, about
    that."""
    draws = mode_draws(rng, problem, root, joints, checkpoint)
    if draws.gain > SURPASSED and draws.effective_sample_size < ENOUGH:
        plan, best = problem.schedule(report.iteration), (draws.best_root[None], draws.best_joints[None])
        roots, others, _ = polish(rng, problem, *best, plan, problem.tolerance_end, POLISH_ROUNDS)
        root, joints = roots[0], others[0]
        seen, draws = confirmation(problem, root, joints), mode_draws(rng, problem, root, joints, checkpoint)
    nats = float(log_posterior(problem, root[None], joints[None])[0])
    return _Place(root=root, joints=joints, nats=nats, seen=seen, draws=draws, apart=apart)


def _contenders(
    rng: np.random.Generator, problem: Problem, report: IterationReport, own: _Place, reach: Array
) -> Iterator[tuple[Array, Array, Confirmation, bool]]:
    """Root pose (7,) and joint vector (D,) of the rivals at their best, what the views say of each, and whether it is
    another thing of the same kind: those are told first, then those that come near the estimate's mode, of all that are
    not within `reach` (N,) of it."""
    if report.rivals is None or not len(report.rivals):
        return
    roots, joints = report.rivals[:, :7], report.rivals[:, 7:]
    left = np.any(_part_motions(problem, own.root, own.joints, roots, joints) > reach, axis=1)
    roots, joints = roots[left], joints[left]
    score = log_posterior(problem, roots, joints)
    others = _others(rng, problem, report, own, roots, joints, score)
    yield from ((*other, True) for other in others)
    close = score > own.nats - CLOSE * abs(own.nats)
    nats = NATS * _misfit(own)
    for root, q in _polished(rng, problem, report, own, roots[close], joints[close], nats):
        seen = confirmation(problem, root, q)
        # what is another thing, or leaves the region that the estimate is in, is no place of this one
        if _shared(own.seen, seen) >= SHARED and (own.seen.outside_region or not seen.outside_region):
            yield root, q, seen, False


def _polished(
    rng: np.random.Generator,
    problem: Problem,
    report: IterationReport,
    own: _Place,
    roots: Array,
    joints: Array,
    nats: float,
) -> list[tuple[Array, Array]]:
    """Rivals (R, 7), (R, D) at their best, best first, of which none is worse than the estimate's mode by more nats."""
    plan, tolerance = problem.schedule(report.iteration), problem.tolerance_end
    for rounds, worse in ((1, nats + HOPELESS), (POLISH_ROUNDS - 1, nats)):
        if not len(roots):
            return []
        roots, joints, _ = polish(rng, problem, roots, joints, plan, tolerance, rounds)
        score = log_posterior(problem, roots, joints)
        order = np.argsort(-score, kind="stable")[: np.count_nonzero(score > own.nats - worse)]
        roots, joints = roots[order], joints[order]
    return list(zip(roots, joints, strict=True))


def _others(
    rng: np.random.Generator,
    problem: Problem,
    report: IterationReport,
    own: _Place,
    roots: Array,
    joints: Array,
    score: Array,
) -> list[tuple[Array, Array, Confirmation]]:
    """Things of the same kind among rivals (R, 7), (R, D), polished: a good fit each, that explains other pixels."""
    middles, least = _middles(problem, roots, joints), APART * float(problem.mrf.radii.max())
    taken, found = [_middles(problem, own.root[None], own.joints[None])[0]], []
    for row in np.argsort(-score, kind="stable"):
        if len(taken) > OTHERS or score[row] <= 0:
            break
        if min(float(np.linalg.norm(middles[row] - middle)) for middle in taken) < least:
            continue
        taken.append(middles[row])
        plan = problem.schedule(report.iteration)
        places, q, _ = polish(rng, problem, roots[[row]], joints[[row]], plan, problem.tolerance_end, POLISH_ROUNDS)
        seen = confirmation(problem, places[0], q[0])
        if _shared(own.seen, seen) < SHARED and assess(seen).verdict == "good":
            found.append((places[0], q[0], seen))
    return found


def _told(
    rng: np.random.Generator, problem: Problem, iteration: int, places: list[_Place], estimate: tuple[Array, Array]
) -> Posterior:
    """All modes' draws, each weighed by its mode; told is the place of the heaviest one, where that is better than the
    estimate's, too."""
    model, log_weights = problem.mrf.model, _log_weights(places)
    order = [k for k in np.argsort(-log_weights, kind="stable") if log_weights[k] > np.log(LEAST_WEIGHT) or k == 0]
    log_weights[order] = normalise(log_weights[order])
    better = [k for k in order if not places[k].apart and places[k].nats > places[0].nats]
    told = next((k for k in better if log_weights[k] > log_weights[0]), 0)
    place, found = places[told], [places[k].draws for k in order]
    fit = assess(place.seen)
    if fit.verdict == "good" and (others := sum(places[k].apart for k in order)):
        number = "another one like it" if others == 1 else f"{others} others like it"
        fit = replace(fit, reason=f"{fit.reason}, and as well {number}: which one is meant?")
    denied = [node for node, part in enumerate(model.parts) if part.name in fit.denied]
    drawn_joints = np.concatenate([draws.joints for draws in found])
    return Posterior(
        iteration=iteration,
        root=estimate[0],
        joints=estimate[1],
        drawn_roots=np.concatenate([draws.roots for draws in found]),
        drawn_joints=drawn_anew(rng, problem, place.root, place.joints, denied, drawn_joints),
        log_weights=np.concatenate([draws.log_weights + log_weights[k] for k, draws in zip(order, found, strict=True)]),
        mode=np.repeat(np.arange(len(order)), [len(draws.roots) for draws in found]),
        modes=tuple(
            ObjectMode(weight=float(np.exp(log_weights[k])), root=places[k].root, joints=places[k].joints)
            for k in order
        ),
        effective_sample_size=place.draws.effective_sample_size,
        fit=fit,
        drawn_sizes=_sizes(problem, found),
        centre=_centre(problem, place) if problem.settings.object_estimate else None,
    )


def _log_weights(places: list[_Place]) -> Array:
    """(K,) of the places, the first of which is the estimate's. Those of one thing share its weight by evidence."""
    evidence = np.array([place.draws.log_evidence - _log_room(place.draws) for place in places])
    apart = np.array([place.apart for place in places])
    found = np.zeros(len(places))
    found[~apart] = normalise(evidence[~apart] / _misfit(places[0]))
    return found


def _misfit(place: _Place) -> float:
    """Nats of evidence that count as one, between places."""
    return 1.0 + MISFIT * abs(place.nats)


def _log_room(draws: ModeDraws) -> float:
    """Logarithm of the volume that a mode's joint positions fill, up to what is the same for all modes."""
    weights = np.exp(draws.log_weights)
    gap = draws.joints - weights @ draws.joints
    spread = np.einsum("k,ki,kj->ij", weights, gap, gap) + SHUT**2 * np.eye(gap.shape[1])
    return float(np.linalg.slogdet(spread)[1] / 2)


def _centre(problem: Problem, place: _Place) -> Centre:
    """The middle of a place's draws in what is known to within the tolerance, the root's pose all together; in what is
    not, the place itself."""
    model, middle, draws = problem.mrf.model, problem.mrf.centres[0], place.draws
    offsets = mode_offsets(problem, place.root, place.joints, draws.roots, draws.joints)
    weights = np.exp(draws.log_weights)
    mean = weights @ offsets
    stds = np.sqrt(weights @ (offsets - mean) ** 2)
    known = stds * coordinate_levers(problem) < problem.tolerance_end
    known[:6] = known[:6].all()
    mean = np.where(known, mean, 0.0)
    root = poses.perturb(place.root, mean[:3], mean[3:6], middle)
    joints = within_limits(place.joints + mean[6:], model.lower, model.upper, model.wraps)
    nuisances = weights @ draws.nuisances if draws.nuisances is not None and known[0] else problem.nuisances
    return Centre(root=root, joints=joints, nuisances=nuisances)


def mode_offsets(problem: Problem, root: Array, joints: Array, roots: Array, drawn_joints: Array) -> Array:
    """(K, 6 + D) of draws (K, 7), (K, D) from a configuration (7,), (D,): the translation of the root's centre, its
    rotation vector, joints."""
    middle = problem.mrf.centres[0]
    moves = poses.transform_points(roots, middle) - poses.transform_points(root, middle)
    turns = poses.quaternion_multiply(roots[:, 3:], poses.quaternion_conjugate(root[3:]))
    slides = short_way_round(drawn_joints - joints, problem.mrf.model.wraps)
    return np.concatenate([moves, poses.to_rotation_vector(turns), slides], axis=1)


def coordinate_levers(problem: Problem) -> Array:
    """(6 + D,) metres that the object moves for one unit of each coordinate of root and joints."""
    reach = float(problem.mrf.radii.max())
    return np.concatenate([np.ones(3), np.full(3, reach), np.where(problem.joint_turns, reach, 1.0)])


def _sizes(problem: Problem, found: list[ModeDraws]) -> Array | None:
    sizes = [own for draws in found if (own := problem.free_sizes(draws.nuisances)) is not None]
    return np.concatenate(sizes) if sizes else None


def _shared(one: Confirmation, other: Confirmation) -> float:
    """Of the pixels that confirm the one or the other place, whichever are fewer, the share that confirm both."""
    both = sum(np.count_nonzero(a & b) for (_, _, a), (_, _, b) in zip(one.pixels, other.pixels, strict=True))
    return both / max(min(one.confirmed, other.confirmed), 1)


def _middles(problem: Problem, roots: Array, joints: Array) -> Array:
    """(R, 3) of the parts of configurations (R, 7), (R, D) together."""
    found: Array = poses.transform_points(problem.mrf.part_poses(roots, joints), problem.mrf.centres).mean(axis=1)
    return found


def _reach(problem: Problem, place: _Place) -> Array:
    """(N,) metres up to which a part is of the same mode as at a place, by what is drawn about it."""
    draws = place.draws
    strayed = _part_motions(problem, place.root, place.joints, draws.roots, draws.joints)
    return np.maximum(SAME, DEVIATIONS * np.sqrt(np.exp(draws.log_weights) @ strayed**2))


def _part_motions(problem: Problem, root: Array, joints: Array, roots: Array, others: Array) -> Array:
    """(C, N): metres that each part's middle or rim moves, the most, from (7,), (D,) to (C, 7), (C, D)."""
    mrf = problem.mrf
    return part_motions(mrf, mrf.part_poses(root, joints), mrf.part_poses(roots, others))
