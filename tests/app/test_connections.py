"""What becomes of connections that say nothing, too little, too slowly or nonsense? Is anybody else in their way?"""

from __future__ import annotations

import logging
import resource
import socket
import time
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

from app.http import descriptors
from tests.app.raw_http import answer, connect, everything, head, problem
from tests.servers import NO_AUTHORITIES

# Short, so that tests need not wait; each is a setting of the server.
HEADER_SECONDS = 0.4
# Seconds, at most, until what has ended is counted no more.
SOON = 30.0


@pytest.fixture(scope="module")
def short(serve_for_module: Callable[..., Any]) -> Any:
    """A server without patience for headers."""
    return serve_for_module(header_seconds=HEADER_SECONDS, max_connections_each=40)


@pytest.fixture(autouse=True)
def nothing_left(request: pytest.FixtureRequest, caplog: pytest.LogCaptureFixture) -> Iterator[None]:
    """Every test ends without a connection that is still counted, and without a line in the log."""
    yield
    if "short" in request.fixturenames:
        served = request.getfixturevalue("short")
        served.client.close()
        served.client = httpx.Client(base_url=served.url, timeout=None, verify=NO_AUTHORITIES)
        state, until = served.app.state, time.monotonic() + SOON
        while len(state.connections):
            time.sleep(0.01)
        # counted down where a connection's task ends, which may be a little later
        while state.traffic.connected.all and time.monotonic() < until:
            time.sleep(0.01)
        assert state.traffic.connected.all == 0
    assert [record for record in caplog.records if record.levelno >= logging.ERROR] == []


def test_a_silent_connection_is_closed(short: Any) -> None:
    with connect(short) as silent, connect(short) as half:
        half.sendall(b"GET /healthz HTTP/1.1\r\nHost: a")
        assert everything(silent) == b"" and everything(half) == b""


def test_a_byte_now_and_then_is_no_header(short: Any) -> None:
    with connect(short) as connection, pytest.raises(OSError):
        connection.sendall(b"GET /healthz HTTP/1.1\r\n")
        while True:
            connection.sendall(b"X-A: b\r\n")
            time.sleep(HEADER_SECONDS / 8)


def test_nor_is_it_after_a_request(short: Any) -> None:
    with connect(short) as connection:
        connection.sendall(head("GET", "/healthz"))
        assert answer(connection)[0] == 200
        with pytest.raises(OSError):
            while True:
                connection.sendall(b"G")
                time.sleep(HEADER_SECONDS / 8)


def test_between_two_requests_a_connection_may_be_silent(short: Any) -> None:
    with connect(short) as connection:
        for _ in range(2):
            connection.sendall(head("GET", "/healthz"))
            assert answer(connection)[0] == 200
            time.sleep(3 * HEADER_SECONDS)
        # also after a body that nobody wanted
        connection.sendall(head("POST", "/healthz", "Content-Length: 2000000"))
        assert answer(connection)[0] == 413
        connection.sendall(b"x" * 2_000_000)
        time.sleep(3 * HEADER_SECONDS)
        connection.sendall(head("GET", "/healthz"))
        assert answer(connection)[0] == 200


def test_a_call_may_take_longer_than_its_header(short: Any) -> None:
    """An event stream, or a call that waits."""
    with connect(short) as connection:
        connection.sendall(head("GET", "/metrics") * 20)
        time.sleep(3 * HEADER_SECONDS)
        connection.sendall(head("GET", "/healthz", "Connection: close"))
        assert everything(connection).count(b"HTTP/1.1 200 OK") == 21


def test_a_body_that_goes_on_after_its_answer_ends(short: Any) -> None:
    with connect(short) as connection:
        connection.sendall(head("POST", "/api/v1/sessions", "Transfer-Encoding: chunked"))
        piece = b"10000\r\n" + b"x" * (1 << 16) + b"\r\n"
        with pytest.raises(OSError):
            while True:
                connection.sendall(piece)


@pytest.mark.parametrize("path", ["/api/v1/sessions", "/api/v1/models"])
@pytest.mark.parametrize("line", ["Connection: close", "Connection: keep-alive"])
def test_who_sends_all_of_it_first_reads_the_answer(short: Any, path: str, line: str) -> None:
    """A connection that is closed while something comes is reset, and what was on its way back is lost."""
    size = 20 << 20
    with connect(short) as connection:
        connection.sendall(head("POST", path, f"Content-Length: {size}", "Content-Type: text/plain", line))
        connection.sendall(b"x" * size)
        assert problem(connection)[0] in (413, 415)


def test_one_address_has_only_so_many(short: Any) -> None:
    refused = short.app.state.connections.ended["too many of one address"]
    short.client.close()
    opened = [connect(short) for _ in range(100)]
    last = opened[-1]
    assert problem(last) == (429, "40 connections of this address are open, the most of one (max_connections_each)")
    assert everything(last) == b""
    assert short.app.state.connections.ended["too many of one address"] - refused == 60
    for connection in opened:
        connection.close()


def test_all_together_have_only_so_many(short: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    short.client.close()
    monkeypatch.setattr(short.app.state.connections, "limit", 10)
    opened = [connect(short) for _ in range(11)]
    assert problem(opened[-1])[0] == 429
    for connection in opened:
        connection.close()


def test_a_websocket_is_counted_until_it_ends(short: Any) -> None:
    with connect(short) as connection:
        connection.sendall(websocket("/sessions/none/view/a"))
        assert problem(connection)[0] == 404
        assert everything(connection) == b""


def websocket(path: str, *lines: str, key: str = "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==") -> bytes:
    upgrade = ("Upgrade: websocket", "Connection: Upgrade", "Sec-WebSocket-Version: 13", key)
    return head("GET", path, *upgrade, *lines)


@pytest.mark.parametrize(
    "request_header",
    [
        b"nonsense\r\n\r\n",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
        b"GET / HTTP/1.1\r\n\r\n",
        head("GET", "/healthz", "Content-Length: -1"),
        head("GET", "/healthz", "Content-Length: 1", "Content-Length: 2"),
        head("GET", "/healthz", "Content-Length: 1e3"),
        head("GET", "/healthz", "Transfer-Encoding: gzip"),
        head("GET", "/healthz", "X: " + "y" * 40_000)[:-4],
        head("GET", "/healthz", "X: a\0b"),
        head("POST", "/api/v1/sessions", "Transfer-Encoding: chunked") + b"no length\r\n",
        head("POST", "/api/v1/models", "Content-Type: multipart/form-data; boundary=b", "Transfer-Encoding: chunked")
        + b"-5\r\n",
        websocket("/sessions/none/view/a", key="Sec-WebSocket-Key: short"),
        websocket("/sessions/none/view/a", "Sec-WebSocket-Protocol: \xe9"),
        websocket("/sessions/none/view/a", "X: " + "y" * 9_000),
        websocket("/sessions/none/view/a", *(f"X{number}: y" for number in range(200))),
        websocket("/sessions/none/view/a", "Content-Length: 5") + b"hello",
    ],
)
def test_what_is_no_http_is_told_so(short: Any, request_header: bytes) -> None:
    with connect(short) as connection:
        connection.sendall(request_header)
        assert everything(connection).startswith(b"HTTP/1.1 400 Bad Request\r\n")


@pytest.mark.parametrize(
    ("request_header", "status"),
    [
        (b"GET /healthz HTTP/1.0\r\n\r\n", 200),
        (head("CONNECT", "example.org:443"), 404),
        (head("OPTIONS", "*"), 404),
        (
            head("GET", "/healthz", "Upgrade: h2c", "Connection: Upgrade", "HTTP2-Settings: AAMAAABkAAQCAAAAAAIAAAAA"),
            200,
        ),
        (head("TRACE", "/healthz"), 405),
        (head("BREW", "/healthz"), 405),
        (head("GET", "http://127.0.0.1/healthz"), 404),
        (websocket("/nowhere"), 403),
    ],
)
def test_what_is_strange_is_answered(short: Any, request_header: bytes, status: int) -> None:
    with connect(short) as connection:
        connection.sendall(request_header)
        assert answer(connection)[0] == status


def test_who_goes_in_the_middle_leaves_nothing(short: Any) -> None:
    pieces = (
        b"GET /heal",
        head("GET", "/metrics"),
        head("POST", "/api/v1/sessions", "Content-Length: 100") + b"x",
        head("POST", "/api/v1/models", "Content-Type: multipart/form-data; boundary=b", "Content-Length: 100") + b"--b",
        websocket("/sessions/none/view/a"),
    )
    for piece in pieces:
        with connect(short) as connection:
            connection.sendall(piece)
            # closed with a reset, not with a farewell
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")


def test_who_does_not_read_is_dropped(serve: Callable[..., Any]) -> None:
    served = serve(header_seconds=HEADER_SECONDS)
    served.app.state.connections.unread.seconds = 0.5
    with connect(served) as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        # answers of several MB, which lie in the server where they are not read
        connection.sendall(head("GET", "/openapi.json") * 200)
        while not served.app.state.connections.ended["unread"]:
            time.sleep(0.01)
        while served.app.state.traffic.connected.all:
            time.sleep(0.01)


def test_one_address_leaves_only_so_much_unread(serve: Callable[..., Any]) -> None:
    served = serve(header_seconds=HEADER_SECONDS)
    served.app.state.connections.unread.bytes = 50_000
    with connect(served) as connection:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        connection.sendall(head("GET", "/openapi.json") * 200)
        while not served.app.state.connections.ended["unread"]:
            time.sleep(0.01)
    assert served.client.get("/healthz").status_code == 200


def test_the_limit_of_open_files_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    limits = {"now": (256, 4096)}
    monkeypatch.setattr(resource, "getrlimit", lambda _: limits["now"])
    monkeypatch.setattr(resource, "setrlimit", lambda _, wanted: limits.update(now=wanted))
    assert descriptors.limit() == 256
    descriptors.raise_limit()
    assert limits["now"] == (4096, 4096) and descriptors.limit() == 4096
    limits["now"] = (1024, resource.RLIM_INFINITY)
    descriptors.raise_limit()
    assert limits["now"] == (descriptors.MOST_DESCRIPTORS, resource.RLIM_INFINITY)
    limits["now"] = (1 << 20, 1 << 20)
    descriptors.raise_limit()
    assert limits["now"] == (1 << 20, 1 << 20) and descriptors.limit() == descriptors.MOST_DESCRIPTORS


def test_where_files_are_few_there_is_room_for_others(
    serve: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(descriptors, "limit", lambda: 200)
    connections = serve().app.state.connections
    assert (connections.limit, connections.limit_each) == (150, 100)


def test_where_no_connection_can_be_accepted_it_is_said_once(
    served_process: Callable[..., Any], capfd: pytest.CaptureFixture[str]
) -> None:
    process = served_process()
    resource.prlimit(process.process.pid, resource.RLIMIT_NOFILE, (48, 48))  # less than it counted on when it started
    opened = [socket.create_connection(("127.0.0.1", process.client.base_url.port)) for _ in range(100)]
    said = ""
    while "accept" not in said:
        time.sleep(0.1)
        said += capfd.readouterr().err
    for connection in opened:
        connection.close()
    assert process.client.get("/healthz").status_code == 200
    assert process.stop() == 0
    said += capfd.readouterr().err
    assert "connections cannot be accepted: [Errno 24] Too many open files" in said
    assert said.count("accept") == 1
