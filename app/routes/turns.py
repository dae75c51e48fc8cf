"""Whose computation is next? Threads that compute share one interpreter with those that iterate: forty at once leave a
session a fiftieth of its rate. So of every client one goes on at a time, and few in all; the others wait.

What takes seconds and what takes a few hundredths of one wait apart: nobody waits for a decision to see a belief.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import AbstractAsyncContextManager, asynccontextmanager
from typing import Any, ClassVar
from weakref import WeakValueDictionary

from fastapi import Request, Response

from app.problems import HttpProblem
from app.rate_limit import client_of
from app.routes.named import NamedRoute

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


def long_turn(request: Request) -> AbstractAsyncContextManager[None]:
    """The turn of a call that computes for seconds. HttpProblem 408, which nobody hears, where its client did not
    wait."""
    return _turn(request.app.state.long_turns, request)


def short_turn(request: Request) -> AbstractAsyncContextManager[None]:
    """The turn of a call that reads what was recorded, and makes a picture or a file of it; likewise."""
    return _turn(request.app.state.short_turns, request)


class _TurnRoute(NamedRoute):
    # whose turns: the name that the application knows them by
    turns: ClassVar[str]

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """As of any route, in turn."""
        handler = super().get_route_handler()

        async def in_turn(request: Request) -> Response:
            async with _turn(getattr(request.app.state, self.turns), request):
                return await handler(request)

        return in_turn


class ShortTurnRoute(_TurnRoute):
    """A route whose answers are made in `short_turn`, and sent after it: who reads slowly keeps nobody waiting."""

    turns = "short_turns"


class LongTurnRoute(_TurnRoute):
    """The same in `long_turn`."""

    turns = "long_turns"


def client_gone() -> HttpProblem:
    """What ends a call that nobody waits for any more, and nobody hears."""
    return HttpProblem(408, "the client has gone before its answer was there")


@asynccontextmanager
async def _turn(turns: Turns, request: Request) -> AsyncIterator[None]:
    async with turns.one(client_of(request.scope)):
        if await request.is_disconnected():
            raise client_gone()
        yield
