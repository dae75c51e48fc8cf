"""How does a browser get to a 3D view? By the server's one port: viser's page, and its websocket passed on.

viser's client takes its websocket's address from the page's: `/sessions/{id}/view/{view}/` talks to the same path. The
page at `/sessions/{id}/view/` gives itself a view's name first, so each tab has a view of its own and keeps it when
loaded again.
"""

from __future__ import annotations

import asyncio
from contextlib import suppress

import anyio.to_thread
import websockets.asyncio.client
from fastapi import APIRouter, Request, WebSocket
from fastapi.responses import HTMLResponse, Response
from starlette.websockets import WebSocketDisconnect, WebSocketState
from websockets.asyncio.client import ClientConnection
from websockets.exceptions import ConnectionClosed
from websockets.typing import Subprotocol

from app.problems import HttpProblem, problem_response
from app.security import VIEW_POLICY
from app.viewer.client_files import LASTING, PLACE, client
from app.viewer.client_page import scene_only
from app.viewer.view import View
from app.viewer.views import new_view_id
from app.viewer.viser_server import SECRET_HEADER, is_finite, members_of

router = APIRouter(include_in_schema=False)

# Messages read ahead from viser for a browser: few, so that what a slow one has not got yet is merged in viser.
AHEAD = 4
# Codes that stand for "closed without one", which no close frame may carry.
_NO_CODE = (1005, 1006, 1015)

_NAME_ITSELF = """<script>{{
const here = window.location;
history.replaceState(null, "", here.pathname.replace(/\\/?$/, "/") + "{view}/" + here.search);
}}</script>"""


@router.get("/sessions/{session_id}/view")
@router.get("/sessions/{session_id}/view/")
@router.get("/sessions/{session_id}/view/{view_id}")
@router.get("/sessions/{session_id}/view/{view_id}/")
def open_view(request: Request, session_id: str) -> HTMLResponse:
    """viser's page, for the view of that name, or for a new one."""
    request.app.state.sessions.get(session_id)  # 404 where there is none
    script = "" if "view_id" in request.path_params else _NAME_ITSELF.format(view=new_view_id())
    headers = {"Content-Security-Policy": VIEW_POLICY, "Cache-Control": "no-store"}
    return HTMLResponse(scene_only(client()[0], script), headers=headers)


@router.get(PLACE + "{name}")
def client_file(name: str) -> Response:
    """A file of viser's program, which never changes under its name."""
    files = client()[1]
    if name not in files:
        raise HttpProblem(404, f"file '{name:.80}' is not here; there are {', '.join(files) or 'none'}")
    headers = {"Content-Encoding": "gzip", "Cache-Control": LASTING}
    return Response(files[name].zipped, media_type=files[name].media_type, headers=headers)


@router.websocket("/sessions/{session_id}/view")
@router.websocket("/sessions/{session_id}/view/")
@router.websocket("/sessions/{session_id}/view/{view_id}")
@router.websocket("/sessions/{session_id}/view/{view_id}/")
async def connect(websocket: WebSocket, session_id: str) -> None:
    """A client of the view of that name, or of one that nobody else has."""
    state, view_id = websocket.app.state, websocket.path_params.get("view_id") or new_view_id()
    try:
        view: View = await anyio.to_thread.run_sync(state.views.join, session_id, view_id, state.sessions.get)
        try:
            await _pass_on(websocket, view)
        finally:
            state.views.leave(view)
    except HttpProblem as problem:  # before anything was accepted
        await problem_response(problem)(websocket.scope, websocket.receive, websocket.send)


async def _pass_on(websocket: WebSocket, view: View) -> None:
    url, secret = await anyio.to_thread.run_sync(view.address)
    protocols = [Subprotocol(name) for name in websocket.scope["subprotocols"]]
    async with websockets.asyncio.client.connect(
        url,
        subprotocols=protocols or None,
        additional_headers={SECRET_HEADER: secret},
        compression=None,
        max_size=None,
        max_queue=AHEAD,
        ping_interval=None,
        close_timeout=1,
        proxy=None,
    ) as upstream:
        await websocket.accept(subprotocol=upstream.subprotocol)
        tasks = [asyncio.create_task(_down(upstream, websocket)), asyncio.create_task(_up(websocket, upstream))]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
    if websocket.application_state is WebSocketState.CONNECTED and websocket.client_state is WebSocketState.CONNECTED:
        code = upstream.close_code if upstream.close_code not in (None, *_NO_CODE) else 1001
        with suppress(RuntimeError, WebSocketDisconnect):
            await websocket.close(code or 1001, upstream.close_reason or "")


async def _down(upstream: ClientConnection, websocket: WebSocket) -> None:
    """From viser to the browser, waiting for a slow one."""
    with suppress(ConnectionClosed, WebSocketDisconnect, RuntimeError):
        async for message in upstream:
            if isinstance(message, str):
                await websocket.send_text(message)
            else:
                await websocket.send_bytes(message)


async def _up(websocket: WebSocket, upstream: ClientConnection) -> None:
    """From the browser to viser, which takes what it is sent for what its own page sends."""
    with suppress(ConnectionClosed):
        while True:
            message = await websocket.receive()
            if message["type"] == "websocket.disconnect":
                return
            data = message.get("bytes")
            members = None if data is None else members_of(data)
            if data is None or members is None:
                await websocket.close(1003, "this is no message of a 3D view")
                return
            if is_finite(members):  # a page that is being laid out may look nowhere
                await upstream.send(data)
