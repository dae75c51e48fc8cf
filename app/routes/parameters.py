"""What do many calls ask for alike? A session, one of its iterations, links of its model: how each is named in a call,
and what the call gets for it.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Sequence
from typing import Annotated

import anyio.to_thread
from fastapi import Depends, Path, Query, Request

from app.problems import HttpProblem
from app.routes.turns import client_gone, short_turn
from app.sessions.session import Session
from app.sessions.sessions import Sessions
from app.sessions.source import Source
from pmpnbp.readout.snapshot import Snapshot

SessionId = Annotated[str, Path(description="id of the session")]
SourceId = Annotated[str, Path(description="id of the session, or of an uploaded recording")]
Iteration = Annotated[
    int | None, Query(ge=0, le=2**31, description="number of the iteration, 0 is the start; default: the newest")
]

# Of a query's `links`.
LINK_NAMES = (
    "names of links, each as a `links` of its own, or several with commas between; what is a link's name as it stands "
    "counts as that, though it has a comma"
)


def sessions_of(request: Request) -> Sessions:
    """All sessions of the server."""
    return request.app.state.sessions


async def find_source(request: Request, session_id: SessionId) -> Source:
    """`Sessions.get` for calls in the event loop: from memory, and in a thread only what is not there. HttpProblem
    404."""
    sessions = sessions_of(request)
    session = sessions.at_hand(session_id)
    if session is None:
        session = await anyio.to_thread.run_sync(sessions.get, session_id)
    return session


def _live_session(request: Request, session_id: SessionId) -> Session:
    return sessions_of(request).session(session_id)


# A session that can be told what to do. HttpProblem 404, and 409 for an uploaded recording.
LiveSession = Annotated[Session, Depends(_live_session)]


def read(
    request: Request, session_id: str, iteration: int | None = None, links: Iterable[str] = ()
) -> tuple[Source, Snapshot]:
    """A session and an iteration of it, None: the newest. HttpProblem 404, also for a link of `links` that its model
    does not have, and 409."""
    session = sessions_of(request).get(session_id)
    snapshot = session.archive.read(iteration)
    check_links(snapshot, links)
    return session, snapshot


async def told(
    request: Request, session_id: str, iteration: int | None, links: Iterable[str]
) -> tuple[Source, Snapshot]:
    """What `read` gives, with its posterior where it is not of the search, for calls in the event loop. HttpProblem
    404, 409, and 408, which nobody hears."""
    async with short_turn(request):
        source, snapshot = await anyio.to_thread.run_sync(read, request, session_id, iteration, links)
    return source, await read_out(request, source, snapshot)


async def told_of_links(
    request: Request, session_id: str, iteration: int | None, listed: Sequence[str] | None
) -> tuple[Source, Snapshot, list[str]]:
    """What `told` gives, and the links that `links` of a query names; none where it names none."""
    async with short_turn(request):
        source, snapshot = await anyio.to_thread.run_sync(read, request, session_id, iteration)
    known = snapshot.problem.mrf.model.links
    asked = [name for entry in listed or () for name in ([entry] if entry in known else entry.split(","))]
    check_links(snapshot, asked)
    return source, await read_out(request, source, snapshot), list(dict.fromkeys(asked))


async def read_out(request: Request, source: Source, snapshot: Snapshot) -> Snapshot:
    """The snapshot with its posterior, for calls in the event loop: it is read out elsewhere, once for all who ask for
    it, for as long as the client stays. HttpProblem 409, and 408, which nobody hears."""
    asked = asyncio.wrap_future(source.read_outs.ask(snapshot))
    gone = asyncio.ensure_future(_gone(request))
    try:
        await asyncio.wait((asked, gone), return_when=asyncio.FIRST_COMPLETED)
        if not asked.done():
            raise client_gone()
        return asked.result()
    finally:
        asked.cancel()
        gone.cancel()


async def _gone(request: Request) -> None:
    while (await request.receive())["type"] != "http.disconnect":
        pass


def check_links(snapshot: Snapshot, links: Iterable[str]) -> None:
    """HttpProblem 404 for the first of `links` that the model does not have."""
    known = snapshot.problem.mrf.model.links
    for link in links:
        if link not in known:
            raise HttpProblem(404, f"link '{link:.60}' is not in the model; it has {', '.join(known)}")
