"""How much can a recording from elsewhere say? Its tables are counted before they are read: none has more than these.

A session may come to a hundred thousand iterations; a table of ten million notes is nothing that this program wrote.
"""

from __future__ import annotations

import json
import math
import sqlite3
from contextlib import suppress

# Bytes of one text or name; a row of the trace about a thousand links takes less.
LONGEST_TEXT = 4 << 20
# Pixels of all scans, which are kept while a recording is looked at: thirty-two of two million each.
MOST_PIXELS = 64 << 20
# By table: rows, what is measured of each, and the bytes that these come to in all.
_MOST = {
    "inputs": (100, "length(name) + length(value)", 16 << 20),
    "model": (1, "0", 0),
    "scans": (1000, "length(camera) + length(frame_id)", 1 << 20),
    "iterations": (100_001, "length(stage) + length(notes)", 64 << 20),
    "notes": (1000, "length(text)", 1 << 20),
    "summaries": (100_001, "length(text)", 128 << 20),
    "changes": (10_000, "length(coalesce(settings, '')) + length(note)", 64 << 20),
}


def excess(connection: sqlite3.Connection) -> str | None:
    """What a recording has too much of, in words; None where nothing. What cannot be read is not counted."""
    for table, (rows, measure, most) in _MOST.items():
        count = total = 0
        with suppress(sqlite3.DatabaseError):  # damaged, or of a format that has no such table
            for (size,) in connection.execute(f"SELECT {measure} FROM {table} LIMIT {rows + 1}"):
                count, total = count + 1, total + int(size or 0)
        if count > rows or total > most:
            limit = f"{rows} rows" if count > rows else f"{most} bytes"
            return f"more than {limit} of {table}"
    if _pixels(connection) > MOST_PIXELS:
        return f"more than {MOST_PIXELS} pixels of scans"
    return None


def _pixels(connection: sqlite3.Connection) -> int:
    """Of all scans, by what they say of their shapes; what says otherwise cannot be read later."""
    total = 0
    with suppress(sqlite3.DatabaseError):
        for (shape,) in connection.execute("SELECT shape FROM scans"):
            with suppress(ValueError, TypeError):
                total += abs(math.prod(json.loads(shape)))
    return total
