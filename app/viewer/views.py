"""Which 3D views are open? One viser server per view, that is per tab that looks at a session.

Each listens on the loopback interface, on a port of its own, and lets in only who knows its secret: this process, which
passes a browser's websocket on after its own checks. A view outlives its last client for a while, so that a page that
is loaded again finds its view as it was.
"""

from __future__ import annotations

import hmac
import re
import secrets
import threading
from collections.abc import Callable
from dataclasses import dataclass, field
from http import HTTPStatus
from pathlib import Path
from typing import Any, cast

import rich
import viser
import websockets.asyncio.server
from viser import _messages as viser_messages
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

from app.problems import HttpProblem

LOOPBACK = "127.0.0.1"
SECRET_HEADER = "X-Pmpnbp-View"
LINGER_SECONDS = 60.0
CLIENT_PAGE = Path(viser.__file__).parent / "client" / "build" / "index.html"

_VIEW_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")
# viser hands `serve` to no caller: it is replaced while a view's server starts, one at a time.
_starting = threading.Lock()


@dataclass
class View:
    """An open view of a session."""

    session_id: str
    view_id: str
    server: viser.ViserServer
    secret: str
    clients: int = 0
    last_left: threading.Timer | None = field(default=None, repr=False)

    @property
    def url(self) -> str:
        """Where its websocket is; for this process only."""
        return f"ws://{LOOPBACK}:{self.server.get_port()}"


class Views:
    """The open views of all sessions."""

    def __init__(self, limit: int = 200, linger_seconds: float = LINGER_SECONDS) -> None:
        self._limit = limit
        self._linger = linger_seconds
        self._views: dict[tuple[str, str], View] = {}
        self._lock = threading.Lock()
        self._closed = False

    def __len__(self) -> int:
        return len(self._views)

    def join(self, session_id: str, view_id: str) -> View:
        """The view, opened where it is not, with one client more. Raises HttpProblem: no more views, or no such id."""
        if not _VIEW_ID.fullmatch(view_id):
            raise HttpProblem(404, f"view {view_id!r} cannot be; a view's name has up to 64 letters, digits, - and _")
        with self._lock:
            if self._closed:
                raise HttpProblem(503, "the server stops")
            view = self._views.get((session_id, view_id))
            if view is None:
                if len(self._views) >= self._limit:
                    detail = f"{self._limit} views are open, which is all this server takes"
                    raise HttpProblem(429, detail, headers={"Retry-After": "60"})
                view = _open(session_id, view_id)
                self._views[session_id, view_id] = view
            view.clients += 1
            if view.last_left is not None:
                view.last_left.cancel()
                view.last_left = None
            return view

    def leave(self, view: View) -> None:
        """One client less; the view closes a while after the last."""
        with self._lock:
            view.clients -= 1
            if view.clients == 0 and not self._closed:
                view.last_left = threading.Timer(self._linger, self._drop, (view,))
                view.last_left.daemon = True
                view.last_left.start()

    def close_session(self, session_id: str) -> None:
        """Close every view of a session, as when it is deleted."""
        with self._lock:
            gone = [self._views.pop(key) for key in list(self._views) if key[0] == session_id]
        for view in gone:
            view.server.stop()

    def close(self) -> None:
        """Close all."""
        with self._lock:
            self._closed = True
            gone = list(self._views.values())
            self._views.clear()
        for view in gone:
            if view.last_left is not None:
                view.last_left.cancel()
            view.server.stop()

    def _drop(self, view: View) -> None:
        with self._lock:
            key = (view.session_id, view.view_id)
            if view.clients > 0 or self._views.get(key) is not view:
                return
            del self._views[key]
        view.server.stop()


def new_view_id() -> str:
    """A name for a view that no other has."""
    return secrets.token_hex(8)


def _open(session_id: str, view_id: str) -> View:
    """A server on a free loopback port with an empty scene: axes and a ground grid, world frame, metres."""
    secret = secrets.token_hex(32)
    # viser prints a banner, and who comes and goes, to standard output, which is for our own one line
    rich.get_console().quiet = True
    with _starting:
        original = websockets.asyncio.server.serve
        cast(Any, websockets.asyncio.server).serve = _guarded(original, secret)
        try:
            server = viser.ViserServer(host=LOOPBACK, port=0, verbose=False)
        finally:
            cast(Any, websockets.asyncio.server).serve = original
    # Any client could ask for a public address for the scene: nobody is to be asked outside this machine
    connection = server._websock_server
    for message in (viser_messages.ShareUrlRequest, viser_messages.ShareUrlDisconnect):
        connection.unregister_handler(message)
    server.gui.configure_theme(show_share_button=False, show_logo=False)
    server.scene.world_axes.visible = True
    return View(session_id, view_id, server, secret)


def _guarded(serve: Callable[..., Any], secret: str) -> Callable[..., Any]:
    """`serve` for connections that carry the secret; its own checks, and serving of files, are left out."""

    def check(connection: ServerConnection, request: Request) -> Response | None:
        given = request.headers.get_all(SECRET_HEADER)
        if len(given) == 1 and hmac.compare_digest(given[0].encode("utf-8", "surrogateescape"), secret.encode()):
            return None
        return connection.respond(HTTPStatus.FORBIDDEN, "this port is for the server's own use\n")

    def guarded(*arguments: Any, **options: Any) -> Any:
        options |= {"process_request": check, "ping_interval": None}
        return serve(*arguments, **options)

    return guarded
