"""`pmpnbp benchmark`: runs the workloads in the project's `benchmarks/` folder, which is not installed."""

from __future__ import annotations

from pathlib import Path

from app.commands.checkout import PROJECT, load


def run(out: Path | None, project: Path = PROJECT) -> int:
    """Run `benchmarks.run.main(out)` of the folder `project`; return 0. Raises CheckoutError where it is missing."""
    load("benchmarks.run", project).main(out)
    return 0
