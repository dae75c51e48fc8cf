"""3D views: what each shows, as a page sets it and as clicks in the scene change it, and the scene as a file."""

from __future__ import annotations

from collections.abc import AsyncIterator, Iterator
from contextlib import contextmanager
from typing import Annotated, Any

from fastapi import APIRouter, Depends, Path, Request, Response
from fastapi.responses import HTMLResponse
from fastapi.sse import EventSourceResponse, ServerSentEvent

from app import view_schemas
from app.problems import HttpProblem, responses
from app.routes.event_stream import RETRY, News, news, not_stored
from app.routes.parameters import SourceId, sessions_of
from app.schemas import answer
from app.security import VIEW_POLICY
from app.sessions.source import Source
from app.store.store import safe_name
from app.viewer.view import View
from app.viewer.view_state import ViewStateError
from app.viewer.views import Views, with_handles
from pmpnbp.json_text import json_bytes
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.prior import load_prior

router = APIRouter(prefix="/api/v1", tags=["views"])

ViewId = Annotated[
    str, Path(description="name of the view: up to 64 letters, digits, - and _; the 3D view of that name shows it")
]


@router.get(
    "/sessions/{session_id}/views/{view_id}",
    response_model=view_schemas.ViewState,
    operation_id="get_view",
    summary="What a 3D view shows",
    description="A view that is not there is made; one that nobody looks at goes after a minute.",
    responses=responses(404),
)
def get_view(session_id: SourceId, view_id: ViewId, request: Request) -> Any:
    """Its state."""
    with _view(request, session_id, view_id) as view:
        return view.answer()


@router.patch(
    "/sessions/{session_id}/views/{view_id}",
    response_model=view_schemas.ViewState,
    operation_id="change_view",
    summary="Change what a 3D view shows",
    description="Members that are not named stay. Another `part` forgets the `particle`.",
    responses=responses(409, status_404="The session, or the one to compare it with, is not here."),
)
def change_view(session_id: SourceId, view_id: ViewId, body: view_schemas.ViewChange, request: Request) -> Any:
    """Change it, where all of it is possible."""
    change = view_schemas.given(body)
    with _view(request, session_id, view_id) as view:
        source = sessions_of(request).get(session_id)
        _check(change, source, request)
        view.change(change)
        if "show" in change:
            with_handles(view, source)
        if "camera" in change:
            painter = _views(request).painter(view)
            if painter is not None:
                painter.camera.look(view.state.camera)
        return view.answer()


def _kept(session_id: SourceId, view_id: ViewId, request: Request) -> Iterator[View]:
    with _view(request, session_id, view_id) as view:
        yield view


async def _news(view: Annotated[View, Depends(_kept)]) -> AsyncIterator[News]:
    with news(view.listen) as found:
        yield found


@router.get(
    "/sessions/{session_id}/views/{view_id}/events",
    response_class=EventSourceResponse,
    operation_id="get_view_events",
    summary="What changes in a 3D view, as it changes",
    description="Server-sent events. `view`: the whole state, first as it is, then after each change, those made in "
    "the scene too: a click on a particle, a dragged handle, another place to look from. `drawn`: what was drawn, each "
    "time.",
    dependencies=[Depends(not_stored)],
    responses=responses(404),
)
async def get_view_events(
    view: Annotated[View, Depends(_kept)], fresh: Annotated[News, Depends(_news)]
) -> AsyncIterator[ServerSentEvent]:
    """The stream; it ends with the view."""
    yield RETRY
    told = {"view"}
    while not view.closed:
        for what in sorted(told, reverse=True):
            state = view.answer() if what == "view" else view.drawn_members()
            yield ServerSentEvent(event=what, raw_data=json_bytes(state).decode())
        told = {"view" if what == "clients" else what for what in await fresh.words()}


@router.get(
    "/sessions/{session_id}/views/{view_id}/scene.html",
    response_class=HTMLResponse,
    operation_id="get_view_scene",
    summary="The scene as a page that needs no server",
    description="What the view shows now, to be kept or sent: it can be looked at from all sides, but does not change.",
    responses=answer("The page.", content={"text/html": {"schema": {"type": "string"}}}) | responses(404, 409),
)
def get_view_scene(session_id: SourceId, view_id: ViewId, request: Request) -> Response:
    """Draw, and write down what was drawn."""
    with _view(request, session_id, view_id) as view:
        painter = _views(request).painter(view)
        if painter is None:
            raise HttpProblem(404, f"view '{view_id}' is closed")
        text = painter.html()
        stem = safe_name(f"{session_id}-{0 if view.drawn is None else view.drawn.iteration}.html")
    headers = {"Content-Security-Policy": VIEW_POLICY, "Content-Disposition": f'attachment; filename="{stem}"'}
    return HTMLResponse(text, headers=headers)


@contextmanager
def _view(request: Request, session_id: str, view_id: str) -> Iterator[View]:
    """A view, kept open while a call looks at it."""
    views = _views(request)
    view = views.keep(session_id, view_id, sessions_of(request).get)
    try:
        yield view
    finally:
        views.release(view)


def _views(request: Request) -> Views:
    views: Views = request.app.state.views
    return views


def _check(change: dict[str, Any], source: Source, request: Request) -> None:
    """Whether what is named is there: parts, the edge, the prior's link, the session to compare with."""
    if change.get("compare") is not None:
        sessions_of(request).get(change["compare"]["session_id"])
    if not any(change.get(member) is not None for member in ("part", "edge", "prior")):
        return
    model = source.archive.read().problem.mrf.model
    if change.get("prior") is not None:
        load_prior(change["prior"], model)
    for name in [change.get("part"), *(change.get("edge") or ())]:
        if name is not None and name not in [part.name for part in model.parts]:
            raise ViewStateError(
                f"part {name!r:.60} is not in the model; it has {', '.join(part.name for part in model.parts)}"
            )
    _check_edge(change.get("edge"), model)


def _check_edge(edge: list[str] | None, model: ArticulatedObject) -> None:
    pairs = [(model.parts[one.parent].name, model.parts[one.child].name) for one in model.edges]
    if edge is not None and set(edge) not in [set(pair) for pair in pairs]:
        known = ", ".join(f"{parent}-{child}" for parent, child in pairs)
        raise ViewStateError(f"no joint connects {edge[0]!r:.60} and {edge[1]!r:.60}; there are {known or 'none'}")
