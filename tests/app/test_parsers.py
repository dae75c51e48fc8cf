"""Do the processes that read uploads take the blows? Files that take too long, too much memory, or crash them."""

from __future__ import annotations

import io
import json
import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.problems import HttpProblem
from app.uploads.forking import ENDED
from app.uploads.parsers import Parsers

GIB = 1 << 30


@pytest.fixture
def parsers() -> Iterator[Parsers]:
    opened = Parsers(2 * GIB, 30.0)
    yield opened
    opened.close()


@pytest.fixture
def scan_file(tmp_path: Path) -> Path:
    path = tmp_path / "a.npy"
    np.save(path, np.dstack([*np.meshgrid(np.linspace(-1, 1, 20), np.linspace(-1, 1, 20)), np.full((20, 20), 2.0)]))
    return path


def worker_pid(parsers: Parsers) -> int:
    """Of the process that would read the next scan."""
    worker = parsers._idle[-1]
    worker.wait_ready(time.monotonic() + 600)
    assert worker.pid is not None
    return worker.pid


def test_a_process_reads_many_files_and_carries_no_secret(
    parsers: Parsers, scan_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PMPNBP_TOKEN", "7d1f0c")
    monkeypatch.setenv("CLOUD_KEY", "7d1f0c")
    parsers.warm()
    first = worker_pid(parsers)
    for _ in range(3):
        assert parsers.parse("scans", scan_file, tmp_path / "out.npz")["points"] > 0
    assert worker_pid(parsers) == first
    assert b"7d1f0c" not in Path(f"/proc/{first}/environ").read_bytes()
    assert f"{2 * GIB}" in Path(f"/proc/{first}/limits").read_text().split("Max address space")[1].splitlines()[0]


def test_a_process_is_replaced_after_a_while(
    parsers: Parsers, scan_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.uploads.parsers.MOST_FILES", 2)
    parsers.warm()
    first = worker_pid(parsers)
    parsers.parse("scans", scan_file, tmp_path / "out.npz")
    assert worker_pid(parsers) == first
    parsers.parse("scans", scan_file, tmp_path / "out.npz")
    assert worker_pid(parsers) != first
    assert not Path(f"/proc/{first}").exists()


@pytest.mark.parametrize(
    ("ask", "sentence"),
    [
        (lambda parsers, path: parsers.parse("scans", path, path.with_suffix(".npz")), "to read than the 0.2 s"),
        (lambda parsers, path: parsers.regions(path, [path]), "to look for in its scans than the 0.2 s"),
    ],
)
def test_a_file_that_takes_too_long_is_given_up(
    ask: Callable[[Parsers, Path], object], sentence: str, scan_file: Path
) -> None:
    parsers = Parsers(2 * GIB, 0.2)
    try:
        parsers.warm()
        worker = parsers._idle[-1]
        worker.wait_ready(time.monotonic() + 600)
        os.kill(worker.pid, signal.SIGSTOP)  # for a file that never ends
        with pytest.raises(HttpProblem, match=re.escape(f"'a.npy' takes longer {sentence}")) as caught:
            ask(parsers, scan_file)
        assert caught.value.status == 422
        assert not Path(f"/proc/{worker.pid}").exists()
        assert worker_pid(parsers) != worker.pid
    finally:
        parsers.close()


def test_a_file_that_crashes_its_reader_is_refused_and_the_next_is_read(
    parsers: Parsers, scan_file: Path, tmp_path: Path
) -> None:
    parsers.warm()
    worker = parsers._idle[-1]
    worker.wait_ready(time.monotonic() + 600)
    crash(worker, signal.SIGSEGV)
    with pytest.raises(HttpProblem, match="it made its reader crash") as caught:
        parsers.parse("scans", scan_file, tmp_path / "out.npz")
    assert caught.value.status == 422
    assert parsers.parse("scans", scan_file, tmp_path / "out.npz")["points"] > 0


def crash(worker: Any, with_signal: signal.Signals) -> None:
    """Have the process die of a signal while it reads its next file."""
    os.kill(worker.pid, signal.SIGSTOP)

    def die() -> None:
        os.kill(worker.pid, with_signal)
        with suppress(ProcessLookupError):
            os.kill(worker.pid, signal.SIGCONT)  # it sees no other signal while it is stopped

    threading.Timer(0.1, die).start()


def test_a_file_whose_reader_was_killed_is_read_once_more(parsers: Parsers, scan_file: Path, tmp_path: Path) -> None:
    parsers.warm()
    worker = parsers._idle[-1]
    worker.wait_ready(time.monotonic() + 600)
    crash(worker, signal.SIGKILL)
    assert parsers.parse("scans", scan_file, tmp_path / "out.npz")["points"] > 0


def test_a_file_whose_readers_are_killed_may_come_again(
    parsers: Parsers, scan_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ready = parsers._get_ready

    def killed(worker: Any) -> None:
        ready(worker)
        crash(worker, signal.SIGKILL)

    monkeypatch.setattr(parsers, "_get_ready", killed)
    with pytest.raises(HttpProblem, match=r"the process that reads 'a\.npy' was killed twice") as caught:
        parsers.parse("scans", scan_file, tmp_path / "out.npz")
    assert caught.value.status == 503 and caught.value.headers["Retry-After"]
    monkeypatch.undo()
    assert parsers.parse("scans", scan_file, tmp_path / "out.npz")["points"] > 0


def test_a_process_that_died_of_itself_is_no_uploads_fault(parsers: Parsers, scan_file: Path, tmp_path: Path) -> None:
    parsers.warm()
    worker = parsers._idle[-1]
    os.kill(worker_pid(parsers), signal.SIGKILL)
    while worker.alive:
        time.sleep(0.01)
    assert parsers.parse("scans", scan_file, tmp_path / "out.npz")["points"] > 0


def test_a_file_that_takes_too_much_memory_is_refused(tmp_path: Path) -> None:
    content = io.BytesIO()
    np.savez_compressed(content, points=np.ones((6_000_000, 3)))
    path = tmp_path / "large.npz"
    path.write_bytes(content.getvalue())
    assert path.stat().st_size < 1 << 20
    parsers = Parsers(800 << 20, 60.0)
    try:
        with pytest.raises(HttpProblem, match=r"'large\.npz' takes more memory to read than an upload may"):
            parsers.parse("scans", path, tmp_path / "out.npz")
    finally:
        parsers.close()


def test_a_limit_that_leaves_no_room_for_the_reader_is_the_servers_fault(scan_file: Path, tmp_path: Path) -> None:
    parsers = Parsers(64 << 20, 30.0)
    try:
        with pytest.raises(HttpProblem, match="does not start within 64 MiB of memory") as caught:
            parsers.parse("scans", scan_file, tmp_path / "out.npz")
        assert caught.value.status == 500
    finally:
        parsers.close()


def test_processes_end_with_their_server(scan_file: Path, tmp_path: Path) -> None:
    parsers = Parsers(2 * GIB, 30.0)
    parsers.warm()
    pid = worker_pid(parsers)
    parsers.close()
    assert not Path(f"/proc/{pid}").exists()
    assert parsers.parse("scans", scan_file, tmp_path / "out.npz")["points"] > 0  # an upload that was under way
    assert parsers._idle == []


def test_a_process_that_takes_a_place_is_forked_and_where_what_forks_is_gone_that_is_started_anew(
    parsers: Parsers, scan_file: Path, tmp_path: Path
) -> None:
    parsers.warm()
    nurseries = []
    for _ in range(2):
        os.kill(worker_pid(parsers), signal.SIGKILL)
        assert parsers.parse("scans", scan_file, tmp_path / "out.npz")["points"] > 0
        nurseries.append(parent(worker_pid(parsers)))
    assert nurseries[0] == nurseries[1]
    os.kill(nurseries[0], signal.SIGKILL)
    assert parsers.parse("scans", scan_file, tmp_path / "out.npz")["points"] > 0  # by the one that is there still
    os.kill(worker_pid(parsers), signal.SIGKILL)
    while parsers._idle[-1].alive:
        time.sleep(0.01)
    assert parsers.parse("scans", scan_file, tmp_path / "out.npz")["points"] > 0
    assert parent(worker_pid(parsers)) != nurseries[0]


def parent(pid: int) -> int:
    return int(re.findall(r"^PPid:\s+(\d+)$", Path(f"/proc/{pid}/status").read_text(), re.MULTILINE)[0])


STARTS_AND_DIES = """
import os, signal, socket, subprocess
from app.uploads.forking import fork_for_each

def work(connection):
    child = subprocess.Popen(["sleep", "600"])
    connection.sendall(b"%d\\n" % child.pid)
    os.kill(os.getpid(), signal.SIGSEGV)

fork_for_each(socket.socket(fileno=0), work)
"""


def test_what_a_process_started_ends_with_it() -> None:
    """Forked here, as a reader is, and killed by what it reads."""
    ours, theirs = socket.socketpair()
    with theirs:
        process = subprocess.Popen([sys.executable, "-c", STARTS_AND_DIES], stdin=theirs.fileno())
    mine, its = socket.socketpair()
    with ours, mine:
        with its:
            socket.send_fds(ours, [b"+"], [its.fileno()])
        with mine.makefile() as lines:
            started, told = lines
    assert json.loads(told) == {ENDED: -signal.SIGSEGV}
    assert process.wait() == 0
    status = Path(f"/proc/{int(started)}/stat")
    while status.exists() and status.read_text().rpartition(")")[2].split()[0] != "Z":  # whoever adopts it reaps it
        time.sleep(0.01)
