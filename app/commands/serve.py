"""`pmpnbp serve`: one process, one port, until it is told to stop."""

from __future__ import annotations

import argparse
import asyncio
import logging
import secrets
import signal
import socket
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from functools import partial
from urllib.parse import quote

import anyio.to_thread
import uvicorn
from fastapi import FastAPI

from app.http import descriptors
from app.http.protocols import HttpProtocol, WebsocketProtocol
from app.memory import hold_less, keep_for_good
from app.server_config import ServerConfig, config_from
from pmpnbp.errors import PmpnbpError
from pmpnbp.importing import many_modules

OK = 0
# For requests that are being answered when the server is told to stop; streams end at once.
STOP_SECONDS = 5
# Of a connection that says nothing between two requests: longer than programs keep theirs (httpx 5 s, aiohttp 15 s), or
# the server closes it just as they use it again, and what they get is an error.
KEEP_ALIVE_SECONDS = 20
WEBSOCKET_BYTES = 64 << 20
# Connections that are accepted before any is looked at, and whether there are too many.
BACKLOG = 256


# How uvicorn's messages begin that are about what a client sent.
_OF_CLIENTS = ("Invalid HTTP request", "Unsupported upgrade", "No supported WebSocket", "Invalid UTF-8 sequence")


class ServeError(PmpnbpError):
    """The server cannot listen where it was told to."""


class Server(uvicorn.Server):
    """A server that closes sessions and streams first when it stops, as it would wait for streams without end."""

    def __init__(self, config: uvicorn.Config, app: FastAPI, listening: Callable[[], None] | None = None) -> None:
        super().__init__(config)
        self._app = app
        self._listening = listening

    async def startup(self, sockets: Sequence[socket.socket] | None = None) -> None:
        """Start, and have it said where."""
        asyncio.get_running_loop().set_exception_handler(descriptors.AcceptErrors())
        self._app.state.connections.watch()
        await super().startup(sockets=list(sockets) if sockets is not None else None)
        if self.started and self._listening is not None:
            self._listening()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        """Pause and keep sessions, end streams, then connections."""
        from app.server import end_streams

        # asyncio (until Python 3.12) fails on a connection that it accepts just as it stops listening, and leaks it
        loop = asyncio.get_running_loop()
        for server in self.servers:
            for listening in server.sockets:
                loop.remove_reader(listening.fileno())
        await anyio.to_thread.run_sync(end_streams, self._app)
        await super().shutdown(sockets)


def run(arguments: argparse.Namespace) -> int:
    """Serve until SIGTERM or SIGINT; return the exit status. Raises PmpnbpError for settings that cannot be."""
    config = config_from({entry.name: getattr(arguments, entry.name, None) for entry in fields(ServerConfig)})
    if config.token is None and not config.loopback:
        config = replace(config, token=secrets.token_urlsafe(24))
    return serve(config, logging.INFO, lambda app, config: partial(say, link(config)))


def serve(config: ServerConfig, level: int, opened: Callable[[FastAPI, ServerConfig], Callable[[], None]]) -> int:
    """Serve until SIGTERM or SIGINT; return the exit status.

    level : from which on messages go to standard error; opened : called with the application, its store open, and the
        configuration with the port that it listens at; what it returns is called once the server answers

    Raises PmpnbpError for settings that cannot be, and whatever `opened` does.
    """
    logging.basicConfig(level=level, format="%(levelname)s: %(name)s: %(message)s", stream=sys.stderr)
    quiet_libraries()
    descriptors.raise_limit()
    hold_less()
    listening = _listen(config)
    config = replace(config, port=listening.getsockname()[1])
    with many_modules():
        from app.server import close_all, create_app, open_all  # seconds of imports: bad settings are said before

    # What is first imported on a full disk would be kept in half, and fail from then on: Python 3.11 does not look
    # whether all of it was written
    sys.dont_write_bytecode = True
    app = create_app(config)
    keep_for_good()
    # uvicorn raises the signal that stopped it once more when it is done, by then for this handler
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        open_all(app)  # here, not in the server's own start, where a bad data directory would be a traceback
        server = server_for(app, config, opened(app, config))
        with suppress(KeyboardInterrupt):  # it was asked to stop and did: that is no failure
            server.run(sockets=[listening])
    finally:
        close_all(app)
        listening.close()
    if not server.started:
        raise ServeError("the server did not start; the lines above say why")
    return OK


def quiet_libraries() -> None:
    """Leave what comes and goes out of the log: requests are counted at /metrics, and a 3D view's connections too."""
    # the framework hides this remark on its own calls, but not where kernels are compiled meanwhile: what a thread
    # hides ends with whichever thread restores its filters last
    warnings.filterwarnings("ignore", message="The 'alias' attribute with value")
    for library in ("httpx", "websockets"):
        logging.getLogger(library).setLevel(logging.WARNING)
    logging.getLogger("uvicorn.error").addFilter(_of_ours)


def _of_ours(record: logging.LogRecord) -> bool:
    """Whether a record of uvicorn is about us: a client is told what it did wrong, and could fill the log with it."""
    return not str(record.msg).startswith(_OF_CLIENTS)


def say(line: str) -> None:
    """A line on standard output, at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def server_for(app: FastAPI, config: ServerConfig, listening: Callable[[], None] | None = None) -> Server:
    """A server for `app` that has not started. listening : called once it has."""
    connections = app.state.connections
    settings = uvicorn.Config(
        app,
        http=partial(HttpProtocol, connections=connections),  # type: ignore[arg-type]
        ws=partial(WebsocketProtocol, connections=connections),  # type: ignore[arg-type]
        backlog=BACKLOG,
        host=config.host,
        port=config.port,
        log_level="warning",
        log_config=None,
        access_log=False,  # a page's link has the token in it
        timeout_keep_alive=KEEP_ALIVE_SECONDS,
        ws_max_size=WEBSOCKET_BYTES,
        ws_per_message_deflate=False,
        ws_ping_timeout=60.0,  # a pong waits behind what a slow client has not read yet
        timeout_graceful_shutdown=STOP_SECONDS,
        server_header=False,
    )
    return Server(settings, app, listening)


def link(config: ServerConfig) -> str:
    """Where the page is, with the token where there is one."""
    host = f"[{config.host}]" if ":" in config.host else config.host
    return f"http://{host}:{config.port}/" + (f"?token={quote(config.token, safe='')}" if config.token else "")


def _listen(config: ServerConfig) -> socket.socket:
    """A socket that listens: found out before anything is opened. Raises ServeError."""
    family = socket.AF_INET6 if ":" in config.host else socket.AF_INET
    # asyncio sets TCP_NODELAY only where the protocol is named; without it an answer's body waits 40 ms
    listening = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
    try:
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind((config.host, config.port))
    except OSError as error:
        listening.close()
        raise ServeError(f"the server cannot listen at {config.host}:{config.port}: {error.strerror}") from None
    return listening
