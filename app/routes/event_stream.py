"""How does news reach a listener as it happens? As server-sent events: an answer that goes on until what it tells of
ends. The text is that of the HTML standard, section 9.2.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncGenerator, AsyncIterator, Callable, Iterable
from contextlib import suppress

from fastapi.responses import StreamingResponse

# After so long without an event a comment tells that the connection is alive, seconds.
KEEP_ALIVE = 15.0
# What a stream begins with: after a break the listener comes back in so many milliseconds.
RETRY = b"retry: 1000\n\n"


def response(text: AsyncIterator[bytes]) -> StreamingResponse:
    """The answer that sends `text`, past any proxy that would gather it first."""
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(text, media_type="text/event-stream", headers=headers)


def framed(kind: str, data: bytes, number: int | None = None) -> bytes:
    """An event as the protocol has it. data : one line; number : what Last-Event-ID will name it by"""
    head = b"" if number is None else b"id: %d\n" % number
    return head + b"event: %s\ndata: %s\n\n" % (kind.encode(), data)


async def follow(
    listen: Callable[[Callable[..., None]], Callable[[], None]],
    fresh: Callable[[list[str]], Iterable[bytes]],
    closed: Callable[[], bool],
    every: float = KEEP_ALIVE,
) -> AsyncGenerator[bytes, None]:
    """The text of all that is new, each time something happens, until `closed`; a comment where nothing does for long.
    To be closed by whoever iterates (`aclosing`), or the listener is forgotten only when the collector comes by.

    listen : calls what it is given from any thread whenever something happens, with words for it or none; what it
        returns ends that
    fresh : the events to be sent now; it is given the words that came since it was called last
    every : seconds after which it is asked even where nothing was heard
    """
    told, loop = asyncio.Event(), asyncio.get_running_loop()
    words: list[str] = []
    spoken = loop.time()

    def note(*what: str) -> None:
        words.extend(what)
        told.set()

    def wake(*what: str) -> None:
        with suppress(RuntimeError):  # the loop has ended, and this stream with it
            loop.call_soon_threadsafe(note, *what)

    end = listen(wake)
    try:
        while not closed():
            told.clear()
            heard = words.copy()
            words.clear()
            quiet = True
            for event in fresh(heard):
                quiet = False
                yield event
                spoken = loop.time()
            if quiet:
                with suppress(TimeoutError):
                    await asyncio.wait_for(told.wait(), every)
                if not told.is_set() and loop.time() >= spoken + KEEP_ALIVE:
                    yield b": still here\n\n"
                    spoken = loop.time()
    finally:
        end()
