"""Whose long computation is next? Threads that compute share one interpreter with those that iterate: forty at once
leave a session a fiftieth of its rate. So of every client one goes on at a time, and few in all; the others wait.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from weakref import WeakValueDictionary

from fastapi import Request

from app.rate_limit import client_of
from app.routes.parameters import client_gone

# Computations that go on at once.
AT_ONCE = 2


class Turns:
    """Who computes. Used from the event loop alone."""

    def __init__(self) -> None:
        self._all = asyncio.Semaphore(AT_ONCE)
        self._of: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()

    @asynccontextmanager
    async def one(self, client: str) -> AsyncIterator[None]:
        """A turn of `client`, once its others are over and one is free, in the order of asking."""
        async with self._of.setdefault(client, asyncio.Lock()), self._all:
            yield


@asynccontextmanager
async def in_turn(request: Request) -> AsyncIterator[None]:
    """The turn of a call that computes long. HttpProblem 408, which nobody hears, where its client did not wait."""
    async with request.app.state.turns.one(client_of(request.scope)):
        if await request.is_disconnected():
            raise client_gone()
        yield
