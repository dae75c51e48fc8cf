"""Who does a session's work? One thread at a time, which lives while there is some: commands first, in their order,
then what there is to pursue."""

from __future__ import annotations

import os
import sys
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from typing import TypeVar

Kind = TypeVar("Kind")

# How much a thread that iterates steps back behind those that answer, in the system's niceness.
NICENESS = 5
# Seconds after which a thread that iterates lets another have the interpreter. With Python's 5 ms a call that goes to
# and fro between threads waits several times that.
SWITCH_SECONDS = 0.0005


def share_interpreter() -> None:
    """Let threads that answer come to word often, in the whole process."""
    sys.setswitchinterval(SWITCH_SECONDS)


class Worker:
    """A queue of commands and the thread that works it off.

    pursue : called again and again between commands; whether there was anything to do. Must not raise
    leave : called before the thread ends
    nudge : called with every command, so that `pursue` does not go on waiting for something else
    """

    def __init__(
        self,
        name: str,
        pursue: Callable[[], bool] = lambda: False,
        leave: Callable[[], None] = lambda: None,
        nudge: Callable[[], None] = lambda: None,
    ) -> None:
        self._name = name
        self._pursue = pursue
        self._leave = leave
        self._nudge = nudge
        self._lock = threading.Lock()
        self._commands: deque[Callable[[], None]] = deque()
        self._thread: threading.Thread | None = None
        self._awake = False

    @property
    def awaited(self) -> bool:
        """Whether a command waits for the thread."""
        return bool(self._commands)

    def submit(self, action: Callable[[], Kind]) -> Future[Kind]:
        """Have `action` done after the commands before it; the future has its result, or what it raised."""
        future: Future[Kind] = Future()

        def command() -> None:
            try:
                result = action()
            except BaseException as error:  # told to whoever waits for it
                future.set_exception(error)
            else:
                future.set_result(result)

        with self._lock:
            self._commands.append(command)
        self.wake()
        return future

    def wake(self) -> None:
        """There is something to pursue."""
        with self._lock:
            self._awake = True
            if self._thread is None:
                self._thread = threading.Thread(target=self._work, name=self._name, daemon=True)
                self._thread.start()
        self._nudge()

    def finish(self, last: Callable[[], None]) -> None:
        """Do `last` after the commands there are, where the thread lives, and return when it has ended."""
        with self._lock:
            thread = self._thread
        if thread is not None:
            self.submit(last)
            thread.join()

    def _work(self) -> None:
        if sys.platform == "linux":  # elsewhere it would be the whole process that steps back
            with suppress(OSError):
                os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), NICENESS)
        while True:
            with self._lock:
                self._awake = False
                command = self._commands.popleft() if self._commands else None
            if command is not None:
                command()
            elif not self._pursue():
                self._leave()
                with self._lock:
                    if not self._commands and not self._awake:
                        self._thread = None
                        return
