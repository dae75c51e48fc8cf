"""Servers for tests: real ones on free ports, in this process or in one that can be killed."""

from __future__ import annotations

import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import httpx
import pytest

from benchmarks import server_process
from tests.servers import NO_AUTHORITIES, Served, serving


@dataclass
class Process:
    """A server in a process of its own. client : carries its token, where it has one."""

    url: str
    data_dir: Path
    process: subprocess.Popen[str]
    client: httpx.Client
    first_line: str

    def kill(self) -> None:
        """As a power cut does it."""
        self.process.kill()
        self.process.wait()

    def stop(self) -> int:
        """As an operator does it; the exit status."""
        self.process.send_signal(signal.SIGTERM)
        return self.process.wait()

    def ready(self) -> Process:
        """Wait until the kernels are there."""
        while self.client.get("/readyz").status_code != 200:
            time.sleep(0.05)
        return self


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[..., Served]]:
    """A function that starts a server with the settings it is given; all are stopped at the end."""
    with serving(tmp_path / "data") as start:
        yield start


@pytest.fixture(scope="module")
def serve_for_module(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Served]]:
    """The same for the tests of a whole file, each call with a data directory of its own."""
    with ExitStack() as stack:
        yield lambda **settings: stack.enter_context(serving(tmp_path_factory.mktemp("data")))(**settings)


@pytest.fixture(scope="module")
def shared(serve_for_module: Callable[..., Served]) -> Served:
    """A server for a whole file, whose kernels are there."""
    return serve_for_module().ready()


@pytest.fixture(scope="module")
def client(shared: Served) -> httpx.Client:
    """Calls to it."""
    return shared.client


@pytest.fixture
def served(serve: Callable[..., Served]) -> Served:
    """A server on the loopback interface, without a token, with nothing in its store."""
    return serve()


@pytest.fixture
def served_process(tmp_path: Path) -> Iterator[Callable[..., Process]]:
    """A function that starts `pmpnbp serve` with the options it is given, in the same data directory each time."""
    started: list[Process] = []

    def start(*options: str, environment: dict[str, str] | None = None) -> Process:
        data_dir = tmp_path / "data"
        server = server_process.start(data_dir, *options, environment=environment)
        headers = {} if server.token is None else {"Authorization": f"Bearer {server.token}"}
        client = httpx.Client(base_url=server.url, headers=headers, timeout=None, verify=NO_AUTHORITIES)
        started.append(Process(server.url, data_dir, server.process, client, server.first_line))
        return started[-1]

    yield start
    for one in started:
        one.client.close()
        if one.process.poll() is None:
            one.kill()
        assert one.process.stdout is not None
        one.process.stdout.close()
