"""A session's life: commands wait in a queue, one thread works them off and iterates, and the newest snapshot is there
to be read at any time without waiting for it.

The thread lives while there is work. What it makes is in the recording before anybody hears of it, so a session goes on
after a kill from where it was heard of last, to the same numbers. The recording is what counts; the document beside it
only names what REST shows.
"""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from functools import partial
from typing import Any, TypeVar

from app.problems import HttpProblem
from app.schemas import Until
from app.sessions import document as documents
from app.sessions.document import Document
from app.sessions.events import Event, Events
from app.sessions.goal import Goal
from app.sessions.long_read_out import LongReadOut
from app.sessions.memory_room import MemoryRoom
from app.sessions.recorded_inference import RecordedInference
from app.sessions.run_queue import RunQueue
from app.sessions.source import Source, no_view
from app.sessions.trace_row import verdict
from app.sessions.worker import Worker
from app.store.store import Store
from pmpnbp.errors import PmpnbpError, RecordingError, StorageError
from pmpnbp.inference.arrival import ScanMode
from pmpnbp.inference.problem import Problem
from pmpnbp.readout.snapshot import Snapshot
from pmpnbp.recording import Change, Inputs, IterationArchive
from pmpnbp.scene.common_scene import one_frame
from pmpnbp.scene.observation import Scan

Kind = TypeVar("Kind")

# Iterations after which a session lets one that waits have its slot.
TURN = 10
# In the session's folder.
RECORDING = "recording.sqlite"

_log = logging.getLogger("pmpnbp.server")


class Session(Source):
    """One session. `begin` or `recover` comes first; then any thread may call what is public."""

    kind = "session"

    def __init__(self, id: str, store: Store, document: Document, slots: RunQueue, room: MemoryRoom) -> None:
        first = int(document.get("events") or 1)
        self._store = store
        self._slots = slots
        self._room = room
        self._document = document
        remedy = "reset or delete" if document.get("model_id") else "delete"
        archive = IterationArchive(store.session_folder(id) / RECORDING, f"session '{id}'", remedy=remedy)
        super().__init__(id, Events(first, first, self._reserve), archive)
        self._lock = threading.RLock()
        self._worker = Worker(f"session-{id}", self._pursue_goal, archive.abandon, partial(slots.nudge, self))
        self._goal: Goal | None = None
        self.state = "paused"
        self.truth_known = document.get("truth") is not None
        self._error: str | None = None
        self._target: int = document.get("iterations") or 0
        self._until: Until = "iterations"
        self._announced: tuple[object, ...] = ()
        # of the thread alone
        self._long_read_out = LongReadOut(lambda: self._worker.awaited, self._tell)
        self._inference = RecordedInference(archive, self.events.number, self._announce, self._long_read_out)
        self._turn = 0

    def begin(self, problem: Problem, inputs: Inputs) -> None:
        """Make iteration 0 and a recording that begins with it."""
        self._inference.begin(problem, inputs, documents.criteria(self._document))
        with self._lock:
            self._error, self._target = None, int(self._document.get("iterations") or 0)

    def recover(self) -> None:
        """Take up what the recording has, after a restart. Where it is damaged the session is there, as failed."""
        try:
            if not self._document.get("model_id"):
                raise RecordingError("its session.json is damaged")
            changes = self.archive.open(documents.criteria(self._document))
            self._document["changes"] = [json.loads(change.note) for change in changes]
        except (PmpnbpError, OSError, ValueError) as error:
            self.archive.damage = self._error = str(error)
            self.state = "failed"

    # What it is asked for

    def run(self, iterations: int | None = None, until: Until = "iterations") -> None:
        """Iterate in the background: `iterations` more, or, without it, up to the session's own number of them (that
        many more where it has made them); less where `until` comes true before. HttpProblem 409."""
        own = int(self._document.get("iterations") or 0)
        at = self.archive.iteration
        if iterations is None:
            iterations = own - at if at < own else own
        self._set_goal(Goal(at + iterations, until, verdict=True))

    def step(self, iterations: int = 1) -> Future[None]:
        """Iterate so many times; the future is done after the last. HttpProblem 409, also through the future."""
        self._set_goal(goal := Goal(self.archive.iteration + iterations, "iterations"))
        return goal.done

    def pause(self) -> Future[None]:
        """Stop after the present iteration, or before it where it is being read out; done once all is recorded."""
        return self._submit(self._pause)

    def reset(self, members: Mapping[str, Any] | None = None) -> Future[None]:
        """Begin anew with the settings and scans now in force, and other `members` of its document; the old recording
        goes. The future may raise PmpnbpError, or HttpProblem 507, and then nothing has changed."""
        return self._submit(partial(self._reset, dict(members or {})))

    def change(self, config: Mapping[str, Any], labels: Mapping[str, Any] | None = None) -> Future[None]:
        """Other settings from the next iteration on, and with them, or not at all, what `label` takes. The future may
        raise SettingError, or HttpProblem 409 or 507."""
        return self._submit(partial(self._change, dict(config), dict(labels or {})))

    def label(self, labels: Mapping[str, Any]) -> None:
        """Another `name`, or other `tags`, at once: the inference knows nothing of them, so no iteration is waited for.
        HttpProblem 409, StorageError."""
        with self._lock:
            self._check_open()
            documents.check_whole(self._document)
            self._rewrite(labels)
            self._announced = ()
            self._worker.wake()  # it tells of it between two iterations, as numbers of events come in their order

    def add_scan(self, scan_id: str, mode: ScanMode) -> Future[None]:
        """Another scan from the next iteration on. The future may raise ScanError, or HttpProblem 404, 409, 507."""
        return self._submit(partial(self._add_scan, scan_id, mode))

    def close(self) -> None:
        """Stop after the present iteration, keep everything, end the event streams. A second call does nothing."""
        with self._lock:
            self.closed = True
        self.read_outs.close()
        self._worker.finish(self._pause)
        self._slots.leave(self)  # the last command's nudge may have come after its rest
        self.events.close()

    # What it tells

    def status(self) -> dict[str, Any]:
        """What REST shows of the session."""
        with self._lock:
            own = {"id": self.id, "kind": self.kind, "view_url": f"/sessions/{self.id}/"}
            return {**own, **self.progress(), **documents.shown(self._document)}

    def progress(self) -> dict[str, Any]:
        """The part of it that events tell of."""
        with self._lock:
            return {
                "name": self._document.get("name"),
                "state": self.state,
                "iteration": self.archive.row["iteration"],
                "iterations": self._target,
                "until": self._until,
                **verdict(self.archive.row, self.archive.changed_since()),
                "error": self._error,
                "position": self._slots.position(self) if self.state == "waiting" else None,
                "reading_out": self._long_read_out.underway,
            }

    def changes(self) -> list[dict[str, Any]]:
        """What was changed since it began."""
        with self._lock:
            return list(self._document.get("changes") or ())

    def scan(self, view: int, iteration: int | None = None) -> tuple[str, Scan]:
        """The id and the scan of a view. HttpProblem 404."""
        with self._lock:
            scans, _ = documents.present_scans(self._document, iteration)
        if view >= len(scans):
            raise no_view(self, view, len(scans))
        return scans[view], self._store.load_scan(scans[view])

    # The thread

    def _submit(self, action: Callable[[], Kind]) -> Future[Kind]:
        with self._lock:
            self._check_open()
            return self._worker.submit(action)

    def _check_open(self) -> None:
        if self.closed:
            raise HttpProblem(409, f"session '{self.id}' is closed")

    def _set_goal(self, goal: Goal) -> None:
        with self._lock:
            self._check_open()
            self.archive.check()
            if self._goal is not None:
                raise HttpProblem(409, f"session '{self.id}' is {self.state}; pause it first")
            self._goal, self._target, self._until, self._error = goal, goal.last, goal.until, None
            self.state = "running" if self._slots.take(self) else "waiting"
            self._worker.wake()

    def _pursue_goal(self) -> bool:
        goal = self._goal
        if goal is None:
            self._tell()
            return False
        try:
            self._pursue(goal)
        except Exception as error:  # whatever it is, the session keeps it and the server goes on
            self._fail(error)
        return True

    def _pursue(self, goal: Goal) -> None:
        """One iteration, or what keeps it from being made."""
        if goal.reached(self._inference.newest, self.archive.changed_since()):
            self._rest("paused")
        elif not self._slots.take(self):
            self._tell("waiting")
            self._slots.wait(self)
        else:
            self._tell("running")
            if self._inference.iteration % TURN == 0:
                documents.check_room(self._store)
            if not self._inference.advance(goal.last if goal.verdict else None):
                return
            self._turn += 1
            if goal.reached(self._inference.newest, changed=False):
                self._rest("paused")
            elif self._turn >= TURN and self._slots.others_wait():
                self.archive.flush()
                self._slots.leave(self)
                self._turn = 0

    def _announce(self, newest: Snapshot) -> None:
        self.events.publish(Event(newest.row["event"], "iteration", newest.row_text))

    def _rest(self, state: str) -> None:
        """Come to rest in `state`, with everything written."""
        self.archive.flush()
        with self._lock:
            goal, self._goal, self.state = self._goal, None, state
            self._slots.leave(self)
            self._turn = 0
        self._tell()
        if goal is not None:
            goal.done.set_result(None)

    def _fail(self, error: Exception) -> None:
        expected = isinstance(error, PmpnbpError | HttpProblem)
        _log.log(logging.WARNING if expected else logging.ERROR, "session %s failed", self.id, exc_info=not expected)
        self.archive.abandon()
        self._inference.forget()
        at = self.archive.iteration
        sentence = str(error) if expected else f"iteration {at + 1} could not be made: {type(error).__name__}: {error}"
        with self._lock:
            goal, self._goal, self.state, self._error = self._goal, None, "failed", sentence
            self._slots.leave(self)
            self._turn = 0
        self._tell()
        self._publish("error", {"error": sentence, "iteration": at})
        if goal is not None:
            goal.done.set_exception(HttpProblem(409, f"session '{self.id}' is failed: {sentence}"))

    def _tell(self, state: str | None = None) -> None:
        """Be in `state`, where it is given, and say what is new of it."""
        with self._lock:
            self.state = state or self.state
            place, changes = self._slots.position(self), self.archive.changes
            reading = self._long_read_out.underway
            announced = (self.state, place, self._target, self._until, self._error, changes, reading)
            if announced == self._announced:
                return
            self._announced = announced
        self.archive.flush()  # an iteration has its number before it is announced, and would come out of turn
        self._publish("state", self.progress())

    def _reserve(self, limit: int) -> None:
        """Write down that numbers of events below `limit` may be used."""
        with self._lock:
            self._document["events"] = limit
            try:
                self._store.write_session(self.id, self._document)
            except (HttpProblem, StorageError):  # a full disk: clients may see numbers again after a restart
                _log.warning("session %s: the numbers of its events could not be written down", self.id)

    # Commands, in the thread

    def _pause(self) -> None:
        if self._goal is not None:
            try:
                self._rest("paused")
            except Exception as error:  # the last iterations could not be written
                self._fail(error)

    def _reset(self, members: dict[str, Any]) -> None:
        anew = {**members, **documents.folded(self._document)}
        problem, inputs = documents.prepare(self._store, {**self._document, **anew})
        self._room.claim(self.id, problem)
        self._pause()
        self.archive.abandon()
        self._rewrite(anew)
        self.begin(problem, inputs)
        self._announced = ()
        self._tell("paused")

    def _change(self, config: dict[str, Any], labels: dict[str, Any]) -> None:
        self.archive.check()
        now = documents.present_config(self._document)
        settings = documents.settings_of(documents.fold(now, config))
        if settings == documents.settings_of(now):
            return self.label(labels)
        self._apply({"config": config}, {"settings": settings}, labels)

    def _add_scan(self, scan_id: str, mode: ScanMode) -> None:
        self.archive.check()
        if scan_id in documents.present_scans(self._document)[0]:
            raise HttpProblem(409, f"scan '{scan_id}' is in session '{self.id}' already")
        scan = self._store.load_scan(scan_id)
        one_frame((self._inference.newest.problem.observation.frame_id, scan.frame_id))
        self._apply({"scan_id": scan_id, "mode": mode}, {"scan": scan, "mode": mode})

    def _apply(self, entry: dict[str, Any], change: dict[str, Any], labels: Mapping[str, Any] | None = None) -> None:
        """Make a change after the iteration just made, in document and recording; nothing of it where it fails."""
        after = self.archive.next_change(self._inference.iteration)
        entry = {"after_iteration": after, **entry}
        new = {"changes": [*self.changes(), entry], **(labels or {})}
        problem, _ = documents.prepare(self._store, {**self._document, **new})
        self._room.claim(self.id, problem)
        old = self._rewrite(new)
        try:
            self.archive.change(Change(after, note=json.dumps(entry), **change), problem)
        except (HttpProblem, RecordingError) as error:
            self._rewrite(old)
            self._fail(error)
            raise
        self._tell()

    def _rewrite(self, members: Mapping[str, Any]) -> Document:
        """Write the document with other `members`, and what they were before. Always from the present one: names and
        tags come from other threads, settings and scans from the session's own."""
        with self._lock:
            old = {name: self._document.get(name) for name in members}
            new = {**self._document, **members}
            self._store.write_session(self.id, new)
            self._document = new
        return old
