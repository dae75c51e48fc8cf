"""Writes a recording beside the inference: iterations go into a queue, a thread packs and commits them.

Each iteration is one transaction in SQLite's write-ahead log, so a reader sees whole iterations only, and a process
that is killed leaves all those that were committed. A power cut may lose the last few, never the file.
"""

from __future__ import annotations

import contextlib
import json
import math
import queue
import sqlite3
import stat
import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from pmpnbp.errors import RecordingError, StorageError, why_not_written
from pmpnbp.files import quoted, status
from pmpnbp.inference.belief import IterationReport, State
from pmpnbp.readout.posterior import Posterior
from pmpnbp.recording import inputs as inputs_module
from pmpnbp.recording.arrays import Arrays, to_arrays
from pmpnbp.recording.changes import Change, store_change
from pmpnbp.recording.inputs import Inputs
from pmpnbp.recording.posteriors import posterior_arrays
from pmpnbp.recording.schema import ADDED_MODE, ADDED_TABLES, APPLICATION_ID, TABLES, VERSION, pack
from pmpnbp.recording.thinning import Thinning
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.settings import SessionOptions

# Size up to which every iteration is kept, bytes.
MAX_BYTES = 1 << 30
# Iterations that may wait to be written; an inference faster than the disk then waits for it. Each is up to a megabyte.
WAITING = 8


@dataclass(frozen=True)
class _Iteration:
    report: IterationReport
    state: State
    summary: str | None
    written: Callable[[], None] | None
    posterior: Posterior | None


class RecordingWriter:
    """A recording being written; a context manager.

    path : a new file, or an old recording, which is replaced; any other file is left alone
    model : that of the problem, for its names; max_std : metres, up to which a link is said to be certain
    max_bytes : beyond it every second iteration is dropped, then three of four and so on; the newest is always kept

    Raises RecordingError where the file cannot be written, from `write` and on leaving too. `appending` goes on with a
    recording that is there.
    """

    def __init__(
        self,
        path: Path,
        inputs: Inputs,
        model: ArticulatedObject,
        *,
        max_std: float = SessionOptions.max_std,
        max_bytes: int = MAX_BYTES,
    ) -> None:
        make_way(Path(path))
        self._begin(path, max_bytes, partial(self._create, inputs, model, max_std))

    @classmethod
    def appending(cls, path: Path, *, max_bytes: int = MAX_BYTES) -> RecordingWriter:
        """A writer that goes on with the recording at `path`; `make_whole` sees to it that it can."""
        writer = cls.__new__(cls)
        writer._begin(path, max_bytes, writer._go_on)
        return writer

    def _begin(self, path: Path, max_bytes: int, prepare: Callable[[], None]) -> None:
        """Open the file, have its tables prepared, and start the thread, which alone uses the connection then."""
        self._path = Path(path)
        self._queue: queue.Queue[_Iteration | Change | Posterior | threading.Event | None] = queue.Queue(WAITING)
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._write_all, name="recording", daemon=True)
        try:
            self._connection = sqlite3.connect(self._path, isolation_level=None, check_same_thread=False)
            self._connection.execute("PRAGMA journal_mode = WAL")
            self._connection.execute("PRAGMA synchronous = NORMAL")
            prepare()
            self._thinning = Thinning(self._connection, max_bytes)
        except sqlite3.Error as error:
            raise self._failure(error) from None
        self._thread.start()

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None:
            self.close()
            return
        with contextlib.suppress(RecordingError):  # what went wrong first is what the caller has to hear
            self.close()

    def write(
        self,
        report: IterationReport,
        state: State,
        summary: str | None = None,
        written: Callable[[], None] | None = None,
        posterior: Posterior | None = None,
    ) -> None:
        """Record an iteration and the state after it. Returns at once; the arrays of all must not change.

        summary : kept with the iteration, for the program that records
        written : called once the iteration is in the file, by the thread that writes
        posterior : kept with the iteration where it was read out from it, not from an earlier one
        """
        self._raise_failure()
        if posterior is not None and posterior.iteration != report.iteration:
            posterior = None
        self._queue.put(_Iteration(report, state, summary, written, posterior))

    def keep(self, posterior: Posterior) -> None:
        """Record the posterior of an iteration that was recorded without it. Returns at once."""
        self._raise_failure()
        self._queue.put(posterior)

    def change(self, change: Change) -> None:
        """Record that later iterations are made with other settings or another scan. Returns at once."""
        self._raise_failure()
        self._queue.put(change)

    def flush(self) -> None:
        """Return once everything so far is in the file."""
        done = threading.Event()
        self._queue.put(done)
        done.wait()
        self._raise_failure()

    def close(self) -> None:
        """Write what is waiting and close the file. A second call does nothing."""
        if self._thread.is_alive():
            self._queue.put(None)
            self._thread.join()
        self._raise_failure()

    def _create(self, inputs: Inputs, model: ArticulatedObject, max_std: float) -> None:
        run = self._connection.execute
        run("BEGIN IMMEDIATE")
        # both in the transaction: a file killed here is empty rather than a recording without tables
        run(f"PRAGMA application_id = {APPLICATION_ID}")
        run(f"PRAGMA user_version = {VERSION}")
        for statement in (TABLES + ADDED_TABLES).split(";"):
            run(statement)
        inputs_module.store(self._connection, inputs, model, max_std)
        run("COMMIT")

    def _go_on(self) -> None:
        run = self._connection.execute
        if run("PRAGMA user_version").fetchone()[0] < VERSION:
            run("BEGIN IMMEDIATE")
            for statement in ADDED_TABLES.split(";"):
                run(statement)
            run(f"PRAGMA user_version = {VERSION}")
            run("COMMIT")
        elif "mode" not in [column[1] for column in run("PRAGMA table_info(changes)")]:
            run(ADDED_MODE)

    def _write_all(self) -> None:
        try:
            while (item := self._queue.get()) is not None:
                if isinstance(item, threading.Event):
                    item.set()
                elif self._error is None:  # after a failure the rest is dropped: a full queue would hold up for ever
                    self._write_item(item)
            if self._error is None:
                # one file to share, without a log beside it; refused while somebody reads, who then does it on leaving
                with contextlib.suppress(sqlite3.OperationalError):
                    self._connection.execute("PRAGMA journal_mode = DELETE")
        finally:
            self._connection.close()

    def _write_item(self, item: _Iteration | Change | Posterior) -> None:
        try:
            if isinstance(item, Change | Posterior):
                self._connection.execute("BEGIN IMMEDIATE")
                if isinstance(item, Change):
                    store_change(self._connection, item)
                else:
                    self._store(item.iteration, posterior_arrays(item))
                self._connection.execute("COMMIT")
                return
            self._write_one(item)
            if item.written is not None:
                item.written()
        except Exception as error:  # handed to the inference's thread, which raises it
            self._error = error

    def _write_one(self, item: _Iteration) -> None:
        report = item.report
        arrays = to_arrays(report, item.state)
        if item.posterior is not None:
            arrays |= posterior_arrays(item.posterior)
        run = self._connection.execute
        run("BEGIN IMMEDIATE")
        score = report.map_score if math.isfinite(report.map_score) else None
        row = (report.iteration, report.stage, report.tolerance, score, report.seconds, json.dumps(report.notes))
        run("INSERT INTO iterations VALUES (?, ?, ?, ?, ?, ?)", row)
        self._store(report.iteration, arrays)
        if item.summary is not None:
            run("INSERT INTO summaries VALUES (?, ?)", (report.iteration, item.summary))
        self._thinning.written(report.iteration)
        run("COMMIT")

    def _store(self, iteration: int, arrays: Arrays) -> None:
        packed = [(iteration, name, *pack(values)) for name, values in arrays.items()]
        self._connection.executemany("INSERT INTO arrays VALUES (?, ?, ?, ?, ?)", packed)

    def _raise_failure(self) -> None:
        if self._error is not None:
            raise self._failure(self._error) from None

    def _failure(self, error: Exception) -> RecordingError:
        reason = why_not_written(error)
        kind = RecordingError if reason is None else StorageError
        return kind(f"recording '{self._path.name}' cannot be written: {reason or error}")


def fold_log(path: Path) -> bool:
    """Fold the log that a killed writer left into the recording at `path`: one file again, to share.

    Returns whether it now is; not while somebody else has it open. Raises RecordingError where it cannot be written.
    """
    path = Path(path)
    log = path.with_name(path.name + "-wal")
    if not log.exists():
        return True
    try:
        with contextlib.closing(sqlite3.connect(path, isolation_level=None, timeout=0.1)) as connection:
            connection.execute("PRAGMA journal_mode = DELETE")
    except sqlite3.Error as error:
        if log.exists() and "locked" in str(error):
            return False
        raise RecordingError(f"the log of recording '{path.name}' cannot be folded into it: {error}") from None
    return not log.exists()


def make_way(path: Path) -> None:
    """Remove an old recording at `path`, or where a link leads that is there. Raises RecordingError for anything else,
    so that nothing is lost by a slip, and for a recording that is still being written."""
    name = quoted(path)
    found = status(path, f"recording {name}", RecordingError, done="written")
    if found is not None and not stat.S_ISREG(found.st_mode):
        raise RecordingError(f"{name} is there and is no file; expected a new name, or an old recording")
    place = path.resolve()
    try:
        if found is not None and found.st_size:
            if not _is_recording(place):
                raise RecordingError(f"{name} is there and is no recording; expected a new name, or an old recording")
            if _is_open(place):
                raise RecordingError(f"recording {name} is still being written or looked at; expected another name")
        for old in (place, place.with_name(place.name + "-wal"), place.with_name(place.name + "-shm")):
            old.unlink(missing_ok=True)
    except OSError as error:
        raise RecordingError(f"recording {name} cannot be written: {error.strerror}") from None


def _is_recording(path: Path) -> bool:
    with path.open("rb") as file:
        header = file.read(100)
    if header[:15] != b"SQLite format 3":
        return False
    if header[68:72] == APPLICATION_ID.to_bytes(4, "big"):
        return True
    try:  # as long as it is new, only its log tells
        with contextlib.closing(sqlite3.connect(f"{path.as_uri()}?mode=ro", uri=True)) as connection:
            return bool(connection.execute("PRAGMA application_id").fetchone()[0] == APPLICATION_ID)
    except sqlite3.Error:
        return False


def _is_open(path: Path) -> bool:
    """Whether another writer or reader has a recording open that has a log."""
    try:
        return not fold_log(path)
    except RecordingError:  # it is damaged, and may go
        return False
