"""Reads a recording: iterations, the state after each, and the problem they belong to."""

from __future__ import annotations

import sqlite3
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

from numpy.typing import NDArray

from pmpnbp.errors import DamageError, RecordingError
from pmpnbp.files import is_file, quoted
from pmpnbp.inference.belief import IterationReport, State
from pmpnbp.inference.problem import Problem
from pmpnbp.json_text import read_json
from pmpnbp.readout.posterior import Posterior
from pmpnbp.recording import inputs as inputs_module
from pmpnbp.recording.amounts import LONGEST_TEXT, excess
from pmpnbp.recording.array_shapes import ArrayShapes, array_shapes
from pmpnbp.recording.arrays import Arrays, to_report, to_state
from pmpnbp.recording.changes import Change, changed_after, changes
from pmpnbp.recording.inputs import Inputs
from pmpnbp.recording.posteriors import to_posterior
from pmpnbp.recording.schema import APPLICATION_ID, ITERATION_S_OWN, PREFIX, VERSION, unpack
from pmpnbp.settings import Settings, changed, preset

# SQLite's own limit of a value, bytes.
_LONGEST = (1 << 31) - 1
# What reading damaged bytes can raise.
_DAMAGE = (
    sqlite3.DatabaseError,
    zlib.error,
    ValueError,
    KeyError,
    TypeError,
    IndexError,
    AttributeError,
    OverflowError,
)


class Recording:
    """A recording opened for reading; a context manager. It may still be written, or have been cut off.

    Raises RecordingError where the file is none, or is newer than this version reads, and from each method for what is
    damaged. Iterations before the damage can be read.
    """

    def __init__(self, path: Path) -> None:
        self._path = Path(path)
        self.name = self._path.name  # as errors call it
        self.connection = self._open()
        self._shapes: ArrayShapes | None = None
        try:
            application, version = (self._pragma(name) for name in ("application_id", "user_version"))
            if application != APPLICATION_ID:
                raise RecordingError(f"'{self.name}' is not a recording of pmpnbp")
            if version > VERSION:
                raise RecordingError(
                    f"recording '{self.name}' has format {version}; this version reads up to {VERSION}"
                )
            self.parts: tuple[str, ...] = self._parts()
        except BaseException:
            self.connection.close()
            raise

    def __enter__(self) -> Recording:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self.connection.close()

    def distrust(self, shapes: ArrayShapes | None = None) -> ArrayShapes:
        """Take it for one from elsewhere from now on: arrays that its own model does not make are damage, before they
        are unpacked. Raises RecordingError where it holds more than a recording does.

        shapes : what another reader of the same recording was returned
        """
        if shapes is None:
            if found := excess(self.connection):
                raise RecordingError(f"recording '{self.name}' has {found}, which no recording has")
            with self._reading("its model or scans"), self.blobs():
                model = inputs_module.restored_model(self.connection)
                scans = self.connection.execute("SELECT count(*) FROM scans").fetchone()[0]
                shapes = array_shapes(model, inputs_module.option(self.connection, "particles"), scans)
        self._shapes = shapes
        return shapes

    def restored_inputs(self, folder: Path, iteration: int | None = None) -> Inputs:
        """The inputs that an iteration was made with, or else the next one will be, as a writer takes them, to begin
        another run from; the model becomes a file in `folder`."""
        with self._reading("its model or scans"), self.blobs():
            return inputs_module.restored_inputs(self.connection, folder, iteration)

    def inputs(self) -> dict[str, Any]:
        """`version`, `method`, `model` (its name), `parts`, `settings`, `prior`, `region`, `particles`, `seed` and
        `max_std`, as JSON has them: those the inference began with."""
        with self._reading("its inputs"):
            rows = self.connection.execute("SELECT name, value FROM inputs").fetchall()
            return {str(name): read_json(value) for name, value in rows}

    def max_std(self) -> float:
        """Metres up to which a link was said to be certain."""
        with self._reading("its inputs"):
            return inputs_module.max_std(self.connection)

    def changes(self, iteration: int | None = None) -> list[Change]:
        """Other settings and scans that an iteration was made with, in order; without it all there are."""
        with self._reading("its changes"), self.blobs():
            return changes(self.connection, iteration)

    def changed_after(self) -> list[int]:
        """The iterations that the changes came after, in order; also where what was changed is damaged."""
        with self._reading("its changes"):
            return changed_after(self.connection)

    def settings(self, iteration: int | None = None) -> Settings:
        """The settings that an iteration was made with, or else the next one will be."""
        found = [change.settings for change in self.changes(iteration) if change.settings is not None]
        return found[-1] if found else changed(preset("robust"), self._input("settings"))

    def problem(self, iteration: int | None = None) -> Problem:
        """The problem of an iteration, or else of the next one, made again from model, scans, prior and settings as
        they were then; the same for all iterations between two changes, so that callers keep it."""
        with self._reading("its model or scans"), self.blobs():
            return inputs_module.restored_problem(self.connection, iteration)

    def iterations(self) -> list[int]:
        """Numbers of the iterations that can be read, ascending; those thinned out are not among them."""
        found: list[int] = []
        try:
            for (number,) in self.connection.execute("SELECT number FROM iterations ORDER BY number"):
                found.append(number)
        except _DAMAGE:  # cut off: what came before is whole
            pass
        return [number for number in found if self._whole(number)]

    def seconds(self, iteration: int) -> float:
        """Wall time of all iterations up to this one, without what came between them."""
        query = "SELECT coalesce(sum(seconds), 0) FROM iterations WHERE number <= ?"
        with self._reading("its list of iterations"):
            return float(self.connection.execute(query, (iteration,)).fetchone()[0])

    def notes(self) -> list[str]:
        """What the writer had to say, such as that it thinned out iterations."""
        with self._reading("its notes"):
            return _texts(self.connection.execute("SELECT text FROM notes ORDER BY number"))

    def newest(self) -> int | None:
        """The number of the newest iteration that is written down, whole or not; None where there is none."""
        with self._reading("its list of iterations"):
            found = self.connection.execute("SELECT max(number) FROM iterations").fetchone()[0]
        return None if found is None else int(found)

    def summaries(self, after: int = -1, last: int | None = None) -> list[str]:
        """What the program that recorded had to say of each iteration beyond `after`, and up to `last` where it is
        given, ascending; also of those thinned out. Empty where it said nothing."""
        query = "SELECT text FROM summaries WHERE iteration > ? AND iteration <= ? ORDER BY iteration"
        with self._reading("its summaries"):
            if self._pragma("user_version") < VERSION:
                return []
            return _texts(self.connection.execute(query, (after, 2**62 if last is None else last)))

    def summary(self, iteration: int) -> str | None:
        """The same of one iteration; None where there is none."""
        query = "SELECT text FROM summaries WHERE iteration = ?"
        with self._reading("its summaries"):
            if self._pragma("user_version") < VERSION:
                return None
            row = self.connection.execute(query, (iteration,)).fetchone()
        return None if row is None else str(row[0])

    def report(self, iteration: int) -> IterationReport:
        """The report of an iteration, equal bit for bit to the one that was written."""
        scalars, arrays = self._scalars(iteration), self._arrays(iteration)
        with self._reading(f"iteration {iteration}"):
            return to_report(iteration, scalars, arrays)

    def state(self, iteration: int) -> State:
        """The state after an iteration; `advance` with it and `problem()` makes the next one again."""
        self._scalars(iteration)
        arrays = self._arrays(iteration)
        with self._reading(f"iteration {iteration}"):
            return to_state(iteration, arrays)

    def posterior(self, iteration: int) -> Posterior | None:
        """The posterior that was read out from an iteration, equal bit for bit to the one that was written; None where
        there was none. It stays when the iteration is thinned out."""
        arrays = self._read_arrays(iteration, f"name LIKE '{PREFIX}%'")
        with self._reading(f"the posterior of iteration {iteration}"):
            return to_posterior(iteration, arrays)

    def _parts(self) -> tuple[str, ...]:
        with self._reading("its inputs"):
            return tuple(str(part["name"]) for part in self._input("parts"))

    def _open(self) -> sqlite3.Connection:
        if not is_file(self._path, f"recording {quoted(self._path)}", DamageError):
            raise DamageError(f"recording {quoted(self._path)} is not there")
        address = f"file:{quote(str(self._path.absolute()))}?mode=ro"
        log = self._path.with_name(self._path.name + "-wal")
        # in a folder that cannot be written SQLite finds no place for its index; without a log it needs none
        attempts = (address,) if log.exists() else (address, f"{address}&immutable=1")
        for number, attempt in enumerate(attempts):
            connection = sqlite3.connect(attempt, uri=True, isolation_level=None, check_same_thread=False, timeout=10)
            try:
                # else a file that was cut short is refused as a whole; opened read-only, nothing can be harmed
                connection.execute("PRAGMA writable_schema = ON")
                connection.execute("SELECT count(*) FROM sqlite_master").fetchone()
                connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, LONGEST_TEXT)
                return connection
            except sqlite3.DatabaseError as error:
                connection.close()
                if number + 1 == len(attempts) or not isinstance(error, sqlite3.OperationalError):
                    break
        raise RecordingError(f"'{self.name}' is not a recording, or its beginning is damaged")

    def _pragma(self, name: str) -> int:
        with self._reading("its header"):
            return int(self.connection.execute(f"PRAGMA {name}").fetchone()[0])

    def _input(self, name: str) -> Any:
        with self._reading("its inputs"):
            return inputs_module.value(self.connection, name)

    def sound(self) -> bool:
        """Whether SQLite finds no fault with the file as a whole, read from end to end."""
        try:
            found = self.connection.execute("PRAGMA quick_check(1)").fetchone()[0]
            return not self._cut_short() and found == "ok"
        except (*_DAMAGE, RecordingError):
            return False

    def _whole(self, iteration: int) -> bool:
        try:
            # the sizes are beside the bytes' first page, so this does not read them, but for a file that was cut short
            rows = f"SELECT length(data) AS size FROM arrays WHERE iteration = ? AND {ITERATION_S_OWN} LIMIT 100"
            found = self.connection.execute(f"SELECT sum(size) FROM ({rows})", (iteration,)).fetchone()[0] is not None
            if found and self._cut_short():
                self._arrays(iteration)
            return found
        except (*_DAMAGE, RecordingError):
            return False

    def _cut_short(self) -> bool:
        log = self._path.with_name(self._path.name + "-wal")
        pages, size = self._pragma("page_count"), self._pragma("page_size")
        return not log.exists() and pages * size > self._path.stat().st_size

    def _scalars(self, iteration: int) -> dict[str, Any]:
        query = "SELECT stage, tolerance, mle_score, seconds, notes FROM iterations WHERE number = ?"
        with self._reading(f"iteration {iteration}"):
            row = self.connection.execute(query, (iteration,)).fetchone()
            if row is not None:
                return _checked_scalars(*row)
        known = self.iterations()
        there = f"iterations {known[0]} to {known[-1]}" if known else "none"
        raise RecordingError(f"iteration {iteration} is not in recording '{self.name}'; it has {there}")

    def _arrays(self, iteration: int) -> Arrays:
        found = self._read_arrays(iteration, ITERATION_S_OWN)
        if not found:
            raise RecordingError(f"iteration {iteration} of recording '{self.name}' was thinned out")
        return found

    def _read_arrays(self, iteration: int, which: str) -> Arrays:
        query = f"SELECT name, dtype, shape, data FROM arrays WHERE iteration = ? AND {which}"
        found: dict[str, NDArray[Any]] = {}
        with self._reading(f"iteration {iteration}"), self.blobs():
            if self._shapes is not None:
                said = query.replace("data", "length(data)") + f" LIMIT {len(self._shapes.largest) * 2}"
                try:
                    self._shapes.check(self.connection.execute(said, (iteration,)))
                except (ValueError, KeyError, TypeError):
                    raise RecordingError(f"iteration {iteration} does not fit the model of its recording") from None
            for name, dtype, shape, data in self.connection.execute(query, (iteration,)):
                found[name] = unpack(dtype, shape, data)
                found[name].setflags(write=False)
        return found

    @contextmanager
    def blobs(self) -> Iterator[None]:
        """Meanwhile what is read may be longer than a text: a model, depths, an array."""
        before = self.connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LONGEST)
        try:
            yield
        finally:
            self.connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, before)

    @contextmanager
    def _reading(self, what: str) -> Iterator[None]:
        """RecordingError where `what` turns out to be damaged."""
        try:
            yield
        except _DAMAGE:
            raise RecordingError(f"recording '{self.name}' is damaged: {what} cannot be read") from None


def _texts(rows: Iterable[tuple[Any, ...]]) -> list[str]:
    """Raises TypeError where one is none."""
    found = []
    for (text,) in rows:
        if not isinstance(text, str):
            raise TypeError("no text")
        found.append(text)
    return found


def _checked_scalars(stage: Any, tolerance: Any, score: Any, seconds: Any, notes: Any) -> dict[str, Any]:
    """The row of an iteration. Raises TypeError or ValueError where it is none."""
    told = read_json(notes)
    numbers = [tolerance, seconds, *([] if score is None else [score])]
    if not all(isinstance(number, float) for number in numbers) or not isinstance(stage, str):
        raise TypeError("no row of an iteration")
    if not isinstance(told, list) or not all(isinstance(note, str) for note in told):
        raise TypeError("no notes")
    return {"stage": stage, "tolerance": tolerance, "mle_score": score, "seconds": seconds, "notes": told}
