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

Where the object is told to be is the middle of the draws, in all that is known to within the tolerance where all else
is held. The score is rough, and its highest place a less good guess: on even seeds parts were 2.1 mm from it (root mean
square), and 1.3 mm from that middle. What is known only together is moved together: of a chain whose joints may turn
against each other, some at their middle and some not bend it where nothing was seen.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from pmpnbp.geometry.poses import Array
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.confirmation import Confirmation, confirmation
from pmpnbp.inference.joint_draws import within_limits
from pmpnbp.inference.log_weights import normalise
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.tree_estimate import agreeing, polish
from pmpnbp.potentials.nuisances import split
from pmpnbp.readout.checkpoint import Checkpoint, go_on
from pmpnbp.readout.denied_parts import drawn_anew, without
from pmpnbp.readout.fit import Fit, assess
from pmpnbp.readout.log_posterior import log_posterior
from pmpnbp.readout.object_posterior import ModeDraws, drawn_nuisance_stds, draws_or_better, misfit, mode_draws
from pmpnbp.readout.places import POLISH_ROUNDS, Place, contenders, least_reach, mode_reach, strayed
from pmpnbp.readout.posterior import DOUBT, Centre, ObjectMode, Posterior, numbered
from pmpnbp.scene.prior import GaussianPrior

# Modes are told at most. What weighs no more than DOUBT is none: it keeps nobody from being certain, and so must not do
# by the deviation that 0.3 % of the draws half a metre away would give all of them.
MODES = 6
# Share of a mode's draws that are of another one, which it then is.
GONE_OVER = 0.5
# Draws that are more nats better than the place they were drawn about are drawn about the best of them, so many times;
# where nuisances are free, which the place does not take over, they may be better by those alone. And a middle that is
# as much worse is none.
SURPASSED, SURPASSED_BY_NUISANCES, MOVES = 30.0, 45.0, 6
# Standard deviations of a prior, of six numbers, that no object is from where it was said to be; and of its own that no
# camera's pose, depth scale or size is off by. On even seeds, and odd ones, further cameras were by 2.9 at the most, as
# one in four hundred is by 4.5 whose prior is right, and all else by less.
CONTRADICTED, STRAINED = 8.0, 4.5


def read_out(problem: Problem, report: IterationReport, checkpoint: Checkpoint = go_on) -> Posterior | None:
    """The posterior about the estimate of an iteration; None during the search, whose estimate is on its way. Raises
    what `checkpoint` does."""
    return None if report.searching else of_estimate(problem, report, checkpoint)


def of_estimate(problem: Problem, report: IterationReport, checkpoint: Checkpoint = go_on) -> Posterior:
    """The posterior about the estimate of an iteration, whatever its stage. The same problem and report give the same
    numbers. Raises what `checkpoint` does, which is called between rounds of draws and between modes."""
    problem = problem.taking(report.nuisances)
    estimate = agreeing(problem, report)
    rng = np.random.default_rng([problem.seed, report.iteration, 1])
    own = _drawn_about(rng, problem, report, *estimate, confirmation(problem, *estimate), checkpoint)
    assert own is not None
    places, reaches = [own], [mode_reach(problem, own)]
    checkpoint()
    for root, joints, seen, apart in contenders(rng, problem, report, own, reaches[0]):
        if len(places) < MODES and _is_new(problem, places, reaches, root, joints):
            place = _drawn_about(rng, problem, report, root, joints, seen, checkpoint, known=places, apart=apart)
            if place is not None and not _drawn_in(problem, places, reaches, place):
                places.append(place)
                reaches.append(mode_reach(problem, place))
    checkpoint()
    return _told(rng, problem, report.iteration, places, estimate, checkpoint)


def at_rest(
    problem: Problem, report: IterationReport, before: Posterior | None, checkpoint: Checkpoint = go_on
) -> Posterior | None:
    """The posterior of an iteration at rest: that of `before`, read out with the same problem, as long as the estimate
    has not moved since by what is rest. Raises what `checkpoint` does."""
    if before is not None and _stays(problem, before.root, before.joints, report):
        return before
    return read_out(problem, report, checkpoint)


def rests_as(problem: Problem, before: IterationReport, report: IterationReport) -> bool:
    """Whether what was read out at rest from the iteration of `before`, with the same problem, is a later one's."""
    return _stays(problem, *agreeing(problem.taking(before.nuisances), before), report)


def _stays(problem: Problem, root: Array, joints: Array, report: IterationReport) -> bool:
    """Whether the estimate has not moved from (7,), (D,) by more than what is rest."""
    problem = problem.taking(report.nuisances)
    there = agreeing(problem, report)
    moved = motions(problem, root, joints, there[0][None], there[1][None])[0]
    return bool(moved <= problem.settings.converged_motion)


def motions(problem: Problem, root: Array, joints: Array, roots: Array, others: Array) -> Array:
    """(C,) metres: the largest that any part's middle or rim moves from (7,), (D,) to (C, 7), (C, D)."""
    found: Array = strayed(problem, root, joints, roots, others).max(axis=1)
    return found


def _is_new(
    problem: Problem, places: Sequence[Place], reaches: Sequence[Array | float], root: Array, joints: Array
) -> bool:
    """Whether a configuration (7,), (D,) is of none of the modes, each of which has its reach, (N,) or of all parts."""
    return not any(
        np.all(strayed(problem, place.root, place.joints, root, joints) <= reach)
        for place, reach in zip(places, reaches, strict=True)
    )


def _drawn_in(problem: Problem, places: Sequence[Place], reaches: Sequence[Array], found: Place) -> bool:
    """Whether most of what is drawn about a place is of one of the modes, each of which has its reach (N,): it stood
    on a ledge beside that, and its draws have left it."""
    draws, weights = found.draws, np.exp(found.draws.log_weights)
    return any(
        np.all(strayed(problem, place.root, place.joints, draws.roots, draws.joints) <= reach, axis=1) @ weights
        > GONE_OVER
        for place, reach in zip(places, reaches, strict=True)
    )


def _drawn_about(
    rng: np.random.Generator,
    problem: Problem,
    report: IterationReport,
    root: Array,
    joints: Array,
    seen: Confirmation,
    checkpoint: Checkpoint,
    *,
    known: Sequence[Place] = (),
    apart: bool = False,
) -> Place | None:
    """The mode about a configuration (7,), (D,), or about a much better one that its draws find; None where that is one
    of the known."""
    moved, least = False, [least_reach(problem)] * len(known)
    surpassed = SURPASSED_BY_NUISANCES if problem.nuisance_std.any() else SURPASSED
    for left in range(MOVES, -1, -1):
        found = draws_or_better(rng, problem, root, joints, checkpoint, surpassed if left else np.inf)
        if isinstance(found, ModeDraws):
            seen = confirmation(problem, root, joints) if moved else seen
            return Place(seen=seen, draws=found, apart=apart)
        plan, best = problem.schedule(report.iteration), (found.root[None], found.joints[None])
        roots, others, _ = polish(rng, problem, *best, plan, problem.tolerance_end, 1)
        root, joints, moved = roots[0], others[0], True
        if not _is_new(problem, known, least, root, joints):
            return None
    raise AssertionError("nothing is better by more than any number of nats")


def _told(
    rng: np.random.Generator,
    problem: Problem,
    iteration: int,
    places: list[Place],
    estimate: tuple[Array, Array],
    checkpoint: Checkpoint,
) -> Posterior:
    """All modes' draws, each weighed by its mode; told is the place of the heaviest one, where that is better than the
    estimate's, too, drawn about without those of its parts that are denied or beyond the region."""
    model, log_weights = problem.mrf.model, _log_weights(places)
    order = [k for k in np.argsort(-log_weights, kind="stable") if log_weights[k] > np.log(DOUBT) or k == 0]
    log_weights[order] = normalise(log_weights[order])
    better = [k for k in order if not places[k].apart and places[k].nats > places[0].nats]
    told = next((k for k in better if log_weights[k] > log_weights[0]), 0)
    fit = _agreeing_with_priors(problem, places[told], assess(places[told].seen))
    anew = numbered(model, (*fit.denied, *fit.beyond))
    drawn_in = problem
    if anew and 0 not in anew:
        drawn_in = without(problem, anew)
        # at its best without them: it leans to where they were found
        best, plan = (places[told].root[None], places[told].joints[None]), problem.schedule(iteration)
        roots, others, _ = polish(rng, drawn_in, *best, plan, problem.tolerance_end, POLISH_ROUNDS)
        draws = mode_draws(rng, drawn_in, roots[0], others[0], checkpoint)
        places[told] = replace(places[told], draws=draws)
    place, found = places[told], [places[k].draws for k in order]
    if fit.verdict == "good" and (others := sum(places[k].apart for k in order)):
        number = "another one like it" if others == 1 else f"{others} others like it"
        fit = replace(fit, reason=f"{fit.reason}, and as well {number}: which one is meant?")
    drawn_joints = np.concatenate([draws.joints for draws in found])
    return Posterior(
        iteration=iteration,
        root=estimate[0],
        joints=estimate[1],
        drawn_roots=np.concatenate([draws.roots for draws in found]),
        drawn_joints=drawn_anew(rng, problem, place.root, place.joints, anew, drawn_joints),
        log_weights=np.concatenate([draws.log_weights + log_weights[k] for k, draws in zip(order, found, strict=True)]),
        mode=np.repeat(np.arange(len(order)), [len(draws.roots) for draws in found]),
        modes=tuple(
            ObjectMode(weight=float(np.exp(log_weights[k])), root=places[k].root, joints=places[k].joints)
            for k in order
        ),
        effective_sample_size=place.draws.effective_sample_size,
        fit=fit,
        drawn_sizes=_sizes(problem, found),
        nuisance_stds=drawn_nuisance_stds(problem, place.draws),
        centre=_centre(drawn_in, place) if problem.settings.object_estimate else None,
    )


def _agreeing_with_priors(problem: Problem, place: Place, fit: Fit) -> Fit:
    """The fit of a place, doubtful where that, or what cameras or model have wrong everywhere, is far from where a
    prior has it: one of them is wrong."""
    contradiction = next(_contradictions(problem, place), None) if fit.verdict == "good" else None
    if contradiction is None:
        return fit
    return replace(fit, verdict="doubtful", reason=f"{fit.reason}, but {contradiction}")


def _contradictions(problem: Problem, place: Place) -> Iterator[str]:
    """What of a place its priors speak against, in words."""
    if isinstance(problem.prior, GaussianPrior):
        at = problem.mrf.part_poses(place.root, place.joints)[problem.prior_node]
        off = float(np.sqrt(-2 * problem.log_prior(at)))
        if off > CONTRADICTED:
            yield f"{off:.3g} standard deviations from where the prior has it"
    for what, off in _strains(problem, place.draws.middle_nuisances):
        if off > STRAINED:
            yield f"{what} would be off by {off:.3g} of its standard deviations"


def _strains(problem: Problem, nuisances: Array | None) -> Iterator[tuple[str, float]]:
    """Of each camera's depth scale and pose, and of the object's size, by how many of its standard deviations the
    nuisances (K,) have it off; nothing where all are fixed."""
    if nuisances is None:
        return
    free = problem.nuisance_std > 0
    off = np.divide(nuisances, problem.nuisance_std, out=np.zeros(len(free)), where=free)
    scans = problem.observation.scan_numbers
    scales, cameras, sizes = split(off, len(scans))
    for scan, scale, camera in zip(scans, scales, cameras, strict=True):
        yield f"the depth scale of scan {scan}", float(abs(scale))
        yield f"the camera pose of scan {scan}", float(np.linalg.norm(camera))
    yield "the object's size", float(np.linalg.norm(sizes))


def _log_weights(places: list[Place]) -> Array:
    """(K,) of the places, the first of which is the estimate's. Those of one thing share its weight by evidence."""
    evidence = np.array([place.draws.log_evidence - place.draws.log_room for place in places])
    apart = np.array([place.apart for place in places])
    found = np.zeros(len(places))
    found[~apart] = normalise(evidence[~apart] / misfit(places[0].nats))
    return found


def _centre(problem: Problem, place: Place) -> Centre:
    """The middle of a place's draws in what is known to within the tolerance, the pose of what holds it all together;
    in what is not, the place itself, and in all where the middle is worse: that of a bent ridge lies beside it."""
    model, draws = problem.mrf.model, place.draws
    known = draws.held_stds * coordinate_levers(problem) < problem.tolerance_end
    known[:6] = known[:6].all()
    mean = np.where(known, draws.middle, 0.0)
    joints = within_limits(place.joints + mean[6:], model.lower, model.upper, model.wraps)
    root = draws.about.roots(mean[None, :6], joints[None])[0]
    nuisances = draws.middle_nuisances if known[0] else problem.nuisances
    nats = log_posterior(problem, root[None], joints[None], None if nuisances is None else nuisances[None])[0]
    if nats < place.nats - SURPASSED:
        return Centre(root=place.root, joints=place.joints, nuisances=problem.nuisances)
    return Centre(root=root, joints=joints, nuisances=nuisances)


def coordinate_levers(problem: Problem) -> Array:
    """(6 + D,) metres that the object moves for one unit of each coordinate of root and joints."""
    reach = float(problem.mrf.radii.max())
    return np.concatenate([np.ones(3), np.full(3, reach), np.where(problem.joint_turns, reach, 1.0)])


def _sizes(problem: Problem, found: list[ModeDraws]) -> Array | None:
    sizes = [own for draws in found if (own := problem.free_sizes(draws.nuisances)) is not None]
    return np.concatenate(sizes) if sizes else None
