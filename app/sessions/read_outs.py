"""Who asks for a posterior where the inference is not at rest? It is read out beside the inference, one at a time of a
session, once for all who ask for it, and only as long as one of them waits.
"""

from __future__ import annotations

import threading
from concurrent.futures import Future
from functools import partial

from cachetools import LRUCache

from app.problems import HttpProblem
from app.sessions.worker import Worker
from pmpnbp.readout.snapshot import Snapshot

# Iterations kept with their posterior.
KEPT = 4

# Those who wait for one iteration.
Waiting = list[Future[Snapshot]]


class _Unwanted(Exception):
    """Nobody waits for it any more."""


class ReadOuts:
    """Those of one session, or recording, which errors call `name`. Thread-safe."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._worker = Worker(f"read-out of {name}")
        self._lock = threading.Lock()
        # both by the number of the iteration's event, which no other iteration has after a reset either
        self._waiting: dict[int, Waiting] = {}
        self._known: LRUCache[int, Snapshot] = LRUCache(KEPT)
        self._closed = False

    def ask(self, snapshot: Snapshot) -> Future[Snapshot]:
        """The same with its posterior, as `Snapshot.read_out` gives it. Who no longer waits for it cancels the future.
        HttpProblem 409, also through the future, when it is closed."""
        future: Future[Snapshot] = Future()
        if snapshot.placed.posterior is not None or snapshot.report.searching:
            future.set_result(snapshot)
            return future
        event = snapshot.row["event"]
        with self._lock:
            if self._closed:
                raise self._ended()
            known = self._known.get(event)
            if known is not None:
                future.set_result(known)
            elif event in self._waiting:
                self._waiting[event].append(future)
            else:
                self._waiting[event] = [future]
                self._worker.submit(partial(self._read_out, snapshot, self._waiting[event]))
        return future

    def close(self) -> None:
        """End what is being read out; return when it has ended. A second call does nothing."""
        with self._lock:
            self._closed = True
            waiting = [future for futures in self._waiting.values() for future in futures]
            self._waiting.clear()
            for future in waiting:
                _settle(future, self._ended())
        self._worker.finish(lambda: None)

    def _ended(self) -> HttpProblem:
        return HttpProblem(409, f"{self._name} is closed")

    # The thread

    def _read_out(self, snapshot: Snapshot, waiting: Waiting) -> None:
        event = snapshot.row["event"]

        def checkpoint() -> None:
            with self._lock:
                if all(future.done() for future in waiting):
                    self._forget(event, waiting)  # who asks from now on does not join those who left
                    raise _Unwanted

        found: Snapshot | Exception
        try:
            checkpoint()
            found = snapshot.read_out(checkpoint)
        except _Unwanted:
            return
        except Exception as error:  # told to those who wait for it
            found = error
        with self._lock:
            self._forget(event, waiting)
            if isinstance(found, Snapshot):
                self._known[event] = found
            for future in waiting:
                _settle(future, found)

    def _forget(self, event: int, waiting: Waiting) -> None:
        if self._waiting.get(event) is waiting:
            del self._waiting[event]


def _settle(future: Future[Snapshot], found: Snapshot | Exception) -> None:
    """Tell one who waits, where they still do."""
    if future.done() or not future.set_running_or_notify_cancel():
        return
    if isinstance(found, Snapshot):
        future.set_result(found)
    else:
        future.set_exception(found)
