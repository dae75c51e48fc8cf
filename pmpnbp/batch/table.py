"""What came of a batch, as a table for spreadsheets and programs: a row for each row of the manifest, in its order."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence

from pmpnbp.batch.told import ERROR, Told

COLUMNS = (
    "name",
    "verdict",
    "fit",
    "explained",
    "certain_links",
    "links",
    "iterations",
    "seconds",
    "model",
    "sentence",
    "error",
)
# What makes a spreadsheet take a field for a formula, which a name must not become.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def table(rows: Sequence[Told]) -> str:
    """CSV: COLUMNS, then of every joint of any row `NAME position`, `NAME low` and `NAME high`, the ends of the central
    90 %, metres or radians; a joint with several axes has its axes numbered, `NAME 0 position` and so on. Text that a
    spreadsheet would take for a formula begins with an apostrophe."""
    joints: dict[str, None] = {}
    for row in rows:
        joints.update(dict.fromkeys(numbers for numbers, _ in _numbers(row)))
    stream = io.StringIO(newline="")
    writer = csv.writer(stream)
    writer.writerow(map(_cell, [*COLUMNS, *joints]))
    for row in rows:
        given = dict(_numbers(row))
        failed = row.verdict == ERROR
        cells: list[object] = [
            row.name,
            row.verdict,
            row.fit,
            row.explained,
            row.certain,
            row.links,
            row.iterations,
            row.seconds,
            row.model,
            None if failed else row.sentence,
            row.sentence if failed else None,
        ]
        writer.writerow(map(_cell, [*cells, *(given.get(column) for column in joints)]))
    return stream.getvalue()


def _numbers(row: Told) -> Iterator[tuple[str, float | None]]:
    """Columns of the joints, and what this row has in them."""
    for joint in row.joints:
        for axis, position in enumerate(joint.positions):
            name = joint.name if len(joint.positions) == 1 else f"{joint.name} {axis}"
            low, high = (None, None) if joint.intervals is None else map(float, joint.intervals[axis])
            yield f"{name} position", float(position)
            yield f"{name} low", low
            yield f"{name} high", high


def _cell(value: object) -> object:
    return f"'{value}" if isinstance(value, str) and value.startswith(_FORMULA) else value
