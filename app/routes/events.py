"""Events: what happens in a session, as it happens, as server-sent events."""

from __future__ import annotations

import json
import time
from collections.abc import AsyncIterator, Callable
from contextlib import suppress
from typing import Annotated

import anyio.to_thread
from fastapi import APIRouter, Depends, Header, Query

from app.problems import HttpProblem, responses
from app.routes.event_stream import EVENTS, IDLE, IDLE_SECONDS, RETRY, EventStream, News, news
from app.routes.parameters import find_source
from app.sessions.events import Event
from app.sessions.source import Source
from pmpnbp.errors import RecordingError
from pmpnbp.json_text import json_bytes

router = APIRouter(prefix="/api/v1/sessions/{session_id}", tags=["events"])

Session = Annotated[Source, Depends(find_source)]
Every = Annotated[float, Query(ge=0, le=10, description="seconds; 0: each iteration as it is made")]


async def _news(session: Session, every: Every = 0) -> AsyncIterator[News]:
    """Without a word of iterations that are gathered: each word takes time from the inference."""
    events = session.events

    def listen(tell: Callable[..., None]) -> Callable[[], None]:
        return events.listen(
            lambda: None if every and events.newest_kind == "iteration" and not events.closed else tell()
        )

    with news(listen) as found:
        yield found


@router.get(
    "/events", response_class=EventStream, summary="What happens, as it happens", responses=EVENTS | responses(404)
)
async def get_events(
    session: Session,
    fresh: Annotated[News, Depends(_news)],
    last_event_id: Annotated[
        str | None, Header(description="number of the last event that was received", pattern="^[0-9]{0,15}$")
    ] = None,
    every: Every = 0,
) -> EventStream:
    """Server-sent events. `iteration`: a row of the trace. `state`: name, state, iteration, iterations, until, phase,
    converged, certain, error, position, as the session has them. `error`: error, iteration. Numbers only rise. A stream
    begins with the newest iteration and the state; with Last-Event-ID, with what came after that event. A slow listener
    may miss iterations, never the newest. With `every`, iterations are gathered and come once in so many seconds;
    states and errors, and the iterations before them, come at once. That of an uploaded recording tells how it ends,
    and stays open."""
    return EventStream(_told(session, fresh, int(last_event_id) if last_event_id else None, every))


async def _told(session: Source, fresh: News, seen: int | None, every: float) -> AsyncIterator[bytes]:
    """What came after event `seen` (None: how things stand), then everything new; ends with the session, or the
    server."""
    events = session.events
    cursor = events.last
    yield RETRY
    yield b"".join(event.text for event in await anyio.to_thread.run_sync(_before, session, seen, cursor))
    last = time.monotonic()
    while not events.closed:
        if new := events.since(cursor):
            cursor, last = new[-1].number, time.monotonic()
            yield b"".join(event.text for event in new)
        elif time.monotonic() - last >= IDLE_SECONDS:
            last = time.monotonic()
            yield IDLE
        await fresh.words(every or IDLE_SECONDS)


def _before(session: Source, seen: int | None, cursor: int) -> list[Event]:
    """What a listener has to hear first, up to event `cursor`."""
    events = session.events
    kept = [event for event in events.since(seen or 0) if event.number <= cursor]
    if seen is not None and (seen >= cursor or (kept and kept[0].number == seen + 1)):
        return kept
    state = Event(cursor, "state", json_bytes(session.progress()))
    with suppress(HttpProblem, RecordingError):  # a damaged session has no iterations, but a state
        archive = session.archive
        rows = archive.rows(archive.iteration - 1) if seen is None else archive.rows_after_event(seen)
        numbered = [(int(json.loads(row)["event"]), row) for row in rows]
        return [*(Event(number, "iteration", row.encode()) for number, row in numbered if number <= cursor), state]
    return [state]
