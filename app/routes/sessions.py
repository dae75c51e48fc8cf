"""Sessions: make, list, delete, and tell them what to do."""

from __future__ import annotations

import hashlib
from typing import Annotated, Any

from fastapi import APIRouter, Header, Request, Response

from app.problems import responses
from app.routes.parameters import LiveSession, SessionId, sessions_of
from app.schemas import AddScanRequest, ChangeRequest, RunRequest, Session, SessionRequest, StepRequest, answer
from app.store.idempotency import call_key
from app.store.store import Store

router = APIRouter(prefix="/api/v1", tags=["sessions"])

_BUSY = "The session's state does not allow it; the detail names the state."
_LOCATION = {"Location": {"description": "path of the session", "schema": {"type": "string"}}}


@router.post(
    "/sessions",
    status_code=201,
    response_model=Session,
    operation_id="create_session",
    summary="Make a session",
    description="It is at iteration 0, the start, and paused; `run` or `step` makes it iterate.",
    responses=answer("Made, and safe on the disk.", status=201, headers=_LOCATION) | responses(404, 409, 507),
)
def create_session(
    body: SessionRequest,
    request: Request,
    response: Response,
    idempotency_key: Annotated[
        str | None,
        Header(description="makes the call safe to repeat for a day: the same key and content give the same answer"),
    ] = None,
) -> Any:
    """Make it, or tell what the same call made before."""
    store: Store = request.app.state.store
    path = "/api/v1/sessions"
    fingerprint = hashlib.sha256(body.model_dump_json().encode()).hexdigest()
    members = body.model_dump()
    document, _ = store.idempotency.once(
        call_key(f"POST {path}", idempotency_key), fingerprint, lambda: sessions_of(request).create(members).status()
    )
    response.headers["Location"] = f"{path}/{document['id']}"
    return document


@router.get(
    "/sessions",
    response_model=list[Session],
    operation_id="list_sessions",
    summary="All sessions",
    description="Oldest first, damaged ones too.",
)
def list_sessions(request: Request) -> Any:
    """Every session."""
    return sessions_of(request).list()


@router.get(
    "/sessions/{session_id}",
    response_model=Session,
    operation_id="get_session",
    summary="One session",
    description="What it was made of and how far it is. The id of an uploaded recording stands for a session that can "
    "be read, and only read: its state is `recorded`, and calls that would change it are answered 409.",
    responses=responses(404),
)
def get_session(session_id: SessionId, request: Request) -> Any:
    """One session."""
    return sessions_of(request).get(session_id).status()


@router.delete(
    "/sessions/{session_id}",
    status_code=204,
    operation_id="delete_session",
    summary="Delete a session",
    description="Stops it after its present iteration; its recording goes with it. An uploaded recording is deleted by "
    "DELETE /api/v1/recordings/{id}.",
    responses=responses(404, status_409="It is an uploaded recording."),
)
def delete_session(session_id: SessionId, request: Request) -> Response:
    """Stop and forget it."""
    sessions_of(request).delete(session_id)
    request.app.state.views.close_session(session_id)
    return Response(status_code=204)


@router.post(
    "/sessions/{session_id}/run",
    status_code=202,
    response_model=Session,
    operation_id="run_session",
    summary="Iterate in the background",
    description="Answers at once. A session that finds too many others running waits, first come, first served.",
    responses=responses(404, status_409=_BUSY),
)
def run_session(session: LiveSession, body: RunRequest | None = None) -> Any:
    """Set it going."""
    wanted = body or RunRequest()  # type: ignore[call-arg]  # every member has a default
    session.run(wanted.iterations, wanted.until)
    return session.status()


@router.post(
    "/sessions/{session_id}/step",
    response_model=Session,
    operation_id="step_session",
    summary="Iterate, and wait for it",
    description="Answers after the last of the iterations.",
    responses=responses(404, status_409=_BUSY),
)
def step_session(session: LiveSession, body: StepRequest | None = None) -> Any:
    """Iterate."""
    session.step(1 if body is None else body.iterations).result()
    return session.status()


@router.post(
    "/sessions/{session_id}/pause",
    response_model=Session,
    operation_id="pause_session",
    summary="Stop after the present iteration",
    description="Answers once that iteration is recorded. Nothing happens where the session does not run.",
    responses=responses(404, status_409=_BUSY),
)
def pause_session(session: LiveSession) -> Any:
    """Stop it."""
    session.pause().result()
    return session.status()


@router.post(
    "/sessions/{session_id}/reset",
    response_model=Session,
    operation_id="reset_session",
    summary="Begin anew",
    description="Back to iteration 0 with the settings and scans now in force, in any state. The old recording goes.",
    responses=responses(404, 507, status_409=_BUSY),
)
def reset_session(session: LiveSession) -> Any:
    """Begin anew."""
    session.reset().result()
    return session.status()


@router.patch(
    "/sessions/{session_id}",
    response_model=Session,
    operation_id="change_session",
    summary="Change settings",
    description="From the next iteration on, in any state. Settings that are not named stay; a preset resets them all.",
    responses=responses(404, 507, status_409=_BUSY),
)
def change_session(session: LiveSession, body: ChangeRequest) -> Any:
    """Change settings."""
    session.change(body.config).result()
    return session.status()


@router.post(
    "/sessions/{session_id}/scans",
    response_model=Session,
    operation_id="add_session_scan",
    summary="Add a view",
    description="A further scan of the same scene in the same world frame, from the next iteration on; the belief "
    "carries on from where it is.",
    responses=responses(507, status_404="The session or the scan is not here.", status_409="It has this scan already."),
)
def add_session_scan(session: LiveSession, body: AddScanRequest) -> Any:
    """Add a view."""
    session.add_scan(body.scan_id).result()
    return session.status()
