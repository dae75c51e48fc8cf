"""The page on a recording, by a server of its own in a process of its own."""

from __future__ import annotations

import atexit
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from pmpnbp.errors import ServerError

_servers: list[subprocess.Popen[str]] = []


def show(recorded: Callable[[Path], Path]) -> None:
    """Open the page on a recording, print its link and return; the page stays until this process ends.

    recorded : makes the recording at the path it is given, or names one that is there. Raises PmpnbpError where it
        cannot be made, ServerError where the server does not start.
    """
    with tempfile.TemporaryDirectory(prefix="pmpnbp-show-") as folder:
        path = recorded(Path(folder) / "recording.sqlite")
        command = [sys.executable, "-m", "pmpnbp", "view", str(path)]
        server = subprocess.Popen(command, stdout=subprocess.PIPE, stdin=subprocess.DEVNULL, text=True)
        assert server.stdout is not None
        # it has taken the recording in when it says where its page is
        link = server.stdout.readline().strip()
    if not link:
        raise ServerError(f"the server that shows the page ended with status {server.wait()}")
    if not _servers:
        atexit.register(_end)
    _servers.append(server)
    sys.stdout.write(f"{link}\n")


def _end() -> None:
    for server in _servers:
        with server:  # waits for its end
            server.terminate()
