"""What an attack does to everybody else: is another caller served, how late, and what memory does the server take?"""

from __future__ import annotations

import os
import re
import threading
import time
from collections import Counter
from pathlib import Path
from types import TracebackType

import httpx

from tests.app.attacks.target import OTHER, Target

MIB = 1 << 20
# What another caller asks for: that the server lives, and something of its store.
ASKED = ("/healthz", "/api/v1/scans")


class Watch:
    """A context in which another caller asks five times a second, on a new connection each time.

    calls : answers and errors, counted; slowest : seconds; before, peak : bytes of the server's process
    """

    def __init__(self, target: Target, patience: float = 30.0) -> None:
        self._target = target
        self._patience = patience
        self._end = threading.Event()
        self._threads = [threading.Thread(target=work, daemon=True) for work in (self._ask, self._measure)]
        self.calls: Counter[str] = Counter()
        self.slowest = 0.0
        self.before = self.peak = memory(target)
        self.log_before = log_size(target)

    def __enter__(self) -> Watch:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end.set()
        for thread in self._threads:
            thread.join()
        self.peak = max(self.peak, memory(self._target))

    @property
    def growth(self) -> int:
        """Of memory at its peak, bytes."""
        return self.peak - self.before

    @property
    def unserved(self) -> int:
        """Calls of the other caller that were not answered 200."""
        return sum(count for what, count in self.calls.items() if what != "200")

    def told(self) -> str:
        """All of it in a sentence."""
        calls = ", ".join(f"{count} × {what}" for what, count in self.calls.items()) or "none"
        text = (
            f"another caller's calls: {calls}, slowest {self.slowest:.2f} s; memory {self.before // MIB} MiB before, "
        )
        text += f"{self.peak // MIB} MiB at its peak"
        grown = log_size(self._target) - self.log_before
        return text + (f"; the log grew by {grown / 1000:.1f} kB" if self._target.log is not None else "")

    def _ask(self) -> None:
        number = 0
        while not self._end.wait(0.2):
            number += 1
            began = time.monotonic()
            try:
                with self._target.client(OTHER, self._patience) as client:
                    what = str(client.get(ASKED[number % len(ASKED)]).status_code)
            except httpx.HTTPError as error:
                what = type(error).__name__
            self.calls[what] += 1
            self.slowest = max(self.slowest, time.monotonic() - began)

    def _measure(self) -> None:
        # by the system often; by its own metrics seldom, as that is a call
        while not self._end.wait(0.02 if self._target.pid is not None else 0.5):
            self.peak = max(self.peak, memory(self._target))


def memory(target: Target) -> int:
    """Bytes of the server's process, by the system or else by its own metrics; 0 where neither tells."""
    if target.pid is not None:
        try:
            return int(Path(f"/proc/{target.pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
        except OSError:
            return 0
    try:
        with target.client(OTHER, 10.0) as client:
            found = re.search(r"^pmpnbp_resident_memory_bytes (\S+)$", client.get("/metrics").text, re.MULTILINE)
    except httpx.HTTPError:
        return 0
    return 0 if found is None else int(float(found[1]))


def settled_memory(target: Target, below: int, seconds: float) -> int:
    """The same once it is at most `below`, or else after so many seconds."""
    until = time.monotonic() + seconds
    while (found := memory(target)) > below and time.monotonic() < until:
        time.sleep(0.5)
    return found


def descriptors(target: Target) -> int | None:
    """Open files and sockets of the server's process; None where that cannot be known."""
    try:
        return None if target.pid is None else len(os.listdir(f"/proc/{target.pid}/fd"))
    except OSError:
        return None


def faults(target: Target, since: int = 0) -> Counter[str]:
    """What failed by the server's messages after the first `since` bytes: error, and where in our own code."""
    if target.log is None or not target.log.exists():
        return Counter()
    with target.log.open("rb") as file:
        file.seek(since)
        text = file.read(64 * MIB).decode("utf-8", "replace")
    found: Counter[str] = Counter()
    for trace in text.split("Traceback (most recent call last):")[1:]:
        # the end of a trace is the first line that is neither indented nor empty
        error = next((line for line in trace.splitlines()[1:] if line[:1].strip()), "")
        frames = re.findall(r'File "[^"]*?/((?:app|pmpnbp)/[^"]+)", line (\d+), in (\w+)', trace)
        place = "{}:{} in {}".format(*frames[-1]) if frames else "in a library"
        said = re.sub(r"/[^\s']+|[0-9a-f]{16}", "…", error)[:160]  # alike but for a path or an id
        found[f"{said} at {place}"] += 1
    return found


def log_size(target: Target) -> int:
    """Bytes of the server's messages; 0 where they are not known."""
    return target.log.stat().st_size if target.log is not None and target.log.exists() else 0
