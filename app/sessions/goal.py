"""How far is a session to iterate?"""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import dataclass, field

from app.schemas import Until
from pmpnbp.readout.snapshot import Snapshot


@dataclass(frozen=True)
class Goal:
    """To iteration `last`, or until it is so before; `done` is told, or what went wrong.

    verdict : whether the posterior of the last one is read out though the inference is not at rest: who has it iterate
        to its end expects to hear whether the object was found
    """

    last: int
    until: Until
    verdict: bool = False
    done: Future[None] = field(default_factory=Future)

    def reached(self, newest: Snapshot, changed: bool) -> bool:
        """Whether nothing is left to do; `changed` since `newest`, the inference is neither at rest nor certain. One
        that stays at rest will not become certain: its posterior is the one that it had."""
        told = newest.placed.posterior
        stays = newest.converged and told is not None and told.iteration < newest.iteration
        so = (self.until == "converged" and newest.converged) or (self.until == "certain" and (newest.certain or stays))
        return (so and not changed) or newest.iteration >= self.last
