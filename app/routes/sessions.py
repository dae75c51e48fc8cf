"""Sessions: make, list, delete, and tell them what to do."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel

from app.documentation import answer
from app.problems import responses
from app.routes.entries import not_modified, tellable
from app.routes.once import CallOnce, Once
from app.routes.parameters import LiveSession, SessionId, sessions_of
from app.schemas import AddScanRequest, ChangeRequest, ResetRequest, RunRequest, Session, SessionRequest, StepRequest
from app.uploads.uploads import unchanged
from pmpnbp.json_text import json_bytes

_BUSY = responses(404, status_409="The session's state does not allow it; the detail names the state.")
_LOCATION = {"Location": {"description": "path of the session", "schema": {"type": "string"}}}
_ETAG = {"ETag": {"description": "of the list as it is now", "schema": {"type": "string"}}}
_COUNT = {"X-Total-Count": {"description": "how many there are to begin with", "schema": {"type": "integer"}}}
_LIST: dict[int | str, dict[str, Any]] = {
    200: {"headers": _ETAG | _COUNT},
    304: {"description": "The list is the one that If-None-Match names.", "headers": _ETAG},
}
MADE = answer("Made, and safe on the disk.", status=201, headers=_LOCATION)

router = APIRouter(prefix="/api/v1", tags=["sessions"])
commands = APIRouter(prefix="/sessions/{session_id}", responses=_BUSY)


@router.post(
    "/sessions",
    status_code=201,
    response_model=Session,
    summary="Make a session",
    responses=MADE | responses(404, 409, 507),
)
def create_session(body: SessionRequest, request: Request, response: Response, once: Once) -> Any:
    """It is at iteration 0, the start, and paused; `run` or `step` makes it iterate."""
    members = body.model_dump()
    document = once.made(body, lambda call: sessions_of(request).create(members, call).status())
    response.headers["Location"] = f"/api/v1/sessions/{document['id']}"
    return document


@router.get("/sessions", response_model=list[Session], summary="All sessions", responses=_LIST)
def list_sessions(
    request: Request,
    tag: Annotated[
        list[str] | None, Query(max_length=20, description="only those that have this tag; several: all of them")
    ] = None,
    limit: Annotated[int | None, Query(ge=1, le=10_000, description="sessions, at most; default: all")] = None,
    offset: Annotated[int, Query(ge=0, le=1_000_000, description="sessions left out, the oldest")] = 0,
) -> Response:
    """Oldest first, damaged ones too. Whoever asks again and again asks with If-None-Match, as browsers do."""
    found = sessions_of(request).list(tag or ())
    total = str(len(found))
    # written here: that the framework checks and writes it again takes four times as long, which counts with hundreds
    content = json_bytes(tellable(Session, found[offset:][:limit]))
    version = f'"{hashlib.sha256(content + total.encode()).hexdigest()}"'
    if unchanged(request, version):
        return not_modified(version)
    return Response(content, media_type="application/json", headers={"ETag": version, "X-Total-Count": total})


@router.get("/sessions/{session_id}", response_model=Session, summary="One session", responses=responses(404))
def get_session(session_id: SessionId, request: Request) -> Any:
    """What it was made of and how far it is. The id of an uploaded recording stands for a session that can be read, and
    only read: its state is `recorded`, and calls that would change it are answered 409."""
    return sessions_of(request).get(session_id).status()


@router.delete(
    "/sessions/{session_id}",
    status_code=204,
    summary="Delete a session",
    responses=responses(404, status_409="It is an uploaded recording."),
)
def delete_session(session_id: SessionId, request: Request) -> None:
    """Stops it after its present iteration, and whatever is being read out; its recording goes with it. An uploaded
    recording is deleted by DELETE /api/v1/recordings/{id}."""
    sessions_of(request).delete(session_id)
    request.app.state.views.close_session(session_id)


@commands.post("/run", status_code=202, response_model=Session, summary="Iterate in the background")
def run_session(session: LiveSession, once: Once, body: RunRequest | None = None) -> Any:
    """Answers at once. A session that finds too many others running waits, first come, first served."""
    wanted = body or RunRequest()  # type: ignore[call-arg]  # every member has a default
    return _done(once, body, session, lambda: session.run(wanted.iterations, wanted.until))


@commands.post("/step", response_model=Session, summary="Iterate, and wait for it")
def step_session(session: LiveSession, once: Once, body: StepRequest | None = None) -> Any:
    """Answers after the last of the iterations, or when it is paused before."""
    return _done(once, body, session, lambda: session.step(1 if body is None else body.iterations).result())


@commands.post("/pause", response_model=Session, summary="Stop after the present iteration")
def pause_session(session: LiveSession, once: Once) -> Any:
    """Answers once that iteration is recorded. One whose posterior is being read out is not waited for: the next run
    makes it anew, to the same numbers. Nothing happens where the session does not run."""
    return _done(once, None, session, lambda: session.pause().result())


@commands.post("/reset", response_model=Session, summary="Begin anew", responses=responses(507))
def reset_session(session: LiveSession, once: Once, body: ResetRequest | None = None) -> Any:
    """Back to iteration 0 with the settings and scans now in force, in any state. The old recording goes. Members that
    are named replace those that the session was made with: so a session made without a region is given one that
    GET regions proposes."""
    members = {} if body is None else body.model_dump(include=body.model_fields_set)
    return _done(once, body, session, lambda: session.reset(members).result())


@commands.patch("", response_model=Session, summary="Change settings, name or tags", responses=responses(507))
def change_session(session: LiveSession, once: Once, body: ChangeRequest) -> Any:
    """Settings count from the next iteration on, in any state. Those that are not named stay; a preset resets them all.
    Name and tags are others at once, and the call waits for no iteration where it brings nothing else; `tags` are all
    that the session then has."""
    labels = body.model_dump(include={"name", "tags"} & body.model_fields_set)
    if "config" in body.model_fields_set:
        return _done(once, body, session, lambda: session.change(body.config, labels).result())
    return _done(once, body, session, lambda: session.label(labels))


@commands.post(
    "/scans",
    response_model=Session,
    summary="Give it another scan",
    responses=responses(507, status_404="The session or the scan is not here.", status_409="It has this scan already."),
)
def add_session_scan(session: LiveSession, once: Once, body: AddScanRequest) -> Any:
    """A scan in the same world frame, from the next iteration on: a further view of the same scene, or one that counts
    instead of all before it, as the scene has changed. The belief carries on from where it is. Where the scan confirms
    too little of it, the search begins again; the trace's `notes` say so."""
    return _done(once, body, session, lambda: session.add_scan(body.scan_id, body.mode).result())


def _done(once: CallOnce, body: BaseModel | None, session: LiveSession, command: Callable[[], None]) -> dict[str, Any]:
    """The session's status after `command`."""

    def act() -> dict[str, Any]:
        command()
        return session.status()

    return once.done(body, act)


router.include_router(commands)
