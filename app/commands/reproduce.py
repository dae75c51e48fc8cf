"""`pmpnbp reproduce`: makes an experiment of the paper again."""

from __future__ import annotations

import argparse

from app.commands.benchmark import OK, load


def run(arguments: argparse.Namespace) -> int:
    """Make it; return 0. Raises PmpnbpError."""
    load("benchmarks.reproduce.command").run(arguments)
    return OK
