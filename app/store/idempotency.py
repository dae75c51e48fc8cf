"""Was this call made before? Answers of calls that carried an `Idempotency-Key`, kept for a day and over restarts."""

from __future__ import annotations

import hashlib
import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from app.problems import HttpProblem
from app.store.atomic_files import read_json, replace_json
from pmpnbp.errors import DiskFullError

KEEP_SECONDS = 24 * 3600.0
MOST = 10_000
LONGEST_KEY = 255

_log = logging.getLogger("pmpnbp.server")


class IdempotencyKeys:
    """Answers by key, a file each. Thread-safe."""

    def __init__(self, folder: Path, incoming: Path, now: Callable[[], float] = time.time) -> None:
        self._folder = folder
        self._incoming = incoming
        self._now = now
        self._lock = threading.Lock()
        self._busy: set[str] = set()
        folder.mkdir(exist_ok=True)
        answers = sorted((path.stat().st_mtime, path.stem) for path in folder.glob("*.json"))
        self._kept = {name: at for at, name in answers}  # oldest first
        self._prune()

    def remember(self, key: str, fingerprint: str, response: dict[str, Any]) -> None:
        """Keep `response` as the answer to the call that carried `key` and whose content has `fingerprint`."""
        name = _name(key)
        document = {"fingerprint": fingerprint, "response": response, "at": self._now()}
        replace_json(self._incoming / f"{name}.key", self._folder / f"{name}.json", document)
        with self._lock:
            self._kept.pop(name, None)
            self._kept[name] = self._now()
            self._prune()

    def remembered(self, key: str) -> tuple[str, dict[str, Any]] | None:
        """Fingerprint and answer of the call that carried `key`, or None where there was none within a day."""
        name = _name(key)
        with self._lock:
            self._prune()
            if name not in self._kept:
                return None
        document = read_json(self._folder / f"{name}.json")
        return None if document is None else (document["fingerprint"], document["response"])

    def once(self, key: str | None, fingerprint: str, make: Callable[[], dict[str, Any]]) -> dict[str, Any]:
        """What `make` returns; or, where a call with this key and content was made, its answer.

        key : from `call_key`; without one `make` is always called

        Raises HttpProblem 422 where the key came with other content, 409 while the first call with it is still at work;
        an error of `make` is not remembered.
        """
        if key is None:
            return make()
        with self._alone(key):
            known = self.remembered(key)
            if known is None:
                answer = make()
                try:
                    self.remember(key, fingerprint, answer)
                except (OSError, HttpProblem, DiskFullError):  # what was made is there: its maker must hear so
                    _log.exception("the answer to a call with an Idempotency-Key could not be kept")
                return answer
        if known[0] != fingerprint:
            raise HttpProblem(422, "the Idempotency-Key was used for a call with other content; take a new one")
        return known[1]

    @contextmanager
    def _alone(self, key: str) -> Iterator[None]:
        with self._lock:
            if key in self._busy:
                raise HttpProblem(409, "a call with this Idempotency-Key is still at work; ask again when it is done")
            self._busy.add(key)
        try:
            yield
        finally:
            with self._lock:
                self._busy.discard(key)

    def _prune(self) -> None:
        """Forget what is old, and the oldest where there are too many. Needs the lock."""
        for name, at in list(self._kept.items()):
            if len(self._kept) <= MOST and self._now() - at <= KEEP_SECONDS:
                break
            del self._kept[name]
            (self._folder / f"{name}.json").unlink(missing_ok=True)


def call_key(call: str, header: str | None) -> str | None:
    """The key of a call, as "POST /api/v1/models", with the header Idempotency-Key; None where it has none.

    Two calls may see the same header. Raises HttpProblem 422 where the header is none that can be kept.
    """
    if header is None:
        return None
    if not header or len(header) > LONGEST_KEY or not header.isprintable():
        raise HttpProblem(422, f"the Idempotency-Key is not 1 to {LONGEST_KEY} printable characters")
    return f"{call} {header}"


def _name(key: str) -> str:
    return hashlib.sha256(key.encode("utf-8", "surrogatepass")).hexdigest()
