"""What did a recording's inference do, where the recording was uploaded? Read as it lies there, never written.

A recording that a session made has a row of the trace for each iteration. One that `pmpnbp estimate` made has none, and
a row that is damaged counts as none: then it is made from the iteration itself when it is first asked for.
"""

from __future__ import annotations

import json
import shutil
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

from app.json_text import json_bytes
from app.sessions.history import Row
from app.sessions.snapshot import snapshot
from app.sessions.trace_row import event_of, row_of
from app.store.atomic_files import full_disk_as_problem
from pmpnbp.errors import RecordingError
from pmpnbp.inference import run as engine
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.problem import Problem
from pmpnbp.recording import Change, Recording
from pmpnbp.recording.reopening import last_shown
from pmpnbp.recording.report_check import check_fits

# Problems kept, of the stretches between two changes.
PROBLEMS = 3


class RecordedHistory:
    """The recording at `path`. Thread-safe.

    options : `max_std` and `truth` as `snapshot.snapshot` takes them
    """

    def __init__(self, path: Path, options: Callable[[], dict[str, Any]]) -> None:
        self.path = path
        self._options = options
        self._lock = threading.RLock()
        self._rows: dict[int, Row] = {}
        self._problems: dict[int, Problem] = {}
        self._changes_after: list[int] = []
        self._readable: list[int] = []
        self._last = 0

    def mend(self) -> int:
        """The last whole iteration; the file stays as it is. Raises RecordingError where there is none."""
        with self._lock, Recording(self.path) as recording:
            last = last_shown(recording)
            if last is None:
                raise RecordingError(f"recording '{self.path.name}' is damaged: none of its iterations is whole")
            self._last = last
            self._changes_after = recording.changed_after()
            self._readable = [number for number in recording.iterations() if number <= last]
            self._rows = self._told(recording, last)
        return last

    def changes(self) -> list[Change]:
        """All changes, in order, as far as they can be read."""
        with Recording(self.path) as recording:
            try:
                return recording.changes()
            except RecordingError:
                return recording.changes(self._last)

    def row(self, iteration: int) -> Row:
        """The row of an iteration. Raises RecordingError where it is not, or not whole."""
        with self._lock:
            found = self._rows.get(iteration)
            if found is None:
                with Recording(self.path) as recording:
                    found = self._rows[iteration] = self._made(recording, iteration)
            return found

    def rows(self, after: int = -1, last: int | None = None) -> list[str]:
        """The rows, JSON, of all iterations beyond `after`, and up to `last` where it is given, that have one or can be
        read, ascending."""
        found = []
        with self._lock:
            numbers = sorted({*self._rows, *self._readable})
        for number in numbers:
            if after < number <= (self._last if last is None else last):
                try:
                    found.append(json_bytes(self.row(number)).decode())
                except RecordingError:
                    continue  # damaged in the midst of whole ones
        return found

    def problem(self, iteration: int) -> Problem:
        """What an iteration was made with."""
        number = sum(after < iteration for after in self._changes_after)
        with self._lock:
            if number not in self._problems:
                with Recording(self.path) as recording:
                    self._problems[number] = recording.problem(iteration)
                while len(self._problems) > PROBLEMS:
                    del self._problems[next(iter(self._problems))]
            return self._problems[number]

    def report(self, iteration: int) -> tuple[IterationReport, Row]:
        """An iteration's report and row. Raises RecordingError, also where it does not fit the model."""
        with Recording(self.path) as recording:
            return self._report(recording, iteration), self.row(iteration)

    def copy_to(self, path: Path) -> None:
        """The file, byte for byte."""
        with full_disk_as_problem():
            shutil.copyfile(self.path, path)

    def _report(self, recording: Recording, iteration: int) -> IterationReport:
        report = recording.report(iteration)
        check_fits(self.problem(iteration), report)
        return report

    def _made(self, recording: Recording, iteration: int) -> Row:
        """The row that a session would have kept."""
        problem = self.problem(iteration)
        report = self._report(recording, iteration)
        since = max((after for after in self._changes_after if after < iteration), default=0)
        recent = [report]
        while len(recent) <= problem.settings.converged_iterations and recent[0].iteration > since:
            try:
                recent.insert(0, self._report(recording, recent[0].iteration - 1))
            except RecordingError:
                break  # thinned out
        return snapshot(
            problem,
            report,
            converged=engine.converged(recent, problem),
            elapsed=recording.seconds(iteration),
            event=event_of(iteration),
            **self._options(),
        ).row

    def _told(self, recording: Recording, last: int) -> dict[int, Row]:
        """The rows that are in the file and are such."""
        try:
            texts = recording.summaries()
        except RecordingError:
            texts = [text for number in self._readable if (text := _summary(recording, number)) is not None]
        if not texts:
            return {}
        model = self.problem(last).mrf.model
        found = (row_of(text, model) for text in texts)
        rows = {row["iteration"]: row for row in found if row is not None and row["iteration"] <= last}
        return {number: json.loads(json_bytes(row)) for number, row in sorted(rows.items())}


def _summary(recording: Recording, iteration: int) -> str | None:
    try:
        return recording.summary(iteration)
    except RecordingError:
        return None
