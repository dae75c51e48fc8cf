"""Does a recording stay as large as it may be, losing a few iterations at a time, also when its writer is stopped?"""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator

import pytest

from pmpnbp.recording.schema import ADDED_TABLES, TABLES
from pmpnbp.recording.thinning import AT_A_TIME, Thinning

# Bytes of an iteration, and how many of them there is room for.
SIZE, ROOM = 30_000, 40


@pytest.fixture
def connection() -> Iterator[sqlite3.Connection]:
    made = sqlite3.connect(":memory:", isolation_level=None)
    made.executescript(TABLES + ADDED_TABLES)
    yield made
    made.close()


def write(connection: sqlite3.Connection, thinning: Thinning, number: int) -> None:
    connection.execute("INSERT INTO iterations VALUES (?, 'search', 0, 0, 0, '[]')", (number,))
    connection.execute("INSERT INTO arrays VALUES (?, 'belief.poses', 'u1', '[]', zeroblob(?))", (number, SIZE))
    thinning.written(number)


def kept(connection: sqlite3.Connection) -> list[int]:
    return [number for (number,) in connection.execute("SELECT iteration FROM arrays ORDER BY iteration")]


def notes(connection: sqlite3.Connection) -> int:
    return int(connection.execute("SELECT count(*) FROM notes").fetchone()[0])


def test_a_few_go_at_a_time_and_it_never_grows_beyond(connection: sqlite3.Connection) -> None:
    thinning = Thinning(connection, ROOM * SIZE)
    before: set[int] = set()
    for number in range(12 * ROOM):
        write(connection, thinning, number)
        now = set(kept(connection))
        assert len(before - now) <= AT_A_TIME + 1  # and the newest before, where it is none of the stride's
        assert {0, number} <= now and len(now) <= ROOM + 1
        before = now
    assert notes(connection) == 4
    assert now == {*range(0, 12 * ROOM, 16), 12 * ROOM - 1}


@pytest.mark.parametrize("after", [0, 1, 2, 4])
def test_a_writer_that_was_stopped_meanwhile_is_gone_on_for(connection: sqlite3.Connection, after: int) -> None:
    thinning = Thinning(connection, ROOM * SIZE)
    written = 0
    while not notes(connection):
        write(connection, thinning, written)
        written += 1
    for number in range(written, written + after):
        write(connection, thinning, number)
    assert any(iteration % 2 for iteration in kept(connection))
    again = Thinning(connection, ROOM * SIZE)
    for number in range(written + after, 3 * ROOM):
        write(connection, again, number)
        assert len(kept(connection)) <= ROOM + 1
    stride = kept(connection)[1]
    assert stride in (2, 4) and set(kept(connection)) == {*range(0, 3 * ROOM, stride), 3 * ROOM - 1}


def test_what_was_not_thinned_out_stays(connection: sqlite3.Connection) -> None:
    thinning = Thinning(connection, ROOM * SIZE)
    for number in range(ROOM // 2):
        write(connection, thinning, number)
    again = Thinning(connection, ROOM * SIZE)
    for number in range(ROOM // 2, ROOM - 5):
        write(connection, again, number)
    assert kept(connection) == list(range(ROOM - 5)) and notes(connection) == 0
