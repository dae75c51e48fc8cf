"""How large may a request's body be, and how slow? Middleware that every body passes, also one that no route reads.

All but uploads are JSON: such a body is taken in whole before its route is asked, and is small. An upload goes on as it
comes; how large it may be is its route's to say. A client is given some seconds of waiting ahead, and one more for each
KiB that it sends: it may pause, but not live on a byte now and then.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress

from starlette.datastructures import Headers
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.problems import HttpProblem, problem_response
from app.server_config import ServerConfig

JSON_BYTES = 1 << 20
BYTES_PER_SECOND = 1024
# Waiting that can be saved up by sending fast, in units of what is given ahead.
_SAVED_AT_MOST = 6
# What came while the server itself was busy lies there when the time is over, and is taken within so many seconds.
_BUSY_SECONDS = 0.05


class Bodies:
    """Takes bodies in, or answers 408, 413 or 415. uploads : paths whose POST is an upload"""

    def __init__(self, app: ASGIApp, config: ServerConfig, uploads: frozenset[str]) -> None:
        self._app = app
        self._seconds = config.body_seconds
        self._uploads = uploads

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        if headers.get("content-length", "0") == "0" and "transfer-encoding" not in headers:
            await self._app(scope, receive, send)
            return
        coding = headers.get("content-encoding", "identity")
        if coding.lower() != "identity":
            said = f"the body has the Content-Encoding {coding:.60}; expected none, the body as it is"
            coded = HttpProblem(415, said, headers={"Accept-Encoding": "identity"})
            await problem_response(coded)(scope, receive, send)
            return
        in_time = _InTime(receive, self._seconds)
        if scope["method"] == "POST" and scope["path"] in self._uploads:
            await self._app(scope, in_time, send)
            return
        try:
            body = await _whole(in_time, headers.get("content-length", ""))
        except HttpProblem as problem:
            await problem_response(problem)(scope, receive, send)
            return
        if body is not None:  # else nobody is there to be answered
            await self._app(scope, _Again(body, receive), send)


async def _whole(receive: Receive, length: str) -> bytes | None:
    """The body; None where its client has gone. length : as the client says, or "". Raises HttpProblem 408, 413."""
    too_large = HttpProblem(413, f"the body is larger than {JSON_BYTES >> 20} MiB, the most that this call takes")
    if length.isdecimal() and int(length) > JSON_BYTES:
        raise too_large
    body = bytearray()
    while True:
        message = await receive()
        if message["type"] != "http.request":
            return None
        body += message.get("body", b"")
        if len(body) > JSON_BYTES:
            raise too_large
        if not message.get("more_body", False):
            return bytes(body)


class _Again:
    """`receive` of a body that is there already."""

    def __init__(self, body: bytes, receive: Receive) -> None:
        self._body: bytes | None = body
        self._receive = receive

    async def __call__(self) -> Message:
        if self._body is None:
            return await self._receive()
        body, self._body = self._body, None
        return {"type": "http.request", "body": body, "more_body": False}


class _InTime:
    """`receive` that raises HttpProblem 408 where a body comes too slowly. Its route's own time does not count."""

    def __init__(self, receive: Receive, seconds: float) -> None:
        self._receive = receive
        self._most = seconds * _SAVED_AT_MOST
        self._left = seconds
        self._all = False

    async def __call__(self) -> Message:
        if self._all:
            return await self._receive()
        clock = asyncio.get_running_loop().time
        since = clock()
        message = await self._within(self._left) or await self._within(_BUSY_SECONDS)
        if message is not None:
            sent = len(message.get("body", b"")) / BYTES_PER_SECOND
            self._left = min(self._most, self._left - (clock() - since) + sent)
            self._all = message["type"] != "http.request" or not message.get("more_body", False)
        if message is None or (self._left <= 0 and not self._all):
            raise HttpProblem(
                408,
                f"the body came too slowly: it may pause for {self._most:g} s at most, and has to bring "
                f"{BYTES_PER_SECOND >> 10} KiB a second on average (body_seconds)",
                headers={"Connection": "close"},
            )
        return message

    async def _within(self, seconds: float) -> Message | None:
        """What comes within so many seconds, or None."""
        with suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                return await self._receive()
        return None
