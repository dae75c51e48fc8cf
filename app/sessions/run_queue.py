"""Who may iterate now? A bounded number of sessions at once, first come, first served."""

from __future__ import annotations

import threading
from collections import deque


class RunQueue:
    """Lets `count` owners run at once; the others queue. Owners are compared by identity. Thread-safe."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._changed = threading.Condition()
        self._holders: list[object] = []
        self._queue: deque[object] = deque()
        self._nudged: list[object] = []

    def take(self, owner: object) -> bool:
        """Whether `owner` has a slot now; where not, it stands in the queue, at the place it had."""
        with self._changed:
            if owner in self._holders:
                return True
            if owner not in self._queue:
                self._queue.append(owner)
            if len(self._holders) < self._count and self._queue[0] is owner:
                self._queue.popleft()
                self._holders.append(owner)
                self._changed.notify_all()  # the next one may find a slot too
                return True
            return False

    def wait(self, owner: object) -> None:
        """Return once something has changed for `owner`, which stands in the queue: a slot is free for it, its place in
        the queue is another, or it was nudged."""
        with self._changed:
            before = self._place(owner)
            self._changed.wait_for(lambda: self._place(owner) != before or self._free(owner) or owner in self._nudged)
            self._nudged = [other for other in self._nudged if other is not owner]

    def nudge(self, owner: object) -> None:
        """Let `owner` return from `wait`, or not stay in there the next time."""
        with self._changed:
            if owner not in self._nudged:
                self._nudged.append(owner)
                self._changed.notify_all()

    def leave(self, owner: object) -> None:
        """Give up a slot, or a place in the queue; nothing where `owner` has neither."""
        with self._changed:
            self._holders = [other for other in self._holders if other is not owner]
            self._nudged = [other for other in self._nudged if other is not owner]
            if owner in self._queue:
                self._queue.remove(owner)
            self._changed.notify_all()

    def position(self, owner: object) -> int | None:
        """The place of `owner` in the queue, 1 for the next; None where it does not stand there."""
        with self._changed:
            return self._place(owner)

    def others_wait(self) -> bool:
        """Whether anybody stands in the queue."""
        with self._changed:
            return bool(self._queue)

    def _place(self, owner: object) -> int | None:
        return self._queue.index(owner) + 1 if owner in self._queue else None

    def _free(self, owner: object) -> bool:
        return len(self._holders) < self._count and bool(self._queue) and self._queue[0] is owner
