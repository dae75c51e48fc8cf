"""What is attacked: a server, as its callers reach it, and what an attack has made there and removes again."""

from __future__ import annotations

import socket
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import urlsplit

import httpx

from app.server_config import LOOPBACK
from benchmarks import server_process
from benchmarks.server_process import ServerProcess

KINDS = ("sessions", "models", "scans", "recordings")
# The attacker's address, and that of somebody who has done nothing, where the server is on this machine.
ATTACKER, OTHER = "127.0.0.1", "127.0.0.2"


@dataclass
class Target:
    """url : of the server; pid, log : its process and the file of its messages, where they are known

    made : kind and id of what `keep` was told of
    """

    url: str
    token: str | None = None
    pid: int | None = None
    log: Path | None = None
    made: list[tuple[str, str]] = field(default_factory=list)

    @property
    def host(self) -> str:
        return urlsplit(self.url).hostname or ""

    @property
    def port(self) -> int:
        parts = urlsplit(self.url)
        return parts.port or (443 if parts.scheme == "https" else 80)

    @property
    def several_addresses(self) -> bool:
        """Whether callers of several addresses can be had from this machine."""
        return self.host in LOOPBACK and self.host != "::1"

    @property
    def headers(self) -> dict[str, str]:
        """What a caller with the token sends."""
        return {} if self.token is None else {"Authorization": f"Bearer {self.token}"}

    def client(self, address: str = ATTACKER, timeout: float | None = 120.0) -> httpx.Client:
        """A caller from `address`, where that can be chosen."""
        transport = httpx.HTTPTransport(local_address=address if self.several_addresses else None)
        return httpx.Client(base_url=self.url, headers=self.headers, timeout=timeout, transport=transport)

    def socket(self, address: str = ATTACKER, timeout: float = 30.0) -> socket.socket:
        """A connection from `address` that has said nothing."""
        source = (address, 0) if self.several_addresses else None
        return socket.create_connection((self.host, self.port), timeout, source)

    def head(self, method: str, path: str, **headers: str) -> bytes:
        """A request's first lines with the token, without the empty line that ends them."""
        lines = [f"{method} {path} HTTP/1.1", f"Host: {self.host}:{self.port}"]
        lines += [f"{name.replace('_', '-')}: {value}" for name, value in (self.headers | headers).items()]
        return "\r\n".join(lines).encode() + b"\r\n"

    def keep(self, kind: str, answer: httpx.Response) -> str | None:
        """Remember what an answer says was made, to remove it; its id, None where nothing was."""
        if answer.status_code != 201:
            return None
        self.made.append((kind, answer.json()["id"]))
        return self.made[-1][1]

    def made_by(self, kind: str, answer: httpx.Response) -> str:
        """The same for what has to succeed."""
        id = self.keep(kind, answer)
        assert id is not None, f"nothing was made: {answer.status_code} {answer.text[:300]}"
        return id

    def clean(self) -> None:
        """Remove what was made, sessions first, as they use the others."""
        with self.client() as client:
            for kind, id in sorted(self.made, key=lambda entry: KINDS.index(entry[0])):
                with suppress(httpx.HTTPError):
                    client.delete(f"/api/v1/{kind}/{id}")
        self.made.clear()


@dataclass(frozen=True)
class OwnServer:
    """A server of the attack's own, which may be spoilt."""

    folder: Path
    data_dir: Path
    target: Target
    process: ServerProcess


@contextmanager
def own_server(*options: str) -> Iterator[OwnServer]:
    """One that is ready, with a folder that goes with it."""
    with tempfile.TemporaryDirectory(prefix="attacked-") as name, own_server_in(Path(name), *options) as server:
        yield server


@contextmanager
def own_server_in(folder: Path, *options: str, environment: Mapping[str, str] | None = None) -> Iterator[OwnServer]:
    """The same in a folder that is there, and stays."""
    data_dir, log = folder / "data", folder / "log"
    process = server_process.start(data_dir, *options, environment=environment, log=log)
    try:
        process.ready()
        yield OwnServer(folder, data_dir, Target(process.url, process.token, process.process.pid, log), process)
    finally:
        if process.process.poll() is None:
            process.process.kill()
        process.process.wait()
        assert process.process.stdout is not None
        process.process.stdout.close()
