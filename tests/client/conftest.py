"""Clients of real servers, of servers that fail as they are told to, and of a connection that breaks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from pmpnbp.client import calls
from pmpnbp.client.client import Client
from tests.client.failing_servers import Relay, Scripted
from tests.servers import Served, serving


@pytest.fixture(scope="module")
def served(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A server for a whole file, whose kernels are there."""
    with serving(tmp_path_factory.mktemp("data")) as start:
        yield start().ready()


@pytest.fixture(scope="module")
def client(served: Served) -> Iterator[Client]:
    with Client(served.url) as made:
        yield made


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Callable[..., Served]]:
    """A function that starts a server with the settings it is given."""
    with serving(tmp_path / "data") as start:
        yield start


@pytest.fixture
def scripted() -> Iterator[Callable[..., Scripted]]:
    """A function that starts a server which gives the answers it is told, in order."""
    with ExitStack() as stack:
        yield lambda *answers: stack.enter_context(Scripted(answers))


@pytest.fixture
def relay(served: Served) -> Iterator[Callable[..., Relay]]:
    """A function that starts a relay to the server of this file, told how many bytes of answers the first connections
    carry."""
    with ExitStack() as stack:
        yield lambda *limits: stack.enter_context(Relay(served.config.port, limits))


@pytest.fixture
def at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Calls are made again without a pause, where the server asks for none."""
    monkeypatch.setattr(calls, "FIRST_WAIT", 0.0)
