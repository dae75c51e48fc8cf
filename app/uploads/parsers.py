"""Who reads an uploaded file? A few warm processes that may crash, hang or run out of memory in the server's stead."""

from __future__ import annotations

import errno
import json
import logging
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from app.problems import HttpProblem

# Files that a process reads before a fresh one takes its place, and the memory it may have needed for one of them.
MOST_FILES = 100
MOST_BYTES = 1 << 30
# Processes that stay when they have nothing to do.
MOST_IDLE = 2
# With the answer to an upload whose reader was killed.
LATER = {"Retry-After": "10"}

# What Python and its libraries need of the environment, and what says which instructions the numbers come from, which
# have to be the server's; it may hold secrets that are no upload's business.
_ENVIRONMENT = frozenset(
    {
        "PATH",
        "HOME",
        "LANG",
        "LC_ALL",
        "LC_CTYPE",
        "TZ",
        "LD_LIBRARY_PATH",
        "DYLD_LIBRARY_PATH",
        "VIRTUAL_ENV",
        "PYTHONHOME",
        "PYTHONPATH",
        "PYTHONUTF8",
        "PYTHONDONTWRITEBYTECODE",
        "XDG_CACHE_HOME",
        "NUMBA_CACHE_DIR",
        "NUMBA_CPU_NAME",
        "NUMBA_CPU_FEATURES",
        "NPY_DISABLE_CPU_FEATURES",
        "OPENBLAS_CORETYPE",
        "GLIBC_TUNABLES",
    }
)

_log = logging.getLogger("pmpnbp.server")


class _Gone(Exception):
    """The process ended, or said what no worker says. killed : by whoever may, as the system without memory does."""

    def __init__(self, killed: bool = False) -> None:
        super().__init__()
        self.killed = killed


class _Late(Exception):
    """The process did not answer in time."""


class _Worker:
    """One `app.uploads.parse_worker`, started at once, ready some time after."""

    def __init__(self, memory: int, seconds: float) -> None:
        self.files = 0
        self.peak_bytes = 0
        self._ready = False
        self._rest = b""
        # one thread a process, or the stacks of idle ones eat up the memory it may take
        environment = {name: value for name, value in os.environ.items() if name in _ENVIRONMENT}
        environment |= {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
        self._process = subprocess.Popen(
            [sys.executable, "-m", "app.uploads.parse_worker", str(memory), str(seconds)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            bufsize=0,
            env=environment,
            cwd=Path(__file__).resolve().parents[2],  # where `app` is found
            start_new_session=True,  # a group of its own, so that it can be killed with its children
        )

    @property
    def alive(self) -> bool:
        return self._process.poll() is None

    def wait_ready(self, deadline: float) -> None:
        """Raises _Gone or _Late."""
        if not self._ready:
            self._line(deadline)
            self._ready = True

    def ask(self, job: Mapping[str, Any], deadline: float) -> dict[str, Any]:
        """The answer to `job`. Raises _Gone or _Late."""
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(json.dumps(job).encode() + b"\n")
        except OSError as error:
            raise self._gone() from error
        self.files += 1
        return self._line(deadline)

    def end(self) -> None:
        """Kill it and everything it started."""
        with suppress(OSError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()

    def _line(self, deadline: float) -> dict[str, Any]:
        assert self._process.stdout is not None
        descriptor = self._process.stdout.fileno()
        ready = select.poll()  # not select(): a server with many clients has descriptors beyond its 1024
        ready.register(descriptor, select.POLLIN)
        received = [self._rest]
        while b"\n" not in received[-1]:
            left = deadline - time.monotonic()
            if left <= 0 or not ready.poll(left * 1000):
                raise _Late
            received.append(os.read(descriptor, 1 << 16))
            if not received[-1]:
                raise self._gone()
        line, _, self._rest = b"".join(received).partition(b"\n")
        try:
            answer = json.loads(line)
            self.peak_bytes = int(answer["peak_bytes"])
        except (ValueError, KeyError, TypeError) as error:
            raise _Gone from error
        return dict(answer)

    def _gone(self) -> _Gone:
        with suppress(subprocess.TimeoutExpired):  # its output has ended, so it is about to
            self._process.wait(1.0)
        return _Gone(self._process.poll() == -signal.SIGKILL)


class Parsers:
    """Processes that read uploads: kept warm, replaced once one has failed, grown or served long enough. Thread-safe.

    memory : bytes that a process may take; seconds : that reading one file may take
    """

    def __init__(self, memory: int, seconds: float) -> None:
        self._memory = memory
        self._seconds = seconds
        self._lock = threading.Lock()
        self._idle: list[_Worker] = []
        self._closed = False

    def warm(self) -> None:
        """Have a process ready."""
        self._put_back(self._take())

    def close(self) -> None:
        """End every process that has nothing to do; the others end with their work."""
        with self._lock:
            self._closed = True
            idle, self._idle = self._idle, []
        for worker in idle:
            worker.end()

    def parse(self, kind: str, path: Path, out: Path, camera: Path | None = None) -> dict[str, Any]:
        """What is in the file `path`, as `app.uploads.parse_worker` tells it; a scan, with its `camera`, goes to `out`.

        Raises HttpProblem 422 with the reader's sentence, or where it crashed or took too long; 503 where it was killed
        twice; 507 on a full disk.
        """
        return self._summary(
            {"kind": kind, "path": str(path), "camera": None if camera is None else str(camera), "out": str(out)}, path
        )

    def regions(self, model: Path, scans: Sequence[Path]) -> dict[str, Any]:
        """Where the model may stand in scans, all of them taken in, as `app.uploads.summaries` tells it; likewise."""
        return self._summary({"kind": "regions", "path": str(model), "scans": [str(path) for path in scans]}, model)

    def _summary(self, job: Mapping[str, Any], path: Path) -> dict[str, Any]:
        try:
            answer = self._ask(job, path)
        except _Gone as gone:
            if not gone.killed:  # a signal of its own: a crash, or its limit of processor time
                raise HttpProblem(422, f"'{path.name}' cannot be read: it made its reader crash") from None
            try:
                answer = self._ask(job, path)
            except _Gone:
                raise HttpProblem(
                    503, f"the process that reads '{path.name}' was killed twice; send it again later", headers=LATER
                ) from None
        if "unexpected" in answer:
            _log.warning("reading %s failed unexpectedly: %s", job["kind"], answer["unexpected"])
        if "error" in answer:
            full = os.strerror(errno.ENOSPC) in answer["error"]
            raise HttpProblem(507 if full else 422, answer["error"])
        return dict(answer["summary"])

    def _ask(self, job: Mapping[str, Any], path: Path) -> dict[str, Any]:
        """What a process answers to `job`. Raises _Gone; HttpProblem 422 where it takes too long."""
        worker, answer = self._take(), None
        try:
            self._get_ready(worker)
            answer = worker.ask(job, time.monotonic() + self._seconds)
            return answer
        except _Late:
            raise HttpProblem(
                422, f"'{path.name}' takes longer to read than the {self._seconds:g} s that an upload may"
            ) from None
        except _Gone:
            _log.warning("the process that reads %s ended at an upload of %s bytes", job["kind"], path.stat().st_size)
            raise
        finally:
            if answer is None or "unexpected" in answer or worker.files >= MOST_FILES or worker.peak_bytes > MOST_BYTES:
                worker.end()
                worker = self._start()
            self._put_back(worker)

    def _get_ready(self, worker: _Worker) -> None:
        # its imports are none of the upload's business, nor of its time
        try:
            worker.wait_ready(time.monotonic() + 60.0)
        except (_Gone, _Late) as error:
            if isinstance(error, _Gone) and error.killed:
                raise
            raise HttpProblem(
                500, f"the process that reads uploads does not start within {self._memory >> 20} MiB of memory"
            ) from None

    def _take(self) -> _Worker:
        with self._lock:
            while self._idle:
                worker = self._idle.pop()
                if worker.alive:
                    return worker
                worker.end()
        return self._start()

    def _start(self) -> _Worker:
        return _Worker(self._memory, self._seconds)

    def _put_back(self, worker: _Worker) -> None:
        with self._lock:
            if not self._closed and len(self._idle) < MOST_IDLE:
                self._idle.append(worker)
                return
        worker.end()
