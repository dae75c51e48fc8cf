"""`pmpnbp calibrate`: holds the belief against rendered scenes of an object, a camera and a region of the user's."""

from __future__ import annotations

import argparse

from app.commands.benchmark import OK, load
from app.commands.progress import announce


def run(arguments: argparse.Namespace) -> int:
    """Do it; return 0. Raises PmpnbpError."""
    announce(quiet=False)
    load("benchmarks.calibrate.command").run(arguments)
    return OK
