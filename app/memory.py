"""How much memory is there, and how does what nothing needs any more get back to the system?

A session or a view that ends leaves reference cycles, which Python collects at some later time, and free memory within
the C library's arenas, which glibc keeps: one for each of many threads. So memory is collected and given back soon
after something ended, once for all that ended meanwhile.
"""

from __future__ import annotations

import ctypes
import gc
import threading
from collections.abc import Callable
from functools import cache
from pathlib import Path

# For glibc's `mallopt`, by the numbers of its header: bytes from which on an allocation is mapped on its own, and goes
# back when it is freed; and how many arenas the threads share. Left to itself, a server that takes thousands of uploads
# grows by a hundred MB, most of it free, between little that is not.
M_MMAP_THRESHOLD, MAPPED_FROM = -3, 1 << 20
M_ARENA_MAX, ARENAS = -8, 2
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


def hold_less() -> None:
    """Let little of what is freed stay with the C library: for a process that goes on for weeks, before its threads."""
    set_option = _glibc("mallopt", ctypes.c_int, ctypes.c_int)
    set_option(M_MMAP_THRESHOLD, MAPPED_FROM)
    set_option(M_ARENA_MAX, ARENAS)


def keep_for_good() -> None:
    """What there is now stays: no collection looks through it again, which takes a tenth of a second in which nothing
    else is done. For what is imported, before there is anything that can end."""
    gc.collect()
    gc.freeze()


def give_back() -> None:
    """Collect what is unreachable, and give free pages back to the system."""
    gc.collect()
    _glibc("malloc_trim", ctypes.c_size_t)(0)


@cache
def _glibc(name: str, *types: type) -> Callable[..., object]:
    """A function of glibc, which does without the interpreter's lock; elsewhere one that does nothing."""
    try:
        found = getattr(ctypes.CDLL(None), name)
    except (AttributeError, OSError, TypeError):  # another C library, or none that can be asked
        return lambda *_: None
    found.argtypes, found.restype = types, ctypes.c_int
    return found


def resident_bytes() -> int:
    """What this process has in memory; 0 where the system does not tell."""
    return _kilobytes(Path("/proc/self/status"), "VmRSS")


def free_bytes(root: Path = Path("/")) -> int | None:
    """What this process could take beside what it has: what the machine has available, and its container has left of
    its limit. None where the system tells neither."""
    available = _kilobytes(root / "proc/meminfo", "MemAvailable")
    found = [*([available] if available else []), *_left_in_cgroups(root)]
    return max(min(found), 0) if found else None


def _left_in_cgroups(root: Path) -> list[int]:
    """Of each memory limit that holds for this process, how much is not used. What the system has cached of files it
    gives up when memory is asked for."""
    found = []
    for line in _text(root / "proc/self/cgroup").splitlines():
        _, controllers, path = line.split(":", 2)
        if controllers == "":
            top, limit, usage, cached = "sys/fs/cgroup", "memory.max", "memory.current", "inactive_file"
        elif "memory" in controllers.split(","):
            top, limit, usage = "sys/fs/cgroup/memory", "memory.limit_in_bytes", "memory.usage_in_bytes"
            cached = "total_inactive_file"
        else:
            continue
        # within a container its own group is at the top, whatever it is called outside
        inner = Path(path.lstrip("/"))
        for group in {root / top / inner, *(root / top / parent for parent in inner.parents)}:
            most, used = _text(group / limit).strip(), _text(group / usage).strip()
            if most.isdigit() and used.isdigit():
                statistics = dict(line.split(" ", 1) for line in _text(group / "memory.stat").splitlines())
                found.append(int(most) - int(used) + int(statistics.get(cached, "0")))
    return found


def _kilobytes(path: Path, name: str) -> int:
    """The bytes of an entry such as `VmRSS:  1024 kB`; 0 where there is none."""
    for line in _text(path).splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1]) * 1024
    return 0


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="ascii", errors="replace")
    except OSError:
        return ""
