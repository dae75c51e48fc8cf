"""Servers in this process, as most tests of the server and its page need them: real ones on free ports."""

from __future__ import annotations

import atexit
import ssl
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import httpx

from app.memory import keep_for_good
from app.server_config import ServerConfig
from app.uploads.parsers import Parsers
from app.uploads.uploads import parsers_for

# What a client of plain HTTP trusts: nobody. Each of its own would read all authorities first, for 60 ms.
NO_AUTHORITIES = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)


@dataclass
class Served:
    """A server in this process. app : the FastAPI application, for what cannot be seen from outside; stop : before the
    test ends"""

    url: str
    config: ServerConfig
    client: httpx.Client
    app: Any
    stop: Callable[[], None]

    def ready(self) -> Served:
        """Wait until the kernels are there, as sessions that run need them."""
        while self.client.get("/readyz").status_code != 200:
            time.sleep(0.05)
        keep_for_good()
        return self


@cache
def _parsers(memory: int, seconds: float) -> Parsers:
    """Shared by all servers of this process with these limits: each of its processes takes seconds to import."""
    parsers = parsers_for(ServerConfig(parse_bytes=memory, parse_seconds=seconds))
    atexit.register(parsers.close)
    return parsers


@contextmanager
def serving(data_dir: Path) -> Iterator[Callable[..., Served]]:
    """A function that starts a server in this process with the settings it is given; all are stopped at the end."""
    from app.commands.serve import server_for
    from app.server import create_app

    stops: list[Callable[[], None]] = []

    def start(**settings: Any) -> Served:
        config = ServerConfig(**({"port": 0, "data_dir": data_dir, "requests_per_second": 1e5} | settings))
        app = create_app(config, _parsers(config.parse_bytes, config.parse_seconds))
        server = server_for(app, config)
        thread = threading.Thread(target=server.run, name="served", daemon=True)
        thread.start()
        while not server.started and thread.is_alive():
            time.sleep(0.005)
        assert server.started, "the server did not start; its log says why"
        port = server.servers[0].sockets[0].getsockname()[1]
        headers = {} if config.token is None else {"Authorization": f"Bearer {config.token}"}
        base_url = f"http://127.0.0.1:{port}"
        client = httpx.Client(base_url=base_url, headers=headers, timeout=None, verify=NO_AUTHORITIES)

        def stop() -> None:
            client.close()
            server.should_exit = True
            thread.join()

        stops.append(stop)
        return Served(str(client.base_url).rstrip("/"), replace(config, port=port), client, app, stop)

    try:
        yield start
    finally:
        for stop in stops:
            stop()
