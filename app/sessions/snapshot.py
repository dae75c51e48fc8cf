"""What does a session say of an iteration? The result, the row of the trace, and both as the text that is sent."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from app import estimation
from app.json_text import json_bytes
from app.sessions.history import Row
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.problem import Problem


@dataclass(frozen=True)
class Snapshot:
    """An iteration, read out; immutable.

    problem : what it was made with
    result : the members of result.json, result_text : the same as JSON
    row : the trace's entry, row_text : the same as JSON
    truth : as `truth_file.truth_of` gives it, or None
    """

    problem: Problem
    report: IterationReport
    result: dict[str, Any]
    result_text: bytes
    row: Row
    row_text: bytes
    truth: dict[str, Any] | None = None

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
    method: str,
    max_std: float,
    truth: dict[str, Any] | None,
) -> Snapshot:
    """Read an iteration out.

    elapsed : seconds of wall time the inference has taken so far; event : the number of the iteration's event
    truth : as `truth_file.truth_of` gives it, or None
    """
    result = estimation.read_out(
        problem, report, converged=converged, seconds=elapsed, max_std=max_std, method=method, truth=truth
    )
    names = [part.name for part in problem.mrf.model.parts]
    known = result.get("truth")
    row: Row = {
        "event": event,
        "iteration": report.iteration,
        "stage": report.stage,
        "seconds": report.seconds,
        "elapsed": elapsed,
        "tolerance": report.tolerance,
        "effective_sample_size": dict(zip(names, report.effective_sample_size.tolist(), strict=True)),
        "log_likelihood": report.mle_score,
        "std_xyz": {name: link["std_xyz"] for name, link in result["links"].items()},
        "add": None if known is None else {name: part["add"] for name, part in known["parts"].items()},
        "converged": converged,
        "certain": result["certain"],
        "notes": list(report.notes),
    }
    return Snapshot(problem, report, result, json_bytes(result), row, json_bytes(row), truth)
