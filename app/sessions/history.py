"""What has a session done? Its recording: begun, gone on with, and read, also while it is being written.

With each iteration the recording keeps a row, JSON: what the trace shows of it, and the number of its event.
"""

from __future__ import annotations

import contextlib
import json
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from app.estimation import Step
from app.problems import HttpProblem
from app.store.atomic_files import DISK_FULL, full_disk_as_problem
from pmpnbp.errors import RecordingError
from pmpnbp.inference import run as engine
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.problem import Problem
from pmpnbp.recording import Change, Inputs, Recording, RecordingWriter, make_whole, replace_recording

Row = dict[str, Any]


class History:
    """The recording at `path`. One thread begins, adds and closes; any may read."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._writer: RecordingWriter | None = None

    def begin(self, inputs: Inputs, problem: Problem, step: Step, row: str) -> None:
        """Put a new recording, with iteration 0, in the place of the one that may be there."""
        self.close()
        new = self.path.with_name(self.path.name + ".new")
        with _full_disk_as_problem():
            with RecordingWriter(new, inputs, problem.mrf.model) as writer:
                writer.write(step.report, step.state, row)
            replace_recording(new, self.path)

    def mend(self) -> int:
        """Make the recording fit to go on with; its last whole iteration. Raises RecordingError where it is lost."""
        return make_whole(self.path)

    def add(self, step: Step, row: str, written: Callable[[], None]) -> None:
        """Write an iteration; `written` is called, by another thread, once it is in the file."""
        self._open().write(step.report, step.state, row, written)

    def change(self, change: Change) -> None:
        """Write a change; returns once it is in the file."""
        with _full_disk_as_problem():
            writer = self._open()
            writer.change(change)
            writer.flush()

    def flush(self) -> None:
        """Return once all iterations so far are in the file, and announced."""
        if self._writer is not None:
            self._writer.flush()

    def close(self) -> None:
        """Finish the file. It can be gone on with."""
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.close()

    def abandon(self) -> None:
        """Finish the file as well as may be, after a failure."""
        with contextlib.suppress(RecordingError):
            self.close()

    def changes(self) -> list[Change]:
        """All changes, in order."""
        with Recording(self.path) as recording:
            return recording.changes()

    def row(self, iteration: int) -> Row:
        """The row of an iteration. Raises RecordingError where there is none."""
        with Recording(self.path) as recording:
            return self._row(recording, iteration)

    def rows(self, after: int = -1, last: int | None = None) -> list[str]:
        """The rows, JSON, of all iterations beyond `after`, and up to `last` where it is given, ascending."""
        with Recording(self.path) as recording:
            return recording.summaries(after, last)

    def problem(self, iteration: int) -> Problem:
        """What an iteration was, or will be, made with."""
        with Recording(self.path) as recording:
            return recording.problem(iteration)

    def report(self, iteration: int) -> tuple[IterationReport, Row]:
        """An iteration's report and row."""
        with Recording(self.path) as recording:
            return recording.report(iteration), self._row(recording, iteration)

    def step(self, iteration: int, problem: Problem, since: int = 0) -> Step:
        """An iteration as it was just after it was made, to go on from with `problem`; whether it is at rest is told by
        iterations from `since` on."""
        needed = problem.settings.converged_iterations + 1
        with Recording(self.path) as recording:
            reports = [recording.report(iteration)]
            while len(reports) < needed and reports[0].iteration > since:
                try:
                    reports.insert(0, recording.report(reports[0].iteration - 1))
                except RecordingError:
                    break  # thinned out: convergence is seen a few iterations later
            return Step(recording.state(iteration), reports[-1], tuple(reports), engine.converged(reports, problem))

    def copy_to(self, path: Path) -> None:
        """A consistent copy of the recording as one file, also while it is being written."""
        with (
            _full_disk_as_problem(),
            contextlib.closing(sqlite3.connect(f"{self.path.absolute().as_uri()}?mode=ro", uri=True)) as source,
            contextlib.closing(sqlite3.connect(path)) as target,
        ):
            source.backup(target)
            target.execute("PRAGMA journal_mode = DELETE")

    def _open(self) -> RecordingWriter:
        if self._writer is None:
            self._writer = RecordingWriter.appending(self.path)
        return self._writer

    def _row(self, recording: Recording, iteration: int) -> Row:
        text = recording.summary(iteration)
        if text is None:
            newest = recording.newest()
            there = "none" if newest is None else f"iterations 0 to {newest}"
            raise RecordingError(f"iteration {iteration} is not in recording '{self.path.name}'; it has {there}")
        row: Row = json.loads(text)
        return row


@contextlib.contextmanager
def _full_disk_as_problem() -> Iterator[None]:
    """Turns SQLite's and the system's "no space left" into a 507."""
    with full_disk_as_problem():
        try:
            yield
        except (sqlite3.Error, RecordingError) as error:
            if "disk is full" in str(error):
                raise HttpProblem(507, DISK_FULL) from error
            raise
