"""What has just happened in a session? Numbered events, kept for a while, for listeners that come and go.

Whoever publishes never waits for a listener: a listener is woken, and fetches what it has not seen. Numbers only ever
rise, over restarts too: they are taken from blocks, and a block is written down before the first of it is used.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import takewhile

# Numbers set aside at a time.
BLOCK = 1000
# Events kept; a listener that is further behind gets the newest of them.
KEPT = 512


@dataclass(frozen=True)
class Event:
    """kind : `iteration`, `state` or `error`; data : JSON, UTF-8, one line."""

    number: int
    kind: str
    data: bytes

    @cached_property
    def text(self) -> bytes:
        """As every stream of server-sent events has it; made once for all listeners."""
        return written(self.kind, self.data, self.number)


def written(kind: str, data: bytes, number: int | None = None) -> bytes:
    """A server-sent event. data : one line, UTF-8; number : its id"""
    return b"event: %s\ndata: %s\n%s\n" % (kind.encode(), data, b"" if number is None else b"id: %d\n" % number)


class Events:
    """The events of one session. Thread-safe.

    first : the first number; limit : from here on numbers are not set aside yet
    reserve : writes down the limit it is called with, or raises
    """

    def __init__(self, first: int = 1, limit: int = 1, reserve: Callable[[int], None] | None = None) -> None:
        self._lock = threading.Lock()
        self._next, self._limit = first, limit
        self._reserve = reserve
        self._kept: deque[Event] = deque(maxlen=KEPT)
        self._last = self._next - 1
        self._listeners: dict[object, Callable[[], None]] = {}
        self.closed = False

    @property
    def last(self) -> int:
        """The number of the newest event; just below the first that will be, where there is none yet."""
        with self._lock:
            return self._last

    @property
    def newest_kind(self) -> str | None:
        """The kind of the newest event that is kept; None where there is none."""
        with self._lock:
            return self._kept[-1].kind if self._kept else None

    def number(self) -> int:
        """A number for an event that will be published, before any other gets one."""
        with self._lock:
            if self._next >= self._limit:
                limit = self._next + BLOCK
                if self._reserve is not None:
                    self._reserve(limit)
                self._limit = limit
            self._next += 1
            return self._next - 1

    def publish(self, event: Event) -> None:
        """Add an event and wake all listeners; returns at once."""
        with self._lock:
            self._kept.append(event)
            self._last = max(self._last, event.number)
            listeners = list(self._listeners.values())
        for wake in listeners:
            wake()

    def since(self, number: int) -> list[Event]:
        """The events after `number` that are still kept, oldest first."""
        with self._lock:
            return [*takewhile(lambda event: event.number > number, reversed(self._kept))][::-1]

    def listen(self, wake: Callable[[], None]) -> Callable[[], None]:
        """Call `wake` after each event, from the publisher's thread; it must return at once. What is returned ends
        that."""
        key = object()
        with self._lock:
            self._listeners[key] = wake
        return lambda: self._forget(key)

    def close(self) -> None:
        """Tell the listeners that there will be no more."""
        with self._lock:
            self.closed = True
            listeners = list(self._listeners.values())
        for wake in listeners:
            wake()

    def _forget(self, key: object) -> None:
        with self._lock:
            self._listeners.pop(key, None)
