"""What `pmpnbp reproduce` does once the command line is read."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from benchmarks.reproduce import convergence, occlusion, planning, push, robot
from benchmarks.reproduce.experiment import Experiment, Options, make
from pmpnbp.errors import RunError
from pmpnbp.runs.run_log import NAME

EXPERIMENTS: dict[str, Experiment] = {
    "convergence": convergence.EXPERIMENT,
    "occlusion": occlusion.EXPERIMENT,
    "robot": robot.EXPERIMENT,
    "planning": planning.EXPERIMENT,
    "push": push.EXPERIMENT,
}


def run(arguments: argparse.Namespace) -> None:
    """Make the experiment; say where its report is. Raises RunError."""
    for option, of in (("all", "convergence"), ("urdf", "robot")):
        if getattr(arguments, option) and arguments.experiment != of:
            raise RunError(f"--{option} is for the experiment {of}, and {arguments.experiment} has no use for it")
    out = arguments.out or Path("out") / arguments.experiment
    options = Options(
        out,
        arguments.runs,
        arguments.seed,
        arguments.iterations,
        arguments.particles,
        arguments.all,
        arguments.urdf,
        arguments.processes,
        arguments.on,
        command_line(arguments),
    )
    try:
        make(arguments.experiment, EXPERIMENTS[arguments.experiment], options)
    except KeyboardInterrupt:
        sys.stderr.write(f"what has been run is kept in {out / NAME}; the same command goes on from there\n")
        raise
    sys.stdout.write(f"{out / 'report.md'}\n")


def command_line(arguments: argparse.Namespace) -> tuple[str, ...]:
    """The command that gives the same figures, without what they do not depend on."""
    words = ["pmpnbp", "reproduce", arguments.experiment, "--runs", str(arguments.runs), "--seed", str(arguments.seed)]
    for name in ("iterations", "particles", "urdf"):
        if getattr(arguments, name) is not None:
            words += [f"--{name}", str(getattr(arguments, name))]
    return (*words, "--all") if arguments.all else tuple(words)
