"""Which iterations stay when a recording grows too large? Every second one, then every fourth, and the newest.

What has to go goes a few iterations at a time, with each that is written: all at once took seconds, for which the
inference stood still.
"""

from __future__ import annotations

import math
import sqlite3
from collections import deque

from pmpnbp.recording.schema import ITERATION_S_OWN

# Iterations dropped with each that is written; more than one, so that the file does not go on growing meanwhile.
AT_A_TIME = 3
# Of so many of the newest that were kept, the common divisor is the stride: older ones may still be waiting to go.
TELLING = 8


class Thinning:
    """Keeps a recording at about `max_bytes`. connection : the writer's, used by its thread alone"""

    def __init__(self, connection: sqlite3.Connection, max_bytes: int) -> None:
        self._connection = connection
        self._max_bytes = max_bytes
        found = connection.execute(f"SELECT DISTINCT iteration FROM arrays WHERE {ITERATION_S_OWN} ORDER BY iteration")
        kept = [number for (number,) in found]
        self._newest: int | None = kept.pop() if kept else None
        # what was kept before the newest are multiples of the stride
        self._stride = math.gcd(*kept[-TELLING:]) or 1
        self._surplus = deque(number for number in kept if number % self._stride)

    def written(self, number: int) -> None:
        """Iteration `number` has just been written, in the transaction that is open."""
        if self._newest is not None and self._newest % self._stride:
            self._drop(self._newest)
        self._newest = number
        if not self._surplus and self._used() > self._max_bytes:
            self._widen(number)
        for _ in range(min(AT_A_TIME, len(self._surplus))):
            self._drop(self._surplus.popleft())

    def _widen(self, newest: int) -> None:
        """From here on, every second of those that have been kept. The room they leave in the file is used again."""
        before, self._stride = self._stride, 2 * self._stride
        run = self._connection.execute
        query = "SELECT number FROM iterations WHERE number % ? = 0 AND number % ? != 0 AND number != ? ORDER BY number"
        self._surplus.extend(number for (number,) in run(query, (before, self._stride, newest)))
        text = (
            f"at iteration {newest} the recording reached {self._max_bytes} bytes; of all iterations, earlier ones "
            f"too, every {self._stride}th is kept from here on, and the newest"
        )
        run("INSERT INTO notes (text) VALUES (?)", (text,))

    def _drop(self, number: int) -> None:
        # later iterations may be told with its posterior
        self._connection.execute(f"DELETE FROM arrays WHERE iteration = ? AND {ITERATION_S_OWN}", (number,))

    def _used(self) -> int:
        pages, free, size = (
            int(self._connection.execute(f"PRAGMA {name}").fetchone()[0])
            for name in ("page_count", "freelist_count", "page_size")
        )
        return (pages - free) * size
