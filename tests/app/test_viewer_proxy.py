"""Does a browser get its 3D view through the server's one port, and nobody else's?"""

from __future__ import annotations

import asyncio
import logging
import re
import socket
import threading
import time
from collections.abc import Callable, Coroutine
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import httpx
import pytest
import websockets.asyncio.client
from viser import _messages as viser_messages
from websockets.exceptions import ConnectionClosed, InvalidStatus

from app.commands.serve import quiet_libraries
from app.problems import HttpProblem
from app.viewer.views import Views
from app.viewer.viser_server import SECRET_HEADER, open_server
from benchmarks.view_socket import PROTOCOL

SESSION = "0123456789abcdef"
TOKEN = "a-token-for-this-test"


class OneSession:
    """The server's sessions, and one more that has no inference behind it."""

    def __init__(self, sessions: Any) -> None:
        self._sessions = sessions

    def __getattr__(self, name: str) -> Any:
        return getattr(self._sessions, name)

    def get(self, session_id: str) -> Any:
        if session_id != SESSION:
            raise HttpProblem(404, f"session '{session_id}' is not here; there is 1 session")
        return None

    def delete(self, session_id: str) -> None:
        self.get(session_id)


def with_one_session(served: Any) -> Any:
    served.app.state.sessions = OneSession(served.app.state.sessions)
    return served


@pytest.fixture(scope="module")
def viewed(serve_for_module: Callable[..., Any]) -> Any:
    return with_one_session(serve_for_module())


@pytest.fixture(scope="module")
def guarded(serve_for_module: Callable[..., Any]) -> Any:
    return with_one_session(serve_for_module(token=TOKEN))


def connect(served: Any, path: str = f"/sessions/{SESSION}/view", **options: Any) -> Any:
    options = {"subprotocols": [PROTOCOL], "max_size": None, "proxy": None, "compression": None} | options
    return websockets.asyncio.client.connect(served.url.replace("http", "ws") + path, **options)


def do(coroutine: Coroutine[Any, Any, Any]) -> Any:
    return asyncio.run(coroutine)


async def refused(connection: Any) -> tuple[int, bytes]:
    with pytest.raises(InvalidStatus) as found:
        async with connection:
            pass
    response = found.value.response
    assert response.headers["content-type"] == "application/problem+json"
    return response.status_code, bytes(response.body or b"")


@pytest.mark.parametrize("path", ["", "/", "/tab-1", "/tab-1/"])
def test_viser_answers_through_the_proxy(viewed: Any, path: str) -> None:
    async def talk() -> None:
        async with connect(viewed, f"/sessions/{SESSION}/view{path}", origin=viewed.url) as websocket:
            assert websocket.subprotocol == PROTOCOL
            first = await websocket.recv()
            assert isinstance(first, bytes) and len(first) > 16

    do(talk())


def test_nobody_waits_while_a_view_of_others_starts(viewed: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Starting viser takes a tenth of a second of the processor, and one view starts after the other."""
    asked, go_on = threading.Event(), threading.Event()

    def slow() -> Any:
        asked.set()
        go_on.wait()
        return open_server()

    async def talk() -> None:
        async with connect(viewed, f"/sessions/{SESSION}/view/slow") as websocket:
            assert isinstance(await websocket.recv(), bytes)

    monkeypatch.setattr("app.viewer.view.open_server", slow)
    with ThreadPoolExecutor(1) as pool, httpx.Client(base_url=viewed.url) as client:
        connected = pool.submit(do, talk())
        try:
            asked.wait()
            assert client.get("/healthz").status_code == 200
            view = viewed.app.state.views._views[SESSION, "slow"]
            assert view.answer()["clients"] == 1  # what the page asks for
        finally:
            go_on.set()
        connected.result()


def test_two_clients_of_one_view_see_one_scene_and_another_view_does_not(viewed: Any) -> None:
    async def talk() -> None:
        one, other = f"/sessions/{SESSION}/view/a", f"/sessions/{SESSION}/view/b"
        async with connect(viewed, one), connect(viewed, one), connect(viewed, other):
            views = viewed.app.state.views._views
            assert views[SESSION, "a"].clients == 2 and views[SESSION, "b"].clients == 1
            assert views[SESSION, "a"].server is not views[SESSION, "b"].server

    do(talk())


def test_what_is_drawn_arrives_whole(viewed: Any) -> None:
    """A cloud of several megabytes, larger than any default limit of a websocket."""

    async def talk() -> None:
        async with connect(viewed, f"/sessions/{SESSION}/view/big") as websocket:
            await websocket.recv()
            import numpy as np

            points = np.arange(900_000, dtype=np.float32).reshape(-1, 3)
            server = viewed.app.state.views._views[SESSION, "big"].server
            server.scene.add_point_cloud("/cloud", points, (1, 2, 3), precision="float32")
            while True:
                message = await websocket.recv()
                if points.tobytes() in message:
                    return

    do(talk())


def test_who_comes_and_goes_is_not_logged(viewed: Any, caplog: pytest.LogCaptureFixture) -> None:
    """As `pmpnbp serve` sets its log up; of its lines nearly all were the websocket library's."""

    async def talk() -> None:
        async with connect(viewed, f"/sessions/{SESSION}/view/logged") as websocket:
            await websocket.recv()

    # the libraries' own levels too, which `pmpnbp serve` in a test before this one has set
    with (
        caplog.at_level(logging.INFO),
        caplog.at_level(logging.INFO, "websockets"),
        caplog.at_level(logging.INFO, "httpx"),
    ):
        do(talk())
        assert any(record.name.startswith("websockets") for record in caplog.records)
        caplog.clear()
        quiet_libraries()
        do(talk())
    assert [record.name for record in caplog.records if record.name.startswith("websockets")] == []


@pytest.mark.parametrize("origin", ["http://example.org", "https://127.0.0.1", "null", "http://localhost:1"])
def test_another_origin_is_refused(viewed: Any, origin: str) -> None:
    status, body = do(refused(connect(viewed, origin=origin)))
    assert status == 403 and b"not this server's" in body


def test_another_host_is_refused(viewed: Any) -> None:
    async def talk() -> tuple[int, bytes]:
        port = int(viewed.url.rsplit(":", 1)[1])
        connection = websockets.asyncio.client.connect(
            f"ws://rebound.example.org:{port}/sessions/{SESSION}/view", host="127.0.0.1", port=port, proxy=None
        )
        return await refused(connection)

    status, body = do(talk())
    assert status == 403 and b"rebound.example.org" in body


@pytest.mark.parametrize("path", ["/sessions/fedcba9876543210/view", "/sessions/fedcba9876543210/view/a"])
def test_an_unknown_session_is_refused(viewed: Any, path: str) -> None:
    before = len(viewed.app.state.views)
    status, body = do(refused(connect(viewed, path)))
    assert status == 404 and b"fedcba9876543210" in body
    assert viewed.client.get(path).status_code == 404
    assert len(viewed.app.state.views) == before


@pytest.mark.parametrize("name", ["a b", "x" * 65, "%2e%2e", "a.b"])
def test_a_strange_view_is_refused(viewed: Any, name: str) -> None:
    assert do(refused(connect(viewed, f"/sessions/{SESSION}/view/{name.replace(' ', '%20')}")))[0] == 404


def test_the_token_is_asked_for(guarded: Any) -> None:
    ours = guarded.app.state.page_cookie
    cookie = {"Cookie": f"{ours.name}={ours.value}"}
    assert do(refused(connect(guarded)))[0] == 401
    assert do(refused(connect(guarded, additional_headers={"Authorization": "Bearer wrong"})))[0] == 401
    assert do(refused(connect(guarded, f"/sessions/{SESSION}/view?token={TOKEN}")))[0] == 401
    assert do(refused(connect(guarded, additional_headers=cookie)))[0] == 403
    assert do(refused(connect(guarded, additional_headers=cookie, origin="http://example.org")))[0] == 403

    async def let_in(**options: Any) -> str | None:
        async with connect(guarded, **options) as websocket:
            return websocket.subprotocol

    assert do(let_in(additional_headers=cookie, origin=guarded.url)) == PROTOCOL
    assert do(let_in(additional_headers={"Authorization": f"Bearer {TOKEN}"})) == PROTOCOL


def test_the_loopback_port_is_closed_to_everybody_else(viewed: Any) -> None:
    async def talk() -> None:
        async with connect(viewed, f"/sessions/{SESSION}/view/mine"):
            view = viewed.app.state.views._views[SESSION, "mine"]
            url, secret = view.address()
            for headers in ({}, {SECRET_HEADER: ""}, {SECRET_HEADER: "0" * 64}, {SECRET_HEADER: secret[:-1]}):
                with pytest.raises(InvalidStatus) as found:
                    async with websockets.asyncio.client.connect(url, additional_headers=headers, proxy=None):
                        pass
                assert found.value.response.status_code == 403
            url = url.replace("ws", "http")
            async with httpx.AsyncClient(trust_env=False) as client:
                assert (await client.get(url + "/")).status_code == 403
            # and it is not listened to from outside at all
            host = socket.gethostbyname(socket.gethostname())
            if not host.startswith("127."):
                with pytest.raises(OSError):
                    socket.create_connection((host, view.server.get_port()), timeout=5).close()

    do(talk())


def test_a_view_ends_when_its_session_is_deleted(viewed: Any) -> None:
    async def talk() -> None:
        async with connect(viewed, f"/sessions/{SESSION}/view/doomed") as websocket:
            await websocket.recv()
            async with httpx.AsyncClient(base_url=viewed.url, trust_env=False) as client:
                assert (await client.delete(f"/api/v1/sessions/{SESSION}")).status_code == 204
            with pytest.raises(ConnectionClosed):
                while True:
                    await websocket.recv()
            assert (SESSION, "doomed") not in viewed.app.state.views._views

    do(talk())


def test_there_are_only_so_many_clients(serve: Callable[..., Any]) -> None:
    served = serve(max_clients=2)
    served.app.state.sessions = OneSession(served.app.state.sessions)

    async def talk() -> tuple[int, bytes]:
        async with connect(served), connect(served):
            assert served.client.get("/api/v1/settings").status_code == 429
            assert served.client.get("/healthz").status_code == 200
            return await refused(connect(served))

    status, body = do(talk())
    assert status == 429 and b"2 clients are connected already" in body
    while (answer := served.client.get("/api/v1/settings")).status_code != 200:
        assert int(answer.headers["retry-after"]) > 0


def test_another_version_of_the_client_is_told_so(viewed: Any) -> None:
    async def talk() -> None:
        async with connect(viewed, subprotocols=["viser-v0.0.1"]) as websocket:
            assert websocket.subprotocol == "viser-v0.0.1"
            with pytest.raises(ConnectionClosed) as found:
                await websocket.recv()
            assert found.value.rcvd is not None and found.value.rcvd.code == 1002

    do(talk())


def test_nobody_can_ask_for_a_public_address(viewed: Any) -> None:
    async def talk() -> None:
        async with connect(viewed, f"/sessions/{SESSION}/view/private"):
            handlers = viewed.app.state.views._views[SESSION, "private"].server._websock_server._incoming_handlers
            assert viser_messages.ShareUrlRequest not in handlers
            assert viser_messages.ShareUrlDisconnect not in handlers

    do(talk())


def test_the_page_names_a_view_of_its_own(viewed: Any) -> None:
    answers = [viewed.client.get(f"/sessions/{SESSION}/view/") for _ in range(2)]
    names = [re.search(r'"([0-9a-f]{16})/" \+ here.search', answer.text) for answer in answers]
    assert names[0] and names[1] and names[0][1] != names[1][1]
    policy = answers[0].headers["content-security-policy"]
    assert "connect-src 'self' data: blob:" in policy and "frame-ancestors 'self'" in policy
    again = viewed.client.get(f"/sessions/{SESSION}/view/{names[0][1]}/")
    assert again.status_code == 200 and "here.search" not in again.text
    assert again.text.count("</html>") == 1


def test_the_page_takes_nothing_from_elsewhere(viewed: Any) -> None:
    text = viewed.client.get(f"/sessions/{SESSION}/view/").text
    assert not re.findall(r"""(?:src|href)\s*=\s*["']?https?:""", text)


def test_a_view_outlives_its_last_client_for_a_while() -> None:
    views = Views(linger_seconds=0.3)
    try:
        first = views.join(SESSION, "a")
        views.leave(first)
        second = views.join(SESSION, "a")
        assert second is first
        time.sleep(0.5)
        assert len(views) == 1  # somebody came back
        views.leave(second)
        while len(views):
            time.sleep(0.02)
        assert views.join(SESSION, "a") is not first
    finally:
        views.close()


def test_views_end_with_their_session_and_with_the_server() -> None:
    views = Views()
    servers = [views.join(SESSION, "a").server, views.join("other", "b").server]
    views.leave(views.join(SESSION, "b"))
    views.close_session(SESSION)
    assert list(views._views) == [("other", "b")]
    views.close()
    assert len(views) == 0
    with pytest.raises(HttpProblem, match="the server stops"):
        views.join(SESSION, "a")
    for server in servers:
        thread = server._websock_server._server_thread
        assert thread is not None
        thread.join()


def test_there_are_only_so_many_views() -> None:
    views = Views(limit=2)
    try:
        views.join(SESSION, "a")
        views.join(SESSION, "b")
        with pytest.raises(HttpProblem, match="2 3D views are open") as found:
            views.join(SESSION, "c")
        assert found.value.status == 429
    finally:
        views.close()
