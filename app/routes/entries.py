"""What models, scans and recordings have in common over REST: uploads by form, entries that never change."""

from __future__ import annotations

from typing import Any

from fastapi import Request, Response
from pydantic import BaseModel, Field

from app.store.store import Document
from app.uploads.uploads import etag, unchanged

_ETAG = {"ETag": {"description": "of the entry, which never changes", "schema": {"type": "string"}}}

IF_NONE_MATCH: dict[int | str, dict[str, Any]] = {
    200: {"headers": _ETAG},
    304: {"description": "The entry is the one that If-None-Match names.", "headers": _ETAG},
}


class Stored(BaseModel):
    """What every entry of the store has."""

    id: str = Field(description="16 hexadecimal digits", examples=["0123456789abcdef"])
    file_name: str = Field(description="as the sender called the file", examples=["cabinet.urdf"])
    created: str = Field(description="when it was taken in, UTC, ISO 8601", examples=["2024-05-01T12:00:00.000Z"])
    sha256: str = Field(description="of what is kept, hexadecimal")
    bytes: int = Field(description="size of what is kept", examples=[4096])


def created(model: type[BaseModel]) -> dict[int | str, dict[str, Any]]:
    """Documentation of the answer 201 with a `model`."""
    location = {"Location": {"description": "path of the entry", "schema": {"type": "string"}}}
    return {201: {"model": model, "description": "Taken in, and safe on the disk.", "headers": location | _ETAG}}


def form(file: str, **fields: str) -> dict[str, Any]:
    """Documentation of a form with the part `file`, described by `file`, and text `fields`, each with its meaning."""
    properties = {"file": {"type": "string", "format": "binary", "description": file}}
    properties |= {name: {"type": "string", "description": meaning} for name, meaning in fields.items()}
    schema = {"type": "object", "required": ["file"], "properties": properties, "additionalProperties": False}
    key = {
        "name": "Idempotency-Key",
        "in": "header",
        "required": False,
        "description": "makes the call safe to repeat for a day: the same key and content give the same answer",
        "schema": {"type": "string", "minLength": 1, "maxLength": 255},
    }
    body = {"required": True, "content": {"multipart/form-data": {"schema": schema}}}
    return {"requestBody": body, "parameters": [key]}


def unchanged_or(request: Request, response: Response, document: Document) -> Any:
    """`document` with its ETag, or the answer 304 where the client has it."""
    if unchanged(request, document):
        return Response(status_code=304, headers={"ETag": etag(document)})
    response.headers["ETag"] = etag(document)
    return document
