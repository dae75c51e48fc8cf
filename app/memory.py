"""How does memory that nothing needs any more get back to the system?

A session or a view that ends leaves reference cycles, which Python collects at some later time, and free memory within
the C library's arenas, which glibc keeps: one for each of many threads. So memory is collected and given back soon after
something ended, once for all that ended meanwhile.
"""

from __future__ import annotations

import ctypes
import gc
import threading
from collections.abc import Callable
from functools import cache

# Seconds after something ended: what ends together, as the views of a session, is waited for.
SOON = 1.0


class GivingBack:
    """Gives memory back soon after it is asked to. Thread-safe."""

    def __init__(self, seconds: float = SOON) -> None:
        self._seconds = seconds
        self._lock = threading.Lock()
        self._due: threading.Timer | None = None

    def soon(self) -> None:
        """Something large has ended; returns at once."""
        with self._lock:
            if self._due is None:
                self._due = threading.Timer(self._seconds, self._give_back)
                self._due.daemon = True
                self._due.start()

    def close(self) -> None:
        """Give nothing back any more."""
        with self._lock:
            if self._due is not None:
                self._due.cancel()

    def _give_back(self) -> None:
        with self._lock:
            self._due = None
        give_back()


def give_back() -> None:
    """Collect what is unreachable, and give free pages back to the system."""
    gc.collect()
    _trim()()


@cache
def _trim() -> Callable[[], object]:
    """glibc's `malloc_trim`, which does without the interpreter's lock; elsewhere nothing."""
    try:
        trim = ctypes.CDLL(None).malloc_trim
    except (AttributeError, OSError, TypeError):  # another C library, or none that can be asked
        return lambda: None
    trim.argtypes, trim.restype = [ctypes.c_size_t], ctypes.c_int
    return lambda: trim(0)
