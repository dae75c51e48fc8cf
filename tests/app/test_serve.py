"""Does `pmpnbp serve` start where it is told to, say so in one line, and stop when told to?"""

from __future__ import annotations

import asyncio
import importlib
import logging
import os
import re
import signal
import socket
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any

import anyio.from_thread
import httpx
import pytest
from pydantic import Field, TypeAdapter

from app import server
from app.commands.serve import link, quiet_libraries
from app.commands.serve import serve as serve_until_stopped
from app.routes.start_page import MEDIA_TYPES, STATIC
from app.server_config import ServerConfig, config_from, default_data_dir, environment_name
from pmpnbp.errors import SettingError
from pmpnbp.version import version

PROJECT = Path(__file__).resolve().parents[2]


def test_it_says_where_it_is_and_stops_when_told_to(served_process: Callable[..., Any]) -> None:
    process = served_process()
    assert process.first_line.startswith("http://127.0.0.1:") and "token" not in process.first_line
    assert process.client.get("/healthz").json()["status"] == "ok"
    assert process.client.get("/").headers["content-type"] == "text/html; charset=utf-8"
    assert process.stop() == 0
    assert process.process.stdout.read() == ""  # one line, and no more


def test_it_stops_at_once_while_streams_are_open(served_process: Callable[..., Any]) -> None:
    """A connection that asks for nothing, and one in the middle of a request, do not keep it."""
    process = served_process()
    host, port = process.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port))), socket.create_connection((host, int(port))) as half:
        half.sendall(b"GET /healthz HTTP/1.1\r\n")
        assert process.stop() == 0


def test_who_comes_as_it_stops_is_turned_away(
    serve: Callable[..., Any], monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """Not accepted and forgotten: pages come back at once when their streams end."""
    served, end_streams = serve(), server.end_streams

    def and_somebody_comes(application: Any) -> None:
        end_streams(application)
        loop = anyio.from_thread.run_sync(asyncio.get_running_loop)
        loop.call_soon_threadsafe(time.sleep, 0.3)  # until then it hears neither of the connection nor of our return
        time.sleep(0.1)
        with suppress(ConnectionRefusedError), socket.create_connection(("127.0.0.1", served.config.port)):
            pass  # refused where they are ended once more, after it stopped listening

    monkeypatch.setattr(server, "end_streams", and_somebody_comes)
    served.stop()
    assert not caplog.records, caplog.text


def test_what_is_imported_while_it_serves_is_not_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A disk may be full by then, and half of a module be kept."""

    class Open(Exception):
        """It would serve from here on."""

    def opened(*_: Any) -> Any:
        module = tmp_path / "imported_late.py"
        module.write_text("", encoding="utf-8")
        monkeypatch.syspath_prepend(tmp_path)
        importlib.import_module(module.stem)
        raise Open

    monkeypatch.setattr(sys, "dont_write_bytecode", False)
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    with pytest.raises(Open):
        serve_until_stopped(ServerConfig(port=0, data_dir=tmp_path / "data"), logging.WARNING, opened)
    assert not list(tmp_path.rglob("*.pyc"))


def test_what_the_framework_hides_of_its_own_calls_is_hidden_whatever_another_thread_restores() -> None:
    def call() -> None:
        TypeAdapter(Annotated[int, Field(alias="body")])

    with pytest.warns(UserWarning, match="The 'alias' attribute"):
        call()
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        quiet_libraries()
        call()
    assert said == []


def test_ctrl_c_is_no_failure(served_process: Callable[..., Any]) -> None:
    process = served_process()
    process.process.send_signal(signal.SIGINT)
    assert process.process.wait() == 0


def test_another_host_gets_a_token_that_is_printed_once(served_process: Callable[..., Any]) -> None:
    process = served_process("--host", "0.0.0.0")
    token = process.client.headers["Authorization"].removeprefix("Bearer ")
    assert len(token) >= 24
    assert process.client.get("/api/v1/settings").status_code == 200
    assert httpx.get(f"{process.url}/api/v1/settings").status_code == 401
    page = httpx.get(f"{process.url}/", params={"token": token}, follow_redirects=False)
    assert page.status_code == 303
    assert process.stop() == 0


@pytest.mark.parametrize("seconds", [0.0, 1.5])
def test_it_can_be_stopped_while_its_kernels_are_compiled(
    served_process: Callable[..., Any], tmp_path: Path, seconds: float
) -> None:
    process = served_process(environment={"NUMBA_CACHE_DIR": str(tmp_path / "kernels")})
    time.sleep(seconds)
    assert process.client.get("/readyz").status_code == 503
    assert process.client.get("/healthz").json()["ready"] is False
    assert process.stop() == 0


def test_a_token_can_be_given(served_process: Callable[..., Any]) -> None:
    process = served_process(environment={"PMPNBP_TOKEN": "from-outside"})
    assert process.first_line.rstrip().endswith("/?token=from-outside")
    assert process.client.get("/api/v1/settings").status_code == 200


def test_the_sample_session_is_open(served_process: Callable[..., Any]) -> None:
    process = served_process("--demo").ready()
    sessions = process.client.get("/api/v1/sessions").json()  # a server that is ready has it
    path = f"/api/v1/sessions/{sessions[0]['id']}"
    assert process.client.get(f"{path}/estimate", params={"wait": "idle", "timeout": 60}).status_code == 200
    assert process.client.get(sessions[0]["view_url"]).status_code == 200
    assert process.stop() == 0
    # once more: the same session, not a second one
    process = served_process("--demo").ready()
    assert [entry["id"] for entry in process.client.get("/api/v1/sessions").json()] == [sessions[0]["id"]]
    assert process.stop() == 0


def run(*arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "app.cli", "serve", *arguments]
    return subprocess.run(command, cwd=PROJECT, env=os.environ | environment, capture_output=True, text=True)


@pytest.mark.parametrize(
    ("arguments", "environment", "sentence"),
    [
        (["--port", "70000"], {}, "pmpnbp serve: server setting 'port' is 70000; it must be from 0 to 65535"),
        (["--max-running", "0"], {}, "pmpnbp serve: server setting 'max_running' is 0; it must be at least 1"),
        (
            ["--port", "x"],
            {},
            "pmpnbp serve: argument --port: it is 'x'; it must be a whole number; see pmpnbp serve --help",
        ),
        ([], {"PMPNBP_PORT": "many"}, "pmpnbp serve: PMPNBP_PORT is 'many'; it must be a whole number"),
        ([], {"PMPNBP_DEMO": "perhaps"}, "pmpnbp serve: PMPNBP_DEMO is 'perhaps'; it must be true or false"),
        (
            ["--token", " "],
            {},
            "pmpnbp serve: server setting 'token' is empty or has characters that a header cannot carry",
        ),
        (["--host", "256.1.1.1"], {}, "pmpnbp serve: the server cannot listen at 256.1.1.1:0"),
    ],
)
def test_a_setting_that_cannot_be_is_one_sentence(
    arguments: list[str], environment: dict[str, str], sentence: str, tmp_path: Path
) -> None:
    port = [] if "--port" in arguments or "PMPNBP_PORT" in environment else ["--port", "0"]
    found = run("--data-dir", str(tmp_path / "data"), *port, *arguments, **environment)
    assert found.returncode == 2 and found.stdout == ""
    assert found.stderr.startswith(sentence) and found.stderr.count("\n") == 1
    assert not (tmp_path / "data").exists()


def test_a_port_that_is_taken_is_said(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        found = run("--data-dir", str(tmp_path), "--port", str(port))
    assert found.returncode == 2
    assert found.stderr == f"pmpnbp serve: the server cannot listen at 127.0.0.1:{port}: Address already in use\n"


def test_a_data_directory_in_use_is_said(served_process: Callable[..., Any]) -> None:
    process = served_process()
    found = run("--data-dir", str(process.data_dir), "--port", "0")
    assert found.returncode == 2 and found.stdout == ""
    assert found.stderr.startswith("pmpnbp serve: the data directory") and found.stderr.count("\n") == 1


def test_options_go_before_the_environment_before_the_defaults() -> None:
    environment = {"PMPNBP_PORT": "1", "PMPNBP_HOST": "::1", "PMPNBP_DEMO": "yes", "PMPNBP_PARSE_SECONDS": "2.5"}
    config = config_from({"port": 2, "host": None}, environment)
    assert (config.port, config.host, config.demo, config.parse_seconds) == (2, "::1", True, 2.5)
    assert config.max_running == 2
    assert config_from({"demo": False}, environment).demo is False
    assert config_from({}, {"PMPNBP_TOKEN": "", "PMPNBP_DATA_DIR": "~/there"}).data_dir == Path.home() / "there"
    assert config_from({}, {"PMPNBP_DATA_DIR": "here"}).data_dir == Path.cwd() / "here"


def test_every_setting_has_a_name_and_a_word_of_help() -> None:
    for entry in fields(ServerConfig):
        assert entry.metadata["help"], entry.name
        assert environment_name(entry.name) == "PMPNBP_" + entry.name.upper()
    with pytest.raises(SettingError, match="PMPNBP_PARSE_SECONDS is 'nan'; it must be a finite number"):
        config_from({}, {"PMPNBP_PARSE_SECONDS": "nan"})
    with pytest.raises(SettingError, match="'host' is empty"):
        ServerConfig(host="")


def test_data_goes_where_the_system_keeps_users_data() -> None:
    assert default_data_dir({"XDG_DATA_HOME": "/x"}) == Path("/x/pmpnbp")
    assert default_data_dir({"XDG_DATA_HOME": "not/absolute"}) == Path.home() / ".local/share/pmpnbp"


def test_the_link_fits_the_address() -> None:
    assert link(ServerConfig(host="::1", port=80)) == "http://[::1]:80/"
    assert link(ServerConfig(host="0.0.0.0", port=81, token="a")) == "http://0.0.0.0:81/?token=a"
    # what tokens are often made of means something else in an address
    assert link(ServerConfig(host="h", port=81, token="a+b/c&d=#")) == "http://h:81/?token=a%2Bb%2Fc%26d%3D%23"


@pytest.fixture(scope="module")
def page(serve_for_module: Callable[..., Any]) -> Iterator[httpx.Client]:
    yield serve_for_module().client


def test_the_pages_files_are_served_and_no_others(page: httpx.Client) -> None:
    text = page.get("/").text
    for path in (found for found in STATIC.rglob("*") if found.is_file()):
        answer = page.get(f"/static/{path.relative_to(STATIC).as_posix()}")
        assert answer.content == path.read_bytes()
        assert answer.headers["content-type"] == MEDIA_TYPES[path.suffix]
    for name in (
        "nothing.js",
        "..%2fpyproject.toml",
        "%2e%2e%2fREADME.md",
        ".",
        "%00",
        "start",
        "start/",
        "start/..%2findex.html",
        "start/%2e%2e/%2e%2e/README.md",
    ):
        assert page.get(f"/static/{name}").status_code == 404
    assert re.search(r'"/static/[0-9a-f]{12}/style.css"', text) and "://" not in text
    assert page.get("/favicon.ico").headers["content-type"] == "image/svg+xml"


def test_metrics_are_prometheus_text(page: httpx.Client) -> None:
    page.get("/nowhere")
    answer = page.get("/metrics")
    assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    samples = {}
    for line in answer.text.splitlines():
        if not line.startswith("#"):
            name, value = line.rsplit(" ", 1)
            samples[name] = float(value)
    assert samples['pmpnbp_http_requests_total{method="GET",status="404"}'] >= 1
    assert samples["pmpnbp_clients"] == 1 and samples[f'pmpnbp_info{{version="{version()}"}}'] == 1
    assert {"pmpnbp_ready", "pmpnbp_stored_bytes"} <= set(samples)
    assert samples["pmpnbp_uptime_seconds"] > 0 and samples["pmpnbp_resident_memory_bytes"] > 1e7
    names = {line.split()[2] for line in answer.text.splitlines() if line.startswith("# TYPE")}
    assert {name.split("{")[0] for name in samples} <= names
    assert names == {
        f"pmpnbp_{name}"
        for name in (
            *("info", "ready", "uptime_seconds", "resident_memory_bytes", "stored_bytes", "clients"),
            *("connections", "connections_ended_total"),
            *("http_requests_total", "sessions"),
        )
    }
