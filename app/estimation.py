"""How does an input become a result? The one path that `pmpnbp estimate` and the server's sessions share.

`prepare` makes the problem, `first` and `following` its iterations, `read_out` the members of result.json. The same
input and seed give the same numbers, whoever asks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pmpnbp.inference import problem as problem_module
from pmpnbp.inference import run as engine
from pmpnbp.inference.belief import IterationReport, State
from pmpnbp.inference.problem import Problem
from pmpnbp.readout import estimate as readout
from pmpnbp.readout.estimate import Placement
from pmpnbp.recording import Inputs
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.observe import observe
from pmpnbp.scene.prior import UniformPrior, load_prior
from pmpnbp.scene.urdf import load_model
from pmpnbp.settings import Settings

# Up to this standard deviation along each axis a link is certain (the paper's 0.25 cm), metres.
MAX_STD = 0.0025


@dataclass(frozen=True)
class Step:
    """An iteration just made.

    recent : the reports that tell whether the inference has come to rest, this iteration's last
    """

    state: State
    report: IterationReport
    recent: tuple[IterationReport, ...]
    converged: bool

    @property
    def iteration(self) -> int:
        """Its number; 0 is the start."""
        return self.report.iteration


def prepare(
    model: Path,
    scans: Sequence[Scan],
    roi: Sequence[float] | None,
    prior: Path | Mapping[str, object] | None,
    settings: Settings,
    *,
    particles: int,
    seed: int,
    method: str = "pmpnbp",
) -> tuple[Problem, Inputs]:
    """The problem, and the inputs that a recording keeps of it.

    model : a URDF or zip; roi : x0 y0 z0 x1 y1 z1, metres, world, or None; prior : prior.json, its members, or None
    for upright anywhere; method : one of `settings.METHODS`. Raises PmpnbpError for what does not fit together.
    """
    found = load_model(model, triangle_budget=settings.triangles)
    box = None if roi is None else np.array(roi, dtype=np.float64)
    observation = observe(scans, box, width=settings.image_width)
    known = UniformPrior("upright") if prior is None else load_prior(prior, found)
    problem = problem_module.build(found, observation, known, settings, particles=particles, seed=seed, method=method)
    return problem, Inputs(model, tuple(scans), box, known, settings, particles, seed, method)


def first(problem: Problem) -> Step:
    """Iteration 0, the start."""
    state, report = engine.begin(problem)
    return after((), state, report, problem)


def following(step: Step, problem: Problem) -> Step:
    """The iteration after `step`."""
    state, report = engine.advance(step.state, problem)
    return after(step.recent, state, report, problem)


def after(recent: Sequence[IterationReport], state: State, report: IterationReport, problem: Problem) -> Step:
    """The step that `state` and `report` are, following on the reports `recent`."""
    reports = (*recent[-problem.settings.converged_iterations :], report)
    return Step(state, report, reports, engine.converged(reports, problem))


def read_out(
    problem: Problem,
    report: IterationReport,
    placed: Placement | None = None,
    *,
    converged: bool,
    seconds: float,
    max_std: float = MAX_STD,
    truth: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """The members of result.json for an iteration.

    placed : what `readout.place` gave of it, where it is there already
    max_std : metres, up to which a link is certain; seconds : wall time of the inference so far
    truth : as `truth_file.load_truth` gives it; adds how far the estimate is from it
    """
    found = readout.estimate(problem, report, placed, max_std=max_std, converged=converged, seconds=round(seconds, 3))
    if truth is None:
        return readout.to_result(found)
    return readout.to_result(found, readout.errors(problem.mrf.model, found, truth["links"], truth["joints"]))
