"""Which uploaded recordings are open? Those that somebody looks at, and the last few that were asked for.

An open one keeps its model, its scans and connections to its file; there can be more in the store than there is room
for those.
"""

from __future__ import annotations

import threading
import weakref

from cachetools import LRUCache

from app.problems import HttpProblem
from app.sessions.uploaded import UploadedRecording
from app.store.store import Document, Store

# Recordings kept open that nobody looks at.
KEPT = 8


class OpenRecordings:
    """Those of the store. Thread-safe."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._lock = threading.Lock()
        self._open: weakref.WeakValueDictionary[str, UploadedRecording] = weakref.WeakValueDictionary()
        self._kept: LRUCache[str, UploadedRecording] = LRUCache(KEPT)
        # of each that is being opened or closed: one does not wait for another
        self._turns: weakref.WeakValueDictionary[str, threading.Lock] = weakref.WeakValueDictionary()
        self._closed = False

    def at_hand(self, id: str) -> UploadedRecording | None:
        """The recording of that id, where it is open."""
        with self._lock:
            found = self._open.get(id)
            if found is not None:
                self._kept[id] = found
            return found

    def get(self, id: str) -> UploadedRecording | None:
        """The same, opened where it is not yet; None where it is not in the store."""
        found = self.at_hand(id)
        if found is not None:
            return found
        with self._turn(id):
            found = self.at_hand(id)
            if found is not None or self._closed:
                return found
            try:
                path, document = self._store.file("recordings", id), self._store.document("recordings", id)
                found = UploadedRecording(id, path, document)
                # the file's connections end with the recording, whoever lets go of it last
                weakref.finalize(found, found.archive.close)
                # deleted meanwhile it is no longer there, and not damaged
                self._store.document("recordings", id)
            except HttpProblem:
                return None
            with self._lock:
                self._open[id] = self._kept[id] = found
            return found

    def rename(self, id: str, name: str) -> Document:
        """Call it something else, also where it is open; its document in the store. HttpProblem 404, StorageError."""
        with self._turn(id):
            document = self._store.rename_recording(id, name)
            found = self.at_hand(id)
            if found is not None:
                found.call(name)
        return document

    def forget(self, id: str) -> None:
        """It is no longer there: end its event streams."""
        with self._turn(id):
            with self._lock:
                found = self._open.pop(id, None)
                self._kept.pop(id, None)
            if found is not None:
                found.close()

    def close(self) -> None:
        """End the event streams of all, and open none any more."""
        self._closed = True
        with self._lock:
            all_open = list(self._open.values())
        for recording in all_open:
            recording.close()

    def _turn(self, id: str) -> threading.Lock:
        with self._lock:
            turn = self._turns.get(id)
            if turn is None:
                turn = self._turns[id] = threading.Lock()
            return turn
