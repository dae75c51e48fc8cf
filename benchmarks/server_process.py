"""A server in a process of its own, as benchmarks and the tests that kill it need one."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path

import httpx

from benchmarks.trials import PROJECT

CABINET = PROJECT / "sample_data" / "cabinet"


@dataclass(frozen=True)
class ServerProcess:
    """url : where it answers; token : that its link carries, or None; first_line : what it printed"""

    process: subprocess.Popen[str]
    url: str
    token: str | None
    first_line: str

    def ready(self) -> ServerProcess:
        """Wait until the kernels are there. Raises RuntimeError where the server ends before."""
        with httpx.Client() as client:
            while client.get(f"{self.url}/readyz").status_code != 200:
                if self.process.poll() is not None:
                    raise RuntimeError(f"the server ended with status {self.process.returncode}")
                time.sleep(0.1)
        return self

    def end(self, number: signal.Signals) -> int:
        """Send it a signal and wait; the exit status."""
        self.process.send_signal(number)
        status = self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()
        return status


@contextmanager
def running(environment: Mapping[str, str] | None = None) -> Iterator[ServerProcess]:
    """A server that has nothing stored and whose kernels are there; ended, with what it stored, at the end."""
    with tempfile.TemporaryDirectory(prefix="server-") as folder:
        server = start(Path(folder), environment=environment).ready()
        try:
            yield server
        finally:
            server.end(signal.SIGTERM)


def start(
    data_dir: Path, *options: str, environment: Mapping[str, str] | None = None, log: Path | None = None
) -> ServerProcess:
    """`pmpnbp serve` on a free port, listening; settings come from `options` and `environment` alone.

    log : a file that its messages are added to; None: they go where ours go

    Raises RuntimeError where it prints anything but its link.
    """
    command = [sys.executable, "-m", "app.cli", "serve", "--port", "0", "--data-dir", str(data_dir), *options]
    inherited = {name: value for name, value in os.environ.items() if not name.startswith("PMPNBP_")}
    with nullcontext() if log is None else log.open("ab") as messages:
        process = subprocess.Popen(
            command,
            cwd=PROJECT,
            env=inherited | dict(environment or {}),
            stdout=subprocess.PIPE,
            stderr=messages,
            text=True,
        )
    assert process.stdout is not None
    line = process.stdout.readline()
    found = re.search(r"(http://\S+?)/(?:\?token=(\S+))?\s*$", line)
    if found is None:
        process.kill()
        process.wait()
        process.stdout.close()
        raise RuntimeError(f"the server printed {line!r} instead of its link")
    return ServerProcess(process, re.sub(r"//(0\.0\.0\.0|\[::\])", "//127.0.0.1", found[1]), found[2], line)


def upload_model(client: httpx.Client) -> httpx.Response:
    """The sample cabinet to the server at `client`'s base, /api/v1."""
    return client.post("/models", files={"file": ("cabinet.urdf", (CABINET / "cabinet.urdf").read_bytes())})


def upload_scan(client: httpx.Client) -> httpx.Response:
    """The scan of its scene with an open drawer."""
    camera = (CABINET / "open" / "camera.json").read_text(encoding="utf-8")
    depth = (CABINET / "open" / "depth.png").read_bytes()
    return client.post("/scans", files={"file": ("depth.png", depth)}, data={"camera": camera})
