"""What is written about an experiment? Tables as CSV, and a short report whose conclusions follow from the figures."""

from __future__ import annotations

import csv
import os
import platform
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError
from importlib.metadata import version as version_of
from pathlib import Path

from benchmarks.tables import markdown
from pmpnbp.version import version

HOLDS, IN_PART, NOT = "holds", "holds in part", "does not hold"
# The share of runs in which something has to be so for it to hold.
USUALLY = 0.9


@dataclass(frozen=True)
class Claim:
    """One of the paper's. verdict : HOLDS, IN_PART or NOT; because : a sentence with the figures"""

    text: str
    verdict: str
    because: str


@dataclass(frozen=True)
class Table:
    """Columns and rows; numbers are written as they are given. name : the file's, without `.csv`"""

    name: str
    header: Sequence[str]
    rows: Sequence[Sequence[object]]


def verdict(held: Sequence[bool]) -> str:
    """HOLDS where all of them do, NOT where none does."""
    return HOLDS if all(held) else IN_PART if any(held) else NOT


def verdict_of_runs(held: int, runs: int) -> str:
    """HOLDS where it did in nine runs of ten, NOT where it did in none."""
    return verdict([held >= USUALLY * runs, held > 0])


def write_table(folder: Path, table: Table) -> None:
    """`<name>.csv`."""
    with (folder / f"{table.name}.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(table.header)
        writer.writerows(table.rows)


def write_report(
    folder: Path,
    title: str,
    command: Sequence[str],
    seeds: str,
    claims: Sequence[Claim],
    sections: Iterable[str],
    figures: Mapping[str, str],
) -> None:
    """`report.md` of one of the paper's experiments, see `write_sections`."""
    rows = [[claim.text, f"**{claim.verdict}**", claim.because] for claim in claims]
    judged = "\n".join(["## What the paper claims, and what was found", "", markdown(["claim", "", "found"], rows)])
    write_sections(folder, title, [how(command, seeds), judged, *sections], figures)


def write_sections(folder: Path, title: str, sections: Iterable[str], figures: Mapping[str, str]) -> None:
    """`report.md`. sections : Markdown; figures : captions by file name, which come last"""
    lines = [f"# {title}", ""]
    for section in sections:
        lines += [section, ""]
    for name, caption in figures.items():
        lines += [f"![{caption}]({name})", "", f"*{caption}*", ""]
    (folder / "report.md").write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


def how(command: Sequence[str], seeds: str) -> str:
    """By which command, with which seeds and versions: Markdown."""
    return f"`{shlex.join(command)}`\n\nSeeds {seeds}. {made_with()}"


def made_with() -> str:
    """Versions, and how many cores: what figures may depend on."""
    packages = ", ".join(_versions("numpy", "numba", "scipy", "open3d-cpu"))
    return (
        f"pmpnbp {version()}, Python {platform.python_version()}, {packages}; {platform.system()} on "
        f"{platform.machine()}, {os.cpu_count()} cores."
    )


def _versions(*names: str) -> Iterator[str]:
    """Of those that are installed."""
    for name in names:
        with suppress(PackageNotFoundError):
            yield f"{name} {version_of(name)}"
