"""Can a recording be gone on with? Whatever happened to its writer: from the last iteration that is whole.

A writer that was killed leaves a file that SQLite itself makes whole. A file that was cut short, or damaged behind some
iteration, is copied as far as it is whole, and the copy takes its place.
"""

from __future__ import annotations

import contextlib
import os
import sqlite3
from pathlib import Path
from typing import Any

from pmpnbp.errors import DamageError, RecordingError, why_not_written
from pmpnbp.recording.changes import change_rows
from pmpnbp.recording.reader import Recording
from pmpnbp.recording.schema import ADDED_TABLES, APPLICATION_ID, TABLES, VERSION


def make_whole(path: Path) -> int:
    """Make the recording at `path` fit for `RecordingWriter.appending`; the number of its last whole iteration.

    What comes after that iteration is dropped, with a note that says so; changes stay, and belong to the iterations
    they belonged to. Nobody may be writing to it. Raises RecordingError where model, scans or settings are damaged, or
    no iteration is whole.
    """
    path = Path(path)
    with Recording(path) as recording:
        whole = last_whole(recording)
        if whole is not None and recording.sound() and recording.newest() == whole:
            return whole
        copy = path.with_name(path.name + ".part")
        _remove(copy)
        try:
            with recording.blobs():
                whole = None if whole is None else _copy(recording, copy, whole)
        except sqlite3.Error as error:
            _remove(copy)
            raise RecordingError(f"recording '{path.name}' is damaged and cannot be mended: {error}") from None
        if whole is None:
            raise RecordingError(f"recording '{path.name}' is damaged: none of its iterations is whole")
    replace_recording(copy, path)
    return whole


def last_whole(recording: Recording) -> int | None:
    """The newest iteration that can be read, with its state and posterior; None where there is none."""
    for number in reversed(recording.iterations()):
        with contextlib.suppress(RecordingError):
            recording.report(number)
            recording.state(number)
            recording.posterior(number)
            return number
    return None


def last_shown(recording: Recording) -> int | None:
    """The newest iteration that can be read, with the settings and scans it was made with; None where there is none.
    For who only reads, and leaves the file as it is."""
    last = last_whole(recording)
    if last is None:
        return None
    for after in reversed(recording.changed_after()):
        with contextlib.suppress(RecordingError):
            recording.changes(last)
            break
        last = min(last, after)  # a scan that came then is lost
    return last


def replace_recording(new: Path, path: Path) -> None:
    """Put the finished recording `new` in the place of the one at `path`, which nobody may be writing to."""
    # first: SQLite would take the old file's log for the new one's
    for left in (path.with_name(path.name + "-wal"), path.with_name(path.name + "-shm")):
        left.unlink(missing_ok=True)
    os.replace(new, path)
    folder = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def back_up(path: Path, copy: Path) -> None:
    """A consistent copy of the recording at `path` as one file, also while it is being written. Raises DamageError
    where it is damaged; a full disk is SQLite's own error."""
    try:
        with (
            contextlib.closing(sqlite3.connect(f"{path.absolute().as_uri()}?mode=ro", uri=True)) as source,
            contextlib.closing(sqlite3.connect(copy)) as target,
        ):
            source.backup(target)
            target.execute("PRAGMA journal_mode = DELETE")
    except sqlite3.DatabaseError as error:
        if why_not_written(error) is not None and path.exists():
            raise
        raise DamageError(f"recording '{path.name}' cannot be copied: {error}") from None


def _copy(recording: Recording, copy: Path, whole: int) -> int:
    """Write a recording to `copy` with what `recording` has up to iteration `whole`, or to the last before a scan that
    is lost; that iteration."""
    source = recording.connection
    older = source.execute("PRAGMA user_version").fetchone()[0] < VERSION
    scans = _readable(source, "SELECT * FROM scans ORDER BY number")
    changes = change_rows(source)
    for place, (_, after, _, scan, *_) in enumerate(changes):
        if scan is not None and scan >= len(scans):
            changes, whole = changes[:place], min(whole, after)
            break
    with contextlib.closing(sqlite3.connect(copy, isolation_level=None)) as target:
        target.execute(f"PRAGMA application_id = {APPLICATION_ID}")
        target.execute(f"PRAGMA user_version = {VERSION}")
        target.execute("BEGIN IMMEDIATE")
        for statement in (TABLES + ADDED_TABLES).split(";"):
            target.execute(statement)
        for table in ("inputs", "model"):
            _insert(target, table, source.execute(f"SELECT * FROM {table}").fetchall())
        _insert(target, "scans", scans)
        _insert(target, "changes", changes)
        _insert(target, "notes", _readable(source, "SELECT * FROM notes ORDER BY number"))
        for row in _readable(source, f"SELECT * FROM iterations WHERE number <= {whole} ORDER BY number"):
            _insert(target, "iterations", [row])
            for table in ("arrays",) if older else ("summaries", "arrays"):
                with contextlib.suppress(sqlite3.DatabaseError, RecordingError):
                    if table == "arrays":
                        recording.report(row[0])  # one that was thinned out, or is damaged, keeps its row
                    found = source.execute(f"SELECT * FROM {table} WHERE iteration = ?", (row[0],)).fetchall()
                    _insert(target, table, found)
        text = f"what came after iteration {whole} was damaged and is left out"
        target.execute("INSERT INTO notes (text) VALUES (?)", (text,))
        target.execute("COMMIT")
    return whole


def _readable(source: sqlite3.Connection, query: str) -> list[tuple[Any, ...]]:
    """The rows before the damage."""
    found: list[tuple[Any, ...]] = []
    with contextlib.suppress(sqlite3.DatabaseError):
        for row in source.execute(query):
            found.append(row)
    return found


def _insert(target: sqlite3.Connection, table: str, rows: list[tuple[Any, ...]]) -> None:
    if rows:
        target.executemany(f"INSERT INTO {table} VALUES ({', '.join('?' * len(rows[0]))})", rows)


def _remove(path: Path) -> None:
    for old in (path, path.with_name(path.name + "-journal")):
        old.unlink(missing_ok=True)
