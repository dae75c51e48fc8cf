"""How does an upload become an entry of the store? It streams to disk, a process of its own reads it, then it lands."""

from __future__ import annotations

import asyncio
import hashlib
import math
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import anyio.to_thread
from fastapi import Request, Response

from app.problems import HttpProblem
from app.rate_limit import Shares, client_of
from app.server_config import ServerConfig
from app.store.idempotency import Call, call_key
from app.store.store import Document, Kind, Staging, Store
from app.uploads.multipart import Upload, receive
from app.uploads.parsers import Parsers

# Uploads that are read at once. More would only make all of them late on a machine of few cores.
AT_ONCE = 4
# Shares of `parse_seconds`: for the wait before an upload is read, and for reading it. The rest is for the answer.
_WAITING, _READING = 0.2, 0.7


def parsers_for(config: ServerConfig) -> Parsers:
    """Processes that read what a server with this `config` takes in."""
    return Parsers(config.parse_bytes, config.parse_seconds * _READING)


class Uploads:
    """Takes in uploads, a bounded number at once."""

    def __init__(self, store: Store, config: ServerConfig, parsers: Parsers) -> None:
        self._store = store
        self._config = config
        self._parsers = parsers
        self._slots = asyncio.Semaphore(AT_ONCE)
        self._under_way = Shares()

    async def take_in(self, request: Request, response: Response, kind: Kind) -> Document:
        """The entry that the form of `request` makes in the store's folder `kind`; sets Location and ETag.

        The same call again, told by its Idempotency-Key, makes no second entry. Raises HttpProblem as
        `multipart.receive`, `Parsers.parse` and the store do; 429 where too many uploads come in or wait to be read.
        """
        client = client_of(request.scope)
        self._check_shares(client)
        with self._under_way.one(client):
            return await self._taken_in(request, response, kind)

    def _check_shares(self, client: str) -> None:
        detail = None
        if self._under_way.each[client] >= self._config.max_uploads_each:
            detail = f"{self._config.max_uploads_each} uploads of this client are under way already (max_uploads_each)"
        elif self._under_way.all >= self._config.max_uploads:
            detail = f"{self._config.max_uploads} uploads are under way already (max_uploads)"
        if detail is not None:
            raise HttpProblem(429, f"{detail}; send this one again later", headers={"Retry-After": "5"})

    async def _taken_in(self, request: Request, response: Response, kind: Kind) -> Document:
        path = f"/api/v1/{kind}"
        key = call_key(f"POST {path}", request.headers.get("idempotency-key"))
        with self._store.staging() as staging:
            fields = ("camera",) if kind == "scans" else ()
            upload = await receive(request, staging, self._config.max_upload_bytes, fields)
            fingerprint = "\n".join([upload.sha256, upload.file_name, upload.fields.get("camera", "")])
            async with self._slot():
                # waited for even where the client goes away: `staging` has to outlive it
                document = await anyio.to_thread.run_sync(
                    self._store.idempotency.once, key, fingerprint, lambda call: self._read(kind, upload, staging, call)
                )
        response.headers["Location"] = f"{path}/{document['id']}"
        response.headers["ETag"] = etag(document)
        return document

    @asynccontextmanager
    async def _slot(self) -> AsyncIterator[None]:
        patience = self._config.parse_seconds * _WAITING
        try:
            async with asyncio.timeout(patience):
                await self._slots.acquire()
        except TimeoutError:
            raise HttpProblem(
                429,
                f"{AT_ONCE} uploads are being read and more wait; send this one again later",
                headers={"Retry-After": str(math.ceil(patience))},
            ) from None
        try:
            yield
        finally:
            self._slots.release()

    def _read(self, kind: Kind, upload: Upload, staging: Staging, call: Call | None) -> Document:
        beside = staging.folder / "beside"
        beside.mkdir()
        camera, out = None, beside / "scan.npz"
        if upload.fields.get("camera", "").strip():  # a form's empty field says nothing
            camera = beside / "camera.json"
            camera.write_text(upload.fields["camera"], encoding="utf-8")
        summary = self._parsers.parse(kind, upload.path, out, camera)
        if kind == "scans":
            staging.claim(out.stat().st_size)
        return self._store.add(kind, out if kind == "scans" else upload.path, upload.file_name, summary, call)


def etag(document: Document) -> str:
    """The entity tag of an entry: of its content, which never changes, and of its name, which a recording's may."""
    told = f"{document['sha256']} {document.get('name', '')}"
    return f'"{hashlib.sha256(told.encode()).hexdigest()}"'


def unchanged(request: Request, tag: str) -> bool:
    """Whether the client says, by If-None-Match, that it has what `tag` is the entity tag of."""
    given = request.headers.get("if-none-match", "")
    tags = [one.strip().removeprefix("W/") for one in given.split(",")]
    return "*" in tags or tag in tags
