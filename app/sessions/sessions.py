"""Which sessions are there? Makes them, finds them, takes them up after a restart, and lets a bounded number run.

An uploaded recording is found under its id as a session is, to be read; it is opened when it is first asked for.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Collection, Mapping
from dataclasses import asdict
from typing import Any

from app.problems import HttpProblem
from app.server_config import ServerConfig
from app.sessions.document import Document, criteria, prepare
from app.sessions.memory_room import MemoryRoom
from app.sessions.names import named
from app.sessions.open_recordings import OpenRecordings
from app.sessions.run_queue import RunQueue
from app.sessions.sample import DEMO, NAME, sample_document
from app.sessions.session import RECORDING, Session
from app.sessions.source import Source
from app.sessions.uploaded import UploadedRecording
from app.sessions.worker import share_interpreter
from app.store.idempotency import Call
from app.store.store import Store
from pmpnbp.errors import StorageError
from pmpnbp.scene.truth_file import check_truth
from pmpnbp.settings import SessionOptions

# A session as it is asked for, where nothing is said.
DEFAULTS: Mapping[str, Any] = {"name": None, "tags": [], **asdict(SessionOptions()), "config": {}, "truth": None}

_log = logging.getLogger("pmpnbp.server")


class Sessions:
    """All sessions of the store. Thread-safe."""

    def __init__(self, store: Store, config: ServerConfig) -> None:
        self._store = store
        self._config = config
        self._slots = RunQueue(config.max_running)
        self._room = MemoryRoom(config.max_memory_bytes or None, config.max_running)
        share_interpreter()
        self._lock = threading.Lock()
        self._sessions: dict[str, Session] = {}
        self._recordings = OpenRecordings(store)
        self._coming = 0
        self._closed = False

    def restore(self) -> None:
        """Take up every session of the store: paused where its recording ends, or failed where it is damaged."""
        for id, document in self._store.sessions():
            if document:  # older servers kept ids that were given twice, and looked at each scan once
                document = named(document, self._store)
                document["scan_ids"] = list(dict.fromkeys(document.get("scan_ids") or ()))
            document = document or {"id": id}
            session = Session(id, self._store, document, self._slots, self._room)
            session.recover()
            with self._lock:
                self._sessions[id] = session

    def create(self, body: Mapping[str, Any], call: Call | None = None) -> Session:
        """A new session at iteration 0.

        body : `model_id`, `scan_ids` and what DEFAULTS has, which stands for what is left out; of one of the samples
        also which `sample` it is; call : to which the session's status is the answer. Raises PmpnbpError for what does
        not fit together; HttpProblem 404 for a model or scan that is not here, 429 for one session too many, 507 for
        one that does not fit into memory.
        """
        unknown = set(body) - set(DEFAULTS) - {"model_id", "scan_ids", "sample"}
        if unknown:
            raise HttpProblem(422, f"a session has no {', '.join(sorted(unknown))}")
        document: Document = {**DEFAULTS, **body, "changes": [], "events": 1}
        with self._lock:
            if self._closed:
                raise HttpProblem(503, "the server is stopping")
            if len(self._sessions) + self._coming >= self._config.max_sessions:
                raise HttpProblem(
                    429,
                    f"{_there(len(self._sessions))}, which is the most that is kept (max_sessions); delete one first",
                    headers={"Retry-After": "60"},
                )
            self._coming += 1
        try:
            return self._create(document, call)
        finally:
            with self._lock:
                self._coming -= 1

    @property
    def closed(self) -> bool:
        """Whether the server is stopping."""
        return self._closed

    def at_hand(self, id: str) -> Source | None:
        """What `get` gives, where that needs no reading; else None."""
        return self._sessions.get(id) or self._recordings.at_hand(id)

    def get(self, id: str) -> Source:
        """A session, or an uploaded recording as one. HttpProblem 404."""
        with self._lock:
            session = self._sessions.get(id)
            count = len(self._sessions)
        if session is not None:
            return session
        recorded = self._recordings.get(id)
        if recorded is None:
            raise HttpProblem(404, f"session '{id:.40}' is not here; {_there(count)}")
        return recorded

    def session(self, id: str) -> Session:
        """A session that can be told what to do. HttpProblem 404, and 409 for a recording."""
        found = self.get(id)
        if isinstance(found, UploadedRecording):
            raise found.cannot_iterate()
        assert isinstance(found, Session)
        return found

    def rename_recording(self, id: str, name: str) -> Document:
        """Call an uploaded recording something else; its entry's document. HttpProblem 404, StorageError."""
        return self._recordings.rename(id, name)

    def forget_recording(self, id: str) -> None:
        """An uploaded recording is no longer there: end its event streams."""
        self._recordings.forget(id)

    def list(self, tags: Collection[str] = ()) -> list[dict[str, Any]]:
        """What REST shows of each session that has all of `tags`, oldest first."""
        with self._lock:
            sessions = [*self._sessions.values()]
        return [status for session in sessions if set(tags) <= {*(status := session.status())["tags"]}]

    def delete(self, id: str) -> None:
        """Stop and forget a session, with its recording. HttpProblem 404, and 409 for an uploaded recording."""
        session = self.session(id)
        session.close()
        with self._lock:
            if self._sessions.pop(id, None) is None:
                return  # another call was faster
        self._room.release(id)
        self._store.delete("sessions", id)

    def close(self) -> None:
        """Pause and keep every session, and end the event streams. A second call does nothing."""
        with self._lock:
            self._closed = True
            sessions = [*self._sessions.values()]
        self._recordings.close()
        threads = [threading.Thread(target=session.close) for session in sessions]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    def demo(self) -> Session | None:
        """Make, or find, the sample session, and run it; None where it cannot be made, as on a full disk."""
        found = self._demo()
        if found is None:
            try:
                found = self.sample(DEMO)
            except (HttpProblem, StorageError) as problem:
                _log.warning("no sample session is opened: %s", problem)
                return None
        status = found.status()
        if status["state"] == "paused" and not status["converged"]:
            found.run(until="converged")
        return found

    def _demo(self) -> Session | None:
        """The sample session, whatever it is called by now; one that an older server made is known by its name."""
        documents = [(id, document or {}) for id, document in self._store.sessions()]
        known = [id for id, document in documents if document.get("sample") == DEMO or document.get("name") == NAME]
        with self._lock:
            return next((self._sessions[id] for id in known if id in self._sessions), None)

    def sample(self, scene: str, call: Call | None = None) -> Session:
        """A new session at iteration 0 that looks at a scene of `sample.SAMPLES`. call : that it is the answer to"""
        return self.create(sample_document(self._store, scene), call)

    def _create(self, document: Document, call: Call | None) -> Session:
        document = named(document, self._store)
        with self._store.session_draft(document) as draft:
            problem, inputs = prepare(self._store, document)  # what it is made of cannot be deleted meanwhile
            if (truth := criteria(document).truth) is not None:
                check_truth(truth, problem.mrf.model)
            id = draft["id"]
            try:
                self._room.claim(id, problem)
                session = Session(id, self._store, draft, self._slots, self._room)
                session.begin(problem, inputs)
                self._store.land_session(id, session.status(), call)
            except BaseException:
                self._room.release(id)
                raise
        session.archive.moved(self._store.session_folder(id) / RECORDING)
        with self._lock:
            self._sessions[session.id] = session
        return session


def _there(count: int) -> str:
    """How many sessions there are, in words."""
    return "there is 1 session" if count == 1 else f"there are {count} sessions"
