"""Does the 3D view come up in a real browser through the server's one port, and not in a page of another origin?"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest
from playwright.sync_api import Page, WebSocket, expect

from tests.app import small_sessions as small
from tests.browser.conftest import PATIENCE, Troubles, pixels
from tests.browser.session_page import wait
from tests.servers import Served

expect.set_options(timeout=PATIENCE)
pytestmark = pytest.mark.scene


@pytest.fixture(scope="module")
def path(served: Served) -> str:
    """A session after two iterations."""
    made = small.after(served.client, 2, name="looked at")
    return made


def drawn(page: Page) -> float:
    """How much the middle of the 3D view varies, 0 to 255: standard deviation of its pixels."""
    seen = pixels(page.locator("canvas").first).astype(float)
    height, width = seen.shape[:2]
    return float(seen[height // 4 : -height // 4, width // 4 : -width // 4].std())


def test_the_view_is_drawn(page: Page, served: Served, path: str, troubles: Troubles) -> None:
    # a message of the graphics library about the machine's own slowness
    troubles.expect("GPU stall")
    sockets: list[WebSocket] = []
    page.on("websocket", lambda socket: sockets.append(socket))
    id = path.rsplit("/", 1)[1]
    page.goto(f"{served.url}/sessions/{id}/view/")
    page.locator("canvas").first.wait_for()
    while drawn(page) < 5:
        page.wait_for_timeout(200)
    (socket,) = sockets
    # by the server's own port and by a path of this session, whatever port viser has
    assert socket.url.startswith(served.url.replace("http", "ws") + f"/sessions/{id}/view/")
    assert not socket.is_closed()
    # the view has named itself, so that the same one comes up when the page is loaded again
    assert page.url.startswith(f"{served.url}/sessions/{id}/view/") and not page.url.endswith("/view/")
    name = page.url.rstrip("/").rsplit("/", 1)[1]
    page.reload()
    page.locator("canvas").first.wait_for()
    assert page.url.rstrip("/").rsplit("/", 1)[1] == name


def test_the_view_is_drawn_in_the_sessions_page(page: Page, served: Served, path: str, troubles: Troubles) -> None:
    troubles.expect("GPU stall")
    page.goto(served.url)
    page.get_by_role("link", name="looked at").click()
    page.wait_for_url("**/sessions/*/**")
    frame = page.frame_locator("iframe")
    canvas = frame.locator("canvas").first
    canvas.wait_for()
    while pixels(canvas).astype(float).std() < 5:
        page.wait_for_timeout(200)


@pytest.fixture(scope="module")
def foreign() -> Iterator[str]:
    """The address of a page on this machine that is not this server's, and forbids itself nothing."""

    class Page(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(b"<!doctype html><title>foreign</title><link rel=icon href=data:,>")

        def log_message(self, *_: object) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Page) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_port}/"
        server.shutdown()
        thread.join()


def test_a_page_of_another_origin_gets_nothing(
    page: Page, served: Served, path: str, foreign: str, troubles: Troubles
) -> None:
    """Not its websocket, not its answers, and it changes nothing; nor may it show the view as its own."""
    page.goto(foreign)
    assert troubles.found == []
    troubles.expect("")  # all of what follows is meant to fail
    id = path.rsplit("/", 1)[1]
    opened = page.evaluate(
        """(url) => new Promise((done) => {
          const socket = new WebSocket(url);
          socket.onopen = () => done("opened");
          socket.onerror = () => done("refused");
        })""",
        served.url.replace("http", "ws") + f"/sessions/{id}/view/stranger/",
    )
    assert opened == "refused"
    # by the server, not by the browser
    assert any("WebSocket" in one and "403" in one for one in troubles.found), troubles.found

    read = "(url) => fetch(url).then((answer) => answer.text(), () => 'refused')"
    assert page.evaluate(read, f"{served.url}{path}") == "refused"
    before = served.client.get(path).json()
    change = "(url) => fetch(url, { method: 'POST', mode: 'no-cors' }).then(() => 'answered', () => 'refused')"
    assert page.evaluate(change, f"{served.url}{path}/reset") == "refused"
    assert 'method="POST",status="403"' in served.client.get("/metrics").text  # it came here, and no further
    assert served.client.get(path).json() == before

    page.evaluate(
        """(url) => new Promise((done) => {
          const frame = document.createElement("iframe");
          frame.onload = done;
          frame.src = url;
          document.body.append(frame);
        })""",
        f"{served.url}/sessions/{id}/view/",
    )
    assert page.frame_locator("iframe").locator("canvas").count() == 0
    assert any("frame-ancestors" in one or "ERR_BLOCKED_BY_RESPONSE" in one for one in troubles.found), troubles.found


@pytest.mark.parametrize("bypassed", [False, True])
def test_a_link_cannot_make_the_view_talk_to_another_server(
    new_page: Callable[..., Page], served: Served, path: str, troubles: Troubles, bypassed: bool
) -> None:
    """viser takes `?websocket=` from its page's address. The content security policy keeps it here: without it, which
    a browser can be told to leave out, it would not stay."""
    troubles.expect("another.example")
    asked: list[str] = []
    page = new_page(bypass_csp=bypassed)
    page.on("websocket", lambda socket: asked.append(socket.url))
    id = path.rsplit("/", 1)[1]
    with page.expect_console_message(lambda message: "websocket is not connected" in message.text):
        page.goto(f"{served.url}/sessions/{id}/view/led/?websocket=ws://another.example/")
    if bypassed:
        wait(page, lambda: len(asked) > 0)
    assert any("another.example" in url for url in asked) == bypassed
