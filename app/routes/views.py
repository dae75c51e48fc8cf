"""3D views: what each shows, as a page sets it and as clicks in the scene change it, and the scene as a file."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Request, Response
from fastapi.responses import HTMLResponse

from app.documentation import answer
from app.problems import HttpProblem, responses
from app.routes.attachments import attachment
from app.routes.event_stream import EVENTS, IDLE, RETRY, EventStream, News, news
from app.routes.parameters import SourceId, sessions_of
from app.security import VIEW_POLICY
from app.sessions.events import written
from app.sessions.source import Source
from app.viewer.view import View, ViewStatus
from app.viewer.view_state import ViewState, ViewStateError, merged
from app.viewer.views import Views, with_handles
from pmpnbp.json_text import json_bytes
from pmpnbp.scene.prior import load_prior

router = APIRouter(prefix="/api/v1", tags=["views"])
of_a_view = APIRouter(prefix="/sessions/{session_id}/views/{view_id}")

ViewId = Annotated[
    str, Path(description="name of the view: up to 64 letters, digits, - and _; the 3D view of that name shows it")
]


def _kept(session_id: SourceId, view_id: ViewId, request: Request) -> Iterator[View]:
    views: Views = request.app.state.views
    view = views.keep(session_id, view_id, sessions_of(request).get)
    try:
        yield view
    finally:
        views.release(view)


# A view, kept open while a call looks at it.
KeptView = Annotated[View, Depends(_kept)]


@of_a_view.get("", response_model=ViewStatus, summary="What a 3D view shows", responses=responses(404))
def get_view(view: KeptView) -> Any:
    """A view that is not there is made; one that nobody looks at goes after a minute."""
    return view.answer()


@of_a_view.patch(
    "",
    response_model=ViewStatus,
    summary="Change what a 3D view shows",
    responses=responses(409, status_404="The session, or the one to compare it with, is not here."),
)
def change_view(session_id: SourceId, view_id: ViewId, body: ViewState, request: Request) -> Any:
    """Members that are not named stay, and so do layers that `show` does not name. Another `part` forgets the
    `particle`."""
    with contextmanager(_kept)(session_id, view_id, request) as view:  # no dependency: a bad body must open no view
        source = sessions_of(request).get(session_id)
        _check(body, source, request)
        if body.look is not None and view.painter is not None:
            eye = view.painter.place(body.look, merged(view.state, body))
            body = body.model_copy(update={"camera": eye})
        view.change(body)
        if "show" in body.model_fields_set:
            with_handles(view, source)
        if "camera" in body.model_fields_set and view.painter is not None:
            view.painter.camera.look(view.state.camera)
        return view.answer()


async def _news(view: KeptView) -> AsyncIterator[News]:
    with news(view.listen) as found:
        yield found


@of_a_view.get(
    "/events",
    response_class=EventStream,
    summary="What changes in a 3D view, as it changes",
    responses=EVENTS | responses(404),
)
async def get_view_events(view: KeptView, fresh: Annotated[News, Depends(_news)]) -> EventStream:
    """Server-sent events. `view`: the whole state, first as it is, then after each change, those made in the scene too:
    a click on a particle, a dragged handle, another place to look from. `drawn`: what was drawn, each time."""
    return EventStream(_told(view, fresh))


async def _told(view: View, fresh: News) -> AsyncIterator[bytes]:
    yield RETRY
    kinds = {"view"}
    while not view.closed:
        states = {what: view.answer() if what == "view" else view.drawn_members() for what in kinds}
        yield b"".join(written(what, json_bytes(states[what])) for what in sorted(kinds, reverse=True)) or IDLE
        kinds = {"view" if what == "clients" else what for what in await fresh.words()} - {"closed"}


@of_a_view.get(
    "/scene.html",
    response_class=HTMLResponse,
    summary="The scene as a page that needs no server",
    responses=answer("The page.", content={"text/html": {"schema": {"type": "string"}}}) | responses(404, 409),
)
def get_view_scene(view: KeptView) -> Response:
    """What the view shows now, to be kept or sent: it can be looked at from all sides, but does not change."""
    if view.painter is None:
        raise HttpProblem(404, f"view '{view.view_id}' is closed")
    text = view.painter.html()
    name = f"{view.session_id}-{0 if view.drawn is None else view.drawn.iteration}.html"
    headers = {"Content-Security-Policy": VIEW_POLICY} | attachment(name)
    return HTMLResponse(text, headers=headers)


router.include_router(of_a_view)


@router.get("/view-state", summary="The members of a 3D view's state")
def describe_view_state() -> dict[str, Any]:
    """As a JSON schema: default, bounds or choices, and meaning of each member; of each layer its name for people."""
    return ViewState.model_json_schema()


def _check(change: ViewState, source: Source, request: Request) -> None:
    """Whether what is named is there: parts, the edge, the prior's link, the session to compare with."""
    if change.compare is not None:
        sessions_of(request).get(change.compare.session_id)
    named = [name for name in (change.part, *(change.edge or ())) if name is not None]
    if not named and change.prior is None:
        return
    model = source.archive.read().problem.mrf.model
    if change.prior is not None:
        load_prior(change.prior, model)
    parts = [part.name for part in model.parts]
    for name in named:
        if name not in parts:
            raise ViewStateError(f"part {name!r:.60} is not in the model; it has {', '.join(parts)}")
    pairs = [(parts[edge.parent], parts[edge.child]) for edge in model.edges]
    if change.edge is not None and set(change.edge) not in [set(pair) for pair in pairs]:
        known = ", ".join(f"{parent}-{child}" for parent, child in pairs)
        one, other = change.edge
        raise ViewStateError(f"no joint connects {one!r:.60} and {other!r:.60}; there are {known or 'none'}")
