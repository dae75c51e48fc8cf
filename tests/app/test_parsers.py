"""Do the processes that read uploads take the blows? Files that take too long, too much memory, or crash them."""

from __future__ import annotations

import io
import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.problems import HttpProblem
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
    return int(parsers._idle[-1]._process.pid)


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


def test_a_file_that_takes_too_long_is_given_up(scan_file: Path, tmp_path: Path) -> None:
    parsers = Parsers(2 * GIB, 0.2)
    try:
        parsers.warm()
        worker = parsers._idle[-1]
        worker.wait_ready(time.monotonic() + 600)
        os.kill(worker._process.pid, signal.SIGSTOP)  # for a file that never ends
        with pytest.raises(HttpProblem, match=r"'a\.npy' takes longer to read than the 0\.2 s") as caught:
            parsers.parse("scans", scan_file, tmp_path / "out.npz")
        assert caught.value.status == 422
        assert not Path(f"/proc/{worker._process.pid}").exists()
        assert worker_pid(parsers) != worker._process.pid
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
    os.kill(worker._process.pid, signal.SIGSTOP)

    def die() -> None:
        os.kill(worker._process.pid, with_signal)
        with suppress(ProcessLookupError):
            os.kill(worker._process.pid, signal.SIGCONT)  # it sees no other signal while it is stopped

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
    os.kill(worker._process.pid, signal.SIGKILL)
    worker._process.wait()
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
