"""Events: what happens in a session, as it happens, as server-sent events."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator
from contextlib import suppress
from typing import Annotated

import anyio.to_thread
from fastapi import APIRouter, Header, Path, Request
from fastapi.responses import StreamingResponse

from app.json_text import json_bytes
from app.problems import HttpProblem, responses
from app.schemas import answer
from app.sessions.events import Event
from app.sessions.readable import Readable
from app.sessions.sessions import Sessions
from pmpnbp.errors import RecordingError

router = APIRouter(prefix="/api/v1", tags=["events"])

# After so long without an event a comment tells that the connection is alive, seconds.
KEEP_ALIVE = 15.0


@router.get(
    "/sessions/{session_id}/events",
    response_class=StreamingResponse,
    operation_id="get_events",
    summary="What happens, as it happens",
    description="Server-sent events. `iteration`: a row of the trace. `state`: state, iteration, iterations, until, "
    "converged, certain, error, position, as the session has them. `error`: error, iteration. Numbers only rise. A "
    "stream begins with the newest iteration and the state; with Last-Event-ID, with what came after that event. A "
    "slow listener may miss iterations, never the newest. That of an uploaded recording tells how it ends, and stays "
    "open.",
    responses=answer("The stream.", content={"text/event-stream": {"schema": {"type": "string"}}}) | responses(404),
)
async def get_events(
    session_id: Annotated[str, Path(description="id of the session")],
    request: Request,
    last_event_id: Annotated[
        str | None, Header(description="number of the last event that was received", pattern="^[0-9]{0,15}$")
    ] = None,
) -> StreamingResponse:
    """The stream; it ends with the session, or the server."""
    sessions: Sessions = request.app.state.sessions
    session = sessions.at_hand(session_id)
    if session is None:
        session = await anyio.to_thread.run_sync(sessions.get, session_id)
    seen = int(last_event_id) if last_event_id else None
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(stream(session, seen), media_type="text/event-stream", headers=headers)


async def stream(session: Readable, seen: int | None) -> AsyncIterator[bytes]:
    """The text of the stream: what came after event `seen` (None: how things stand), then everything new."""
    told, loop = asyncio.Event(), asyncio.get_running_loop()

    def wake() -> None:
        with suppress(RuntimeError):  # the loop has ended, and this stream with it
            loop.call_soon_threadsafe(told.set)

    end = session.events.listen(wake)
    try:
        cursor = session.events.last
        yield b"retry: 1000\n\n"
        for event in await anyio.to_thread.run_sync(_before, session, seen, cursor):
            yield text(event)
        while not session.events.closed:
            told.clear()
            fresh = session.events.since(cursor)
            for event in fresh:
                yield text(event)
                cursor = event.number
            if not fresh:
                try:
                    await asyncio.wait_for(told.wait(), KEEP_ALIVE)
                except TimeoutError:
                    yield b": still here\n\n"
    finally:
        end()


def text(event: Event) -> bytes:
    """An event as the protocol has it."""
    return b"id: %d\nevent: %s\ndata: %s\n\n" % (event.number, event.kind.encode(), event.data)


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
