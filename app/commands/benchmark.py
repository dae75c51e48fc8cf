"""`pmpnbp benchmark`: runs the workloads in the project's `benchmarks/` folder, which is not installed."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

from pmpnbp.errors import PmpnbpError

PROJECT = Path(__file__).resolve().parents[2]


class BenchmarkError(PmpnbpError):
    """The benchmarks cannot be run."""


def run(out: Path | None, project: Path = PROJECT) -> int:
    """Run `benchmarks.run.main(out)` of the folder `project`; return 0. Raises BenchmarkError where it is missing."""
    if not (project / "benchmarks" / "run.py").is_file():
        raise BenchmarkError(
            "the benchmarks are not installed with the package; run this from a checkout of the project"
        )
    if str(project) not in sys.path:
        sys.path.insert(0, str(project))
    importlib.import_module("benchmarks.run").main(out)
    return 0
