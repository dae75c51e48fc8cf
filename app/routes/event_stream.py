"""How does news reach a stream of server-sent events? From whatever thread it happens in, to the event loop's.

The framework writes the events, and keeps an idle connection alive with a comment every 15 seconds.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from fastapi import Response
from fastapi.sse import ServerSentEvent

# What a stream begins with: after a break the listener comes back in so many milliseconds.
RETRY = ServerSentEvent(retry=1000)


def not_stored(response: Response) -> None:
    """What was heard once is not kept by a cache; a dependency of streams."""
    response.headers["Cache-Control"] = "no-store"


class News:
    """What is told from any thread, awaited in the event loop."""

    def __init__(self) -> None:
        self._loop, self._told = asyncio.get_running_loop(), asyncio.Event()
        self._words: list[str] = []

    async def words(self, seconds: float | None = None) -> list[str]:
        """The words told since the last call, once anything is, or after so many seconds."""
        with suppress(TimeoutError):
            await asyncio.wait_for(self._told.wait(), seconds)
        self._told.clear()
        words, self._words = self._words, []
        return words

    def tell(self, *words: str) -> None:
        """Wake who waits; from any thread, returns at once."""
        with suppress(RuntimeError):  # the loop has ended, and the stream with it
            self._loop.call_soon_threadsafe(self._take, words)

    def _take(self, words: tuple[str, ...]) -> None:
        self._words.extend(words)
        self._told.set()


@contextmanager
def news(listen: Callable[[Callable[..., None]], Callable[[], None]]) -> Iterator[News]:
    """News of what `listen` hears. In a dependency, so that the listener is forgotten when the request ends.

    listen : calls what it is given from any thread whenever something happens; what it returns ends that
    """
    heard = News()
    end = listen(heard.tell)
    try:
        yield heard
    finally:
        end()
