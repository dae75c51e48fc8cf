"""`pmpnbp batch`: makes the estimates that a manifest asks for, and writes results, a table and a report."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from stat import S_ISREG
from typing import TYPE_CHECKING, Any

from app.commands.estimate import INTERRUPTED, OK, InputError, settings_of
from app.commands.progress import announce, rows_bar
from pmpnbp.batch.manifest import read_manifest
from pmpnbp.batch.row import OPTIONS
from pmpnbp.files import quoted, status
from pmpnbp.importing import many_modules
from pmpnbp.settings import changed, preset

if TYPE_CHECKING:
    from pmpnbp.batch.run import Made

BAD_INPUT = 2
# Of so many rows that come to nothing it is told as they come; of all of them in the table and the report.
TOLD = 10


def run(arguments: argparse.Namespace) -> int:
    """Do it and return the exit status: that of bad input where some rows came to nothing. Raises PmpnbpError."""
    manifest = arguments.manifest
    rows = read_manifest(manifest, _for_all(arguments))
    announce(arguments.quiet)
    # imported here: it compiles a kernel, before which a word is said
    with many_modules():
        from pmpnbp.batch.run import batch

    out = arguments.out or Path("out") / f"batch_{manifest.resolve().stem}"
    done = failed = 0
    with rows_bar(len(rows), arguments.quiet) as bar:

        def began(already: int) -> None:
            nonlocal done
            done = already
            bar.update(already)
            bar.unpause()  # what was done before says nothing of how fast it goes

        def on_row(name: str, error: str | None) -> None:
            nonlocal done, failed
            done += 1
            failed += error is not None
            if error is not None and failed <= TOLD and not arguments.quiet:
                bar.write(f"{name}: {error}", file=sys.stderr)
            bar.update()

        try:
            made = batch(
                rows,
                out,
                title=f"Batch {manifest.resolve().name}",
                processes=arguments.processes,
                on=arguments.on,
                began=began,
                on_row=on_row,
            )
        except KeyboardInterrupt:
            bar.close()
            sys.stderr.write(
                f"pmpnbp batch: interrupted; {done} of {len(rows)} rows are kept in '{out}', and the same command goes "
                f"on from there\n"
            )
            return INTERRUPTED
    return _finish(made, len(rows), arguments.quiet)


def _finish(made: Made, count: int, quiet: bool) -> int:
    from pmpnbp.batch.told import ERROR, VERDICTS

    counted = ", ".join(f"{made.counts[verdict]} {verdict}" for verdict in VERDICTS[::-1] if made.counts[verdict])
    if not quiet:
        sys.stderr.write(f"{counted}\n")
    sys.stdout.write(f"{made.report}\n")
    if made.first_error is None:
        return OK
    name, why = made.first_error
    sys.stderr.write(
        f"pmpnbp batch: {made.counts[ERROR]} of {count} rows came to nothing, the first, '{name}': {why}\n"
    )
    return BAD_INPUT


def _for_all(arguments: argparse.Namespace) -> dict[str, Any]:
    """What the command line says of every row that does not say it itself, as a manifest would."""
    given: dict[str, Any] = {name: getattr(arguments, name) for name in OPTIONS}
    if arguments.roi is not None:
        given["roi"] = arguments.roi
    for member, what in (("model", "model"), ("camera", "camera file"), ("prior", "prior file")):
        path = getattr(arguments, member)
        if path is not None:
            found = status(path, f"{what} {quoted(path)}", InputError)
            if found is None:
                raise InputError(f"{what} {quoted(path)} is not there")
            if not S_ISREG(found.st_mode):
                raise InputError(f"{what} {quoted(path)} is a folder, a pipe or a device; expected a file")
            given[member] = str(path.resolve())
    if arguments.config:
        given["config"] = settings_of(arguments.config)
        changed(preset("robust"), given["config"])
    return given
