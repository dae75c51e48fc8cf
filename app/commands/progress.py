"""How far is it? Progress on standard error: a bar of iterations, and a word when kernels have to be compiled first."""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

from tqdm import tqdm

import pmpnbp
from pmpnbp.readout.checkpoint import SOON, Checkpoint

if TYPE_CHECKING:  # importing it would already compile a kernel, before a word is said
    from pmpnbp.inference.belief import IterationReport


# Modules whose kernels every run needs, and which take longest to compile.
_NEEDED = ("rasteriser", "splatting", "joint_sums")


def kernels_compiled() -> bool:
    """Whether kernels compiled from the present source are on disk, where numba puts them: beside it, or in a cache."""
    source = Path(pmpnbp.__file__).parent / "potentials" / "kernels"
    places = [source, Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "numba"]
    if os.environ.get("NUMBA_CACHE_DIR"):
        places = [Path(os.environ["NUMBA_CACHE_DIR"])]

    def compiled(module: str) -> bool:
        written = (source / f"{module}.py").stat().st_mtime
        found = (file for place in places if place.is_dir() for file in place.glob(f"**/{module}.*.nbi"))
        return any(file.stat().st_mtime >= written for file in found)

    return all(compiled(module) for module in _NEEDED)


def announce(quiet: bool) -> None:
    """Say that kernels are about to be compiled, where they are."""
    if not quiet and not kernels_compiled():
        sys.stderr.write("compiling kernels, once; this takes about a minute\n")
        sys.stderr.flush()


def reading_out(quiet: bool) -> Checkpoint:
    """The checkpoint of a read-out that begins now: says so once, where it takes long."""
    began = time.monotonic()
    told = quiet

    def checkpoint() -> None:
        nonlocal told
        if not told and time.monotonic() - began > SOON:
            told = True
            sys.stderr.write("reading out the posterior ...\n")
            sys.stderr.flush()

    return checkpoint


def rows_bar(rows: int, quiet: bool) -> tqdm:
    """A bar of the rows of a batch on standard error, silent where `quiet`."""
    return tqdm(total=rows, disable=quiet, file=sys.stderr, unit="row", dynamic_ncols=True, smoothing=0.05)


class Progress:
    """A bar of iterations on standard error, silent where `quiet`."""

    def __init__(self, iterations: int, quiet: bool) -> None:
        self._bar = tqdm(
            total=iterations, disable=quiet, file=sys.stderr, unit="it", dynamic_ncols=True, leave=True, mininterval=0.2
        )

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.close()

    def show(self, report: IterationReport) -> None:
        """Move the bar to the report's iteration and name its stage; what the inference remarked comes above it."""
        if not self._bar.disable:
            for note in report.notes:
                self._bar.write(f"iteration {report.iteration}: {note}", file=sys.stderr)
        self._bar.set_description_str(report.stage, refresh=False)
        self._bar.update(report.iteration - self._bar.n)

    def finished(self, converged: bool) -> None:
        """Say how the run ended; a run that converged is complete before the bar is."""
        if converged:
            self._bar.total = self._bar.n
            self._bar.set_description_str("converged", refresh=False)
        self._bar.refresh()
