"""Does a session fit into the memory that there is? It is estimated from what is asked for, before it is made.

The estimate is of the peak while a session iterates and is read out, and an upper bound: the peaks that
`python -m benchmarks.session_memory` measures are between a third of it and all. A session that rests takes a part of
its peak, and only so many sessions iterate at once.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

from app import memory
from app.problems import HttpProblem
from pmpnbp.inference.problem import Problem

_MIB = 1 << 20
# Bytes: of every session; and more for each part, each particle of a part, and each hypothesis that the search tries,
# of each part.
SESSION, PART, PARTICLE, HYPOTHESIS = 30 * _MIB, 4 * _MIB, 3 << 10, 500
# More for each joint position that is tried for a message's sample: there, the sender's part is posed and scored.
DRAW = 160
# More for each pixel of a scan's working image, and each particle's pixel where it is rendered.
PIXEL = 300
# More for each triangle of a part in the inference, and each point that stands for a part.
TRIANGLE, POINT = 500, 500
# Bytes that are never given to a session, for uploads, views and calls.
RESERVE = 128 * _MIB
# What a session that rests has of its peak: its newest iteration and what it is made with.
AT_REST = 0.25


def estimated_bytes(problem: Problem) -> int:
    """What a session of this problem takes at most, about."""
    chosen, parts = problem.settings, len(problem.mrf.model.parts)
    pixels = sum(view.depth.size for view in problem.observation.views)
    of_a_part = PART + PARTICLE * problem.particles + POINT * chosen.splat_points + TRIANGLE * chosen.triangles
    searched = HYPOTHESIS * problem.search_proposals if chosen.search_iterations else 0
    drawn = DRAW * len(problem.mrf.sender) * problem.particles * chosen.joint_draws
    return SESSION + parts * (of_a_part + searched) + drawn + PIXEL * pixels


class MemoryRoom:
    """What the sessions of a server take of the memory that there is. Thread-safe.

    most : bytes that the process may take; None: what machine and container have; running : sessions that iterate at
    once; free, taken : what is free beside what the process has, and what it has
    """

    def __init__(
        self,
        most: int | None,
        running: int,
        free: Callable[[], int | None] = memory.free_bytes,
        taken: Callable[[], int] = memory.resident_bytes,
    ) -> None:
        self._most = most
        self._running = running
        self._free, self._taken = free, taken
        self._lock = threading.Lock()
        self._base = taken()
        self._needs: dict[str, int] = {}

    def claim(self, id: str, problem: Problem) -> None:
        """Set memory aside for a session, in place of what was set aside for it before. HttpProblem 507 where it does
        not fit; nothing changes then."""
        need = estimated_bytes(problem)
        with self._lock:
            before = self._needs.get(id, 0)
            others = [other for known, other in self._needs.items() if known != id]
            taken = self._taken()
            left = None if (total := self._total(taken)) is None else total - RESERVE - self._spoken_for(others, taken)
            if need > before and left is not None and need > left:
                raise HttpProblem(507, _sentence(problem, need, max(left, 0)))
            self._needs[id] = need

    def release(self, id: str) -> None:
        """The session is gone."""
        with self._lock:
            self._needs.pop(id, None)

    def _total(self, taken: int) -> int | None:
        """What the process may take in all."""
        free = self._free()
        found = [*([] if free is None else [free + taken]), *([] if self._most is None else [self._most])]
        return min(found) if found else None

    def _spoken_for(self, others: list[int], taken: int) -> int:
        """What the process has, or will have with the peaks of the other sessions that iterate beside one more."""
        largest = sorted(others)[::-1]
        peaks, resting = largest[: self._running - 1], largest[self._running - 1 :]
        return max(taken, self._base + sum(peaks) + round(AT_REST * sum(resting)))


def _sentence(problem: Problem, need: int, left: int) -> str:
    asked = (
        f"{len(problem.mrf.model.parts)} parts of {problem.particles} particles, {problem.settings.joint_draws} joint "
        f"draws and {problem.search_proposals} hypotheses of the search"
    )
    # what is needed is rounded up, what there is down: they never look alike
    return (
        f"the session would take about {-(-need // _MIB):,} MiB of memory, for {asked}, and there are "
        f"{left // _MIB:,} MiB; ask for fewer particles or a smaller 'joint_draws' or 'search_proposals', or "
        "delete other sessions"
    )
