"""`pmpnbp estimate`: reads model, scans and prior, runs the inference, writes the result and the recording."""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Callable, Sequence
from itertools import combinations
from os.path import samestat
from pathlib import Path
from stat import S_ISDIR, S_ISREG
from typing import TYPE_CHECKING, Any

from app.commands.progress import Progress, announce, reading_out
from app.standard_streams import check_output, leads_to_output
from pmpnbp.errors import PmpnbpError, RecordingError, ScanError, SettingError
from pmpnbp.files import quoted, status, written_whole
from pmpnbp.importing import many_modules
from pmpnbp.json_text import json_to_read
from pmpnbp.settings import changed, preset

if TYPE_CHECKING:
    from pmpnbp.library.estimate import Estimate
    from pmpnbp.library.session import Session

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
    with many_modules():
        from pmpnbp.library.session import Session

    with Session(
        arguments.model,
        arguments.scans,
        camera=cameras,
        roi=arguments.roi,
        prior=arguments.prior,
        method=arguments.method,
        particles=arguments.particles,
        iterations=arguments.iterations,
        seed=arguments.seed,
        max_std=arguments.max_std,
        truth=arguments.truth,
        recording=arguments.recording,
        **settings_of(arguments.config),
    ) as session:
        interrupted = _iterate(session, arguments)
        found = None
        try:
            found = session.estimate(checkpoint=reading_out(arguments.quiet))
        except KeyboardInterrupt:  # the estimate is there; nothing tells how sure it is
            interrupted = True
        stopped = found is None
        found = found or session.estimate(posterior=False)
    if not arguments.quiet:
        sys.stderr.write(("No verdict: the read-out was interrupted" if stopped else found.summary) + "\n")
    if arguments.out is not None or not interrupted:
        _write(found.to_dict(), arguments.out)
    if arguments.draws is not None:
        _write_draws(found, "its read-out was interrupted" if stopped else None, arguments.draws)
    if not interrupted:
        return OK
    kept = "" if arguments.out is None else f", what was found so far is in '{arguments.out.name}'"
    sys.stderr.write(f"pmpnbp estimate: interrupted after iteration {found.iteration}{kept}\n")
    return INTERRUPTED


def _iterate(session: Session, arguments: argparse.Namespace) -> bool:
    """To the end, with a bar; whether it was interrupted before."""
    try:
        with Progress(arguments.iterations, arguments.quiet) as bar:
            bar.show(session.newest.report)
            for iteration in session:
                bar.show(iteration.report)
            bar.finished(session.converged)
    except KeyboardInterrupt:
        return True
    return False


def settings_of(assignments: Sequence[tuple[str, str]]) -> dict[str, str]:
    """Settings by name. Raises SettingError for what is none, and for one that is given twice."""
    changes: dict[str, str] = {}
    for name, value in assignments:
        if name in changes:
            raise SettingError(f"setting '{name}' is given twice, as {changes[name]!r} and {value!r}; expected it once")
        changes[name] = value
    changed(preset("robust"), changes)
    return changes


def _cameras(cameras: Sequence[Path], scans: Sequence[Path]) -> Sequence[Path] | None:
    """The camera files: none, one for all, or one each. Raises ScanError for another number of them."""
    if len(cameras) not in (0, 1, len(scans)):
        raise ScanError(
            f"--camera is given {len(cameras)} times for {len(scans)} scans; expected it once for all or once for each"
        )
    return cameras or None


def _check_inputs(arguments: argparse.Namespace) -> None:
    """Raise for the first file that is missing, in the order in which the command line names them, or that an output
    would replace."""
    named = [("model", arguments.model)]
    named += [("scan", path) for path in arguments.scans] + [("camera file", path) for path in arguments.camera]
    named += [("prior file", arguments.prior), ("truth file", arguments.truth)]
    outputs = [(option, path.stat()) for option, path in _outputs(arguments) if path.exists()]
    for what, path in named:
        if path is None:
            continue
        found = status(path, f"{what} {quoted(path)}", InputError)
        if found is None:
            raise InputError(f"{what} {quoted(path)} is not there")
        for option, output in outputs:
            if S_ISREG(found.st_mode) and samestat(found, output):
                raise OutputError(f"{option} would replace the {what} {quoted(path)}; expected another file")


def _check_outputs(arguments: argparse.Namespace) -> None:
    """Raise where an output could not be written: better now than after the run."""
    asked = _outputs(arguments)
    for option, path in asked:
        _check_output(path, option, RecordingError if option == "--recording" else OutputError)
    for (one, path), (other, same) in combinations(asked, 2):
        if path.resolve() == same.resolve():
            raise OutputError(f"{one} and {other} are both {quoted(path)}; expected two files")
    if arguments.out is None:
        check_output()
    if arguments.draws is not None:
        from pmpnbp.readout.arviz_export import load_arviz

        load_arviz()


def _outputs(arguments: argparse.Namespace) -> list[tuple[str, Path]]:
    """Options that name a file to be written, each with its file."""
    named = [("--out", arguments.out), ("--recording", arguments.recording), ("--draws", arguments.draws)]
    return [(option, path) for option, path in named if path is not None]


def _check_output(path: Path, option: str, kind: type[PmpnbpError]) -> None:
    name = f"{option} '{path}'"
    found = status(path, name, kind, done="written")
    if found is not None and S_ISDIR(found.st_mode):
        raise kind(f"{name} is a folder; expected the name of a file")
    if found is not None and not S_ISREG(found.st_mode):
        return  # a pipe or a device, beside which nothing is written
    folder = path.resolve().parent
    if not folder.is_dir():
        raise kind(f"{name} cannot be written: the folder '{folder}' is not there")
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise kind(f"{name} cannot be written: {error.strerror}") from None


def _write(result: dict[str, Any], out: Path | None) -> None:
    """The result as one file that appears whole, or on standard output, which /dev/stdout is another name of."""
    text = json_to_read(result)
    if out is None or leads_to_output(out):
        sys.stdout.write(text)
        sys.stdout.flush()
        return
    _write_whole(out, "--out", lambda partial: partial.write_text(text, encoding="utf-8"))


def _write_draws(found: Estimate, interrupted: str | None, path: Path) -> None:
    """The posterior's draws as netCDF, or where there is no posterior yet, a sentence that says so."""
    if found.posterior_iteration is None:
        why = interrupted or "during the search there is no posterior"
        sys.stderr.write(f"--draws '{path.name}' is not written: {why}\n")
        return
    data = found.to_arviz()
    _write_whole(path, "--draws", lambda partial: data.to_netcdf(str(partial)))


def _write_whole(path: Path, option: str, write: Callable[[Path], object]) -> None:
    """A file that appears whole, or not at all."""
    try:
        with written_whole(path) as partial:
            write(partial)
    except OSError as error:
        raise OutputError(f"{option} '{path}' cannot be written: {error.strerror}") from None
