"""May a session's own read-out go on? It has the session's one thread: it gives way to whoever waits for that, and
where it takes its time people hear what is done.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

from pmpnbp.readout.checkpoint import SOON, Checkpoint

# So many times in a row it gives way; then it goes on to its end, for else who asks for something again and again would
# keep it from ever being told.
GIVES_WAY = 3


class GaveWay(Exception):
    """A read-out was ended for something that waits, and has told nothing."""


class LongReadOut:
    """underway : whether a read-out has been going on for more than SOON seconds; of the thread alone, but for reading.

    awaited : whether something waits for the thread; tell : called when `underway` becomes true
    """

    def __init__(self, awaited: Callable[[], bool], tell: Callable[[], None]) -> None:
        self._awaited = awaited
        self._tell = tell
        self.underway = False
        self._gave_way = 0

    @contextmanager
    def begun(self) -> Iterator[Checkpoint]:
        """For a read-out within: its checkpoint, which raises GaveWay."""
        try:
            yield partial(self._checkpoint, time.monotonic())
            self._gave_way = 0
        finally:
            self.underway = False

    def _checkpoint(self, began: float) -> None:
        if self._gave_way < GIVES_WAY and self._awaited():
            self._gave_way += 1
            raise GaveWay
        if not self.underway and time.monotonic() - began > SOON:
            self.underway = True
            self._tell()
