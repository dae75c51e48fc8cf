"""Runs for tests of how runs are spread: functions of a module, as another process has to find them. And how tests of
experiments make runs, and read tables."""

from __future__ import annotations

import csv
import os
import signal
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from benchmarks.reproduce.experiment import Perform
from pmpnbp.runs.run_log import Asked, Result


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


def second_killed(asked: Asked) -> Result:
    """The run of the number 2 ends its process; the others end once it has done so for the third time."""
    begun = Path(asked["mark"])
    if asked["number"] == 2:
        (begun / f"{os.getpid()}").touch()
        os.kill(os.getpid(), signal.SIGKILL)
    while asked["number"] == 5 and len(list(begun.iterdir())) < 3:
        time.sleep(0.02)
    return squared(asked)


class NoTravellerError(Exception):
    """An error that cannot be made again of what it says."""

    def __init__(self, stone: str, weight: float) -> None:
        super().__init__(stone)


def failing_with_what_stays(asked: Asked) -> Result:
    """A run that fails with an error that cannot be pickled."""
    raise NoTravellerError("a stone that cannot be carried", 1.0)


def threads(asked: Asked) -> Result:
    """How many threads kernels and BLAS may take."""
    import numba

    return {"numba": numba.get_num_threads(), "blas": int(os.environ["OPENBLAS_NUM_THREADS"])}


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


def rows_of(path: Path) -> list[dict[str, str]]:
    """The rows of a table, by column."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def run_here(perform: Perform, asked: Sequence[Asked], *_: object) -> Iterator[tuple[Asked, Result]]:
    """In place of `spread`, which `test_runs` tests: a process of its own takes seconds to begin, and loads a scene
    that others have loaded."""
    yield from ((one, perform(one)) for one in asked)
