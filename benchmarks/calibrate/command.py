"""What `pmpnbp calibrate` does once the command line is read."""

from __future__ import annotations

import argparse
import sys
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.calibrate import report, runs, scenes
from benchmarks.calibrate.task import Task, task_of
from benchmarks.reproduce.experiment import Experiment, Options, make
from pmpnbp.runs.run_log import NAME, Asked
from pmpnbp.settings import preset

# Of so many runs one has no object to find.
ABSENT_EVERY = 5


def run(arguments: argparse.Namespace) -> None:
    """Make the runs and write the report; say where it is. Raises PmpnbpError."""
    task = task_of(
        arguments.model,
        arguments.camera,
        None if arguments.roi is None else np.array(arguments.roi, dtype=np.float64),
        arguments.prior,
        preset("robust"),
        particles=arguments.particles,
        iterations=arguments.iterations,
        max_std=arguments.max_std,
        sensor=arguments.sensor,
    )
    scenes.draw(task, arguments.seed)  # where the object cannot be placed, it is told before anything is written
    options = Options(
        arguments.out or Path("out") / f"calibrate_{arguments.model.stem}",
        arguments.runs,
        arguments.seed,
        processes=arguments.processes,
        on=arguments.on,
        command=command_line(arguments),
    )
    asked = asked_of(task, options)
    experiment = Experiment(partial(runs.perform, task), (lambda *_: asked,), partial(report.write, task, asked))
    try:
        make("calibrate", experiment, options)
    except KeyboardInterrupt:
        sys.stderr.write(f"what has been run is kept in {options.out / NAME}; the same command goes on from there\n")
        raise
    sys.stdout.write(f"{options.out / 'report.md'}\n")


def asked_of(task: Task, options: Options) -> list[Asked]:
    """All runs, every fifth without the object."""
    return [
        {"seed": seed, "absent": number % ABSENT_EVERY == ABSENT_EVERY - 1, "task": task.digest}
        for number, seed in enumerate(options.seeds)
    ]


def command_line(arguments: argparse.Namespace) -> tuple[str, ...]:
    """The command that gives the same figures, without what they do not depend on."""
    words = ["pmpnbp", "calibrate", str(arguments.model)]
    for name in ("camera", "prior"):
        if getattr(arguments, name) is not None:
            words += [f"--{name}", str(getattr(arguments, name))]
    if arguments.roi is not None:
        words.append(f"--roi={','.join(f'{number:g}' for number in arguments.roi)}")
    for name in ("runs", "seed", "particles", "iterations", "max_std", "sensor"):
        words += [f"--{name.replace('_', '-')}", str(getattr(arguments, name))]
    return tuple(words)
