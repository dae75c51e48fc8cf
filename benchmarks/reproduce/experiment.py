"""How is an experiment made? Runs, kept one by one, then figures, tables and a report of all of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from pmpnbp.errors import RunError
from pmpnbp.runs.run_log import Asked, Result, RunLog
from pmpnbp.runs.workers import spread

Perform = Callable[[Asked], Result]


@dataclass(frozen=True)
class Options:
    """What the command line said.

    out : where all files go; runs : of each case; seed : the first run's, the others count up from it
    iterations, particles : None for the experiment's own
    everything : every sample, not only the paper's kind; urdf : another robot
    processes, on : as `spread` takes them; command : as it was called, for the report
    """

    out: Path
    runs: int = 10
    seed: int = 0
    iterations: int | None = None
    particles: int | None = None
    everything: bool = False
    urdf: Path | None = None
    processes: int = 1
    on: str | None = None
    command: tuple[str, ...] = ()

    @property
    def seeds(self) -> range:
        """The seeds of the runs."""
        return range(self.seed, self.seed + self.runs)

    @property
    def named_seeds(self) -> str:
        """The same, for a report."""
        return f"{self.seed} to {self.seed + self.runs - 1}" if self.runs > 1 else f"{self.seed}"


@dataclass(frozen=True)
class Experiment:
    """perform : makes a run; stages : what to run, each knowing what the ones before gave; write : what to say of it"""

    perform: Perform
    stages: Sequence[Callable[[Options, RunLog], Sequence[Asked]]]
    write: Callable[[Options, RunLog], None]


def make(name: str, experiment: Experiment, options: Options) -> None:
    """Make the runs that are not kept yet, and write figures, tables and report into `options.out`.

    Raises RunError; what has been run by then is kept, as it is where this is interrupted.
    """
    try:
        run_log = RunLog(options.out, name)
    except OSError as error:
        raise RunError(f"'{options.out}' cannot be written: {error.strerror}") from None
    for stage in experiment.stages:
        asked = stage(options, run_log)
        left = [one for one in asked if run_log.get(one) is None]
        with tqdm(total=len(asked), initial=len(asked) - len(left), desc=name, unit="run", dynamic_ncols=True) as bar:
            for one, result in spread(experiment.perform, left, options.processes, options.on) if left else ():
                run_log.add(one, result)
                bar.update()
    experiment.write(options, run_log)
