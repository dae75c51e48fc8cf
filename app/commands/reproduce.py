"""`pmpnbp reproduce`: makes an experiment of the paper again; they lie in `benchmarks/`, which is not installed."""

from __future__ import annotations

import argparse

from app.commands.checkout import load
from pmpnbp.errors import PmpnbpError


class MissingPackageError(PmpnbpError):
    """Figures cannot be drawn."""


def run(arguments: argparse.Namespace) -> int:
    """Run it; return 0. Raises PmpnbpError."""
    try:
        command = load("benchmarks.reproduce.command")
    except ModuleNotFoundError as error:
        if error.name != "matplotlib":
            raise
        raise MissingPackageError("figures need matplotlib: pip install 'pmpnbp[reproduce]'") from None
    command.run(arguments)
    return 0
