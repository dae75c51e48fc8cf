"""How does a browser that draws elsewhere look at a 3D view? By the view's websocket alone."""

from __future__ import annotations

from typing import Any

import viser
from websockets.asyncio.client import connect
from websockets.typing import Subprotocol

# What viser's own page asks for; a client of another version is turned away.
PROTOCOL = Subprotocol(f"viser-v{viser.__version__}")


def view_socket(url: str, session: str, view: str, **options: Any) -> connect:
    """A connection to a view, to be entered or awaited; messages of any size, no compression, no proxy.

    url : of the server; options : further ones of `websockets`
    """
    return connect(
        f"{url.replace('http', 'ws', 1)}/sessions/{session}/view/{view}/",
        subprotocols=[PROTOCOL],
        compression=None,
        max_size=None,
        proxy=None,
        **options,
    )
