"""`pmpnbp benchmark`: how fast is it on this machine? Kernels and inference, as a table and as one JSON file."""

from __future__ import annotations

import json
import os
import platform
import stat
from collections.abc import Callable
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numba

from benchmarks import inference, kernels
from benchmarks.tables import progress
from pmpnbp.errors import PmpnbpError
from pmpnbp.files import status, written_whole

SCHEMA = "pmpnbp/benchmark-1"
PACKAGES = ("pmpnbp", "numpy", "numba", "scipy", "open3d-cpu", "open3d")


class OutputError(PmpnbpError):
    """The figures cannot be written where they were asked for."""


Rates = Callable[[], dict[str, Any]]


def main(out: Path | None = None, plan: inference.Plan | None = None, rates: Rates = kernels.measure) -> None:
    """Measure, print the tables, and write the JSON to `out`; progress goes to stderr.

    plan : how much of the inference is measured, everything by default; rates : measures the kernels
    Raises OutputError where `out` cannot be written: before anything is measured, where that can be told.
    """
    what = f"--out '{out}'"
    if out is not None:
        there, folder = (status(path, what, OutputError, done="written") for path in (out, out.absolute().parent))
        if folder is None or not stat.S_ISDIR(folder.st_mode) or (there is not None and stat.S_ISDIR(there.st_mode)):
            raise OutputError(f"{what} cannot be written; expected the name of a file in a folder that is there")
    figures = collect(plan or inference.Plan(), rates, progress)
    # printed first: minutes of measuring are not to be lost with a file that cannot be written
    print(report(figures), flush=True)
    if out is not None:
        try:
            with written_whole(out) as partial:
                partial.write_text(json.dumps(figures, indent=1, allow_nan=False) + "\n", encoding="utf-8")
        except OSError as error:
            raise OutputError(f"{what} cannot be written: {error.strerror}") from None


def collect(plan: inference.Plan, rates: Rates, say: Callable[[str], None]) -> dict[str, Any]:
    """All figures: {"schema", "date", "machine", "kernels", "inference"}."""
    described = machine()
    say("kernels against the ray caster")
    found = rates()
    times = inference.measure(plan, say)
    return {
        "schema": SCHEMA,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "machine": described,
        "kernels": found,
        "inference": times,
    }


def machine() -> dict[str, Any]:
    """What it ran on: processor, cores, threads of the kernels, how busy it was before, and versions."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "kernel_threads": numba.get_num_threads(),
        "load_average_before": round(os.getloadavg()[0], 2),
        "system": f"{platform.system()} {platform.machine()}",
        "versions": {"python": platform.python_version(), **_versions()},
    }


def report(figures: dict[str, Any]) -> str:
    """The figures as text."""
    described = figures["machine"]
    versions = ", ".join(f"{name} {number}" for name, number in described["versions"].items())
    return "\n".join(
        [
            f"{described['processor']}, {described['cores']} cores, load {described['load_average_before']} before",
            versions,
            "",
            "Kernels, part poses a second, and as multiples of the ray caster's:",
            "",
            kernels.table(figures["kernels"]),
            "",
            inference.table(figures["inference"]),
        ]
    )


def _processor() -> str:
    information = Path("/proc/cpuinfo")
    if information.is_file():
        for line in information.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _versions() -> dict[str, str]:
    found = {}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


if __name__ == "__main__":
    main()
