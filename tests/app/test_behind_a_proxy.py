"""Does all that a browser needs pass through the proxy that docs/deployment describes? Where Caddy is installed, the
very Caddyfile is asked, with another address for the server and another port for TLS."""

from __future__ import annotations

import asyncio
import random
import shutil
import socket
import ssl
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import httpx
import pytest
import websockets.asyncio.client
from websockets.exceptions import InvalidStatus

from benchmarks.view_socket import PROTOCOL
from tests.app import small_sessions as small

TOKEN = "a-token-for-this-test"
CADDY = shutil.which("caddy")
pytestmark = pytest.mark.skipif(CADDY is None, reason="caddy is not installed: nothing to put in front of the server")


@contextmanager
def proxy_of(served: Any, repository: Path, folder: Path) -> Iterator[tuple[str, ssl.SSLContext]]:
    """The address of a Caddy in front of the server, and what to trust it by."""
    assert CADDY is not None
    port = free_port()
    text = (repository / "docs" / "deployment" / "Caddyfile").read_text(encoding="utf-8")
    assert text.count("pmpnbp:8080") == 1
    (folder / "Caddyfile").write_text(text.replace("pmpnbp:8080", f"127.0.0.1:{served.config.port}"), encoding="utf-8")
    environment = {"PMPNBP_DOMAIN": f"localhost:{port}", "HOME": str(folder), "XDG_DATA_HOME": str(folder)}
    command = [CADDY, "run", "--config", str(folder / "Caddyfile"), "--adapter", "caddyfile"]
    with (folder / "log").open("wb") as log, subprocess.Popen(command, env=environment, stderr=log) as caddy:
        root = folder / "caddy" / "pki" / "authorities" / "local" / "root.crt"
        try:
            while not (root.exists() and root.stat().st_size and listens(port, root)):
                assert caddy.poll() is None, (folder / "log").read_text(encoding="utf-8")
                time.sleep(small.PATIENCE)
            yield f"https://localhost:{port}", ssl.create_default_context(cafile=str(root))
        finally:
            caddy.terminate()


def free_port() -> int:
    """Free at every address, where Caddy listens, and below those that the system gives to whoever asks: of these one
    may be another test's connection a moment later."""
    for port in random.sample(range(20_000, 32_000), 100):
        with socket.socket() as free, suppress(OSError):
            free.bind(("", port))
            return port
    raise AssertionError("of a hundred ports none is free")


def listens(port: int, root: Path) -> bool:
    """Whether it answers, with a certificate, which it makes some time after it listens."""
    try:
        trusted = ssl.create_default_context(cafile=str(root))
        with socket.create_connection(("127.0.0.1", port)) as probe:
            trusted.wrap_socket(probe, server_hostname="localhost").close()
    except OSError:
        return False
    return True


@pytest.fixture
def through(
    serve: Callable[..., Any], repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Iterator[Callable[..., tuple[Any, str, ssl.SSLContext]]]:
    """A function that starts a server, with a token and these settings, and the proxy as compose.yaml has them."""
    from contextlib import ExitStack

    monkeypatch.setenv("FORWARDED_ALLOW_IPS", "*")
    with ExitStack() as stack:

        def start(**settings: Any) -> tuple[Any, str, ssl.SSLContext]:
            served = serve(token=TOKEN, **settings)
            return served, *stack.enter_context(proxy_of(served, repository, tmp_path))

        yield start


def test_page_uploads_events_and_view_pass_over_tls(through: Callable[..., Any]) -> None:
    served, url, trusted = through()
    served.ready()
    with httpx.Client(base_url=url, verify=trusted, timeout=None, follow_redirects=True, trust_env=False) as browser:
        assert browser.get("/api/v1/models").status_code == 401
        page = browser.get(f"/?token={TOKEN}")
        assert page.status_code == 200 and "<html" in page.text
        assert page.headers["strict-transport-security"] == "max-age=31536000"
        cookies = [answer.headers.get("set-cookie", "") for answer in [*page.history, page]]
        assert any("Secure" in cookie for cookie in cookies), cookies
        # from here on by the cookie alone, as the page does
        browser.headers["Origin"] = url
        path = small.create(browser)
        with browser.stream("GET", f"{path}/events") as events:
            lines = events.iter_lines()
            heard = [next(lines)]
            # the stream stays open: that this iteration is heard of at all says that nothing was held back
            small.step(browser, path)
            while not heard[-1].startswith("event: iteration"):
                heard.append(next(lines))

        async def view(origin: str) -> bytes:
            cookie = "; ".join(f"{name}={value}" for name, value in browser.cookies.items())
            address = f"{url.replace('https', 'wss')}/sessions/{path.rsplit('/', 1)[1]}/view"
            async with websockets.asyncio.client.connect(
                address,
                ssl=trusted,
                origin=origin,  # type: ignore[arg-type]
                additional_headers={"Cookie": cookie},
                subprotocols=[PROTOCOL],
                max_size=None,
                proxy=None,
            ) as websocket:
                return bytes(await websocket.recv(decode=False))

        assert len(asyncio.run(view(url))) > 16
        with pytest.raises(InvalidStatus):
            asyncio.run(view("https://elsewhere.example"))


def test_each_client_behind_it_has_its_own_allowance(through: Callable[..., Any]) -> None:
    """Also where a client claims to be another one."""
    _, url, trusted = through(requests_per_second=0.1)

    def client(address: str) -> httpx.Client:
        transport = httpx.HTTPTransport(verify=trusted, local_address=address)
        return httpx.Client(base_url=url, transport=transport, headers={"Authorization": f"Bearer {TOKEN}"})

    with client("127.0.0.1") as greedy, client("127.0.0.2") as modest:
        while (answer := greedy.get("/api/v1/models", headers={"X-Forwarded-For": "192.0.2.1"})).status_code == 200:
            pass
        assert answer.status_code == 429
        assert "from this client" in answer.text
        assert modest.get("/api/v1/models").status_code == 200


def test_the_largest_upload_is_refused_by_the_server_itself(through: Callable[..., Any]) -> None:
    _, url, trusted = through(max_upload_bytes=4096)
    with httpx.Client(base_url=url, verify=trusted, headers={"Authorization": f"Bearer {TOKEN}"}) as client:
        answer = client.post("/api/v1/scans", files={"file": ("cloud.xyz", b"0 0 1\n" * 10_000)})
    assert answer.status_code == 413
    assert answer.headers["content-type"] == "application/problem+json"
