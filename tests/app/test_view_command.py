"""Does `pmpnbp view` show a recording at the link it prints, leave the file alone, and end when told to?"""

from __future__ import annotations

import json
import os
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.cli import main
from app.commands.view import take_in
from app.server_config import ServerConfig
from app.store.store import Store
from pmpnbp.errors import RecordingError

PROJECT = Path(__file__).resolve().parents[2]
CABINET = PROJECT / "sample_data" / "cabinet"
SCENE = CABINET / "open"


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `pmpnbp estimate --recording` writes of three iterations."""
    folder = tmp_path_factory.mktemp("recorded")
    path = folder / "an open drawer.sqlite"
    roi = ",".join(str(number) for number in json.loads((SCENE / "roi.json").read_text())["roi"])
    status = main(
        [
            "estimate",
            str(CABINET / "cabinet.urdf"),
            str(SCENE / "depth.png"),
            "--camera",
            str(SCENE / "camera.json"),
            f"--roi={roi}",
            "--particles",
            "40",
            "--iterations",
            "3",
            "--config",
            "search_iterations=2",
            "--config",
            "search_proposals=300",
            "--config",
            "search_islands=1",
            "--recording",
            str(path),
            "--out",
            str(folder / "result.json"),
            "--quiet",
        ]
    )
    assert status == 0
    return path


@pytest.fixture
def view(tmp_path: Path) -> Iterator[Callable[..., tuple[subprocess.Popen[str], str]]]:
    """A function that starts `pmpnbp view` with the arguments it is given: the process, and the line it prints."""
    started: list[subprocess.Popen[str]] = []

    def start(*arguments: str, **environment: str) -> tuple[subprocess.Popen[str], str]:
        inherited = {name: value for name, value in os.environ.items() if not name.startswith(("PMPNBP_", "BROWSER"))}
        command = [sys.executable, "-m", "app.cli", "view", *arguments]
        process = subprocess.Popen(
            command,
            cwd=PROJECT,
            env=inherited | {"TMPDIR": str(tmp_path)} | environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        assert process.stdout is not None
        return process, process.stdout.readline().rstrip("\n")

    yield start
    for process in started:
        process.kill()
        process.communicate()


def ended(process: subprocess.Popen[str], number: signal.Signals) -> tuple[int, str, str]:
    """Exit status, and what it printed after its first line."""
    process.send_signal(number)
    out, err = process.communicate()
    return process.returncode, out, err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_the_recording_is_at_the_link(view: Any, recording: Path, tmp_path: Path, number: signal.Signals) -> None:
    before = recording.read_bytes()
    process, link = view(str(recording), "--no-browser")
    assert link.startswith("http://127.0.0.1:") and link.endswith("/")
    root, _, id = link.rstrip("/").partition("/sessions/")
    with httpx.Client(base_url=root, trust_env=False, timeout=None) as client:
        page = client.get(link)
        assert page.status_code == 200 and page.headers["content-type"].startswith("text/html")
        found = client.get(f"/api/v1/sessions/{id}").json()
        assert (found["kind"], found["state"], found["iteration"]) == ("recording", "recorded", 3)
        assert found["name"] == recording.stem
        assert client.get(f"/api/v1/sessions/{id}/estimate").json()["iteration"] == 3
        (listed,) = client.get("/api/v1/recordings").json()
        assert listed["id"] == id and listed["file_name"] == recording.name
    assert ended(process, number) == (0, "", "")
    assert list(tmp_path.iterdir()) == []  # nothing is left behind
    assert recording.read_bytes() == before
    assert [path.name for path in recording.parent.iterdir() if path.suffix != ".json"] == [recording.name]


def test_the_browser_is_opened_where_there_is_a_screen(view: Any, recording: Path, tmp_path: Path) -> None:
    """`webbrowser` takes a command from the environment: here one that notes what it is given."""
    noted = tmp_path / "noted"
    browser = tmp_path / "a-browser"
    browser.write_text(f'#!/bin/sh\nprintf %s "$1" > {noted}.part && mv {noted}.part {noted}\n')
    browser.chmod(0o755)
    process, link = view(str(recording), BROWSER=f"{browser} %s")
    while not noted.exists():
        assert process.poll() is None
    assert noted.read_text() == link
    assert ended(process, signal.SIGINT)[0] == 0
    noted.unlink()
    process, _ = view(str(recording), "--no-browser", BROWSER=f"{browser} %s")
    assert ended(process, signal.SIGINT)[0] == 0
    assert not noted.exists()


def test_a_bad_file_is_one_sentence(capsys: pytest.CaptureFixture[str], recording: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.sqlite"
    with sqlite3.connect(other) as connection:
        connection.execute("CREATE TABLE a (b)")
    connection.close()
    beginning = tmp_path / "beginning.sqlite"
    beginning.write_bytes(recording.read_bytes()[:3000])
    sentences = {
        tmp_path / "nothing": "is not there; expected what `pmpnbp estimate --recording` writes",
        tmp_path: "is no file; expected",
        PROJECT / "README.md": "'README.md' is not a recording, or its beginning is damaged",
        other: "'other.sqlite' is not a recording of pmpnbp",
        beginning: "beginning.sqlite",
    }
    for path, sentence in sentences.items():
        assert main(["view", str(path), "--no-browser"]) == 2
        out, err = capsys.readouterr()
        assert out == "" and err.startswith("pmpnbp view: ") and sentence in err and err.count("\n") == 1, err
    assert main(["view", str(recording), "--port", "70000"]) == 2
    assert "'70000' is not a whole number from 0 to 65535" in capsys.readouterr().err


def test_what_is_still_in_the_log_is_seen(recording: Path, tmp_path: Path) -> None:
    """A recording whose writer has not closed it, or was killed: its newest iterations are in the log beside it."""
    copy = tmp_path / "cut off.sqlite"
    copy.write_bytes(recording.read_bytes())
    writer = sqlite3.connect(copy, isolation_level=None)
    writer.execute("PRAGMA journal_mode = WAL")
    newest = writer.execute("SELECT max(number) FROM iterations").fetchone()[0]
    writer.execute("DELETE FROM iterations WHERE number = ?", (newest,))
    store = Store(tmp_path / "data", 1 << 30)
    try:
        id = take_in(copy, store, ServerConfig(data_dir=tmp_path / "data"))
        assert store.document("recordings", id)["last_iteration"] == newest - 1
        with pytest.raises(RecordingError, match=r"'README\.md' is not a recording"):
            take_in(PROJECT / "README.md", store, ServerConfig(data_dir=tmp_path / "data"))
        assert len(store.documents("recordings")) == 1
    finally:
        store.close()
        writer.close()
