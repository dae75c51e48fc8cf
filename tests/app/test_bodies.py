"""How large may a body be, how slow, and of what kind?"""

from __future__ import annotations

import asyncio
import gzip
import json
import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest
from starlette.types import Message, Receive, Scope, Send

from app.http.bodies import JSON_BYTES, Bodies
from app.server_config import ServerConfig
from tests.app.raw_http import connect, everything, head, problem
from tests.app.upload_calls import detail, nothing_kept

JSON = {"Content-Type": "application/json"}
BODY_SECONDS = 0.4
UPLOAD = ("Content-Type: multipart/form-data; boundary=b", "Content-Length: 9000000")
FILE = b'--b\r\nContent-Disposition: form-data; name="file"; filename="a.pcd"\r\n\r\n'


@pytest.fixture(scope="module")
def served(serve_for_module: Callable[..., Any]) -> Any:
    return serve_for_module(body_seconds=BODY_SECONDS, header_seconds=30.0)


def pieces(size: int) -> Iterator[bytes]:
    """A body that does not say its length."""
    for _ in range(size >> 16):
        yield b"[" * (1 << 16)


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("POST", "/api/v1/sessions"),
        ("POST", "/api/v1/sessions/0123456789abcdef/pause"),
        ("GET", "/api/v1/sessions"),
        ("DELETE", "/api/v1/models/0123456789abcdef"),
        ("POST", "/nowhere"),
        ("PUT", "/api/v1/models"),
    ],
)
def test_a_body_that_is_no_upload_ends_at_1_mib(served: Any, method: str, path: str) -> None:
    said = "the body is larger than 1 MiB"
    for content in (b"[" * (JSON_BYTES + 1), pieces(3 * JSON_BYTES)):
        answer = served.client.request(method, path, content=content, headers=JSON)
        assert said in detail(answer, 413)


def test_too_large_a_body_is_refused_before_it_comes(served: Any) -> None:
    with connect(served) as connection:
        connection.sendall(head("POST", "/api/v1/sessions", f"Content-Length: {48 << 20}"))
        assert problem(connection)[0] == 413


def test_a_body_of_1_mib_is_read(served: Any) -> None:
    fitting = json.dumps({"model_id": "x" * 10}).encode()
    fitting += b" " * (JSON_BYTES - len(fitting))
    assert "scan_ids in the body" in detail(served.client.post("/api/v1/sessions", content=fitting, headers=JSON), 422)


@pytest.mark.parametrize("content", [b"[" * JSON_BYTES, b'{"a":' * 200_000, b"\xff\xfe", b"1" * JSON_BYTES, b"nan\0"])
def test_what_is_no_json_is_malformed(served: Any, content: bytes) -> None:
    detail(served.client.post("/api/v1/sessions", content=content, headers=JSON), 400)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [(b'{"name": "\xe9"}', "not text in UTF-8"), (b'{"seed": %s}' % (b"9" * 4400), "thousands of digits")],
)
def test_what_is_wrong_with_text_that_is_no_json_is_said(served: Any, content: bytes, sentence: str) -> None:
    assert sentence in detail(served.client.post("/api/v1/sessions", content=content, headers=JSON), 400)


@pytest.mark.parametrize("depth", [200, 300, 900, 5000])
@pytest.mark.parametrize(
    ("before", "after"),
    [('"prior": {"kind": "gaussian", "link": "frame", "joints": ', "}"), ('"truth": {"links": ', "}")],
)
def test_brackets_however_deep_are_the_callers_fault(served: Any, depth: int, before: str, after: str) -> None:
    """What is read is written once more for its fingerprint, which goes less deep than reading does."""
    content = f'{{"model_id": "0", "scan_ids": ["0"], {before}{"[" * depth}{"]" * depth}{after}}}'
    answer = served.client.post("/api/v1/sessions", content=content, headers={"Content-Type": "application/json"})
    assert answer.status_code in (400, 404, 422), answer.text
    assert answer.headers["Content-Type"] == "application/problem+json" and answer.json()["detail"]


@pytest.mark.parametrize("kind", [None, "text/plain", "application/x-www-form-urlencoded", "application/jsonp"])
def test_another_media_type_is_named(served: Any, kind: str | None) -> None:
    headers = {} if kind is None else {"Content-Type": kind}
    said = detail(served.client.post("/api/v1/sessions", content=b"{}", headers=headers), 415)
    assert said == f"the body is {kind or 'of no type'}; expected application/json"


@pytest.mark.parametrize("path", ["/api/v1/sessions", "/api/v1/models"])
def test_a_body_that_is_packed_is_refused_by_the_name_of_its_coding(served: Any, path: str) -> None:
    content = gzip.compress(b"{}")
    answer = served.client.post(path, content=content, headers=JSON | {"Content-Encoding": "gzip"})
    assert detail(answer, 415) == "the body has the Content-Encoding gzip; expected none, the body as it is"
    assert answer.headers["accept-encoding"] == "identity"
    plain = JSON | {"Content-Encoding": "Identity"}
    detail(served.client.post("/api/v1/sessions", content=b"{}", headers=plain), 422)
    assert served.client.get("/api/v1/sessions", headers={"Content-Encoding": "gzip"}).status_code == 200


@pytest.mark.parametrize(
    "kind", ["application/json; charset=utf-8", "application/merge-patch+json", "APPLICATION/JSON"]
)
def test_json_has_several_names(served: Any, kind: str) -> None:
    detail(served.client.post("/api/v1/sessions", content=b"{}", headers={"Content-Type": kind}), 422)


def test_every_call_with_a_body_says_how_large_and_of_what_kind(served: Any) -> None:
    for path, operations in served.client.get("/openapi.json").json()["paths"].items():
        for method, operation in operations.items():
            if "requestBody" in operation:
                assert {"408", "413", "415"} <= set(operation["responses"]), f"{method} {path}"


@pytest.mark.parametrize(
    ("path", "lines", "body"),
    [
        ("/api/v1/sessions", ("Content-Length: 1000",), b"{"),
        ("/api/v1/sessions/x/pause", ("Transfer-Encoding: chunked",), b"1\r\n{\r\n"),
        ("/nowhere", ("Content-Length: 1000",), b""),
        ("/api/v1/models", UPLOAD, b""),
        ("/api/v1/scans", UPLOAD, FILE + b"x" * 100),
    ],
)
def test_a_body_that_stays_away_is_not_waited_for(served: Any, path: str, lines: tuple[str, ...], body: bytes) -> None:
    with connect(served) as connection:
        connection.sendall(head("POST", path, *lines) + body)
        status, said = problem(connection)
        assert status == 408 and "came too slowly" in said and "(body_seconds)" in said
        assert everything(connection) == b""
    assert nothing_kept(served) and served.app.state.store.used_bytes() == 0


def test_a_byte_now_and_then_is_no_body(served: Any) -> None:
    """Also not after much was sent at once: what is saved up by that ends."""
    for sent in (b"", b"x" * (1 << 20)):
        with connect(served) as connection, pytest.raises(OSError):
            connection.sendall(head("POST", "/api/v1/scans", *UPLOAD) + FILE + sent)
            while True:
                connection.sendall(b"x")
                time.sleep(BODY_SECONDS / 8)


def test_a_server_that_was_busy_does_not_blame_its_client() -> None:
    """The body is there in time, but not seen before the time is over."""
    seen = []

    async def app(scope: Scope, receive: Receive, send: Send) -> None:
        seen.append(await receive())

    async def call() -> None:
        loop = asyncio.get_running_loop()
        body: asyncio.Queue[Message] = asyncio.Queue()
        client, server = socket.socketpair()

        def be_busy() -> None:
            client.sendall(b"{}")
            time.sleep(0.2)

        def take() -> None:
            body.put_nowait({"type": "http.request", "body": server.recv(2)})

        async def refused(message: Message) -> None:
            raise AssertionError(message)

        scope = {"type": "http", "method": "POST", "path": "/", "headers": [(b"content-length", b"2")]}
        with client, server:
            loop.add_reader(server, take)
            loop.call_later(0.01, be_busy)
            await Bodies(app, ServerConfig(body_seconds=0.1), frozenset())(scope, body.get, refused)
            loop.remove_reader(server)

    asyncio.run(call())
    assert seen == [{"type": "http.request", "body": b"{}", "more_body": False}]


def test_an_upload_may_pause_after_it_has_begun(served: Any) -> None:
    end = b"\r\n--b--\r\n"
    content = b"x" * 10_000
    length = len(FILE) + 2 * len(content) + len(end)
    with connect(served) as connection:
        connection.sendall(head("POST", "/api/v1/scans", UPLOAD[0], f"Content-Length: {length}") + FILE + content)
        time.sleep(2 * BODY_SECONDS)
        connection.sendall(content + end)
        assert problem(connection)[0] == 422  # read, and no scan


def test_one_client_does_not_keep_others_from_uploading(serve: Callable[..., Any]) -> None:
    served = serve(max_uploads=5, max_uploads_each=3)
    waiting = [connect(served) for _ in range(20)]
    for connection in waiting:
        connection.sendall(head("POST", "/api/v1/models", *UPLOAD))
    refused = [problem(connection) for connection in waiting[3:]]
    assert {status for status, _ in refused} == {429}
    assert all("3 uploads of this client are under way already (max_uploads_each)" in said for _, said in refused)
    # the same client's other calls, and another's uploads
    assert served.client.get("/api/v1/settings").status_code == 200
    for number in range(3):
        other = connect(served)
        waiting.append(other)
        other.sendall(head("POST", "/api/v1/scans", f"X-Forwarded-For: 10.0.0.{number}", *UPLOAD))
    assert "5 uploads are under way already (max_uploads)" in problem(waiting[-1])[1]
    for connection in waiting:
        connection.close()
    while served.app.state.uploads._under_way.all:
        time.sleep(0.01)


def test_one_client_does_not_keep_others_out(serve: Callable[..., Any]) -> None:
    served = serve(max_clients=5, max_clients_each=3)
    waiting = [connect(served) for _ in range(3)]
    for connection in waiting:
        connection.sendall(head("POST", "/api/v1/models", *UPLOAD))
    while served.app.state.traffic.connected.all < 3:
        time.sleep(0.01)
    answer = served.client.get("/api/v1/settings")
    assert "3 requests, streams and views of this client are open" in detail(answer, 429)
    assert int(answer.headers["Retry-After"]) > 0
    assert served.client.get("/healthz").status_code == 200
    others = {"X-Forwarded-For": "10.0.0.1"}
    assert served.client.get("/api/v1/settings", headers=others).status_code == 200
    for connection in waiting:
        connection.close()
    while (answer := served.client.get("/api/v1/settings")).status_code == 429:
        time.sleep(0.01)
    assert answer.status_code == 200
    while served.app.state.traffic.connected.each:  # an answer is counted until it is sent
        time.sleep(0.01)


def test_a_client_that_goes_in_the_middle_is_forgotten(served: Any) -> None:
    with connect(served) as connection:
        connection.sendall(head("POST", "/api/v1/sessions", "Content-Length: 1000") + b"{")
    with httpx.Client(base_url=served.url) as client:
        while "pmpnbp_clients 1.0\n" not in client.get("/metrics").text:
            time.sleep(0.01)
