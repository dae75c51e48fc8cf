"""Which connections are open, and which must end?

A connection takes a descriptor whether it says anything or not, so their number is bounded: for each address, and in
all, where a part of the descriptors is kept for files. One that is silent where a request's header is due, or that does
not read what was sent to it, is ended. All are looked at once a second, which needs no timer for each.
"""

from __future__ import annotations

import asyncio
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Protocol

from app.http import descriptors
from app.server_config import ServerConfig

# Of descriptors: kept for recordings, uploads, and what 3D views take beside their connections.
_SHARE_FOR_FILES = 0.25
_PERIOD_SECONDS = 1.0
# So long one that is refused may take to read why, as long as no more than so many do.
_LEAVING_SECONDS = 1.0
_LEAVING_AT_ONCE = 64


@dataclass
class Unread:
    """How long what was sent may lie unread. seconds : so many, and one more for each 1/`bytes_per_second` that is read
    after all; bytes : that may lie at all of one address, beyond which the connection with the most of it ends"""

    seconds: float = 60.0
    bytes_per_second: float = 1024.0
    bytes: int = 128 << 20


class Watched(Protocol):
    """A connection, as it is looked at. due : when its client must have said something, in the loop's time"""

    due: float | None


@dataclass
class _Open:
    """unread : bytes that the client had not taken when last looked at; waited : seconds that it is behind with them"""

    address: str
    protocol: Watched
    unread: int = 0
    waited: float = 0.0


@dataclass
class Connections:
    """The open connections. Used from the event loop alone.

    limit, limit_each : in all, and of one address; ended : how many were refused or ended, by reason
    """

    limit: int
    limit_each: int
    header_seconds: float
    unread: Unread = field(default_factory=Unread)
    ended: Counter[str] = field(default_factory=Counter)
    _open: dict[asyncio.Transport, _Open] = field(default_factory=dict)
    _of: Counter[str] = field(default_factory=Counter)
    _leaving: int = 0
    _looked: float = 0.0

    def __len__(self) -> int:
        return len(self._open)

    def opened(self, transport: asyncio.Transport, protocol: Watched) -> str | None:
        """Count a connection in; or why it cannot be, in a sentence."""
        address = _address(transport)
        if self._of[address] >= self.limit_each:
            self.ended["too many of one address"] += 1
            return f"{self.limit_each} connections of this address are open, the most of one (max_connections_each)"
        if len(self._open) >= self.limit:
            self.ended["too many"] += 1
            return f"{self.limit} connections are open, which is all that the system's limit of open files allows"
        self._of[address] += 1
        self._open[transport] = _Open(address, protocol)
        return None

    def upgraded(self, transport: asyncio.Transport, protocol: Watched) -> None:
        """The connection is a websocket from here on."""
        if transport in self._open:
            self._open[transport].protocol = protocol

    def closed(self, transport: asyncio.Transport) -> None:
        """Count a connection out; one that is not there is none."""
        gone = self._open.pop(transport, None)
        if gone is not None:
            self._of[gone.address] -= 1
            if not self._of[gone.address]:
                del self._of[gone.address]

    def leave(self, transport: asyncio.Transport) -> None:
        """Close one that was refused, once it has read why."""
        if self._leaving >= _LEAVING_AT_ONCE:
            transport.close()
            return
        self._leaving += 1
        with suppress(OSError):  # it has gone already
            transport.write_eof()
        asyncio.get_running_loop().call_later(_LEAVING_SECONDS, self._gone, transport)

    def _gone(self, transport: asyncio.Transport) -> None:
        self._leaving -= 1
        transport.abort()

    def watch(self) -> None:
        """Look at all of them every second, as long as the loop runs."""
        self._looked = asyncio.get_running_loop().time()
        self._look()

    def _look(self) -> None:
        loop = asyncio.get_running_loop()
        now = loop.time()
        seconds, self._looked = now - self._looked, now
        for transport, one in list(self._open.items()):
            if one.protocol.due is not None and now > one.protocol.due and not transport.is_closing():
                self.ended["silent"] += 1
                transport.close()
            if self._unread_too_long(transport, one, seconds):
                self._drop(transport)
        self._make_room()
        loop.call_later(min(_PERIOD_SECONDS, self.header_seconds / 4), self._look)

    def _unread_too_long(self, transport: asyncio.Transport, one: _Open, seconds: float) -> bool:
        before, one.unread = one.unread, transport.get_write_buffer_size()
        if one.unread <= transport.get_write_buffer_limits()[0] and not transport.is_closing():
            one.waited = 0.0
            return False
        read = max(0, before - one.unread) / self.unread.bytes_per_second
        one.waited = max(0.0, one.waited - read) + seconds
        return one.waited > self.unread.seconds

    def _make_room(self) -> None:
        """End what holds the most of those addresses that leave too much unread."""
        of_address: Counter[str] = Counter()
        for one in self._open.values():
            of_address[one.address] += one.unread
        for address, unread in of_address.items():
            if unread > self.unread.bytes:
                theirs = [(one.unread, transport) for transport, one in self._open.items() if one.address == address]
                self._drop(max(theirs, key=lambda entry: entry[0])[1])

    def _drop(self, transport: asyncio.Transport) -> None:
        self.ended["unread"] += 1
        transport.abort()  # not `close`, which waits until all is read


def connections_for(config: ServerConfig) -> Connections:
    """With the limits that `config` and the system set."""
    allowed = descriptors.limit()
    return Connections(
        limit=allowed - int(allowed * _SHARE_FOR_FILES),
        limit_each=min(config.max_connections_each, allowed // 2),
        header_seconds=config.header_seconds,
    )


def _address(transport: asyncio.Transport) -> str:
    """Of the other end; "" where that has none."""
    peer = transport.get_extra_info("peername")
    return str(peer[0]) if isinstance(peer, tuple) and peer else ""
