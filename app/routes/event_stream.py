"""How does news reach a stream of server-sent events? From whatever thread it happens in, to the event loop's.

The framework has such streams, too, but passes each event through two queues and four tasks of a listener, and logs an
error where one leaves in between. Here an event is written once for all its listeners, and what has come meanwhile is
sent in one piece.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import contextmanager, suppress

from fastapi.responses import StreamingResponse

from app.documentation import answer

MEDIA_TYPE = "text/event-stream"
# What a stream begins with: after a break the listener comes back in so many milliseconds.
RETRY = b"retry: 1000\n\n"
# What a stream says, where it has said nothing for so many seconds, so that nobody on the way takes it for dead.
IDLE_SECONDS, IDLE = 15.0, b": ping\n\n"

_STRING = {"type": "string"}
_EVENT = {"data": _STRING, "event": _STRING, "id": _STRING, "retry": {"type": "integer", "minimum": 0}}
EVENTS = answer("The events.", content={MEDIA_TYPE: {"itemSchema": {"type": "object", "properties": _EVENT}}})


class EventStream(StreamingResponse):
    """Server-sent events, as `written` gives them: what was heard once is not kept by a cache, nor gathered by a
    proxy."""

    media_type = MEDIA_TYPE

    def __init__(self, events: AsyncIterator[bytes], status_code: int = 200) -> None:
        super().__init__(events, status_code, headers={"Cache-Control": "no-store", "X-Accel-Buffering": "no"})


class News:
    """What is told from any thread, awaited in the event loop."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()
        self._words: list[str] = []
        self._told = False
        self._waiting: asyncio.Future[None] | None = None

    async def words(self, seconds: float = IDLE_SECONDS) -> list[str]:
        """The words told since the last call, once anything is, or after so many seconds."""
        if not self._words:
            self._waiting = self._loop.create_future()
            timer = self._loop.call_later(seconds, self._wake)
            try:
                await self._waiting
            finally:
                timer.cancel()
                self._waiting = None
        words, self._words = self._words, []
        return words

    def tell(self, *words: str) -> None:
        """Wake who waits; from any thread, returns at once."""
        if not words:
            words = ("",)
        with suppress(RuntimeError):  # the loop has ended, and the stream with it
            self._loop.call_soon_threadsafe(self._take, words)

    def _take(self, words: tuple[str, ...]) -> None:
        self._words.extend(words)
        self._wake()

    def _wake(self) -> None:
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)


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
