"""What became different in the course of an inference? Settings and scans, each from some iteration on.

A change belongs to the iteration it was made after: iteration k is made with all changes whose `after_iteration` is
below k, so that any iteration can be done again with what it was done with.
"""

from __future__ import annotations

import json
import sqlite3
from dataclasses import asdict, dataclass
from typing import Any

from pmpnbp.inference.arrival import SCAN_MODES, ScanMode
from pmpnbp.json_text import read_json
from pmpnbp.recording.scans import scans, store_scan
from pmpnbp.recording.schema import VERSION
from pmpnbp.scene.observation import Scan
from pmpnbp.settings import Settings, changed, preset


@dataclass(frozen=True)
class Change:
    """From iteration `after_iteration` + 1 on: other `settings` (all of them), or another `scan`, or both.

    mode : whether the scan joins those there are or replaces them
    note : what the program that made the change wants to find again; nothing here reads it
    """

    after_iteration: int
    settings: Settings | None = None
    scan: Scan | None = None
    note: str = ""
    mode: ScanMode = "joins"

    def __post_init__(self) -> None:
        if self.mode not in SCAN_MODES:
            raise ValueError(f"a scan's mode is {self.mode!r}; expected {' or '.join(SCAN_MODES)}")


def store_change(connection: sqlite3.Connection, change: Change) -> None:
    """Write a change behind those there are."""
    number = None if change.scan is None else store_scan(connection, change.scan)
    settings = None if change.settings is None else json.dumps(asdict(change.settings))
    connection.execute(
        "INSERT INTO changes (after_iteration, settings, scan, note, mode) VALUES (?, ?, ?, ?, ?)",
        (change.after_iteration, settings, number, change.note, change.mode),
    )


def changes(connection: sqlite3.Connection, iteration: int | None = None) -> list[Change]:
    """The changes that iteration `iteration` was made with, in order; without it all there are."""
    rows = [row for row in change_rows(connection) if iteration is None or row[1] < iteration]
    numbers = [row[3] for row in rows if row[3] is not None]
    # not more than these: further ones may be damaged
    there = scans(connection, max(numbers) + 1) if numbers else ()
    return [
        Change(
            after,
            None if settings is None else changed(preset("robust"), read_json(settings)),
            None if number is None else there[number],
            note,
            mode,
        )
        for _, after, settings, number, note, mode in rows
    ]


def change_rows(connection: sqlite3.Connection) -> list[tuple[Any, ...]]:
    """The rows of the table `changes`, in order; those that are older than modes join."""
    if connection.execute("PRAGMA user_version").fetchone()[0] < VERSION:
        return []  # format 1 knew none
    found = []
    for row in connection.execute("SELECT * FROM changes ORDER BY number"):
        if type(row[1]) is not int or not (row[3] is None or (type(row[3]) is int and row[3] >= 0)):
            raise ValueError("a change after no iteration, or of no scan")
        found.append((*row[:5], (*row[5:], None)[0] or "joins"))
    return found


def changed_after(connection: sqlite3.Connection) -> list[int]:
    """The iteration that each change came after, in order."""
    if connection.execute("PRAGMA user_version").fetchone()[0] < VERSION:
        return []
    return [int(after) for (after,) in connection.execute("SELECT after_iteration FROM changes ORDER BY number")]


def first_scans(connection: sqlite3.Connection) -> tuple[Scan, ...]:
    """The scans that the inference began with."""
    if connection.execute("PRAGMA user_version").fetchone()[0] < VERSION:
        return scans(connection)
    return scans(connection, connection.execute("SELECT min(scan) FROM changes").fetchone()[0])
