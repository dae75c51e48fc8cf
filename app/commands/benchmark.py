"""`pmpnbp benchmark`: runs the workloads of the package `benchmarks`."""

from __future__ import annotations

import argparse
import importlib
from types import ModuleType

from pmpnbp.errors import PmpnbpError
from pmpnbp.importing import many_modules

OK = 0


class MissingPackageError(PmpnbpError):
    """Something is not installed that only experiments need."""


def run(arguments: argparse.Namespace) -> int:
    """Measure; return 0. Raises PmpnbpError."""
    load("benchmarks.run").main(arguments.out)
    return OK


def load(module: str) -> ModuleType:
    """A module of the package `benchmarks`. Raises MissingPackageError where it cannot be imported."""
    try:
        with many_modules():
            return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name == "matplotlib":
            raise MissingPackageError("figures need matplotlib: pip install 'pmpnbp[reproduce]'") from None
        if error.name is None or error.name.split(".")[0] != "benchmarks":
            raise
        raise MissingPackageError(
            f"{error.name} is not here: another package of the name hides it; give pmpnbp an environment of its own"
        ) from None
