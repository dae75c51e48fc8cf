"""What does an iteration say? Its row of the trace at once, the whole result when it is asked for.

Nobody looks at most of the results, and reading one out takes longer than an iteration.
"""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

from pmpnbp.inference.belief import SEARCH_STAGES, IterationReport
from pmpnbp.inference.problem import Problem
from pmpnbp.json_text import json_bytes
from pmpnbp.readout import estimate as readout
from pmpnbp.readout.checkpoint import Checkpoint, go_on
from pmpnbp.readout.mixture import read_out
from pmpnbp.readout.placement import Placement, place
from pmpnbp.readout.posterior import Posterior
from pmpnbp.readout.result import to_result
from pmpnbp.readout.truth_errors import errors as truth_errors
from pmpnbp.readout.truth_errors import part_adds

Row = dict[str, Any]
Phase = Literal["searching", "settling", "at rest"]


def phase_of(stage: str, converged: bool) -> Phase:
    """What an iteration does, of all its stages, in the words that people read."""
    if stage in SEARCH_STAGES:
        return "searching"
    return "at rest" if converged else "settling"


@dataclass(frozen=True, kw_only=True)
class Criteria:
    """By what an iteration is judged.

    max_std : metres, up to which standard deviation along each axis a link is certain
    truth : `links` and `joints` as `truth_file.load_truth` gives them, or None where it is not known
    """

    max_std: float
    truth: Mapping[str, Any] | None = None


@dataclass(frozen=True, kw_only=True)
class Snapshot:
    """An iteration, read out; immutable.

    problem : what it was made with
    placed : where the estimate has everything, with the posterior where it was read out
    row : the trace's entry; row_text : the same as JSON
    asked : set by whoever asks for its result, so that the next iteration's is there when they ask again
    """

    problem: Problem
    report: IterationReport
    placed: Placement
    criteria: Criteria
    row: Row
    row_text: bytes
    asked: threading.Event = field(default_factory=threading.Event, compare=False, repr=False)

    def read_out(self, checkpoint: Checkpoint = go_on) -> Snapshot:
        """The same with its posterior, also where it is not at rest; without one still during the search. Raises what
        `checkpoint` does."""
        if self.placed.posterior is not None:
            return self
        return self.told(read_out(self.problem, self.report, checkpoint))

    def told(self, posterior: Posterior | None) -> Snapshot:
        """The same with a posterior that was read out for it; itself where that is None."""
        if posterior is None:
            return self
        return snapshot(
            self.problem,
            self.report,
            self.criteria,
            converged=self.converged,
            elapsed=self.row["elapsed"],
            event=self.row["event"],
            posterior=posterior,
        )

    @cached_property
    def result(self) -> dict[str, Any]:
        """The members of result.json."""
        estimate = readout.estimate(
            self.problem,
            self.report,
            self.placed,
            max_std=self.criteria.max_std,
            converged=self.converged,
            seconds=round(self.row["elapsed"], 3),
        )
        model, truth = self.problem.mrf.model, self.criteria.truth
        errors = None if truth is None else truth_errors(model, estimate, truth["links"], truth["joints"])
        return to_result(estimate, errors)

    @cached_property
    def result_text(self) -> bytes:
        """The same as JSON."""
        return json_bytes(self.result)

    @property
    def known_text(self) -> bytes | None:
        """`result_text` where it is there already: nothing is waited for."""
        return self.__dict__.get("result_text")

    @property
    def iteration(self) -> int:
        """Its number; 0 is the start."""
        return self.report.iteration

    @property
    def converged(self) -> bool:
        """Whether the inference had come to rest."""
        return bool(self.row["converged"])

    @property
    def certain(self) -> bool:
        """Whether every link was certain."""
        return bool(self.row["certain"])


def snapshot(
    problem: Problem,
    report: IterationReport,
    criteria: Criteria,
    *,
    converged: bool,
    elapsed: float,
    event: int | None = None,
    posterior: Posterior | None = None,
    before: Snapshot | None = None,
) -> Snapshot:
    """Read an iteration out.

    elapsed : seconds of wall time the inference has taken so far
    event : the number by which the iteration is announced, where it is
    posterior : what the scan leaves open, where it was read out
    before : the iteration before, so that what has stayed is not worked out again
    """
    model = problem.mrf.model
    placed = place(problem, report, posterior, None if before is None else before.placed)
    names = [part.name for part in model.parts]
    truth, std_xyz = criteria.truth, placed.std_xyz
    certain = placed.certain(criteria.max_std)
    row: Row = {
        "event": event,
        "iteration": report.iteration,
        "stage": report.stage,
        "phase": phase_of(report.stage, converged),
        "seconds": report.seconds,
        "elapsed": elapsed,
        "tolerance": report.tolerance,
        "effective_sample_size": dict(zip(names, report.effective_sample_size.tolist(), strict=True)),
        "log_likelihood": report.map_score,
        "final_log_likelihood": float(placed.standing.log_likelihoods.sum()),
        "std_xyz": None if std_xyz is None else dict(zip(model.links, std_xyz.tolist(), strict=True)),
        "particle_std_xyz": dict(zip(model.links, placed.particle_std_xyz.tolist(), strict=True)),
        "add": None if truth is None else part_adds(model, placed.part_poses, truth["links"]),
        "converged": converged,
        "certain": bool(certain.all()),
        "certain_by_link": None if posterior is None else dict(zip(model.links, certain.tolist(), strict=True)),
        "fit": None if posterior is None else posterior.fit.verdict,
        "fit_reason": None if posterior is None else posterior.fit.reason,
        "posterior_iteration": None if posterior is None else posterior.iteration,
        "notes": list(report.notes),
    }
    return Snapshot(problem=problem, report=report, placed=placed, criteria=criteria, row=row, row_text=json_bytes(row))
