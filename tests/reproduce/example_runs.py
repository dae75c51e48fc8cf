"""Runs for tests of how runs are spread: functions of a module, as another process has to find them."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from benchmarks.reproduce.run_log import Asked, Result


def squared(asked: Asked) -> Result:
    """A short run."""
    return {"square": asked["number"] ** 2, "process": os.getpid()}


def killed_once(asked: Asked) -> Result:
    """The first run that finds its file missing takes its process with it."""
    mark = Path(asked["mark"])
    if asked["number"] == 2 and not mark.exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return squared(asked)


def always_killed(asked: Asked) -> Result:
    """A run that ends its process."""
    os.kill(os.getpid(), signal.SIGKILL)
    return squared(asked)


def slow(asked: Asked) -> Result:
    """A run that tells by a file that it has begun, and takes a while."""
    Path(asked["folder"], f"{asked['number']}-{os.getpid()}").touch()
    time.sleep(0.3)
    return squared(asked)


def failing(asked: Asked) -> Result:
    """A run that fails."""
    raise ValueError("a stone in the gears")


def waiting_for_a_third(asked: Asked) -> Result:
    """A run that tells by a file that it has begun; from the tenth on it ends once three processes have told so."""
    folder = Path(asked["folder"])
    (folder / f"{asked['number']}-{os.getpid()}").touch()
    while asked["number"] >= 10 and len({path.name.split("-")[1] for path in folder.iterdir()}) < 3:
        time.sleep(0.02)
    return squared(asked)
