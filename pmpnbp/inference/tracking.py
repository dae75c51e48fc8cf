"""What becomes of the belief when a scan arrives? It carries on where the scan agrees with it, and else begins again.

A further view of the same scene is asked first what it confirms of the estimate. Where it confirms enough, nothing else
happens. Where it does not, and always where the scene has moved on, places near the estimate and its rivals are tried
in one iteration as the search tries its hypotheses: as near as the belief is wide, or with the process noise of the
settings. The best of them is asked the same, and more strictly, as the best of many places is confirmed in part by
chance; where the new views confirm too little of that one too, the search begins again, with what was tried among its
hypotheses.
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.inference import global_search, initialisation
from pmpnbp.inference.arrival import Arrival
from pmpnbp.inference.belief import OWN, IterationReport, State
from pmpnbp.inference.confirmation import Confirmation, by_last_views, confirmation
from pmpnbp.inference.hypotheses import Proposals
from pmpnbp.inference.joint_draws import joint_spreads, within_limits
from pmpnbp.inference.nuisance_fit import fitted
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.settling import SETTLE_INFORMED, tight_tolerance
from pmpnbp.inference.tree_estimate import assemble
from pmpnbp.names import some_of
from pmpnbp.scene.observation import Observation
from pmpnbp.scene.prior import UniformPrior
from pmpnbp.settings import Schedule

# Pixels in sight, weighed as the score is, below which a view says nothing for or against a place.
FEWEST = 60.0
# Share of the tried places that are about the estimate; the rest are about its rivals.
ABOUT_ESTIMATE = 0.5

# The state after the views; the iteration that they asked for, or None where the next one is still to be made; remarks.
Outcome = tuple[State, IterationReport | None, tuple[str, ...]]


def received(rng: np.random.Generator, state: State, problem: Problem) -> Outcome:
    """The state after the problem's newest views, where these came after its iteration; the report of the iteration
    that they asked for, or None where the method goes on; and what is to be said of it. Takes no random numbers where
    the views agree."""
    arrival = problem.arrival
    if arrival is None or arrival.after_iteration != state.iteration or state.iteration == 0:
        return state, None, ()
    state, report, notes = _asked(rng, state, problem, arrival)
    return state, report, (*out_of_sight(problem.observation, arrival.first), *notes)


def out_of_sight(observation: Observation, first: int = 0) -> tuple[str, ...]:
    """What is to be said where scans from number `first` on show nothing of the region."""
    gone = [str(number) for number in range(first, observation.scan_count) if number not in observation.scan_numbers]
    if not gone:
        return ()
    shown = f"view {gone[0]} shows" if len(gone) == 1 else f"views {some_of(gone)} show"
    return (f"{shown} nothing of the region of interest",)


def _asked(rng: np.random.Generator, state: State, problem: Problem, arrival: Arrival) -> Outcome:
    """The same of views that have just come."""
    if state.iteration - state.search_after < problem.search_iterations:
        if not arrival.replaces:
            return state, None, ()
        return replace(state, search_after=state.iteration), None, ("the scene has changed; the search begins again",)
    state = _with_estimate(state, problem)
    least = problem.settings.view_explained
    if not arrival.replaces:
        before = _seen(problem, state)
        # a view that the object is hardly in says nothing
        if before.expected < FEWEST or _confirms(before, least):
            return state, None, ()
    tracked, report = _tracked(rng, state, problem)
    after = _seen(problem, tracked)
    if least == 0 or (after.expected >= FEWEST and _confirms(after, max(least, problem.settings.search_explained))):
        said = (
            "the scene has changed; near where it was"
            if arrival.replaces
            else f"{_views(problem)} contradicts the estimate, but not the belief: near it"
        )
        return tracked, report, (f"{said} {_share(after)}",)
    said = "the scene has changed, and the new scan" if arrival.replaces else _views(problem)
    begins = "the search begins again" if problem.search_iterations else "the inference begins again"
    belief = tracked.belief if problem.search_iterations else initialisation.start(rng, problem).belief
    begun = State(iteration=state.iteration, belief=belief, search_after=state.iteration)
    return begun, None, (f"{said} contradicts the belief: {_share(after)}; {begins}",)


def _with_estimate(state: State, problem: Problem) -> State:
    """The state with a whole-object estimate: where it has none, the parts' best particles as the joints allow."""
    if state.root is not None and state.joints is not None:
        return state
    belief = state.belief
    best = belief.poses[np.arange(problem.mrf.nodes), belief.log_weights.argmax(axis=1)]
    roots, joints = assemble(problem.mrf, best[None], 0)
    return replace(state, root=roots[0], joints=joints[0])


def _seen(problem: Problem, state: State) -> Confirmation:
    """What the new views say of the state's estimate."""
    assert problem.arrival is not None and state.root is not None and state.joints is not None
    return confirmation(by_last_views(problem.taking(state.nuisances), problem.arrival.first), state.root, state.joints)


def _confirms(seen: Confirmation, least: float) -> bool:
    """Whether at least that share is confirmed, and something of every part that can be seen; 0: always."""
    return least == 0 or (seen.explained >= least and not seen.missed)


def _share(seen: Confirmation) -> str:
    share = f"{100 * seen.explained:.0f} % of what should be seen is confirmed"
    return f"{share}, but not {some_of(seen.missed)}" if seen.missed and seen.explained > 0 else share


def _views(problem: Problem) -> str:
    """The new views by number, from 0 as everywhere."""
    assert problem.arrival is not None
    first, last = problem.arrival.first, problem.observation.scan_count - 1
    return f"view {first}" if first == last else f"what views {first} to {last} show"


def _tracked(rng: np.random.Generator, state: State, problem: Problem) -> tuple[State, IterationReport]:
    """The iteration that tries places near the estimate and its rivals."""
    began = time.perf_counter()
    assert problem.arrival is not None
    plan = problem.schedule(problem.search_iterations)
    proposals, kept = _diffused(rng, state, problem, plan)
    islands = max(problem.settings.search_islands, 1)
    new, report = global_search.compared(
        rng, state, problem, proposals, kept, plan, islands, SETTLE_INFORMED, "tracking"
    )
    if problem.nuisances is not None:
        assert new.root is not None and new.joints is not None
        taken = problem.taking(state.nuisances)
        root, joints, nuisances, score = fitted(rng, taken, new.root, new.joints, plan, tight_tolerance(problem))
        new = replace(new, root=root, joints=joints, nuisances=nuisances)
        part_poses = problem.taking(nuisances).mrf.part_poses(root, joints)
        report = replace(report, map_poses=part_poses, map_joints=joints, map_score=score, nuisances=nuisances)
    return new, replace(report, seconds=time.perf_counter() - began)


def _diffused(rng: np.random.Generator, state: State, problem: Problem, plan: Schedule) -> tuple[Proposals, slice]:
    """The estimate and its rivals as they are, then moved; and which are the unmoved ones."""
    assert problem.arrival is not None and state.root is not None and state.joints is not None
    settings, model, count = problem.settings, problem.mrf.model, problem.search_proposals
    parents = np.concatenate([state.root, state.joints])[None]
    if state.rivals is not None:
        parents = np.concatenate([parents, state.rivals])[: max(count // 2, 1)]
    ancestor = rng.integers(len(parents), size=count)
    ancestor[rng.random(count) < ABOUT_ESTIMATE] = 0
    ancestor[: len(parents)] = np.arange(len(parents))
    if problem.arrival.replaces:
        far, turned = settings.moved_std_xyz, settings.moved_std_rpy
        moved = settings.moved_joint_share * np.where(
            np.isfinite(model.upper - model.lower), model.upper - model.lower, 0
        )
    else:
        far, turned, moved = plan.diffusion_position, plan.diffusion_rotation, joint_spreads(problem, plan)
    noise = rng.standard_normal((count, 6 + model.dof))
    noise[: len(parents)] = 0.0
    turn = turned * noise[:, 3:6]
    if isinstance(problem.prior, UniformPrior) and not problem.any_orientation:  # what stands upright stays so
        turn = turned * noise[:, 3:4] * problem.observation.up
    roots = poses.perturb(parents[ancestor, :7], far * noise[:, :3], turn, problem.mrf.centres[0])
    joints = within_limits(parents[ancestor, 7:] + moved * noise[:, 6:], model.lower, model.upper, model.wraps)
    proposals = Proposals(
        roots=roots,
        joints=joints,
        source=np.full(count, OWN, dtype=np.uint8),
        ancestor=ancestor.astype(np.int32),
        held=np.zeros(count, dtype=np.int64),
    )
    return proposals, slice(len(parents))
