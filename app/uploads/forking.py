"""A process that has everything imported, and forks for each connection that it is handed.

Whoever reads a hostile file may die of it, and a fresh process has to take its place: forked, it is there in a few
milliseconds, and shares its pages with the others; started, it would import for seconds.
"""

from __future__ import annotations

import json
import os
import select
import signal
import socket
from collections.abc import Callable
from contextlib import suppress

# What a process is told of, over its connection, once it has ended: the member that has its exit status, negative where
# it was a signal.
ENDED = "ended"


def fork_for_each(control: socket.socket, work: Callable[[socket.socket], None]) -> None:
    """For each connection that comes over `control` (`socket.send_fds`, with a byte), a process in a session of its own
    that does `work` with it. When it ends, a line of JSON with ENDED is the last that comes over its connection.
    Returns when `control` ends; the processes end with their connections."""
    living: dict[int, socket.socket] = {}
    woken, wake = os.pipe()
    for end in (woken, wake):
        os.set_blocking(end, False)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    while True:
        ready, _, _ = select.select([control.fileno(), woken], [], [])
        if woken in ready:
            os.read(woken, 1 << 12)
            _tell_of_the_dead(living)
        if control.fileno() in ready:
            _, descriptors, _, _ = socket.recv_fds(control, 1, 1)
            if not descriptors:
                return
            connection = socket.socket(fileno=descriptors[0])
            child = os.fork()
            if not child:
                for other in (control, *living.values()):
                    other.close()
                _alone(connection, work)
            living[child] = connection


def _alone(connection: socket.socket, work: Callable[[socket.socket], None]) -> None:
    """What the forked process does; it never comes back."""
    status = 1
    try:
        signal.set_wakeup_fd(-1)
        signal.signal(signal.SIGCHLD, signal.SIG_DFL)
        os.setsid()  # a group of its own, so that it can be killed with its children
        work(connection)
        status = 0
    finally:
        os._exit(status)


def _tell_of_the_dead(living: dict[int, socket.socket]) -> None:
    """What they started ends with them."""
    with suppress(ChildProcessError):
        while (found := os.waitpid(-1, os.WNOHANG))[0]:
            child, status = found
            with suppress(ProcessLookupError, PermissionError):
                os.killpg(child, signal.SIGKILL)
            with living.pop(child) as connection, suppress(OSError):
                told = json.dumps({ENDED: os.waitstatus_to_exitcode(status)})
                connection.send(told.encode() + b"\n", socket.MSG_DONTWAIT)
