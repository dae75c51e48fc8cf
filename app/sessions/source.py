"""What has iterations to be looked at? A session, whether it still iterates, or a recording that was uploaded.

What shows iterations takes a `Source` and reads its archive; what tells a session to do something takes a `Session`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Literal

from app.problems import HttpProblem
from app.sessions.events import Event, Events
from app.sessions.read_outs import ReadOuts
from pmpnbp.json_text import json_bytes
from pmpnbp.recording import IterationArchive
from pmpnbp.scene.observation import Scan


class Source(ABC):
    """Iterations, and what happens. Any thread may call what is public.

    state : `paused`, `waiting` (for a slot), `running` or `failed`; of a recording `recorded`
    truth_known : whether it is told where the links really are; recordings keep no truth
    closed : whether it takes nothing more: it is being deleted, or the server stops
    """

    kind: Literal["session", "recording"]
    state: str
    truth_known: bool = False
    closed: bool = False

    def __init__(self, id: str, events: Events, archive: IterationArchive) -> None:
        self.id = id
        self.events = events
        self.archive = archive
        self.read_outs = ReadOuts(f"{self.kind} '{id}'")

    @property
    def idle(self) -> bool:
        """Whether it stays as it is until it is told something."""
        return self.state in ("paused", "failed", "recorded")

    @abstractmethod
    def status(self) -> dict[str, Any]:
        """What REST shows of it."""

    @abstractmethod
    def progress(self) -> dict[str, Any]:
        """The part of it that events tell of."""

    @abstractmethod
    def changes(self) -> list[dict[str, Any]]:
        """What was changed on the way, in order: `after_iteration`, and `config` (settings by name), or `scan_id` and
        `mode`."""

    @abstractmethod
    def scan(self, view: int, iteration: int | None = None) -> tuple[str, Scan]:
        """The name and the scan of view `view`, counted from 0, of those that an iteration was made with, or else the
        next one will be. HttpProblem 404 where there are fewer."""

    @abstractmethod
    def close(self) -> None:
        """End the event streams, and whatever it does. A second call does nothing."""

    def _publish(self, kind: str, members: dict[str, Any]) -> None:
        self.events.publish(Event(self.events.number(), kind, json_bytes(members)))


def no_view(source: Source, view: int, count: int) -> HttpProblem:
    """The 404 for a view that is not here, of `count` that are."""
    there = f"it has 0 to {count - 1}" if count else "it has none"
    return HttpProblem(404, f"view {view} of {source.kind} '{source.id}' is not here; {there}")
