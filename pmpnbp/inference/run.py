"""Running an inference: which step comes when, and when to stop."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from pmpnbp.geometry.poses import Array
from pmpnbp.inference import belief_propagation, global_search, initialisation, particle_filter, tracking
from pmpnbp.inference.belief import IterationReport, State
from pmpnbp.inference.mrf import part_motions
from pmpnbp.inference.problem import Problem


@dataclass(frozen=True, kw_only=True)
class Step:
    """An iteration just made.

    state : what the next iteration is made from; converged : whether the inference is at rest
    recent : the reports that tell so, this iteration's last; as many as `converged` needs, or all so far
    """

    state: State
    recent: tuple[IterationReport, ...]
    converged: bool

    @property
    def report(self) -> IterationReport:
        """The iteration's report."""
        return self.recent[-1]

    @property
    def iteration(self) -> int:
        """The iteration's number; 0 is the start."""
        return self.state.iteration


def first(problem: Problem) -> Step:
    """Iteration 0, the start."""
    state, report = begin(problem)
    return resumed(state, [report], problem)


def following(step: Step, problem: Problem) -> Step:
    """The iteration after `step`. Where `problem` is another one than `step` was made with, pass `resumed(step.state,
    [step.report], problem)`: whether the inference is at rest is decided anew then."""
    state, report = advance(step.state, problem)
    return resumed(state, [*step.recent, report], problem)


def resumed(state: State, reports: Sequence[IterationReport], problem: Problem) -> Step:
    """The step that ended in `state`, from the newest `reports`, its own last, all of them made with `problem`."""
    recent = tuple(reports[-(problem.settings.converged_iterations + 1) :])
    return Step(state=state, recent=recent, converged=converged(recent, problem))


def steps(problem: Problem, iterations: int) -> Iterator[Step]:
    """Iterations 0 to `iterations`; stops earlier, once converged."""
    step = first(problem)
    yield step
    while step.iteration < iterations and not step.converged:
        step = following(step, problem)
        yield step


def iterate(problem: Problem, iterations: int) -> Iterator[IterationReport]:
    """The reports of `steps`."""
    return (step.report for step in steps(problem, iterations))


def begin(problem: Problem) -> tuple[State, IterationReport]:
    """The state before the first iteration and its report, iteration 0."""
    state = initialisation.start(np.random.default_rng([problem.seed, 0]), problem)
    nodes, particles = state.belief.log_weights.shape
    model = problem.mrf.model
    report = IterationReport(
        iteration=0,
        stage="start",
        belief=state.belief,
        messages=None,
        log_message_shares=np.zeros((nodes, particles, 0)),
        inverse_temperature=np.zeros(nodes),
        tolerance=problem.settings.tolerance_start,
        effective_sample_size=np.full(nodes, float(particles)),
        map_poses=state.belief.poses[:, 0],
        map_joints=np.clip(0.0, model.lower, model.upper),
        map_score=float("nan"),
        seconds=0.0,
        notes=tracking.out_of_sight(problem.observation),
    )
    return state, report


def advance(state: State, problem: Problem) -> tuple[State, IterationReport]:
    """The next iteration: what a scan that has just come asks for, else of the search, then of the problem's method.
    Its random numbers depend on the seed and its number alone, so that any iteration can be done again from its
    recorded state."""
    rng = np.random.default_rng([problem.seed, state.iteration + 1])
    state, report, notes = tracking.received(rng, state, problem)
    if report is None:
        state, report = _method(state, problem)(rng, state, problem)
    return state, replace(report, notes=(*notes, *report.notes)) if notes else report


def _method(
    state: State, problem: Problem
) -> Callable[[np.random.Generator, State, Problem], tuple[State, IterationReport]]:
    """What makes the iteration after a state."""
    if state.iteration - state.search_after < problem.search_iterations:
        return global_search.step
    return particle_filter.step if problem.method == "particle_filter" else belief_propagation.step


def converged(reports: Sequence[IterationReport], problem: Problem) -> bool:
    """Whether the inference is at rest: the schedule (search, annealing, refinement) is over, and over the last
    `converged_iterations` iterations no part's estimate has moved by more than `converged_motion`, neither at its
    middle nor, by turning, at its rim."""
    settings = problem.settings
    over = problem.annealed + settings.refine_iterations
    needed = settings.converged_iterations
    recent = reports[-(needed + 1) :]
    if len(recent) <= needed or recent[1].iteration - recent[1].search_after <= over:
        return False
    return all(
        motion(problem, before.map_poses, after.map_poses) <= settings.converged_motion
        for before, after in pairwise(recent)
    )


def motion(problem: Problem, before: Array, after: Array) -> float:
    """The largest distance that any part's middle or rim has moved between part poses (N, 7), metres."""
    return float(part_motions(problem.mrf, before, after).max())
