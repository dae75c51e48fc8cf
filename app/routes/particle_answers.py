"""How do particles and draws answer a call? In the form that it asks for, with what they are of."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Query, Response

from app.documentation import BINARY
from app.particle_files import MEDIA_TYPES, Format
from app.routes.attachments import attachment
from app.sessions.source import Source
from pmpnbp.readout.snapshot import Snapshot

FormatQuery = Annotated[
    Format,
    Query(
        alias="format",
        description="json; npz with the arrays `particles` and `log_weights`; ply, a vertex with x y z qw qx qy qz "
        "log_weights each",
    ),
]
FILES = {"application/octet-stream": BINARY}


def members_of(session: Source, snapshot: Snapshot) -> dict[str, Any]:
    """What every answer tells besides."""
    return {
        "session_id": session.id,
        "iteration": snapshot.iteration,
        "frame_id": snapshot.problem.observation.frame_id,
    }


def file_of(stem: str, content: bytes, form: Format) -> Response:
    """A file, called by its stem where a program keeps it."""
    headers = {} if form == "json" else attachment(f"{stem}.{form}")
    return Response(content, media_type=MEDIA_TYPES[form], headers=headers)
