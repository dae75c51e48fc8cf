"""What models, scans and recordings have in common over REST: uploads by form, entries whose content never changes."""

# without `from __future__ import annotations`: the framework evaluates those of the routes, which name their factory's
# variables
from collections.abc import Iterable
from contextlib import suppress
from typing import Annotated, Any

from fastapi import APIRouter, Path, Request, Response
from pydantic import BaseModel, Field, ValidationError

from app.documentation import answer
from app.problems import HttpProblem, responses
from app.routes.once import SAFE_TO_REPEAT
from app.store.store import KINDS, Document, Kind, Store
from app.uploads.uploads import Uploads, etag, unchanged

_ETAG = {
    "ETag": {
        "description": "of the entry as it is named now; all else of it never changes",
        "schema": {"type": "string"},
    }
}
_NEW = {"Location": {"description": "path of the entry", "schema": {"type": "string"}}} | _ETAG

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


def entry_routes(
    kind: Kind, schema: type[Stored], upload: str, form: dict[str, Any], *, uploaded: str = "", listed: str = ""
) -> APIRouter:
    """The routes by which entries of a kind are uploaded, listed and read.

    upload : what can be uploaded; form : as `form` makes it
    uploaded : a word that goes before the noun where a session makes such things too; listed : what else the list is
    """
    noun = KINDS[kind]
    called, path = f"{uploaded} {noun}".strip(), f"/{kind}/{{{noun}_id}}"
    router = APIRouter(prefix="/api/v1", tags=[kind])

    @router.post(
        f"/{kind}",
        status_code=201,
        response_model=schema,
        name=f"create_{noun}",
        summary=f"Upload a {noun}",
        description=upload,
        responses=answer("Taken in, and safe on the disk.", status=201, model=schema, headers=_NEW)
        | responses(408, 409, 413, 415, 507, status_503="The process that reads it was killed; send it again."),
        openapi_extra=form,
    )
    async def create(request: Request, response: Response) -> Any:
        """Take in the parts of the form."""
        uploads: Uploads = request.app.state.uploads
        return await uploads.take_in(request, response, kind)

    @router.get(
        f"/{kind}",
        response_model=list[schema],  # type: ignore[valid-type]
        name=f"list_{kind}",
        summary=f"All {called}s",
        description=f"Oldest first. {listed}".strip(),
    )
    def list_all(request: Request) -> Any:
        """Every entry's document but those that are damaged."""
        return tellable(schema, store_of(request).documents(kind))

    @router.get(
        path,
        response_model=schema,
        name=f"get_{noun}",
        summary=f"One {called}",
        description="Never changes, but for a recording's name, as its ETag says: ask with If-None-Match.",
        responses=IF_NONE_MATCH | responses(404),
    )
    def get(id: Annotated[str, Path(alias=f"{noun}_id")], request: Request, response: Response) -> Any:
        """An entry's document, or 304."""
        document = store_of(request).document(kind, id)
        if not tellable(schema, [document]):
            raise HttpProblem(404, f"{noun} '{id}' is damaged: its {noun}.json does not tell what a {noun}'s does")
        if unchanged(request, etag(document)):
            return not_modified(etag(document))
        response.headers["ETag"] = etag(document)
        return document

    return router


def add_deletion(router: APIRouter, kind: Kind) -> None:
    """The route by which an entry that sessions may use is deleted."""
    noun = KINDS[kind]

    @router.delete(
        f"/{kind}/{{{noun}_id}}",
        status_code=204,
        name=f"delete_{noun}",
        summary=f"Delete a {noun}",
        description="Only where no session uses it.",
        responses=responses(404, status_409="A session uses it; the detail names it."),
    )
    def delete(id: Annotated[str, Path(alias=f"{noun}_id")], request: Request) -> None:
        """Forget an entry."""
        store_of(request).delete(kind, id)


def form(file: str, **fields: str) -> dict[str, Any]:
    """Documentation of a form with the part `file`, described by `file`, and text `fields`, each with its meaning."""
    properties = {"file": {"type": "string", "format": "binary", "description": file}}
    properties |= {name: {"type": "string", "description": meaning} for name, meaning in fields.items()}
    schema = {"type": "object", "required": ["file"], "properties": properties, "additionalProperties": False}
    key = {
        "name": "Idempotency-Key",
        "in": "header",
        "required": False,
        "description": SAFE_TO_REPEAT,
        "schema": {"type": "string", "minLength": 1, "maxLength": 255},
    }
    body = {"required": True, "content": {"multipart/form-data": {"schema": schema}}}
    return {"requestBody": body, "parameters": [key]}


def tellable(schema: type[BaseModel], documents: Iterable[Document]) -> list[Document]:
    """Those of the documents that say what `schema` asks for: a damaged one must not take the list of all away."""
    found = []
    for document in documents:
        with suppress(ValidationError):
            schema.model_validate(document)
            found.append(document)
    return found


def store_of(request: Request) -> Store:
    """The server's store."""
    return request.app.state.store


def not_modified(tag: str) -> Response:
    """The answer 304."""
    return Response(status_code=304, headers={"ETag": tag})
