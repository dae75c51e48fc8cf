"""How does news reach a stream of server-sent events? From whatever thread it happens in, to the event loop's.

The framework has such streams, too, but passes each event through two queues and four tasks of a listener, and logs an
error where one leaves in between. Here an event is written once for all its listeners, and what has come meanwhile is
sent in one piece.
"""

from __future__ import annotations

import asyncio
import math
import threading
import weakref
from collections.abc import AsyncIterator, Callable, Iterable, Iterator
from contextlib import contextmanager
from itertools import islice

from fastapi.responses import StreamingResponse

from app.documentation import answer

MEDIA_TYPE = "text/event-stream"
# What a stream begins with: after a break the listener comes back in so many milliseconds.
RETRY = b"retry: 1000\n\n"
# What a stream says, where it has said nothing for so many seconds, so that nobody on the way takes it for dead.
IDLE_SECONDS, IDLE = 15.0, b": ping\n\n"
# News go to so many listeners at a time, with so many seconds in between; to more at a time where there are so many
# listeners that one would wait longer than this.
AT_ONCE, PAUSE, SECONDS_AT_MOST = 5, 0.03, 0.5

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
        self._post = _posts.get(self._loop) or _posts.setdefault(self._loop, _Post(self._loop))
        self._words: list[str] = []
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
        self._post.hand_in(self, words or ("",))

    def take(self, words: Iterable[str]) -> None:
        """What `tell` was told, in the event loop."""
        self._words.extend(words)
        self._wake()

    def _wake(self) -> None:
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_result(None)


class _Post:
    """Brings what is told to the event loop: to a few listeners at a time, those that wait longest first, so that what
    else the loop has to do comes in between, and to many less often, as that takes time from the inference."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = weakref.proxy(loop)  # it holds its loop no longer than the streams do
        self._lock = threading.Lock()
        # of each listener its words, each once, in the order that they came in
        self._words: dict[News, dict[str, None]] = {}
        self._on_its_way = False
        self._next = -math.inf

    def hand_in(self, news: News, words: Iterable[str]) -> None:
        """Words for a listener; from any thread, returns at once."""
        with self._lock:
            self._words.setdefault(news, {}).update(dict.fromkeys(words))
            if self._on_its_way:
                return
            self._on_its_way = True
        try:
            self._loop.call_soon_threadsafe(self._set_off)
        except RuntimeError:  # the loop has ended, and the streams with it
            with self._lock:
                self._words, self._on_its_way = {}, False

    def _set_off(self) -> None:
        if self._next > self._loop.time():
            self._loop.call_at(self._next, self._deliver)
        else:
            self._deliver()

    def _deliver(self) -> None:
        with self._lock:
            count = max(AT_ONCE, math.ceil(len(self._words) * PAUSE / SECONDS_AT_MOST))
            taken = [(news, self._words.pop(news)) for news in [*islice(self._words, count)]]
            self._on_its_way = bool(self._words)
        self._next = self._loop.time() + PAUSE
        if self._on_its_way:
            self._loop.call_at(self._next, self._deliver)
        for news, words in taken:
            news.take(words)


_posts: weakref.WeakKeyDictionary[asyncio.AbstractEventLoop, _Post] = weakref.WeakKeyDictionary()


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
