"""What can be asked of an inference's past? Every iteration, read out as it was when it was made.

The newest is in memory; an older one is read from the recording. What is announced is in the recording: `add` tells of
an iteration when it is in the file. A recording from elsewhere is archived as it lies there, and never written.
"""

from __future__ import annotations

import contextlib
import shutil
import threading
from bisect import bisect_right
from collections.abc import Callable
from pathlib import Path

from cachetools import LRUCache

from pmpnbp.errors import DamageError, IterationError, RecordingError, storage_told
from pmpnbp.inference import run
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.run import Step
from pmpnbp.readout.mixture import read_out
from pmpnbp.readout.posterior import Posterior
from pmpnbp.readout.snapshot import Criteria, Row, Snapshot, snapshot
from pmpnbp.recording.changes import Change
from pmpnbp.recording.inputs import Inputs
from pmpnbp.recording.posteriors import check_posterior_fits
from pmpnbp.recording.reader import Recording
from pmpnbp.recording.readers import Readers
from pmpnbp.recording.reopening import back_up, last_shown, make_whole, replace_recording
from pmpnbp.recording.report_check import check_fits
from pmpnbp.recording.trace_rows import NO_ROW, ForeignRows, OwnRows, Rows, event_of
from pmpnbp.recording.writer import RecordingWriter
from pmpnbp.scene.articulated_object import ArticulatedObject

# The row of the trace that a text from elsewhere is, about this model; None where it is none.
ForeignRow = Callable[[str, ArticulatedObject], Row | None]
# Problems kept, of the stretches between two changes: the newest, and those that two views look at.
PROBLEMS = 3
# Posteriors kept: the last, and a few that were asked for.
POSTERIORS = 4


class IterationArchive:
    """The iterations in the recording at `path`. `begin` or `open` comes first; one thread then begins, adds, changes
    and closes, and any may read.

    name : what errors call it; remedy : what helps where the recording is damaged
    foreign_row : given where the recording comes from elsewhere: it is never written, and what it says is checked
        against its model; the row of the trace that a text is, or None
    """

    def __init__(
        self, path: Path, name: str, *, remedy: str = "reset or delete", foreign_row: ForeignRow | None = None
    ) -> None:
        self.path = path
        self._name = name
        self._remedy = remedy
        self._criteria: Criteria | None = None
        self._foreign_row = foreign_row
        self._readers = Readers(path, foreign=foreign_row is not None)
        self._writer: RecordingWriter | None = None
        self._rows: Rows = OwnRows()
        self._lock = threading.Lock()
        self._loading = threading.Lock()
        self._newest: Snapshot | None = None
        self._row: Row | None = None
        self._changes_after: list[int] = []
        # of a recording from elsewhere, the newest iteration that is whole
        self._last: int | None = None
        # by the number of changes before
        self._problems: LRUCache[int, Problem] = LRUCache(PROBLEMS)
        # by the iteration that they were read out from
        self._posteriors: LRUCache[int, Posterior | None] = LRUCache(POSTERIORS)
        # why the recording cannot be read, or None
        self.damage: str | None = None

    def open(self, criteria: Criteria | None) -> list[Change]:
        """Take up the recording that is there; its changes. Raises RecordingError where it is lost.

        criteria : by what its iterations are judged; None, of one from elsewhere: as they were then
        """
        self._criteria = criteria
        if self._foreign_row is not None:
            return self._open_foreign(self._foreign_row)
        last = make_whole(self.path)
        with self._readers.recording() as recording:
            changes = recording.changes()
            self._row = self._rows.row(recording, last)
        self._changes_after = [change.after_iteration for change in changes]
        return changes

    def _open_foreign(self, foreign_row: ForeignRow) -> list[Change]:
        with self._readers.recording() as recording:
            last = last_shown(recording)
            if last is None:
                raise RecordingError(f"recording '{self.path.name}' is damaged: none of its iterations is whole")
            self._last, self._changes_after = last, recording.changed_after()
            self._criteria = self._criteria or Criteria(max_std=recording.max_std())
            model = self.problem(last).mrf.model
            self._rows = ForeignRows(recording, last, lambda text: foreign_row(text, model), self._made_row)
            self._row = self._rows.row(recording, last)
            try:
                return recording.changes()
            except RecordingError:
                return recording.changes(last)

    # Writing

    def moved(self, path: Path) -> None:
        """The recording lies at `path` from now on; nobody has it open."""
        self.path, self._readers = path, Readers(path)

    def begin(self, inputs: Inputs, step: Step, snapshot: Snapshot) -> None:
        """Put a new recording, with iteration 0, in the place of the one that may be there."""
        self.close()
        new = self.path.with_name(self.path.name + ".new")
        with storage_told():
            with RecordingWriter(new, inputs, snapshot.problem.mrf.model, max_std=snapshot.criteria.max_std) as writer:
                writer.write(step.report, step.state, snapshot.row_text.decode())
            replace_recording(new, self.path)
        with self._lock:
            self._newest, self._row, self._criteria = snapshot, snapshot.row, snapshot.criteria
            self._changes_after, self.damage = [], None
            self._problems.clear()
            self._posteriors.clear()
            self._problems[0] = snapshot.problem

    def add(self, step: Step, snapshot: Snapshot, written: Callable[[], None]) -> None:
        """Write an iteration; `written` is called, by another thread, once it is in the file and the newest."""

        def arrived() -> None:
            with self._lock:
                self._newest, self._row = snapshot, snapshot.row
            written()

        text, posterior = snapshot.row_text.decode(), snapshot.placed.posterior
        self._writing().write(step.report, step.state, text, arrived, posterior)

    def change(self, change: Change, problem: Problem) -> None:
        """Write a change, of which the next iterations are made with `problem`; returns once it is in the file."""
        with storage_told():
            writer = self._writing()
            writer.change(change)
            writer.flush()
        with self._lock:
            self._changes_after.append(change.after_iteration)
            self._problems[len(self._changes_after)] = problem

    def flush(self) -> None:
        """Return once all iterations so far are in the file, and announced."""
        if self._writer is not None:
            self._writer.flush()

    def close(self) -> None:
        """Finish the file. It can be gone on with, and read."""
        self._readers.close()
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.close()

    def abandon(self) -> None:
        """Finish the file as well as may be, after a failure."""
        with contextlib.suppress(RecordingError):
            self.close()

    # The newest iteration, without waiting

    @property
    def row(self) -> Row:
        """The newest iteration's row; `iteration` is None where there is none."""
        return self._row or NO_ROW

    @property
    def iteration(self) -> int:
        """The newest iteration."""
        return int(self.row["iteration"] or 0)

    @property
    def present(self) -> Snapshot | None:
        """The newest iteration, where it is in memory."""
        return self._newest

    @property
    def changes(self) -> int:
        """How many changes there were."""
        return len(self._changes_after)

    def changed_since(self, iteration: int | None = None) -> bool:
        """Whether settings or scans have changed since an iteration, by default the newest."""
        since = self.iteration if iteration is None else iteration
        return any(after >= since for after in self._changes_after)

    def next_change(self, iteration: int) -> int:
        """The iteration that a change made after `iteration` belongs to: behind the changes there are."""
        return max([iteration, *self._changes_after])

    # Reading

    def check(self) -> None:
        """Raise DamageError where the recording is damaged."""
        if self.damage is not None:
            raise DamageError(f"{self._name} is failed: {self.damage}; only {self._remedy} helps")

    def read(self, iteration: int | None = None) -> Snapshot:
        """An iteration, read out as it was when it was made; without a number the newest. Raises DamageError, and
        IterationError where it cannot be had."""
        newest = self._newest or self._load_newest()
        if iteration is None or iteration == newest.iteration:
            return newest
        if not 0 <= iteration < newest.iteration:
            raise IterationError(f"iteration {iteration} of {self._name} is not here; it has 0 to {newest.iteration}")
        try:
            return self._read(iteration)
        except RecordingError as error:
            raise IterationError(str(error)) from None

    def rows(self, after: int = -1, last: int | None = None) -> list[str]:
        """The trace, JSON, beyond iteration `after` and up to `last`, ascending. Raises DamageError."""
        self.check()
        with self._readers.recording() as recording:
            return self._rows.texts(recording, after, self.iteration if last is None else last)

    def rows_after_event(self, event: int) -> list[str]:
        """The trace, JSON, of the iterations that were announced after the event of that number. Raises DamageError.

        The numbers rise with the iterations, so the first is found by bisection, without reading all rows.
        """
        if self._foreign_row is not None:
            return self.rows(after=event - event_of(0))
        self.check()
        with self._readers.recording() as recording:
            numbers = range(self.iteration + 1)
            heard = bisect_right(numbers, event, key=lambda number: self._rows.row(recording, number)["event"])
            return self._rows.texts(recording, heard - 1, self.iteration)

    def problem(self, iteration: int) -> Problem:
        """What an iteration was, or will be, made with; of the newest iteration's stretch always the same object."""
        number = self._changes_before(iteration)
        with self._lock:
            newest = self._newest
            if newest is not None and number == self._changes_before(newest.iteration):
                return newest.problem
            found = self._problems.get(number)
        if found is None:
            with self._readers.recording() as recording:
                found = recording.problem(iteration)
            with self._lock:
                self._problems[number] = found
        return found

    def resume(self) -> Step:
        """The newest iteration as it was just after it was made, to go on from with `problem` of the next."""
        at = self.iteration
        since = max((after for after in self._changes_after if after <= at), default=0)
        problem = self.problem(at + 1)
        with self._readers.recording() as recording:
            return run.resumed(recording.state(at), self._recent(recording, at, since, problem), problem)

    def copy_to(self, path: Path) -> None:
        """A consistent copy as one file, also of a recording that is written, or damaged. Raises DamageError."""
        with storage_told():
            if self._foreign_row is not None and self.path.is_file():
                shutil.copyfile(self.path, path)
            else:
                back_up(self.path, path)

    def _changes_before(self, iteration: int) -> int:
        return sum(after < iteration for after in self._changes_after)

    def _writing(self) -> RecordingWriter:
        if not self.path.exists():
            self.damage = f"somebody has removed its {self.path.name}"
            raise RecordingError(self.damage)
        if self._writer is None:
            self._writer = RecordingWriter.appending(self.path)
        return self._writer

    def _load_newest(self) -> Snapshot:
        self.check()
        with self._loading:
            if self._newest is None:
                found = self._read(self.iteration)
                with self._lock:
                    self._newest = self._newest or found  # else another one was made meanwhile
            return self._newest

    def _read(self, iteration: int) -> Snapshot:
        with self._readers.recording() as recording:
            report, row = self._report(recording, iteration), self._rows.row(recording, iteration)
            posterior = self._posterior(recording, report, row.get("posterior_iteration"))
        return self._read_out(report, posterior, converged=row["converged"], elapsed=row["elapsed"], event=row["event"])

    def _read_out(
        self, report: IterationReport, posterior: Posterior | None, *, converged: bool, elapsed: float, event: int
    ) -> Snapshot:
        problem = self.problem(report.iteration)
        assert self._criteria is not None  # `begin` or `open` came first
        return snapshot(
            problem, report, self._criteria, converged=converged, elapsed=elapsed, event=event, posterior=posterior
        )

    def _posterior(self, recording: Recording, report: IterationReport, iteration: int | None) -> Posterior | None:
        """The posterior that an iteration's report was told with, read out from the same or an earlier one."""
        if iteration is None:
            return None
        with self._lock:
            newest = None if self._newest is None else self._newest.placed.posterior
            if newest is not None and newest.iteration == iteration:
                return newest
            if iteration in self._posteriors:
                return self._posteriors[iteration]
        found = recording.posterior(iteration)
        if found is None:  # recorded before posteriors were
            source = report if iteration == report.iteration else self._report(recording, iteration)
            found = read_out(self.problem(iteration), source)
        elif self._foreign_row is not None:
            check_posterior_fits(self.problem(iteration), found)
        with self._lock:
            self._posteriors[iteration] = found
        return found

    def _report(self, recording: Recording, iteration: int) -> IterationReport:
        report = recording.report(iteration)
        if self._foreign_row is not None:
            check_fits(self.problem(iteration), report)
        return report

    def _recent(self, recording: Recording, iteration: int, since: int, problem: Problem) -> list[IterationReport]:
        """The reports up to an iteration that tell whether it is at rest, from iteration `since` on."""
        reports = [self._report(recording, iteration)]
        while len(reports) <= problem.settings.converged_iterations and reports[0].iteration > since:
            try:
                reports.insert(0, self._report(recording, reports[0].iteration - 1))
            except RecordingError:
                break  # thinned out: convergence is seen a few iterations later
        return reports

    def _made_row(self, recording: Recording, iteration: int) -> Row:
        """The row that a session would have written."""
        since = max((after for after in self._changes_after if after < iteration), default=0)
        problem = self.problem(iteration)
        recent = self._recent(recording, iteration, since, problem)
        elapsed, converged = recording.seconds(iteration), run.converged(recent, problem)
        # of the many that may be at rest the newest alone: each takes longer than an iteration
        told = converged and iteration == self._last
        posterior = self._posterior(recording, recent[-1], iteration if told else None)
        event = event_of(iteration)
        return self._read_out(recent[-1], posterior, converged=converged, elapsed=elapsed, event=event).row
