"""What can be read of a session, whether it still iterates or is a recording that was uploaded to be looked at?

Everything that shows iterations takes a `Readable`; what tells a session to do something takes a `Session`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Any, Literal

from app.problems import HttpProblem
from app.sessions.events import Events
from app.sessions.past import Past
from app.sessions.snapshot import Snapshot
from pmpnbp.scene.observation import Scan


class Readable(ABC):
    """Iterations, and what happens. Any thread may call what is public."""

    kind: Literal["session", "recording"]

    def __init__(self, id: str, events: Events, past: Past) -> None:
        self.id = id
        self.events = events
        self._past = past

    @property
    @abstractmethod
    def state(self) -> str:
        """`paused`, `waiting` (for a slot), `running` or `failed`; of a recording `recorded`."""

    @property
    def idle(self) -> bool:
        """Whether it stays as it is until it is told something."""
        return self.state in ("paused", "failed", "recorded")

    @property
    def present(self) -> Snapshot | None:
        """The newest iteration, where it is in memory: nothing is waited for."""
        return self._past.present

    @property
    def snapshot(self) -> Snapshot:
        """The newest iteration. HttpProblem 409 where the recording is damaged."""
        return self._past.snapshot

    def read(self, iteration: int | None = None) -> Snapshot:
        """An iteration, read out as it was when it was made; without a number the newest. HttpProblem 404, 409."""
        return self._past.read(iteration)

    def rows(self, after: int = -1, last: int | None = None) -> list[str]:
        """The trace, JSON, beyond iteration `after`, up to `last`. HttpProblem 409 where the recording is damaged."""
        return self._past.rows(after, last)

    def copy_recording(self, path: Path) -> None:
        """A consistent copy of the recording. HttpProblem 409 where it is damaged."""
        self._past.copy_to(path)

    @abstractmethod
    def status(self) -> dict[str, Any]:
        """What REST shows of it."""

    @abstractmethod
    def progress(self) -> dict[str, Any]:
        """The part of it that changes by itself."""

    @abstractmethod
    def changes(self) -> list[dict[str, Any]]:
        """What was changed on the way, in order: `after_iteration`, and `config` (settings by name) or `scan_id`."""

    @abstractmethod
    def scan(self, view: int) -> tuple[str, Scan]:
        """The name and the scan of view `view`, counted from 0. HttpProblem 404 where there are fewer."""

    @property
    @abstractmethod
    def truth_known(self) -> bool:
        """Whether it is told where the links really are."""

    @abstractmethod
    def close(self) -> None:
        """End the event streams, and whatever it does. A second call does nothing."""


def no_view(readable: Readable, view: int, count: int) -> HttpProblem:
    """The 404 for a view that is not here, of `count` that are."""
    there = f"it has 0 to {count - 1}" if count else "it has none"
    return HttpProblem(404, f"view {view} of {readable.kind} '{readable.id}' is not here; {there}")
