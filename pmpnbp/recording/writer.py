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
import threading
from pathlib import Path
from types import TracebackType

from pmpnbp.errors import RecordingError
from pmpnbp.inference.belief import IterationReport, State
from pmpnbp.recording import inputs as inputs_module
from pmpnbp.recording.arrays import to_arrays
from pmpnbp.recording.inputs import Inputs
from pmpnbp.recording.schema import APPLICATION_ID, TABLES, VERSION, pack
from pmpnbp.scene.articulated_object import ArticulatedObject

# Size up to which every iteration is kept, bytes.
MAX_BYTES = 1 << 30
# Iterations that may wait to be written; an inference faster than the disk then waits for it.
WAITING = 64


class RecordingWriter:
    """A recording being written; a context manager.

    path : a new file, or an old recording, which is replaced; any other file is left alone
    model : that of the problem, for its names
    max_bytes : beyond it every second iteration is dropped, then three of four and so on; the newest is always kept

    Raises RecordingError where the file cannot be written, from `write` and on leaving too.
    """

    def __init__(self, path: Path, inputs: Inputs, model: ArticulatedObject, *, max_bytes: int = MAX_BYTES) -> None:
        self._path = Path(path)
        self._max_bytes = max_bytes
        self._stride = 1
        self._newest: int | None = None
        self._queue: queue.Queue[tuple[IterationReport, State] | None] = queue.Queue(WAITING)
        self._error: Exception | None = None
        make_way(self._path)
        try:
            # used by the thread alone from here on
            self._connection = sqlite3.connect(self._path, isolation_level=None, check_same_thread=False)
            self._create(inputs, model)
        except sqlite3.Error as error:
            raise self._failure(error) from None
        self._thread = threading.Thread(target=self._write_all, name="recording", daemon=True)
        self._thread.start()

    def __enter__(self) -> RecordingWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
            return
        with contextlib.suppress(RecordingError):  # what went wrong first is what the caller has to hear
            self.close()

    def write(self, report: IterationReport, state: State) -> None:
        """Record an iteration and the state after it. Returns at once; the arrays of both must not change."""
        self._raise_failure()
        self._queue.put((report, state))

    def close(self) -> None:
        """Write what is waiting and close the file. A second call does nothing."""
        if self._thread.is_alive():
            self._queue.put(None)
            self._thread.join()
        self._raise_failure()

    def _create(self, inputs: Inputs, model: ArticulatedObject) -> None:
        run = self._connection.execute
        run("PRAGMA journal_mode = WAL")
        run("PRAGMA synchronous = NORMAL")
        run("BEGIN IMMEDIATE")
        # both in the transaction: a file killed here is empty rather than a recording without tables
        run(f"PRAGMA application_id = {APPLICATION_ID}")
        run(f"PRAGMA user_version = {VERSION}")
        for statement in TABLES.split(";"):
            run(statement)
        inputs_module.store(self._connection, inputs, model)
        run("COMMIT")

    def _write_all(self) -> None:
        try:
            while (item := self._queue.get()) is not None:
                self._write_one(*item)
            # one file to share, without a log beside it; refused while somebody reads, who then does it on leaving
            with contextlib.suppress(sqlite3.OperationalError):
                self._connection.execute("PRAGMA journal_mode = DELETE")
        except Exception as error:  # handed to the inference's thread, which raises it
            self._error = error
            while self._queue.get() is not None:  # a full queue would hold the inference up for ever
                pass
        finally:
            self._connection.close()

    def _write_one(self, report: IterationReport, state: State) -> None:
        packed = [(report.iteration, name, *pack(values)) for name, values in to_arrays(report, state).items()]
        run = self._connection.execute
        run("BEGIN IMMEDIATE")
        score = report.mle_score if math.isfinite(report.mle_score) else None
        row = (report.iteration, report.stage, report.tolerance, score, report.seconds, json.dumps(report.notes))
        run("INSERT INTO iterations VALUES (?, ?, ?, ?, ?, ?)", row)
        self._connection.executemany("INSERT INTO arrays VALUES (?, ?, ?, ?, ?)", packed)
        if self._newest is not None and self._newest % self._stride:
            run("DELETE FROM arrays WHERE iteration = ?", (self._newest,))
        self._newest = report.iteration
        if self._used() > self._max_bytes:
            self._thin_out(report.iteration)
        run("COMMIT")

    def _used(self) -> int:
        pages, free, size = (
            int(self._connection.execute(f"PRAGMA {name}").fetchone()[0])
            for name in ("page_count", "freelist_count", "page_size")
        )
        return (pages - free) * size

    def _thin_out(self, newest: int) -> None:
        """Drop every second of the iterations kept so far. The room they leave in the file is used again."""
        self._stride *= 2
        run = self._connection.execute
        run("DELETE FROM arrays WHERE iteration % ? AND iteration != ?", (self._stride, newest))
        text = (
            f"at iteration {newest} the recording reached {self._max_bytes} bytes; of all iterations, earlier ones "
            f"too, every {self._stride}th is kept from here on, and the newest"
        )
        run("INSERT INTO notes (text) VALUES (?)", (text,))

    def _raise_failure(self) -> None:
        if self._error is not None:
            raise self._failure(self._error) from None

    def _failure(self, error: Exception) -> RecordingError:
        return RecordingError(f"recording '{self._path.name}' cannot be written: {error}")


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
    """Remove an old recording at `path`. Raises RecordingError for any other file, so that none is lost by a slip."""
    try:
        if path.exists() and path.stat().st_size:
            with path.open("rb") as file:
                header = file.read(100)
            if header[:15] != b"SQLite format 3" or header[68:72] != APPLICATION_ID.to_bytes(4, "big"):
                raise RecordingError(
                    f"'{path.name}' is there and is no recording; expected a new name, or an old recording"
                )
        for old in (path, path.with_name(path.name + "-wal"), path.with_name(path.name + "-shm")):
            old.unlink(missing_ok=True)
    except OSError as error:
        raise RecordingError(f"recording '{path.name}' cannot be written: {error.strerror}") from None
