"""How much may one client ask, and how many may be connected? Refusals are 429, and say which limit it was and when to
come back.

A client is an address; no one of them may take all that there is for everybody. Each has a bucket of permits that fills
at `requests_per_second` and holds two seconds' worth, so a page that loads twenty things at once is served, and a loop
without a pause is slowed down.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager

from cachetools import LRUCache
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from app.problems import HttpProblem, problem_response
from app.server_config import ServerConfig

BURST_SECONDS = 2.0
# Buckets kept: the one unused for longest goes first, which is full again by then.
REMEMBERED_CLIENTS = 10_000
# An orchestrator's probes must not fail because others are busy.
EXEMPT = ("/healthz", "/readyz")


class Buckets:
    """A bucket of permits per client. Used from the event loop alone."""

    def __init__(self, per_second: float) -> None:
        self._rate = per_second
        self._size = max(1.0, per_second * BURST_SECONDS)
        self._levels: LRUCache[str, tuple[float, float]] = LRUCache(REMEMBERED_CLIENTS)

    def take(self, client: str, now: float) -> float:
        """Take a permit: 0 where there was one, else the seconds until there is."""
        level, since = self._levels.pop(client, (self._size, now))
        level = min(self._size, level + (now - since) * self._rate)
        wait = 0.0 if level >= 1.0 else (1.0 - level) / self._rate
        self._levels[client] = (level - 1.0 if wait == 0.0 else level, now)
        return wait


class Shares:
    """How many of something go on, in all and of each client. Used from the event loop alone."""

    def __init__(self) -> None:
        self.all = 0
        self.each: Counter[str] = Counter()

    @contextmanager
    def one(self, client: str) -> Iterator[None]:
        """One of `client`, as long as it lasts."""
        self.all += 1
        self.each[client] += 1
        try:
            yield
        finally:
            self.all -= 1
            self.each[client] -= 1
            if not self.each[client]:
                del self.each[client]


class Traffic:
    """What came and what goes on, for /metrics. connected : requests, event streams and 3D views"""

    def __init__(self) -> None:
        self.requests: Counter[tuple[str, int]] = Counter()
        self.connected = Shares()


class RateLimit:
    """Middleware: counts, and refuses what is too much."""

    def __init__(self, app: ASGIApp, config: ServerConfig, traffic: Traffic) -> None:
        self._app = app
        self._config = config
        self._traffic = traffic
        self._buckets = Buckets(config.requests_per_second)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on, or answer 429."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return

        async def counted(message: Message) -> None:
            if message["type"] in ("http.response.start", "websocket.http.response.start"):
                self._traffic.requests[scope.get("method", "WEBSOCKET"), message["status"]] += 1
            elif message["type"] == "websocket.accept":
                self._traffic.requests["WEBSOCKET", 101] += 1
            await send(message)

        if scope["path"] in EXEMPT:
            await self._app(scope, receive, counted)
            return
        client = client_of(scope)
        problem = self._objection(client)
        if problem is not None:
            await problem_response(problem)(scope, receive, counted)
            return
        with self._traffic.connected.one(client):
            await self._app(scope, receive, counted)

    def _objection(self, client: str) -> HttpProblem | None:
        wait = self._buckets.take(client, time.monotonic())
        if wait > 0:
            detail = (
                f"more than {self._config.requests_per_second:g} requests a second came from this client "
                "(requests_per_second)"
            )
            return HttpProblem(429, detail, headers={"Retry-After": str(math.ceil(wait))})
        if self._traffic.connected.all >= self._config.max_clients:
            detail = f"{self._config.max_clients} clients are connected already, all that are taken (max_clients)"
            return HttpProblem(429, detail, headers={"Retry-After": "5"})
        if self._traffic.connected.each[client] >= self._config.max_clients_each:
            detail = (
                f"{self._config.max_clients_each} requests, streams and views of this client are open already, which "
                "is all this server takes of one (max_clients_each)"
            )
            return HttpProblem(429, detail, headers={"Retry-After": "5"})
        return None


def client_of(scope: Scope) -> str:
    """The address that a call comes from, as a trusted proxy tells it; "" where there is none."""
    return scope["client"][0] if scope.get("client") else ""
