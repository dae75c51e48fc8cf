"""Running an inference: which step comes when, and when to stop."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import belief_propagation, global_search, initialisation, particle_filter
from pmpnbp.inference.belief import IterationReport, State
from pmpnbp.inference.problem import Problem


def begin(problem: Problem) -> tuple[State, IterationReport]:
    """The state before the first iteration and its report, iteration 0."""
    state = initialisation.start(np.random.default_rng([problem.seed, 0]), problem)
    nodes, particles = state.belief.log_weights.shape
    model = problem.mrf.model
    report = IterationReport(
        0,
        "start",
        state.belief,
        None,
        np.full((nodes, particles, 0), np.nan),
        np.zeros(nodes),
        problem.settings.tolerance_start,
        np.full(nodes, float(particles)),
        state.belief.poses[:, 0],
        np.clip(0.0, model.lower, model.upper),
        float("nan"),
        0.0,
    )
    return state, report


def advance(state: State, problem: Problem) -> tuple[State, IterationReport]:
    """The next iteration: of the search, then of the problem's method. Its random numbers depend on the seed and its
    number alone, so that any iteration can be done again from its recorded state."""
    rng = np.random.default_rng([problem.seed, state.iteration + 1])
    if state.iteration < problem.search_iterations:
        return global_search.step(rng, state, problem)
    if problem.method == "particle_filter":
        return particle_filter.step(rng, state, problem)
    return belief_propagation.step(rng, state, problem)


def iterate(problem: Problem, iterations: int) -> Iterator[IterationReport]:
    """Reports of iteration 0 to `iterations`, stopping early once converged."""
    state, report = begin(problem)
    reports = [report]
    yield report
    while state.iteration < iterations:
        state, report = advance(state, problem)
        reports = [*reports[-problem.settings.converged_iterations :], report]
        yield report
        if converged(reports, problem):
            return


def converged(reports: Sequence[IterationReport], problem: Problem) -> bool:
    """Whether the inference is at rest: the schedule (search, annealing, refinement) is over, and over the last
    `converged_iterations` iterations no part's estimate has moved by more than `converged_motion`, neither at its
    middle nor, by turning, at its rim."""
    settings = problem.settings
    over = problem.search_iterations + settings.anneal_iterations + settings.refine_iterations
    needed = settings.converged_iterations
    recent = reports[-(needed + 1) :]
    if len(recent) <= needed or recent[1].iteration <= over:
        return False
    return all(
        motion(problem, before.mle, after.mle) <= settings.converged_motion for before, after in pairwise(recent)
    )


def motion(problem: Problem, before: Array, after: Array) -> float:
    """The largest distance that any part's middle or rim has moved between part poses (N, 7), metres."""
    middle = poses.transform_points(after, problem.mrf.centres) - poses.transform_points(before, problem.mrf.centres)
    turned = poses.rotation_angle(before[:, 3:], after[:, 3:])
    return float(np.max(np.linalg.norm(middle, axis=-1) + problem.mrf.radii * turned))
