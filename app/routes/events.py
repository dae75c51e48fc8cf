"""Events: what happens in a session, as it happens, as server-sent events."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import aclosing, suppress
from typing import Annotated

import anyio.to_thread
from fastapi import APIRouter, Header, Query, Request
from fastapi.responses import StreamingResponse

from app.json_text import json_bytes
from app.problems import HttpProblem, responses
from app.routes import event_stream
from app.routes.event_stream import framed
from app.routes.parameters import SessionId, readable
from app.schemas import answer
from app.sessions.events import Event
from app.sessions.readable import Readable
from pmpnbp.errors import RecordingError

router = APIRouter(prefix="/api/v1", tags=["events"])


@router.get(
    "/sessions/{session_id}/events",
    response_class=StreamingResponse,
    operation_id="get_events",
    summary="What happens, as it happens",
    description="Server-sent events. `iteration`: a row of the trace. `state`: state, iteration, iterations, until, "
    "converged, certain, error, position, as the session has them. `error`: error, iteration. Numbers only rise. A "
    "stream begins with the newest iteration and the state; with Last-Event-ID, with what came after that event. A "
    "slow listener may miss iterations, never the newest. With `every`, iterations are gathered and come once in so "
    "many seconds; states and errors, and the iterations before them, come at once. That of an uploaded recording "
    "tells how it ends, and stays open.",
    responses=answer("The stream.", content={"text/event-stream": {"schema": {"type": "string"}}}) | responses(404),
)
async def get_events(
    session_id: SessionId,
    request: Request,
    last_event_id: Annotated[
        str | None, Header(description="number of the last event that was received", pattern="^[0-9]{0,15}$")
    ] = None,
    every: Annotated[float, Query(ge=0, le=10, description="seconds; 0: each iteration as it is made")] = 0,
) -> StreamingResponse:
    """The stream; it ends with the session, or the server."""
    session = await readable(request, session_id)
    seen = int(last_event_id) if last_event_id else None
    return event_stream.response(_stream(session, seen, every))


async def _stream(session: Readable, seen: int | None, every: float) -> AsyncIterator[bytes]:
    """The text of the stream: what came after event `seen` (None: how things stand), then everything new."""
    events = session.events
    cursor = events.last
    yield event_stream.RETRY
    for event in await anyio.to_thread.run_sync(_before, session, seen, cursor):
        yield framed(event.kind, event.data, event.number)

    def fresh(_: list[str]) -> Iterator[bytes]:
        nonlocal cursor
        for event in events.since(cursor):
            yield framed(event.kind, event.data, event.number)
            cursor = event.number

    def listen(wake: Callable[..., None]) -> Callable[[], None]:
        """Without a word of iterations that are gathered: each word takes time from the inference."""

        def hear() -> None:
            if not every or events.closed or events.newest_kind != "iteration":
                wake()

        return events.listen(hear)

    pace = every or event_stream.KEEP_ALIVE
    async with aclosing(event_stream.follow(listen, fresh, lambda: events.closed, pace)) as following:
        async for text in following:
            yield text


def _before(session: Readable, seen: int | None, cursor: int) -> list[Event]:
    """What a listener has to hear first, up to event `cursor`."""
    events = session.events
    kept = [event for event in events.since(seen or 0) if event.number <= cursor]
    if seen is not None and (seen >= cursor or (kept and kept[0].number == seen + 1)):
        return kept
    state = Event(cursor, "state", json_bytes(session.progress()))
    with suppress(HttpProblem, RecordingError):  # a damaged session has no iterations, but a state
        rows = session.rows(-1 if seen is not None else (session.progress()["iteration"] or 0) - 1)
        numbered = [(int(json.loads(row)["event"]), row) for row in rows]
        missed = [
            Event(number, "iteration", row.encode()) for number, row in numbered if (seen or 0) < number <= cursor
        ]
        return [*missed, state]
    return [state]
