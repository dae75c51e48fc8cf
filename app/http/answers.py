"""How does an answer go out? Its head together with the first of its body, where that follows at once.

uvicorn sends them one after the other. Each sending lets go of the interpreter, which the threads that iterate then
take, and wakes the client for half an answer.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any


class Answers:
    """A transport, but for when the first of what is written is sent, and how it is closed."""

    def __init__(
        self, transport: asyncio.Transport, loop: asyncio.AbstractEventLoop, close: Callable[[], None]
    ) -> None:
        self._transport = transport
        self._loop = loop
        self._close = close
        # None until something is written; then what of it is held
        self._head: bytes | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._transport, name)

    def write(self, data: bytes) -> None:
        """Send it; hold it until the loop's next turn where it is the first."""
        if self._head is None:
            self._head = data
            self._loop.call_soon(self._send)
        else:
            self._send(data)

    def close(self) -> None:
        """Close after what was written."""
        self._send()
        self._close()

    def _send(self, data: bytes = b"") -> None:
        whole, self._head = (self._head or b"") + data, b""
        if whole:
            self._transport.write(whole)
