"""Was this call made before? Answers of calls that carried an `Idempotency-Key`, kept for a day and over restarts.

What a call makes and its answer land in one step: the answer is a file in the entry's folder. It moves to the folder of
answers when the entry is deleted, so that the call is not made again then either.

A command makes no entry, and what it does cannot land in one step with its answer. That it begins is written down
before, and its answer takes the place of that. Where the server was killed in between, the same call is not done again,
but told that nobody knows.
"""

from __future__ import annotations

import hashlib
import logging
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from app.problems import HttpProblem
from app.store.atomic_files import read_json, replace_json, sync
from pmpnbp.errors import StorageError

KEEP_SECONDS = 24 * 3600.0
MOST = 10_000
LONGEST_KEY = 255
# In the folder of an entry that a call with a key has made.
ANSWER = "answer.json"
# Seconds after which it is worth asking again what became of a call that is at work.
_AT_WORK = {"Retry-After": "1"}

_log = logging.getLogger("pmpnbp.server")


@dataclass(frozen=True)
class Call:
    """A call that carried a key. name : made of the key, fit to be a file's; fingerprint : of its content."""

    name: str
    fingerprint: str

    def answered(self, response: Mapping[str, Any] | None) -> dict[str, Any]:
        """What is to lie beside the entry that the call has made, as ANSWER; of a command None, while it is at work."""
        return {"call": self.name, "fingerprint": self.fingerprint, "response": response}


class IdempotencyKeys:
    """Answers by key, a file each. Thread-safe.

    folder : for answers whose entries are deleted; beside : answers that lie beside entries, at the start
    """

    def __init__(self, folder: Path, beside: Iterable[Path] = (), now: Callable[[], float] = time.time) -> None:
        self._folder = folder
        self._now = now
        self._lock = threading.Lock()
        self._busy: set[str] = set()
        folder.mkdir(exist_ok=True)
        for left in folder.glob("*.partial"):
            left.unlink()
        found = [(path.stat().st_mtime, path.stem, path) for path in folder.glob("*.json")]
        for path in beside:
            answer = read_json(path)
            if answer is not None and isinstance(answer.get("call"), str):
                found.append((path.stat().st_mtime, answer["call"], path))
        # by name when it was given, and where it lies; oldest first
        self._kept = {name: (at, path) for at, name, path in sorted(found)}
        self._prune()

    def once(self, key: str | None, fingerprint: str, make: Callable[[Call | None], dict[str, Any]]) -> dict[str, Any]:
        """What `make` returns; or, where a call with this key and content was made, its answer.

        key : from `call_key`; without one `make` is always called
        make : called with what it has to let land beside the entry that it makes, and to tell of by `landed`

        Raises HttpProblem 422 where the key came with other content, 409 while the first call with it is still at work,
        and where it was a command at whose work the server was killed; an error of `make` is not remembered.
        """
        if key is None:
            return make(None)
        call = Call(hashlib.sha256(key.encode("utf-8", "surrogatepass")).hexdigest(), fingerprint)
        with self._alone(call):
            known = self._remembered(call)
            if known is None:
                return make(call)
        if known[0] != fingerprint:
            raise HttpProblem(422, "the Idempotency-Key was used for a call with other content; take a new one")
        if known[1] is None:
            raise HttpProblem(
                409, "the server stopped while it did this; whether it was done is not known, so see how things stand"
            )
        return known[1]

    def command(self, call: Call | None, act: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """What `act` answers to `call`, which makes no entry; to be called within `once`. Raises StorageError where it
        cannot be written down that it begins: then nothing was done."""
        if call is None:
            return act()
        self._write(call, None)
        try:
            response = act()
        except BaseException:
            with self._lock:
                self._kept.pop(call.name, None)
                self._place(call).unlink(missing_ok=True)
            raise
        try:
            self._write(call, response)
        except StorageError as error:  # it is done; the same call again is told that nobody knows
            _log.warning("the answer to a call with an Idempotency-Key is not kept: %s", error)
        return response

    def landed(self, call: Call | None, entry: Path) -> None:
        """The folder `entry` has landed, with the answer to `call`, where there is one."""
        if call is not None:
            with self._lock:
                self._kept.pop(call.name, None)
                self._kept[call.name] = self._now(), entry / ANSWER
                self._prune()

    def keep(self, entry: Path) -> None:
        """The folder `entry` is about to be deleted: keep the answer to the call that made it."""
        answer = read_json(entry / ANSWER)
        if answer is None or not isinstance(answer.get("call"), str):
            return
        with self._lock:
            at, path = self._kept.get(answer["call"], (0.0, None))
            if path == entry / ANSWER:
                place = self._folder / f"{answer['call']}.json"
                os.replace(path, place)
                sync(self._folder)
                self._kept[answer["call"]] = at, place

    def _write(self, call: Call, response: dict[str, Any] | None) -> None:
        place = self._place(call)
        replace_json(place.with_suffix(".partial"), place, call.answered(response))
        with self._lock:
            self._kept.pop(call.name, None)
            self._kept[call.name] = self._now(), place
            self._prune()

    def _place(self, call: Call) -> Path:
        return self._folder / f"{call.name}.json"

    def _remembered(self, call: Call) -> tuple[str, dict[str, Any] | None] | None:
        """Fingerprint and answer of the call that carried the same key, or None where there was none within a day."""
        with self._lock:
            self._prune()
            if call.name not in self._kept:
                return None
            document = read_json(self._kept[call.name][1])
        return None if document is None else (document["fingerprint"], document["response"])

    @contextmanager
    def _alone(self, call: Call) -> Iterator[None]:
        with self._lock:
            if call.name in self._busy:
                raise HttpProblem(
                    409,
                    "a call with this Idempotency-Key is still at work; ask again when it is done",
                    headers=_AT_WORK,
                )
            self._busy.add(call.name)
        try:
            yield
        finally:
            with self._lock:
                self._busy.discard(call.name)

    def _prune(self) -> None:
        """Forget what is old, and the oldest where there are too many. Needs the lock."""
        for name, (at, path) in list(self._kept.items()):
            if len(self._kept) <= MOST and self._now() - at <= KEEP_SECONDS:
                break
            del self._kept[name]
            path.unlink(missing_ok=True)


def call_key(call: str, header: str | None) -> str | None:
    """The key of a call, as "POST /api/v1/models", with the header Idempotency-Key; None where it has none.

    Two calls may see the same header. Raises HttpProblem 422 where the header is none that can be kept.
    """
    if header is None:
        return None
    if not header or len(header) > LONGEST_KEY or not header.isprintable():
        raise HttpProblem(422, f"the Idempotency-Key is not 1 to {LONGEST_KEY} printable characters")
    return f"{call} {header}"
