"""Who reads an uploaded file? A few warm processes that may crash, hang or run out of memory in the server's stead."""

from __future__ import annotations

import errno
import json
import logging
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from app.problems import HttpProblem
from app.uploads.forking import ENDED

# Files that a process reads before a fresh one takes its place, and the memory it may have needed for one of them.
MOST_FILES = 100
MOST_BYTES = 1 << 30
# Processes that stay when they have nothing to do.
MOST_IDLE = 2
# With the answer to an upload whose reader was killed.
LATER = {"Retry-After": "10"}
# Until a process that is killed is gone.
DYING_SECONDS = 10.0

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


class _Nursery:
    """The process `app.uploads.parse_worker`, started at once, which forks one for each connection once it is ready."""

    def __init__(self, memory: int, seconds: float) -> None:
        # one thread a process, or the stacks of idle ones eat up the memory it may take
        environment = {name: value for name, value in os.environ.items() if name in _ENVIRONMENT}
        environment |= {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMBA")}
        self._control, theirs = socket.socketpair()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "app.uploads.parse_worker", str(memory), str(seconds)],
                stdin=theirs.fileno(),
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env=environment,
                cwd=Path(__file__).resolve().parents[2],  # where `app` is found
                start_new_session=True,  # what ends the server by its group leaves the end of this to `end`
            )

    @property
    def alive(self) -> bool:
        return self._process.poll() is None

    @property
    def killed(self) -> bool:
        """Whether it was; asked once its end is known."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(1.0)
        return self._process.poll() == -signal.SIGKILL

    def connection(self) -> socket.socket:
        """One to a process of its own. Raises OSError where this one is gone."""
        ours, theirs = socket.socketpair()
        try:
            with theirs:
                socket.send_fds(self._control, [b"+"], [theirs.fileno()])
        except OSError:
            ours.close()
            raise
        return ours

    def end(self) -> None:
        """Whoever still reads for it goes on to the end of their file."""
        self._control.close()
        self._process.kill()
        self._process.wait()


class _Worker:
    """One process that reads files, ready some time after the nursery."""

    def __init__(self, nursery: _Nursery) -> None:
        self.nursery = nursery
        self.files = 0
        self.peak_bytes = 0
        self.pid: int | None = None  # once it is ready
        self._connection = nursery.connection()
        self._rest = b""

    @property
    def alive(self) -> bool:
        """What says nothing is; what is about to say that it is ready, too."""
        try:
            said = self._connection.recv(1 << 12, socket.MSG_PEEK | socket.MSG_DONTWAIT)
        except BlockingIOError:
            return True
        except OSError:
            return False
        return bool(said) and f'"{ENDED}"'.encode() not in said

    def wait_ready(self, deadline: float) -> None:
        """Raises _Gone or _Late."""
        if self.pid is None:
            self.pid = int(self._line(deadline)["pid"])

    def ask(self, job: Mapping[str, Any], deadline: float) -> dict[str, Any]:
        """The answer to `job`. Raises _Gone or _Late."""
        with suppress(OSError):  # of its end the next line tells
            self._connection.sendall(json.dumps(job).encode() + b"\n")
        self.files += 1
        return self._line(deadline)

    def end(self) -> None:
        """Kill it and everything it started; returns when it is gone."""
        if self.pid is not None and self.alive:
            with suppress(OSError):
                os.killpg(self.pid, signal.SIGKILL)
            with suppress(_Gone, _Late):
                while True:  # what it had still to say
                    self._line(time.monotonic() + DYING_SECONDS)
        self._connection.close()

    def _line(self, deadline: float) -> dict[str, Any]:
        ready = select.poll()  # not select(): a server with many clients has descriptors beyond its 1024
        ready.register(self._connection, select.POLLIN)
        received = [self._rest]
        while b"\n" not in received[-1]:
            left = deadline - time.monotonic()
            if left <= 0 or not ready.poll(left * 1000):
                raise _Late
            try:
                received.append(self._connection.recv(1 << 16))
            except OSError:
                received.append(b"")
            if not received[-1]:
                raise _Gone(self.nursery.killed)  # nobody is left to tell how it ended
        line, _, self._rest = b"".join(received).partition(b"\n")
        try:
            answer = dict(json.loads(line))
            if ENDED in answer:
                raise _Gone(answer[ENDED] == -signal.SIGKILL)
            self.peak_bytes = int(answer["peak_bytes"])
        except (ValueError, KeyError, TypeError) as error:
            raise _Gone from error
        return answer


class Parsers:
    """Processes that read uploads: kept warm, replaced once one has failed, grown or served long enough. Thread-safe.

    memory : bytes that a process may take; seconds : that reading one file may take
    """

    def __init__(self, memory: int, seconds: float) -> None:
        self._memory = memory
        self._seconds = seconds
        self._lock = threading.Lock()
        self._idle: list[_Worker] = []
        self._nursery: _Nursery | None = None
        self._closed = False

    def warm(self) -> None:
        """Have a process ready."""
        self._put_back(self._take())

    def close(self) -> None:
        """End every process that has nothing to do; the others end with their work."""
        with self._lock:
            self._closed = True
            idle, self._idle = self._idle, []
            nursery, self._nursery = self._nursery, None
        for worker in idle:
            worker.end()
        if nursery is not None:
            nursery.end()

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
            what = "look for in its scans" if job["kind"] == "regions" else "read"
            raise HttpProblem(
                422, f"'{path.name}' takes longer to {what} than the {self._seconds:g} s that an upload may"
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
            worker.nursery.end()
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
        while True:
            with self._lock:
                nursery = self._nursery
                if nursery is None or not nursery.alive:
                    if nursery is not None:
                        nursery.end()
                    nursery = self._nursery = _Nursery(self._memory, self._seconds)
            with suppress(OSError):  # where it was killed just now
                return _Worker(nursery)

    def _put_back(self, worker: _Worker) -> None:
        nursery = None
        with self._lock:
            kept = not self._closed and len(self._idle) < MOST_IDLE
            if kept:
                self._idle.append(worker)
            if self._closed:
                nursery, self._nursery = self._nursery, None
        if not kept:
            worker.end()
        if nursery is not None:
            nursery.end()
