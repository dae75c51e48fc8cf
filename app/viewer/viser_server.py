"""How is viser started so that nobody else gets in? On the loopback interface, on a free port, behind a secret.

Only this process knows the secret: it passes a browser's websocket on after its own checks.
"""

from __future__ import annotations

import hmac
import math
import secrets
import threading
from collections.abc import Callable
from http import HTTPStatus
from typing import Any, cast

import rich
import viser
import websockets.asyncio.server
from viser import _messages as viser_messages
from websockets.asyncio.server import ServerConnection
from websockets.http11 import Request, Response

LOOPBACK = "127.0.0.1"
SECRET_HEADER = "X-Pmpnbp-View"

# viser hands `serve` to no caller: it is replaced while a view's server starts, one at a time.
_starting = threading.Lock()


def open_server() -> tuple[viser.ViserServer, str]:
    """A server with an empty scene, world frame, metres; and the secret that a connection has to carry."""
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
    scene = server.scene
    scene.world_axes.visible = False
    # light that costs little: without a graphics card the default's surroundings and shadows take most of the time
    scene.configure_default_lights(enabled=False)
    scene.configure_environment_map(None)
    scene.add_light_hemisphere("/light/sky", intensity=2.4)
    scene.add_light_directional("/light/sun", intensity=1.2, cast_shadow=False, position=(1.0, -1.0, 2.0))
    return server, secret


def address(server: viser.ViserServer) -> str:
    """Where its websocket is; for this process only."""
    return f"ws://{LOOPBACK}:{server.get_port()}"


def members_of(data: bytes) -> dict[str, Any] | None:
    """The members of a message that a browser sends; None where it is none that viser knows."""
    try:
        return vars(viser_messages.Message.deserialize(data))
    except Exception:  # whatever it trips over
        return None


def is_finite(value: Any) -> bool:
    """Whether no number in a message's members is infinite or none."""
    if isinstance(value, dict):
        return all(map(is_finite, value.values()))
    if isinstance(value, tuple | list):
        return all(map(is_finite, value))
    return not isinstance(value, float) or math.isfinite(value)


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
