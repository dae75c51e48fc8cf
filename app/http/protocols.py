"""How does a connection behave that does not do as HTTP has it? uvicorn's protocols, with an end to every patience.

| a client that | is |
| --- | --- |
| connects where there are too many | told so, and closed |
| sends no whole header in time, or a byte of it now and then | closed |
| goes on sending a body after it was answered | listened to for a while, so that it reads the answer; then closed |
| sends what is no HTTP, or no handshake of a websocket | told so in a problem, and closed; nothing is logged |

Between two requests of one connection uvicorn's own time-out holds.
"""

from __future__ import annotations

import asyncio
import http
from contextlib import suppress
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.http11 import Request as Handshake

from app.http.answers import Answers
from app.http.connections import Connections
from app.problems import HttpProblem, problem_response

# A client that is told to stop while it sends may see a broken connection instead of the answer: read on this long.
_DRAIN_BYTES = 32 << 20
_DRAIN_SECONDS = 2.0

_NO_HTTP = "the request is not HTTP/1.1 as RFC 9112 has it, or its header is larger than 16 KiB"
_NO_HANDSHAKE = "the request is no opening handshake of a websocket as RFC 6455 has it, or a line of it is too long"


class HttpProtocol(H11Protocol):
    """A connection, until it becomes a websocket. due : when its client must have said more, in the loop's time"""

    def __init__(self, *arguments: Any, connections: Connections, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.due: float | None = None
        self._watch = connections
        self._refused = False
        # Of a body whose answer is out: bytes that are still listened to; None where there is no such body.
        self._left: int | None = None
        self._last = False  # whether that answer was the connection's last

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin, or refuse."""
        refusal = self._watch.opened(transport, self)
        if refusal is None:
            super().connection_made(transport)
            self.due = self.loop.time() + self._watch.header_seconds
        else:
            self.transport = transport
            self._refused = True
            transport.write(_answer(HttpProblem(429, refusal, headers={"Retry-After": "5"})))
            self._watch.leave(transport)

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        self._watch.closed(self.transport)
        if not self._refused:
            super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take in what came."""
        if self._refused:
            return
        idle = self.cycle is None or self.cycle.response_complete
        if self._left is not None:
            self._left -= len(data)
            if self._left < 0:
                self.transport.abort()
            if self._left < 0 or self._last:
                return
        elif idle and self.due is None:
            self.due = self.loop.time() + self._watch.header_seconds
        before = self.cycle
        super().data_received(data)
        if self.cycle is not before and not self.cycle.response_complete:
            self.due, self._left = None, None
            self._answer_through()
        elif self._left is not None and self.conn.their_state is not h11.SEND_BODY:
            self.due, self._left = None, None  # the body is over: what comes next is a request, as after any answer
            self._unset_keepalive_if_required()
            self.timeout_keep_alive_task = self.loop.call_later(
                self.timeout_keep_alive, self.timeout_keep_alive_handler
            )

    def on_response_complete(self) -> None:
        """Wait for the next request, or for the end of this one's body."""
        self.due = None
        before = self.cycle
        super().on_response_complete()
        if self.cycle is not before:
            self._answer_through()
        if self.cycle.response_complete and self.conn.their_state is h11.SEND_BODY:
            self.due, self._left = self.loop.time() + _DRAIN_SECONDS, _DRAIN_BYTES

    def _answer_through(self) -> None:
        self.cycle.transport = Answers(self.transport, self.loop, self.close_slowly)  # type: ignore[assignment]

    def close_slowly(self) -> None:
        """Close after an answer: where its request's body still comes, the client would not read it otherwise."""
        if self.conn.their_state is h11.SEND_BODY:
            self._last = True
            with suppress(OSError):  # it has gone already
                self.transport.write_eof()
        else:
            self.transport.close()

    def send_400_response(self, msg: str) -> None:
        """What came is no HTTP: say so, unless an answer is on its way."""
        cycle = self.cycle
        if cycle is not None and not cycle.response_complete:
            cycle.disconnected = True
            cycle.message_event.set()
        if cycle is None or cycle.response_complete or not cycle.response_started:
            self.transport.write(_answer(HttpProblem(400, _NO_HTTP)))
        self.transport.close()

    def handle_websocket_upgrade(self, event: h11.Request) -> None:
        """Hand the connection to the websocket's protocol."""
        super().handle_websocket_upgrade(event)
        self._watch.upgraded(self.transport, self.transport.get_protocol())  # type: ignore[arg-type]


class WebsocketProtocol(WebSocketsSansIOProtocol):
    """A connection that has become a websocket, or wants to."""

    due: float | None = None

    def __init__(self, *arguments: Any, connections: Connections, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self._watch = connections

    def connection_lost(self, exc: Exception | None) -> None:
        """End."""
        self._watch.closed(self.transport)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Take in what came. The first is the whole handshake: uvicorn has read it as HTTP before."""
        super().data_received(data)
        if not self.handshake_initiated:
            self._refuse()

    def handle_connect(self, event: Handshake) -> None:
        """Take in the handshake."""
        try:
            super().handle_connect(event)
        except UnicodeError:  # the library quotes what is wrong with a header, which is not ASCII
            self._refuse()

    async def send(self, message: Any) -> None:
        """Pass on what the application sends; one that answered instead of accepting has completed the handshake."""
        await super().send(message)
        if self.initial_response is not None and self.close_sent:
            self.handshake_complete = True

    def _refuse(self) -> None:
        self.handshake_initiated = self.handshake_complete = self.close_sent = True
        self.transport.write(_answer(HttpProblem(400, _NO_HANDSHAKE)))
        self.transport.close()


def _answer(problem: HttpProblem) -> bytes:
    """The whole answer to what never was a request of the application."""
    response = problem_response(problem)
    phrase = http.HTTPStatus(problem.status).phrase
    lines = [f"HTTP/1.1 {problem.status} {phrase}".encode(), b"connection: close"]
    lines += [name + b": " + value for name, value in response.raw_headers]
    return b"\r\n".join([*lines, b"", bytes(response.body)])
