"""`pmpnbp estimate`: reads model, scans and prior, runs the inference, writes the result and the recording."""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.commands.progress import Progress, announce, reading_out
from pmpnbp.errors import PmpnbpError, RecordingError, ScanError, SettingError

if TYPE_CHECKING:
    from pmpnbp.inference.problem import Problem
    from pmpnbp.inference.run import Step
    from pmpnbp.readout.snapshot import Snapshot
    from pmpnbp.recording import Inputs, RecordingWriter

OK, INTERRUPTED = 0, 130


class InputError(PmpnbpError):
    """A file that the command line names is not there."""


class OutputError(PmpnbpError):
    """The result cannot be written where it was asked for."""


def run(arguments: argparse.Namespace) -> int:
    """Do it and return the exit status. Raises PmpnbpError for bad input, before anything is written."""
    _check_outputs(arguments)
    _check_inputs(arguments)
    cameras = _cameras(arguments.camera, arguments.scans)
    announce(arguments.quiet)
    # imported here: it compiles a kernel, before which a word is said
    from pmpnbp.inference.run import steps
    from pmpnbp.readout.snapshot import Criteria, snapshot
    from pmpnbp.readout.verdict import verdict
    from pmpnbp.scene.truth_file import load_truth

    problem, inputs = _problem(arguments, cameras)
    truth = None if arguments.truth is None else load_truth(arguments.truth)

    began = time.perf_counter()
    step: Step | None = None
    interrupted = False
    try:
        with (
            _recorder(arguments.recording, inputs, problem) as recorder,
            Progress(arguments.iterations, arguments.quiet) as bar,
        ):
            for step in steps(problem, arguments.iterations):
                if recorder is not None:
                    recorder.write(step.report, step.state)
                bar.show(step.report)
            assert step is not None
            bar.finished(step.converged)
    except KeyboardInterrupt:
        interrupted = True
        if step is None:
            raise
    assert step is not None
    criteria = Criteria(max_std=arguments.max_std, truth=truth)
    elapsed = time.perf_counter() - began
    found = snapshot(problem, step.report, criteria, converged=step.converged, elapsed=elapsed)
    try:
        found = found.read_out(reading_out(arguments.quiet))
    except KeyboardInterrupt:  # the estimate is there; nothing tells how sure it is
        interrupted = True
    _keep(found, arguments.recording)
    result = found.result
    if not arguments.quiet:
        missing = found.placed.posterior is None and not found.report.searching
        sys.stderr.write(("No verdict: the read-out was interrupted" if missing else verdict(result)) + "\n")
    if arguments.out is not None or not interrupted:
        _write(result, arguments.out)
    if arguments.draws is not None:
        _write_draws(found, arguments.draws)
    if not interrupted:
        return OK
    kept = "" if arguments.out is None else f", what was found so far is in '{arguments.out.name}'"
    sys.stderr.write(f"pmpnbp estimate: interrupted after iteration {step.iteration}{kept}\n")
    return INTERRUPTED


def _problem(arguments: argparse.Namespace, cameras: Sequence[Path | None]) -> tuple[Problem, Inputs]:
    from pmpnbp import settings as settings_module
    from pmpnbp.recording import prepare
    from pmpnbp.scene.scan_files import load_scan

    settings = settings_module.changed(settings_module.preset("robust"), _changes(arguments.config))
    scans = [load_scan(scan, camera) for scan, camera in zip(arguments.scans, cameras, strict=True)]
    return prepare(
        arguments.model,
        scans,
        arguments.roi,
        arguments.prior,
        settings,
        particles=arguments.particles,
        seed=arguments.seed,
        method=arguments.method,
    )


def _recorder(path: Path | None, inputs: Inputs, problem: Problem) -> AbstractContextManager[RecordingWriter | None]:
    from pmpnbp.recording import RecordingWriter

    return nullcontext(None) if path is None else RecordingWriter(path, inputs, problem.mrf.model)


def _keep(found: Snapshot, path: Path | None) -> None:
    """Put the posterior into the recording, where there is one: its draws are those that the result is of."""
    from pmpnbp.recording import RecordingWriter

    posterior = found.placed.posterior
    if path is not None and posterior is not None:
        with RecordingWriter.appending(path) as writer:
            writer.keep(posterior)


def _changes(assignments: Sequence[tuple[str, str]]) -> dict[str, str]:
    changes: dict[str, str] = {}
    for name, value in assignments:
        if name in changes:
            raise SettingError(f"setting '{name}' is given twice, as {changes[name]!r} and {value!r}; expected it once")
        changes[name] = value
    return changes


def _cameras(cameras: Sequence[Path], scans: Sequence[Path]) -> list[Path | None]:
    """The camera file of each scan: none, one for all, or one each."""
    if len(cameras) <= 1:
        return [cameras[0] if cameras else None] * len(scans)
    if len(cameras) != len(scans):
        raise ScanError(
            f"--camera is given {len(cameras)} times for {len(scans)} scans; expected it once for all or once for each"
        )
    return list(cameras)


def _check_inputs(arguments: argparse.Namespace) -> None:
    """Raise for the first file that is missing, in the order in which the command line names them."""
    named = [("model", arguments.model)]
    named += [("scan", path) for path in arguments.scans] + [("camera file", path) for path in arguments.camera]
    named += [("prior file", arguments.prior), ("truth file", arguments.truth)]
    for what, path in named:
        if path is not None and not path.exists():
            raise InputError(f"{what} '{path.name}' is not there")


def _check_outputs(arguments: argparse.Namespace) -> None:
    """Raise where an output could not be written: better now than after the run."""
    named = [("--out", arguments.out), ("--recording", arguments.recording), ("--draws", arguments.draws)]
    asked = [(option, path) for option, path in named if path is not None]
    for (one, path), (other, same) in combinations(asked, 2):
        if path.absolute() == same.absolute():
            raise OutputError(f"{one} and {other} are both '{path.name}'; expected two files")
    for option, path in asked:
        _check_output(path, option, RecordingError if option == "--recording" else OutputError)
    if arguments.draws is not None:
        from pmpnbp.readout.arviz_export import load_arviz

        load_arviz()


def _check_output(path: Path, option: str, kind: type[PmpnbpError]) -> None:
    if path.is_dir():
        raise kind(f"{option} '{path}' is a folder; expected the name of a file")
    if not path.parent.is_dir():
        raise kind(f"{option} '{path}' cannot be written: the folder '{path.parent}' is not there")
    try:
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise kind(f"{option} '{path}' cannot be written: {error.strerror}") from None


def _write(result: dict[str, Any], out: Path | None) -> None:
    """The result as one file that appears whole, or on standard output."""
    text = _text(result)
    if out is None:
        sys.stdout.write(text)
        sys.stdout.flush()
        return
    _write_whole(out, "--out", lambda partial: partial.write_text(text, encoding="utf-8"))


def _write_draws(found: Snapshot, path: Path) -> None:
    """The posterior's draws as netCDF, or where there is no posterior yet, a sentence that says so."""
    from pmpnbp.readout.arviz_export import to_inference_data

    if found.placed.posterior is None:
        why = "during the search there is no posterior" if found.report.searching else "its read-out was interrupted"
        sys.stderr.write(f"--draws '{path.name}' is not written: {why}\n")
        return
    problem = found.problem
    of_run = {"method": problem.method, "seed": problem.seed, "frame_id": problem.observation.frame_id}
    data = to_inference_data(problem.mrf.model, found.placed.posterior, seed=problem.seed, attributes=of_run)
    _write_whole(path, "--draws", lambda partial: data.to_netcdf(str(partial)))


def _write_whole(path: Path, option: str, write: Callable[[Path], object]) -> None:
    """A file that appears whole, or not at all."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        write(partial)
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        raise OutputError(f"{option} '{path}' cannot be written: {error.strerror}") from None


def _text(result: dict[str, Any]) -> str:
    """JSON with a member a line, and a list of numbers in one: a covariance would be 36 lines."""
    text = json.dumps(result, indent=1, allow_nan=False, ensure_ascii=False) + "\n"
    return re.sub(r"\[\n[-+\d.e,\s]+\]", lambda found: re.sub(r"\n\s*", "", found[0]).replace(",", ", "), text)
