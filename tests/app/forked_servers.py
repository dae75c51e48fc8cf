"""Servers that answer a fraction of a second after they are started, so that they can be killed hundreds of times.

Most of a start is imports. Here a process makes them once, and each server is forked from it, as are the processes that
read its uploads; from there on both run what `pmpnbp serve` runs.
"""

from __future__ import annotations

import importlib
import json
import os
import re
import selectors
import signal
import socket
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from types import TracebackType

# Of the server and of the readers, which import theirs as they need them.
_IMPORTED = (
    "app.cli",
    "app.commands.serve",
    "app.server",
    "app.uploads.parse_worker",
    "pmpnbp.recording.reopening",
    "pmpnbp.scene.urdf",
)
# In a server's place of `sys.executable`: hands its standard streams to the process that has the imports, and stays as
# long as the reader that is forked there.
_READER = """#!{python} -IS
import json, socket, sys
with socket.socket(socket.AF_UNIX) as connection:
    connection.connect({path!r})
    socket.send_fds(connection, [json.dumps(sys.argv[1:]).encode()], [0, 1, 2])
    connection.recv(1)
"""


class ForkedServers:
    """A context; one server at a time."""

    def __init__(self) -> None:
        self._pid = 0

    def __enter__(self) -> ForkedServers:
        self._folder = tempfile.TemporaryDirectory(prefix="forked-")
        command = [sys.executable, "-m", "tests.app.forked_servers", self._folder.name]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pid:
            self.end(signal.SIGKILL)
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait()
        self._process.stdout.close()
        self._folder.cleanup()

    def start(self, data_dir: Path, *options: str) -> str:
        """The address of a server that listens; its kernels may still be loading."""
        words = ["serve", "--port", "0", "--data-dir", str(data_dir), *options]
        self._say(words)
        self._pid = int(self._line())
        line = self._line()
        found = re.search(r"(http://\S+?)/(?:\?token=\S+)?\s*$", line)
        if found is None:
            raise RuntimeError(f"the server printed {line!r} instead of its link")
        return found[1]

    def end(self, number: signal.Signals) -> None:
        """Send it a signal, and wait until it is gone."""
        os.kill(self._pid, number)
        self._say(self._pid)
        while self._line().strip() != "ended":
            pass
        self._pid = 0

    @property
    def pid(self) -> int:
        return self._pid

    def _say(self, message: object) -> None:
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(message) + "\n")

    def _line(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError("the process that servers are forked from has ended")
        return line


def main(folder: Path) -> None:
    """Import, then fork what is asked for: a server for words on standard input, a reader for a connection."""
    for name in _IMPORTED:
        importlib.import_module(name)
    from pmpnbp.scene import lzf

    lzf.lzf_decode(b"\0a", 1)
    program, path = folder / "reader", folder / "socket"
    program.write_text(_READER.format(python=sys.executable, path=str(path)), encoding="utf-8")
    program.chmod(0o700)
    listening = socket.socket(socket.AF_UNIX)
    listening.bind(str(path))
    listening.listen(16)
    waiting = selectors.DefaultSelector()
    waiting.register(0, selectors.EVENT_READ)
    waiting.register(listening, selectors.EVENT_READ)
    rest = b""
    while True:
        for key, _ in waiting.select():
            if key.fileobj is listening:
                _fork_reader(listening)
                continue
            data = os.read(0, 1 << 16)
            if not data:
                return
            *lines, rest = (rest + data).split(b"\n")
            for line in lines:
                _obey(json.loads(line), program, listening)
        _reap()


def _obey(message: list[str] | int, program: Path, listening: socket.socket) -> None:
    """Fork a server, or wait for the end of one."""
    if isinstance(message, int):
        with suppress(ChildProcessError):
            os.waitpid(message, 0)
        _print("ended")
        return
    child = os.fork()
    if child:
        _print(str(child))
        return
    listening.close()
    sys.executable = str(program)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    from app.cli import main

    status = 1
    try:
        status = main(message)
    finally:
        sys.stdout.flush()
        os._exit(status)


def _fork_reader(listening: socket.socket) -> None:
    connection, _ = listening.accept()
    data, streams, _, _ = socket.recv_fds(connection, 1 << 16, 3)
    if os.fork():
        connection.close()
        for stream in streams:
            os.close(stream)
        return
    listening.close()
    for number, stream in enumerate(streams):
        os.dup2(stream, number)
        os.close(stream)
    sys.stdin = open(0, encoding="utf-8")  # noqa: SIM115  # the old one may have read ahead
    try:
        _, _, memory, seconds = json.loads(data)  # "-m", the module, then its arguments
        from app.uploads import parse_worker

        parse_worker.main(int(memory), float(seconds))
    finally:
        os._exit(0)


def _reap() -> None:
    """Readers that have ended."""
    with suppress(ChildProcessError):
        while os.waitpid(-1, os.WNOHANG)[0]:
            pass


def _print(line: str) -> None:
    os.write(1, line.encode() + b"\n")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
