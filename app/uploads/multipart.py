"""What did a form bring? Streams `multipart/form-data` to a file as it comes in, never whole in memory."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from pathlib import Path

import anyio.to_thread
from fastapi import Request
from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.requests import ClientDisconnect

from app.problems import HttpProblem
from app.store.store import Staging, safe_name
from pmpnbp.errors import storage_told

# Written at once; bounds what an upload takes of the server's memory.
_CHUNK = 1 << 20
_LARGEST_FIELD = 1 << 20
_LARGEST_FRAME = 1 << 14  # boundaries and headers between the parts

# It warns of every malformed form, which whoever sent it is told of.
logging.getLogger("python_multipart").setLevel(logging.ERROR)


@dataclass(frozen=True)
class Upload:
    """A form's file and fields.

    path : the file, alone in a folder under the staging folder; file_name : as its sender calls it; sha256 : of its
        bytes; fields : text by name
    """

    path: Path
    file_name: str
    sha256: str
    fields: dict[str, str]


@dataclass
class _Part:
    headers: dict[bytes, bytes] = field(default_factory=dict)
    name: str = ""
    file_name: str | None = None
    text: bytearray = field(default_factory=bytearray)


async def receive(request: Request, staging: Staging, max_bytes: int, fields: tuple[str, ...] = ()) -> Upload:
    """The form of `request`: its part `file` in the folder of `staging`, its other parts, of which there may be
    `fields`, as text.

    Raises HttpProblem: 400 malformed, 408 too slow (`bodies`), 413 larger than `max_bytes`, 415 no form, 422 parts
    that are missing or unknown, 507 no room; StorageError.
    """
    kind, options = parse_options_header(request.headers.get("content-type"))
    if kind != b"multipart/form-data":
        came = request.headers.get("content-type") or "no type"
        raise HttpProblem(415, f"the body is '{came:.60}'; expected multipart/form-data with the part 'file'")
    boundary = options.get(b"boundary", b"")
    if not 1 <= len(boundary) <= 70:
        raise HttpProblem(400, "the form names no boundary of 1 to 70 characters between its parts")
    length = request.headers.get("content-length", "")
    if length.isdecimal() and int(length) > max_bytes + _LARGEST_FIELD + _LARGEST_FRAME:
        raise too_large(max_bytes)
    try:
        return await _Form(boundary, staging, max_bytes, fields).read(request.stream())
    except ClientDisconnect:
        raise HttpProblem(400, "the upload ended before its last byte") from None


def too_large(max_bytes: int) -> HttpProblem:
    """The answer to an upload beyond the limit."""
    size = f"{max_bytes / (1 << 20):g} MiB" if max_bytes >= 1 << 20 else f"{max_bytes} bytes"
    return HttpProblem(413, f"the upload is larger than {size}, the most that this server takes")


class _Form:
    """A form while it comes in: the parser's callbacks note what there is, `read` writes it."""

    def __init__(self, boundary: bytes, staging: Staging, max_bytes: int, fields: tuple[str, ...]) -> None:
        self._staging = staging
        self._max_bytes = max_bytes
        self._known = ("file", *fields)
        self._fields: dict[str, str] = {}
        self._part: _Part | None = None
        self._header = (bytearray(), bytearray())
        self._pending = bytearray()
        self._size = 0
        self._hash = hashlib.sha256()
        self._file_name: str | None = None
        self._path: Path | None = None
        self._ended = False
        self._parser = MultipartParser(
            boundary,
            {
                "on_part_begin": self._begin,
                "on_header_field": lambda data, start, end: self._header_bytes(0, data[start:end]),
                "on_header_value": lambda data, start, end: self._header_bytes(1, data[start:end]),
                "on_header_end": self._header_end,
                "on_headers_finished": self._headers_finished,
                "on_part_data": self._data,
                "on_part_end": self._end,
                "on_end": self._all,
            },
        )

    async def read(self, stream: AsyncIterator[bytes]) -> Upload:
        """Take in the whole form."""
        async for chunk in stream:
            try:
                self._parser.write(chunk)
            except FormParserError as error:
                raise HttpProblem(400, f"the form is malformed: {error}") from None
            if len(self._pending) >= _CHUNK:
                await self._write()
        if not self._ended:
            raise HttpProblem(400, "the form ends before its last boundary")
        if self._path is None:
            raise HttpProblem(422, "the form has no part 'file'; expected the file to upload")
        if not self._size:
            raise HttpProblem(422, f"the file '{self._file_name or ''}' is empty")
        await self._write()
        return Upload(self._path, self._file_name or "", self._hash.hexdigest(), self._fields)

    async def _write(self) -> None:
        pending, self._pending = self._pending, bytearray()
        await anyio.to_thread.run_sync(self._append, pending)

    def _append(self, pending: bytearray) -> None:
        assert self._path is not None
        self._staging.claim(len(pending))
        with storage_told(), self._path.open("ab") as file:
            file.write(pending)
        self._hash.update(pending)

    # The parser's callbacks

    def _begin(self) -> None:
        self._part = _Part()

    def _header_bytes(self, which: int, data: bytes) -> None:
        self._header[which].extend(data)  # the parser bounds their length and number

    def _header_end(self) -> None:
        assert self._part is not None
        name, value = self._header
        self._part.headers[bytes(name).lower()] = bytes(value)
        self._header = (bytearray(), bytearray())

    def _headers_finished(self) -> None:
        assert self._part is not None
        kind, options = parse_options_header(self._part.headers.get(b"content-disposition"))
        if kind != b"form-data" or b"name" not in options:
            raise HttpProblem(400, "a part of the form has no name")
        self._part.name = options[b"name"].decode("utf-8", "replace")
        name = self._part.name
        if name not in self._known:
            raise HttpProblem(422, f"the form has a part '{name:.40}'; expected {' and '.join(self._known)}")
        if name in self._fields or (name == "file" and self._path is not None):
            raise HttpProblem(422, f"the form has the part '{name}' twice; expected it once")
        if name == "file":
            self._file_name = options.get(b"filename", b"").decode("utf-8", "replace")[:255]
            folder = self._staging.folder / "file"
            folder.mkdir()
            self._path = folder / safe_name(self._file_name)
            self._path.touch()

    def _data(self, data: bytes, start: int, end: int) -> None:
        assert self._part is not None
        if self._part.name == "file":
            self._size += end - start
            if self._size > self._max_bytes:
                raise too_large(self._max_bytes)
            self._pending += data[start:end]
            return
        self._part.text += data[start:end]
        if len(self._part.text) > _LARGEST_FIELD:
            raise HttpProblem(413, f"the form's part '{self._part.name}' is larger than {_LARGEST_FIELD} bytes")

    def _end(self) -> None:
        assert self._part is not None
        if self._part.name != "file":
            try:
                self._fields[self._part.name] = self._part.text.decode("utf-8")
            except UnicodeDecodeError:
                raise HttpProblem(422, f"the form's part '{self._part.name}' is not UTF-8 text") from None
        self._part = None

    def _all(self) -> None:
        self._ended = True
