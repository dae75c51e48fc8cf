"""What can views share? The points of a scan, the stage of a problem, and the frame of an iteration in one state.

Each is made once, by the view that needs it first, and lives as long as any view holds it. While a session runs, views
that are drawn at about the same time take the same iteration, so that their frames are one.
"""

from __future__ import annotations

import threading
import time
import weakref
from collections.abc import Callable, Hashable
from typing import Generic, TypeVar

from app.sessions.source import Source
from app.viewer.scan_points import ScanPoints, scan_points
from app.viewer.scene_frame import SceneFrame
from app.viewer.stage import Stage, stage
from pmpnbp.readout.snapshot import Snapshot

Value = TypeVar("Value")


class Shared(Generic[Value]):
    """Values by key, each as long as anybody else holds it. Thread-safe; who asks for one that is being made waits."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._values: weakref.WeakValueDictionary[Hashable, Value] = weakref.WeakValueDictionary()
        self._making: dict[Hashable, threading.Lock] = {}

    def get(self, key: Hashable, make: Callable[[], Value]) -> Value:
        """The value of that key, made where there is none. Raises what `make` does."""
        with self._lock:
            value = self._values.get(key)
            making = self._making.setdefault(key, threading.Lock())
        if value is not None:
            return value
        with making:
            try:
                with self._lock:
                    value = self._values.get(key)
                if value is None:
                    value = make()
                with self._lock:
                    self._values[key] = value
                return value
            finally:
                with self._lock:
                    self._making.pop(key, None)


class Scenery:
    """What the views of one server share. Thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._newest: weakref.WeakKeyDictionary[Source, tuple[float, weakref.ref[Snapshot]]] = (
            weakref.WeakKeyDictionary()
        )
        self._points: Shared[ScanPoints] = Shared()
        self._stages: Shared[Stage] = Shared()
        self._frames: Shared[SceneFrame] = Shared()

    def snapshot(self, source: Source, iteration: int | None, seconds: float) -> Snapshot:
        """An iteration; the newest where there are not so many, as after a reset.

        seconds : for which the newest iteration of a running session stands for the newest one
        """
        newest = self._newest_of(source, seconds)
        if iteration is None or iteration >= newest.iteration:
            return newest
        return source.archive.read(iteration)

    def stage(self, source: Source, snapshot: Snapshot, scans: int) -> Stage:
        """The stage of an iteration, with so many of its scans."""
        problem = snapshot.problem

        def make() -> Stage:
            return stage(problem, tuple(self._scan(source, view, snapshot.iteration) for view in range(scans)))

        # a stage holds its problem, so that no other one can have its id
        return self._stages.get((source.id, id(problem), scans), make)

    def frame(self, key: Hashable, make: Callable[[], SceneFrame]) -> SceneFrame:
        """The frame of that key, which says all that it is made of."""
        return self._frames.get(key, make)

    def _newest_of(self, source: Source, seconds: float) -> Snapshot:
        now = time.monotonic()
        if not source.idle:
            with self._lock:
                at, known = self._newest.get(source, (0.0, None))
            snapshot = None if known is None or now - at > seconds else known()
            if snapshot is not None and snapshot.iteration <= source.archive.iteration:  # else it was reset since
                return snapshot
        snapshot = source.archive.read()
        with self._lock:
            self._newest[source] = now, weakref.ref(snapshot)
        return snapshot

    def _scan(self, source: Source, view: int, iteration: int) -> ScanPoints:
        name, scan = source.scan(view, iteration)
        return self._points.get(name, lambda: scan_points(scan))
