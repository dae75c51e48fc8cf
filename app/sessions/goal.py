"""How far is a session to iterate?"""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass, field
from typing import Literal

from app.sessions.snapshot import Snapshot

Until = Literal["iterations", "converged", "certain"]


@dataclass(frozen=True)
class Goal:
    """To iteration `last`, or until it is so before; `done` is told, or what went wrong."""

    last: int
    until: Until
    done: Future[None] = field(default_factory=Future)

    def reached(self, made: Snapshot, changed: bool) -> bool:
        """Whether nothing is left to do; `changed` since `made`, the inference is neither at rest nor certain."""
        so = (self.until == "converged" and made.converged) or (self.until == "certain" and made.certain)
        return (so and not changed) or made.iteration >= self.last
