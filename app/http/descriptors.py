"""How many files and connections may be open at once, and what is said where there are too many."""

from __future__ import annotations

import asyncio
import logging
import resource
from typing import Any

# More are of no use to us, and each connection costs memory.
MOST_DESCRIPTORS = 65_536
_SAID_EVERY_SECONDS = 60.0

_log = logging.getLogger("pmpnbp.server")


def raise_limit() -> None:
    """Let this process open as many files as the system lets it, where its shell or service manager allows fewer."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MOST_DESCRIPTORS if hard == resource.RLIM_INFINITY else min(hard, MOST_DESCRIPTORS)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def limit() -> int:
    """How many files and connections this process may have open."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return MOST_DESCRIPTORS if soft == resource.RLIM_INFINITY else min(soft, MOST_DESCRIPTORS)


class AcceptErrors:
    """Says once a minute that connections cannot be accepted: asyncio tells it thousands of times a second."""

    def __init__(self) -> None:
        self._said: float | None = None

    def __call__(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """The loop's handler of exceptions that nobody awaits."""
        if "socket.accept()" not in context.get("message", ""):
            loop.default_exception_handler(context)
            return
        now = loop.time()
        if self._said is None or now - self._said >= _SAID_EVERY_SECONDS:
            self._said = now
            _log.error("connections cannot be accepted: %s; said once a minute", context.get("exception"))
