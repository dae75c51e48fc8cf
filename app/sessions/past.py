"""What can be asked of a session's past? Every iteration, read out as it was when it was made.

The newest is there at once; an older one is read from the recording.
"""

from __future__ import annotations

import sqlite3
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

from app.problems import HttpProblem
from app.sessions.history import Row
from app.sessions.snapshot import Snapshot, snapshot
from pmpnbp.errors import RecordingError
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.problem import Problem
from pmpnbp.recording import Change

# Problems kept, of the stretches between two changes.
PROBLEMS = 3


class Kept(Protocol):
    """A recording that rows can be had from: a session's `History`, or that of an uploaded one."""

    def mend(self) -> int:
        """The last whole iteration. Raises RecordingError where there is none."""

    def changes(self) -> list[Change]:
        """All changes, in order."""

    def row(self, iteration: int) -> Row:
        """The row of an iteration. Raises RecordingError where there is none."""

    def rows(self, after: int = -1, last: int | None = None) -> list[str]:
        """The rows, JSON, of all iterations beyond `after`, and up to `last` where it is given, ascending."""

    def problem(self, iteration: int) -> Problem:
        """What an iteration was, or will be, made with."""

    def report(self, iteration: int) -> tuple[IterationReport, Row]:
        """An iteration's report and row."""

    def copy_to(self, path: Path) -> None:
        """A consistent copy as one file."""


class Past:
    """The iterations that are in the recording of a session, which `name` is what errors call. Thread-safe.

    options : `max_std` and `truth` as `snapshot.snapshot` takes them
    remedy : what helps where the recording is damaged
    """

    def __init__(
        self, name: str, history: Kept, options: Callable[[], dict[str, Any]], remedy: str = "reset or delete"
    ) -> None:
        self._name = name
        self._remedy = remedy
        self._history = history
        self._options = options
        self._lock = threading.Lock()
        self._loading = threading.Lock()
        self._snapshot: Snapshot | None = None
        self._row: Row | None = None
        self._problems: dict[int, Problem] = {}
        self._changes_after: list[int] = []
        # why the recording cannot be read, or None
        self.damage: str | None = None

    def recover(self) -> list[str]:
        """Take up what the recording has; the notes of its changes. Raises RecordingError where it is lost."""
        self._row = self._history.row(self._history.mend())
        found = self._history.changes()
        self._changes_after = [change.after_iteration for change in found]
        return [change.note for change in found]

    def begin(self, made: Snapshot) -> None:
        """The recording has been begun anew, with iteration 0."""
        with self._lock:
            self._changes_after, self._problems, self.damage = [], {0: made.problem}, None
            self._snapshot, self._row = made, made.row

    def announce(self, made: Snapshot) -> None:
        """An iteration is in the recording."""
        with self._lock:
            self._snapshot, self._row = made, made.row

    def changed(self, after: int, problem: Problem) -> None:
        """Iterations beyond `after` are made with `problem`."""
        with self._lock:
            self._changes_after.append(after)
            self._keep(len(self._changes_after), problem)

    @property
    def changes(self) -> int:
        """How many changes there were."""
        return len(self._changes_after)

    @property
    def changed_since(self) -> bool:
        """Whether the next iteration is made with other settings or scans than the newest was."""
        return any(after >= self.iteration for after in self._changes_after)

    def stretch(self, iteration: int) -> int:
        """The iteration from which on nothing was changed, of those up to `iteration`."""
        return max((after for after in self._changes_after if after <= iteration), default=0)

    @property
    def row(self) -> Row:
        """The newest iteration's row, without waiting; `iteration` is None where there is none."""
        return self._row or {"iteration": None, "converged": False, "certain": False}

    @property
    def iteration(self) -> int:
        """The newest iteration."""
        return int(self.row["iteration"] or 0)

    @property
    def present(self) -> Snapshot | None:
        """The newest iteration, where it is in memory."""
        return self._snapshot

    @property
    def snapshot(self) -> Snapshot:
        """The newest iteration. HttpProblem 409 where the recording is damaged."""
        found = self._snapshot
        if found is None:
            self.check()
            with self._loading:
                found = self._snapshot
                if found is None:
                    found = self._read(self.iteration)
                    with self._lock:
                        # else another one was made meanwhile
                        self._snapshot = self._snapshot or found
        return found

    def read(self, iteration: int | None) -> Snapshot:
        """An iteration; None for the newest. HttpProblem 404, 409."""
        newest = self.snapshot
        if iteration is None or iteration == newest.iteration:
            return newest
        if not 0 <= iteration < newest.iteration:
            raise HttpProblem(404, f"iteration {iteration} of {self._name} is not here; it has 0 to {newest.iteration}")
        try:
            return self._read(iteration)
        except RecordingError as error:
            raise HttpProblem(404, str(error)) from None

    def rows(self, after: int = -1, last: int | None = None) -> list[str]:
        """The rows, JSON, of the iterations beyond `after`, and up to `last` where it is given. HttpProblem 409 where
        the recording is damaged."""
        self.check()
        return self._history.rows(after, last)

    def copy_to(self, path: Path) -> None:
        """A consistent copy of the recording, also of a damaged one where it can be copied. HttpProblem 409."""
        try:
            self._history.copy_to(path)
        except sqlite3.DatabaseError:
            self.check()
            raise

    def problem(self, iteration: int) -> Problem:
        """What an iteration was, or will be, made with."""
        number = sum(after < iteration for after in self._changes_after)
        found = self._problems.get(number)
        if found is None:
            found = self._history.problem(iteration)
            with self._lock:
                self._keep(number, found)
        return found

    def next_change(self, iteration: int) -> int:
        """The iteration that a change made after `iteration` belongs to: behind the changes there are."""
        return max([iteration, *self._changes_after])

    def check(self) -> None:
        """HttpProblem 409 where the recording is damaged."""
        if self.damage is not None:
            raise HttpProblem(409, f"{self._name} is failed: {self.damage}; only {self._remedy} helps")

    def _keep(self, number: int, problem: Problem) -> None:
        self._problems[number] = problem
        while len(self._problems) > PROBLEMS:
            del self._problems[next(iter(self._problems))]

    def _read(self, iteration: int) -> Snapshot:
        report, row = self._history.report(iteration)
        return snapshot(
            self.problem(iteration),
            report,
            converged=row["converged"],
            elapsed=row["elapsed"],
            event=row["event"],
            **self._options(),
        )
