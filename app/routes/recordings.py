"""Recordings that were made elsewhere, uploaded to be looked at."""

from __future__ import annotations

from pathlib import PurePath
from typing import Any

from fastapi import Request, Response
from pydantic import Field

from app.documentation import BINARY
from app.http.file_answers import FileAnswer
from app.problems import responses
from app.routes.attachments import attachment
from app.routes.entries import IF_NONE_MATCH, Stored, entry_routes, form, not_modified, store_of
from app.routes.parameters import sessions_of
from app.schemas import RenameRequest
from app.uploads.uploads import etag, unchanged

MEDIA_TYPE = "application/vnd.sqlite3"
FILE: dict[int | str, dict[str, Any]] = {
    **IF_NONE_MATCH,
    200: {**IF_NONE_MATCH[200], "description": "The file.", "content": {MEDIA_TYPE: BINARY}},
}


class Recording(Stored):
    """An uploaded recording."""

    name: str | None = Field(None, description="what people call it; null where nobody has named it but by its file")
    model: str = Field(description="name of its model", examples=["cabinet"])
    method: str = Field(description="pmpnbp or particle_filter", examples=["pmpnbp"])
    particles: int = Field(description="of each part", examples=[400])
    seed: int = Field(description="of its random numbers", examples=[0])
    parts: list[str] = Field(description="nodes of the Markov random field", examples=[["frame", "drawer1"]])
    scans: int = Field(description="how many views it holds", examples=[1])
    iterations: int = Field(description="how many iterations can be read", examples=[101])
    first_iteration: int = Field(description="the first that is recorded", examples=[0])
    last_iteration: int = Field(description="the last that is recorded", examples=[100])
    notes: list[str] = Field(description="what its writer had to say")


router = entry_routes(
    "recordings",
    Recording,
    "The file that `pmpnbp estimate --recording` or a session's download gives.",
    form("the recording, one SQLite file"),
    uploaded="uploaded",
    listed="Those of sessions are not among them.",
)


@router.get(
    "/recordings/{recording_id}/file",
    response_class=FileAnswer,
    summary="Download an uploaded recording",
    responses=FILE | responses(404, 416),
)
def download_recording(recording_id: str, request: Request) -> Response:
    """The SQLite file, byte for byte as it was uploaded."""
    document = store_of(request).document("recordings", recording_id)
    if unchanged(request, etag(document)):
        return not_modified(etag(document))
    name = PurePath(document["file_name"]).stem + ".sqlite"
    file = store_of(request).file("recordings", recording_id)
    return FileAnswer(file, media_type=MEDIA_TYPE, headers=attachment(name) | {"ETag": etag(document)})


@router.patch(
    "/recordings/{recording_id}",
    response_model=Recording,
    summary="Rename an uploaded recording",
    responses=responses(404, 507),
)
def rename_recording(recording_id: str, body: RenameRequest, request: Request) -> Any:
    """Its file stays as it is, and so does the name that this is downloaded by."""
    return sessions_of(request).rename_recording(recording_id, body.name)


@router.delete(
    "/recordings/{recording_id}", status_code=204, summary="Delete an uploaded recording", responses=responses(404)
)
def delete_recording(recording_id: str, request: Request) -> None:
    """Forget an uploaded recording."""
    store_of(request).delete("recordings", recording_id)
    sessions_of(request).forget_recording(recording_id)
    request.app.state.views.close_session(recording_id)
