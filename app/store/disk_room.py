"""Is there room for these bytes? Counts what the data directory holds against its limit, and what is on its way in."""

from __future__ import annotations

import os
import threading
import time
from contextlib import suppress
from pathlib import Path

from app.problems import HttpProblem
from app.store.atomic_files import there
from pmpnbp.errors import data_directory_error

# Sessions write their recordings on their own; walking their folders for every chunk of an upload would be waste.
_WALK_SECONDS = 1.0
# Left free for the recordings of running sessions.
_RESERVE = 64 << 20


class DiskRoom:
    """The bytes under a data directory: entries (known by their size), sessions (walked), and claims of uploads."""

    def __init__(self, sessions: Path, max_bytes: int) -> None:
        self._sessions = sessions
        self._max_bytes = max_bytes
        self._lock = threading.Lock()
        self._entries = 0
        self._claimed = 0
        self._walked_at = -float("inf")
        self._walked = 0

    @property
    def max_bytes(self) -> int:
        """The limit."""
        return self._max_bytes

    def used(self) -> int:
        """Bytes that are taken or claimed."""
        with self._lock:
            return self._used()

    def entry(self, size: int) -> None:
        """An entry of `size` bytes has landed, or, where negative, has gone."""
        with self._lock:
            self._entries += size

    def sessions_changed(self) -> None:
        """Walk the sessions' folders again before the next answer."""
        with self._lock:
            self._walked_at = -float("inf")

    def claim(self, count: int) -> None:
        """Set `count` bytes aside. Raises HttpProblem 507 or StorageError where they are not there."""
        with self._lock:
            if self._used() + count > self._max_bytes:
                limit = f"{self._max_bytes / (1 << 20):.0f} MiB"
                raise HttpProblem(
                    507, f"the data directory may hold {limit} and is full; delete sessions, scans or models first"
                )
            space = os.statvfs(there(self._sessions))
            reserve = min(_RESERVE, self._max_bytes // 20)
            if space.f_bavail * space.f_frsize < count + reserve:
                kept = f"{reserve / (1 << 20):.0f} MiB"
                raise data_directory_error(f"its disk has no more than the {kept} that are kept free for recordings")
            self._claimed += count

    def release(self, count: int) -> None:
        """Give claimed bytes back."""
        with self._lock:
            self._claimed -= count

    def _used(self) -> int:
        if time.monotonic() - self._walked_at > _WALK_SECONDS:
            self._walked = folder_size(self._sessions)
            self._walked_at = time.monotonic()
        return self._entries + self._walked + self._claimed


def folder_size(folder: Path) -> int:
    """Bytes of the files in a folder and below; what vanishes meanwhile counts nothing."""
    size = 0
    for place, _, names in os.walk(folder):
        for name in names:
            with suppress(OSError):
                size += os.lstat(os.path.join(place, name)).st_size
    return size
