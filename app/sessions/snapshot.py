"""What does a session say of an iteration? The row of the trace at once, as it is announced.

The whole result is read out when it is asked for: nobody looks at most of them, and it takes longer than an iteration.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from app import estimation
from app.json_text import json_bytes
from app.sessions.history import Row
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.problem import Problem
from pmpnbp.readout.estimate import Placement, part_adds, place


@dataclass(frozen=True)
class Snapshot:
    """An iteration, read out; immutable.

    problem : what it was made with; placed : where it has everything
    row : the trace's entry, row_text : the same as JSON
    max_std, truth : as `snapshot` takes them
    """

    problem: Problem
    report: IterationReport
    placed: Placement
    row: Row
    row_text: bytes
    max_std: float
    truth: dict[str, Any] | None = None

    @cached_property
    def result(self) -> dict[str, Any]:
        """The members of result.json."""
        return estimation.read_out(
            self.problem,
            self.report,
            self.placed,
            converged=self.converged,
            seconds=self.row["elapsed"],
            max_std=self.max_std,
            truth=self.truth,
        )

    @cached_property
    def result_text(self) -> bytes:
        """The same as JSON."""
        return json_bytes(self.result)

    @property
    def known_text(self) -> bytes | None:
        """`result_text` where it was asked for before: nothing is waited for."""
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
    *,
    converged: bool,
    elapsed: float,
    event: int,
    max_std: float,
    truth: dict[str, Any] | None,
) -> Snapshot:
    """Read an iteration out.

    elapsed : seconds of wall time the inference has taken so far; event : the number of the iteration's event
    truth : as `truth_file.truth_of` gives it, or None
    """
    model = problem.mrf.model
    placed = place(problem, report)
    names = [part.name for part in model.parts]
    row: Row = {
        "event": event,
        "iteration": report.iteration,
        "stage": report.stage,
        "seconds": report.seconds,
        "elapsed": elapsed,
        "tolerance": report.tolerance,
        "effective_sample_size": dict(zip(names, report.effective_sample_size.tolist(), strict=True)),
        "log_likelihood": report.map_score,
        "std_xyz": dict(zip(model.links, placed.std_xyz.tolist(), strict=True)),
        "add": None if truth is None else part_adds(model, placed.part_poses, truth["links"]),
        "converged": converged,
        "certain": bool(placed.certain(max_std).all()),
        "notes": list(report.notes),
    }
    return Snapshot(problem, report, placed, row, json_bytes(row), max_std, truth)
