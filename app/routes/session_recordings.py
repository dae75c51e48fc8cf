"""A session's recording as a file, copied while the session goes on."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO

from fastapi import APIRouter, Request
from fastapi.responses import StreamingResponse
from starlette.types import Receive, Scope, Send

from app.documentation import BINARY, answer
from app.problems import responses
from app.routes.attachments import attachment
from app.routes.parameters import SessionId, sessions_of
from app.routes.recordings import MEDIA_TYPE
from app.routes.turns import LongTurnRoute
from app.store.atomic_files import there
from pmpnbp.errors import storage_told

# forty copies at once took 350 MB, and left a session a hundredth of its rate
router = APIRouter(prefix="/api/v1/sessions/{session_id}", tags=["results"], route_class=LongTurnRoute)

# Bytes sent at a time.
_CHUNK = 1 << 18


@router.get(
    "/recording",
    response_class=StreamingResponse,
    summary="The session as a file",
    responses=answer("A SQLite file.", content={MEDIA_TYPE: BINARY}) | responses(404, 409, 507),
)
def get_recording_of_session(session_id: SessionId, request: Request) -> StreamingResponse:
    """A consistent copy, also while the session runs: model, scans, settings and every iteration so far. POST
    /api/v1/recordings takes it, and `pmpnbp view` opens it."""
    # the copy has no name any more when it is sent: nothing is left of it, however the call ends
    session = sessions_of(request).get(session_id)
    title = f"{session.status()['name'] or session.id}.sqlite"
    with storage_told(), TemporaryDirectory(dir=there(request.app.state.store.root / "incoming")) as folder:
        copy = Path(folder) / "recording.sqlite"
        session.archive.copy_to(copy)
        file = copy.open("rb")
    return _FileSent(file, attachment(title) | {"Content-Length": str(os.fstat(file.fileno()).st_size)})


class _FileSent(StreamingResponse):
    """An open file, closed at once also where its client goes away, and not when its memory is collected some day."""

    def __init__(self, file: BinaryIO, headers: Mapping[str, str]) -> None:
        super().__init__(iter(lambda: file.read(_CHUNK), b""), media_type=MEDIA_TYPE, headers=headers)
        self._file = file

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        with self._file:
            await super().__call__(scope, receive, send)
