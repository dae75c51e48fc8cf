"""Damage a valid recording in every way we can think of, as who knows SQLite would: rows, types, shapes, numbers, text.

Each change takes a recording's bytes and gives others. `mutations` sends them with the rest.
"""

from __future__ import annotations

import json
import random
import sqlite3
import tempfile
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from pmpnbp.inference import run as engine
from pmpnbp.readout.snapshot import Criteria, snapshot
from pmpnbp.recording import Change, IterationArchive, prepare
from pmpnbp.recording.schema import pack
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.settings import changed, preset
from tests.app.small_sessions import CABINET, QUICK, ROI

SMALL = QUICK | {"image_width": 40, "splat_points": 16, "search_proposals": 60}
ITERATIONS = 6
PARTICLES = 8
# Where text stands, and what it is: JSON or plain.
TEXTS = (
    ("inputs", "value", True),
    ("iterations", "notes", True),
    ("summaries", "text", True),
    ("changes", "settings", True),
    ("scans", "camera", True),
    ("scans", "frame_id", False),
    ("iterations", "stage", False),
    ("notes", "text", False),
    ("changes", "note", False),
    ("changes", "mode", False),
    ("model", "file_name", False),
    ("arrays", "name", False),
    ("inputs", "name", False),
)
NUMBERS = (
    ("iterations", "number"),
    ("iterations", "tolerance"),
    ("iterations", "mle_score"),
    ("iterations", "seconds"),
    ("scans", "number"),
    ("scans", "stamp"),
    ("changes", "after_iteration"),
    ("changes", "scan"),
    ("summaries", "iteration"),
    ("arrays", "iteration"),
)
TYPES = ("<f8", "<f4", ">f8", "|u1", "<i4", "<i8", "|b1", "|O", "<U9", "|V100", "<c16", "<M8[s]", "", "<f8" * 99)
SHAPES = ("[]", "[4]", "[4, 8]", "[4, 8, 7]", "[1e9]", "[-1, 8]", "[0]", "[1000000000, 1000000000]", "{}", "7", "[[4]]")
HALF = "\ud800"
ODD = ("", "x", "a\0b", "é\u202e", "n" * 300, "n" * 5_000_000, "..", "NaN", "[" * 5000, "1" * 5000, "null", "{}", "[]")
ODD_NUMBERS = (-1, 0, 2.5, 2**31, 2**62, 1e308, float("inf"), -1e-300, None, "x", b"\xff")
BOMB = 64 << 20


@cache
def recording() -> bytes:
    """A session's recording of the sample cabinet: seven iterations, a change, another scan, a posterior."""
    folder = CABINET / "open"
    scan = load_scan(folder / "depth.png", folder / "camera.json")
    settings = changed(preset("robust"), SMALL)
    problem, inputs = prepare(CABINET / "cabinet.urdf", [scan], ROI, None, settings, particles=PARTICLES, seed=11)
    criteria = Criteria(max_std=0.0025)
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "recording.sqlite"
        archive = IterationArchive(path, "the sample")
        for step in engine.steps(problem, ITERATIONS):
            made = snapshot(problem, step.report, criteria, converged=step.converged, elapsed=1.0, event=step.iteration)
            if step.iteration == ITERATIONS:
                made = made.read_out()
            if step.iteration == 0:
                archive.begin(inputs, step, made)
            else:
                archive.add(step, made, lambda: None)
            if step.iteration == ITERATIONS - 3:
                archive.change(Change(step.iteration, settings=settings, note="{}"), problem)
        archive.change(Change(ITERATIONS, scan=scan, mode="joins"), problem)
        archive.close()
        return path.read_bytes()


def altered(content: bytes, change: Callable[[sqlite3.Connection], None]) -> bytes:
    """The recording after `change`; or as it was, where earlier damage does not let it be made."""
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / "recording.sqlite"
        path.write_bytes(content)
        connection = sqlite3.connect(path, isolation_level=None)
        try:
            connection.execute("PRAGMA synchronous = OFF")
            connection.execute("PRAGMA ignore_check_constraints = ON")
            change(connection)
        except (sqlite3.Error, ArithmeticError, LookupError, RecursionError, TypeError, ValueError):
            pass
        finally:
            connection.close()
        return path.read_bytes()


def _row(rng: random.Random, connection: sqlite3.Connection, table: str) -> int:
    rows = [row for (row,) in connection.execute(f"SELECT rowid FROM {table}")]
    return int(rng.choice(rows)) if rows else -1


def array_said(rng: random.Random, content: bytes) -> bytes:
    """An array that says it has another type or shape."""

    def change(connection: sqlite3.Connection) -> None:
        column, values = rng.choice((("dtype", TYPES), ("shape", SHAPES)))
        row = _row(rng, connection, rng.choice(("arrays", "arrays", "scans")))
        connection.execute(f"UPDATE arrays SET {column} = ? WHERE rowid = ?", (rng.choice(values), row))

    return altered(content, change)


@cache
def _zeros(size: int) -> bytes:
    return zlib.compress(bytes(size), 9)


def array_bomb(rng: random.Random, content: bytes) -> bytes:
    """An array, or a depth image, that unpacks to far more than it should."""

    def change(connection: sqlite3.Connection) -> None:
        if rng.random() < 0.2:
            shape, data = json.dumps([8192, BOMB // 4 // 8192]), _zeros(BOMB)
            connection.execute("UPDATE scans SET shape = ?, depth = ?", (shape, data))
            return
        row = _row(rng, connection, "arrays")
        dtype, shape = connection.execute("SELECT dtype, shape FROM arrays WHERE rowid = ?", (row,)).fetchone()
        sides = json.loads(shape) or [1]
        place = rng.randrange(len(sides))
        rest = int(np.prod([max(side, 1) for k, side in enumerate(sides) if k != place]))
        sides[place] = BOMB // (rest * np.dtype(dtype).itemsize)
        size = rest * sides[place] * np.dtype(dtype).itemsize
        if rng.random() < 0.3:
            dtype, sides = "|u1", [size]
        connection.execute(
            "UPDATE arrays SET dtype = ?, shape = ?, data = ? WHERE rowid = ?",
            (dtype, json.dumps(sides), _zeros(size), row),
        )

    return altered(content, change)


def array_numbers(rng: random.Random, content: bytes) -> bytes:
    """An array of its type and shape, with other numbers."""

    def change(connection: sqlite3.Connection) -> None:
        row = _row(rng, connection, "arrays")
        dtype, shape = connection.execute("SELECT dtype, shape FROM arrays WHERE rowid = ?", (row,)).fetchone()
        sides, kind = json.loads(shape), np.dtype(dtype)
        count = int(np.prod(sides)) * kind.itemsize
        way = rng.randrange(4)
        if way == 0:
            values = np.frombuffer(rng.randbytes(count), dtype=kind)
        else:
            number = rng.choice((np.nan, np.inf, -np.inf, 1e308, -1.0, 0.0, 1.0))
            with np.errstate(all="ignore"):
                values = np.full(count // kind.itemsize, number).astype(kind)
        connection.execute("UPDATE arrays SET data = ? WHERE rowid = ?", (pack(values)[2], row))

    return altered(content, change)


def blob_damage(rng: random.Random, content: bytes) -> bytes:
    """Bytes of an array, of the model or of a depth image that are not those."""

    def change(connection: sqlite3.Connection) -> None:
        table, column = rng.choice((("arrays", "data"), ("model", "zip"), ("scans", "depth")))
        row = _row(rng, connection, table)
        data = bytearray(connection.execute(f"SELECT {column} FROM {table} WHERE rowid = ?", (row,)).fetchone()[0])
        way = rng.randrange(4)
        if way == 0 and data:
            data[rng.randrange(len(data))] = rng.randrange(256)
        new: Any = (bytes(data), bytes(data[: len(data) // 2]), bytes(data) + bytes(1 << 20), "text")[way]
        connection.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (new, row))

    return altered(content, change)


def text_damage(rng: random.Random, content: bytes) -> bytes:
    """Text that is too long, no text, no JSON, or other JSON, in any place."""

    def change(connection: sqlite3.Connection) -> None:
        table, column, is_json = rng.choice(TEXTS)
        if table == "notes":
            connection.execute("INSERT INTO notes (text) VALUES ('hello')")
        row = _row(rng, connection, table)
        new: Any = rng.choice((*ODD, b"\xff\xfe", b"\xed\xa0\x80", 5, 2.5))
        if is_json and rng.random() < 0.8:
            old = connection.execute(f"SELECT {column} FROM {table} WHERE rowid = ?", (row,)).fetchone()[0]
            new = json.dumps(_other(rng, json.loads(old)))
        where = "" if rng.random() < 0.2 else f"WHERE rowid = {row}"
        connection.execute(f"UPDATE OR REPLACE {table} SET {column} = ? {where}", (new,))

    return altered(content, change)


def _other(rng: random.Random, value: Any) -> Any:
    """JSON with one of its members other than it was."""
    odd = (HALF, "x", "", "n" * 100_000, -1, 1e308, float("nan"), 2.5, 10**30, None, [], {}, {HALF: 1}, True)
    if isinstance(value, dict) and value and rng.random() < 0.9:
        name = rng.choice(list(value))
        way = rng.randrange(5)
        if way == 0:
            return {key: member for key, member in value.items() if key != name}
        if way == 1:
            return value | {rng.choice((HALF, "x", "n" * 300)): value[name]}
        return value | {name: _other(rng, value[name])}
    if isinstance(value, list) and value and rng.random() < 0.9:
        place = rng.randrange(len(value))
        if rng.random() < 0.2:
            return value[:place] + value[place + 1 :] * rng.choice((0, 1, 3))
        return [*value[:place], _other(rng, value[place]), *value[place + 1 :]]
    return rng.choice(odd)


def number_damage(rng: random.Random, content: bytes) -> bytes:
    """Another number in a row, or in all."""

    def change(connection: sqlite3.Connection) -> None:
        table, column = rng.choice(NUMBERS)
        new = rng.choice(ODD_NUMBERS)
        where = "" if rng.random() < 0.2 else f"WHERE rowid = {_row(rng, connection, table)}"
        value = f"{column} + {rng.choice((-100, 1, 100, 2**40))}" if rng.random() < 0.3 else "?"
        connection.execute(f"UPDATE OR REPLACE {table} SET {column} = {value} {where}", (new,) if value == "?" else ())

    return altered(content, change)


def rows_damage(rng: random.Random, content: bytes) -> bytes:
    """Rows removed, doubled, or without number."""

    def change(connection: sqlite3.Connection) -> None:
        table = rng.choice(("inputs", "model", "scans", "iterations", "arrays", "summaries", "changes"))
        row, way = _row(rng, connection, table), rng.randrange(5)
        if way == 0:
            connection.execute(f"DELETE FROM {table}")
        elif way == 1:
            connection.execute(f"DELETE FROM {table} WHERE rowid = {row}")
        elif way == 2:
            connection.execute("UPDATE OR REPLACE arrays SET iteration = iteration + 1 WHERE rowid > ?", (row,))
        elif way == 3:
            connection.execute("INSERT INTO model SELECT * FROM model")
            connection.execute(
                "INSERT INTO scans SELECT number + 50, camera, frame_id, stamp, dtype, shape, depth FROM scans"
            )
        else:
            numbers = (
                "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n WHERE x < 20000) INSERT OR IGNORE "
            )
            connection.execute(
                numbers
                + rng.choice(
                    (
                        "INTO notes SELECT x, 'hello' FROM n",
                        "INTO iterations SELECT x, 'search', 0.0, 0.0, 0.0, '[]' FROM n",
                        "INTO summaries SELECT x, '{}' FROM n",
                        "INTO changes SELECT x, x, NULL, NULL, '', 'joins' FROM n",
                        "INTO arrays SELECT 3, 'a' || x, '|u1', '[1]', x'00' FROM n",
                        "INTO arrays SELECT x, 'belief.poses', '|u1', '[1]', x'00' FROM n",
                    )
                )
            )

    return altered(content, change)


def schema_damage(rng: random.Random, content: bytes) -> bytes:
    """Other tables, and what SQLite files can hold besides."""
    script = rng.choice(
        (
            "DROP TABLE summaries",
            "DROP TABLE changes",
            "DROP TABLE arrays",
            "DROP TABLE notes",
            "PRAGMA user_version = 1",
            "PRAGMA user_version = 99",
            "PRAGMA application_id = 5",
            "PRAGMA journal_mode = WAL",
            "ALTER TABLE arrays RENAME COLUMN data TO dat",
            "ALTER TABLE changes DROP COLUMN mode",
            "ALTER TABLE scans ADD COLUMN more TEXT",
            "ALTER TABLE notes RENAME TO n; CREATE VIEW notes AS SELECT * FROM n",
            "CREATE TABLE more (a INTEGER, b TEXT)",
            "CREATE TABLE w (a INTEGER PRIMARY KEY, b TEXT) WITHOUT ROWID",
            "CREATE TABLE g (a INTEGER, b TEXT GENERATED ALWAYS AS (hex(zeroblob(a))))",
            "CREATE INDEX i ON notes (text)",
            "CREATE TRIGGER t AFTER INSERT ON notes BEGIN DELETE FROM notes; END",
            "PRAGMA encoding = 'UTF-16'; VACUUM",
            "PRAGMA page_size = 512; VACUUM",
            "PRAGMA auto_vacuum = 1; VACUUM",
            "DELETE FROM arrays WHERE iteration = 3",
        )
    )
    return altered(content, lambda connection: [connection.execute(part) for part in script.split(";", 1)] and None)


def page_flip(rng: random.Random, content: bytes) -> bytes:
    """A page of the file that is another one, zeros, or noise, or whose pointers lead elsewhere."""
    pages = len(content) // 4096
    if pages < 3:
        return content
    target, source = rng.randrange(pages), rng.randrange(pages)
    page = bytearray(content[4096 * source : 4096 * (source + 1)])
    way = rng.randrange(4)
    if way == 0:
        page = bytearray(4096)
    elif way == 1:
        page = bytearray(rng.randbytes(4096))
    elif way == 2:  # chains of overflow pages begin with the number of the next
        page = bytearray(content[4096 * target : 4096 * (target + 1)])
        page[:4] = rng.randrange(pages + 2).to_bytes(4, "big")
    return content[: 4096 * target] + bytes(page) + content[4096 * (target + 1) :]


CHANGES = (
    array_said,
    array_bomb,
    array_numbers,
    blob_damage,
    text_damage,
    text_damage,
    number_damage,
    rows_damage,
    schema_damage,
    page_flip,
)
