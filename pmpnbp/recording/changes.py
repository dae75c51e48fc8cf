"""What became different in the course of an inference? Settings and further scans, each from some iteration on.

A change belongs to the iteration it was made after: iteration k is made with all changes whose `after_iteration` is
below k, so that any iteration can be done again with what it was done with.
"""

from __future__ import annotations

import json
import sqlite3
from dataclasses import asdict, dataclass

from pmpnbp.recording.scans import scans, store_scan
from pmpnbp.recording.schema import VERSION
from pmpnbp.scene.observation import Scan
from pmpnbp.settings import Settings, changed, preset


@dataclass(frozen=True)
class Change:
    """From iteration `after_iteration` + 1 on: other `settings` (all of them), or a further `scan`, or both.

    note : what the program that made the change wants to find again; nothing here reads it
    """

    after_iteration: int
    settings: Settings | None = None
    scan: Scan | None = None
    note: str = ""


def store_change(connection: sqlite3.Connection, change: Change) -> None:
    """Write a change behind those there are."""
    number = None if change.scan is None else store_scan(connection, change.scan)
    settings = None if change.settings is None else json.dumps(asdict(change.settings))
    connection.execute(
        "INSERT INTO changes (after_iteration, settings, scan, note) VALUES (?, ?, ?, ?)",
        (change.after_iteration, settings, number, change.note),
    )


def changes(connection: sqlite3.Connection, iteration: int | None = None) -> list[Change]:
    """The changes that iteration `iteration` was made with, in order; without it all there are."""
    if connection.execute("PRAGMA user_version").fetchone()[0] < VERSION:
        return []  # format 1 knew none
    query = "SELECT after_iteration, settings, scan, note FROM changes ORDER BY number"
    rows = [row for row in connection.execute(query) if iteration is None or row[0] < iteration]
    numbers = [number for _, _, number, _ in rows if number is not None]
    # not more than these: further ones may be damaged
    there = scans(connection, max(numbers) + 1) if numbers else ()
    return [
        Change(
            after,
            None if settings is None else changed(preset("robust"), json.loads(settings)),
            None if number is None else there[number],
            note,
        )
        for after, settings, number, note in rows
    ]


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
