"""Conditions in which a system lets a server down, put on and taken off while it runs: see `bad_systems`."""

from __future__ import annotations

import errno
import os
import resource
import subprocess
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import httpx

from tests.app.attacks import entries
from tests.app.attacks.outcome import Outcome
from tests.app.attacks.target import OwnServer

SMALL_DISK = "96m"
# Room for a session's document, none for a scan or a page more of a recording.
SMALL_FILE = 4096
HOUR = 3600.0

# What a server's Python runs before anything else: its clocks are off by what a file says.
_CLOCK = """
import datetime, time

real, real_ns, instant = time.time, time.time_ns, datetime.datetime

def offset():
    try:
        with open({path!r}) as file:
            return float(file.read() or 0)
    except OSError:
        return 0.0

class Shifted(instant):
    @classmethod
    def now(cls, tz=None):
        return instant.now(tz) + datetime.timedelta(seconds=offset())

    @classmethod
    def utcnow(cls):
        return instant.utcnow() + datetime.timedelta(seconds=offset())

time.time = lambda: real() + offset()
time.time_ns = lambda: real_ns() + int(offset() * 1e9)
Shifted.__name__, Shifted.__qualname__, Shifted.__module__ = "datetime", "datetime", "datetime"
datetime.datetime = Shifted
"""


@contextmanager
def plain(folder: Path) -> Iterator[Path]:
    """The folder as it is."""
    yield folder


@contextmanager
def small_disk(folder: Path) -> Iterator[Path]:
    """A file system of its own that can be filled; the log is beside it."""
    data = folder / "data"
    data.mkdir()
    _mount("-t", "tmpfs", "-o", f"size={SMALL_DISK}", "tmpfs", str(data))
    try:
        yield folder
    finally:
        _unmount(data)


@contextmanager
def filled(server: OwnServer) -> Iterator[None]:
    """Not a byte is left."""
    filler = server.data_dir / "filler"
    _fill(filler)
    end = threading.Event()
    # what is given back under the condition, as a log that is folded, is filled up again
    again = threading.Thread(target=lambda: [_fill(filler) for _ in iter(lambda: end.wait(0.1), True)], daemon=True)
    again.start()
    try:
        yield
    finally:
        end.set()
        again.join()
        filler.unlink()


def _fill(path: Path) -> None:
    with path.open("ab", buffering=0) as file:
        size = 1 << 20
        while size:
            try:
                file.write(bytes(size))
            except OSError as error:
                assert error.errno == errno.ENOSPC
                size //= 2


@contextmanager
def read_only(server: OwnServer) -> Iterator[None]:
    """Files that are open already can be written; nothing can be made, changed or removed."""
    path = str(server.data_dir)
    _mount("--bind", path, path)
    try:
        _mount("-o", "remount,bind,ro", path)
        yield
    finally:
        _unmount(server.data_dir)


@contextmanager
def small_files(server: OwnServer) -> Iterator[None]:
    """RLIMIT_FSIZE, set while it runs."""
    assert server.target.pid is not None
    before = resource.prlimit(server.target.pid, resource.RLIMIT_FSIZE)
    resource.prlimit(server.target.pid, resource.RLIMIT_FSIZE, (SMALL_FILE, before[1]))
    try:
        yield
    finally:
        resource.prlimit(server.target.pid, resource.RLIMIT_FSIZE, before)


def own_clock(folder: Path) -> Mapping[str, str]:
    """The environment of a server whose clock follows a file."""
    place = folder / "clock"
    place.mkdir(exist_ok=True)
    (place / "sitecustomize.py").write_text(_CLOCK.format(path=str(folder / "offset")), encoding="utf-8")
    return {"PYTHONPATH": os.pathsep.join([str(place), os.environ.get("PYTHONPATH", "")]).strip(os.pathsep)}


@contextmanager
def an_hour_ago(server: OwnServer) -> Iterator[None]:
    """The clock jumps back, and forward again in the end. Keys that were remembered before are asked for after."""
    with server.target.client() as client:
        first = _keyed(client, "before").json()["id"]
        (server.folder / "offset").write_text(str(-HOUR), encoding="utf-8")
        created = _keyed(client, "during").json()["created"]
        now = time.strftime("%Y-%m-%dT%H:%M", time.gmtime(time.time() - HOUR + 60))
        assert created <= now, f"the server's clock did not jump: {created}"
        assert _keyed(client, "before").json()["id"] == first, "a key was forgotten as the clock jumped back"
        try:
            yield
        finally:
            second = _keyed(client, "during").json()["id"]
            (server.folder / "offset").write_text("0", encoding="utf-8")
        assert _keyed(client, "before").json()["id"] == first, "a key was forgotten as the clock jumped forward"
        assert _keyed(client, "during").json()["id"] == second, "a key of the other time was forgotten"


def keys_and_waits(server: OwnServer, outcome: Outcome, client: httpx.Client) -> None:
    """Who waits while the clock jumps is answered when they said, not an hour later."""
    session = entries.small_session(server.target, client, 1)
    client.post(f"{session}/run", json={"iterations": 100_000}).raise_for_status()
    began = time.monotonic()
    offset = server.folder / "offset"

    def jump() -> None:
        offset.write_text("0", encoding="utf-8")
        time.sleep(1)
        offset.write_text(str(-HOUR), encoding="utf-8")

    timer = threading.Timer(0.5, jump)
    timer.start()
    answer = client.get(f"{session}/estimate", params={"wait": "idle", "timeout": 3})
    timer.join()
    seconds = time.monotonic() - began
    outcome.answered("a call that waits while the clock jumps", answer, {200})
    outcome.happened.append(f"a call that waits 3 s while the clock jumps was answered after {seconds:.1f} s")
    outcome.expect(2 < seconds < 30, f"a call that waits 3 s was answered after {seconds:.1f} s")
    client.post(f"{session}/pause").raise_for_status()


def _keyed(client: httpx.Client, key: str) -> httpx.Response:
    files = {"file": ("cabinet.urdf", entries.URDF)}
    return client.post("/api/v1/models", files=files, headers={"Idempotency-Key": key}).raise_for_status()


def _mount(*words: str) -> None:
    subprocess.run(["mount", *words], check=True)


def _unmount(path: Path) -> None:
    subprocess.run(["umount", "--lazy", str(path)], check=True)
