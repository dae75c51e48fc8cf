"""Who reads a recording next? Whoever comes takes an idle connection: opening one takes longer than most reads."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from pmpnbp.recording.array_shapes import ArrayShapes
from pmpnbp.recording.reader import Recording

# Idle connections kept for one recording; more than so many readers at once open their own.
IDLE = 2


class Readers:
    """Connections to the recording at `path`, which is from elsewhere where `foreign`. Thread-safe."""

    def __init__(self, path: Path, *, foreign: bool = False) -> None:
        self._path = path
        self._foreign = foreign
        self._shapes: ArrayShapes | None = None
        self._lock = threading.Lock()
        self._idle: list[Recording] = []
        self._generation = 0

    @contextmanager
    def recording(self) -> Iterator[Recording]:
        """The recording, for one thread as long as the context lasts. Raises RecordingError where it is none."""
        with self._lock:
            generation = self._generation
            recording = self._idle.pop() if self._idle else None
        recording = recording or self._opened()
        kept = False
        try:
            yield recording
            with self._lock:
                kept = generation == self._generation and len(self._idle) < IDLE
                if kept:
                    self._idle.append(recording)
        finally:
            if not kept:
                recording.close()

    def _opened(self) -> Recording:
        recording = Recording(self._path)
        if self._foreign:
            try:
                self._shapes = recording.distrust(self._shapes)
            except BaseException:
                recording.close()
                raise
        return recording

    def close(self) -> None:
        """Close what is idle, and what is in use once it is no longer: the file is replaced, or its log folded in."""
        with self._lock:
            self._generation += 1
            idle, self._idle = self._idle, []
        for recording in idle:
            recording.close()
