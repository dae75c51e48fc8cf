"""Manifests for tests: files that are there, and rows that name them. And what other processes do there."""

from __future__ import annotations

import csv
import fcntl
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any


def files(folder: Path, *names: str) -> Path:
    """The folder, with empty files of these names in it."""
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    return folder


def json_lines(path: Path, *rows: Mapping[str, Any]) -> Path:
    path.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")
    return path


def csv_file(path: Path, *rows: Sequence[str]) -> Path:
    stream = io.StringIO(newline="")
    csv.writer(stream).writerows(rows)
    path.write_text(stream.getvalue(), encoding="utf-8", newline="")
    return path


def hold(path: Path, connection: Any) -> None:
    """Lock a file, as a batch does, until something comes."""
    with path.open("w") as file:
        fcntl.lockf(file, fcntl.LOCK_EX)
        connection.send("held")
        connection.recv()


def told_at_once(work: Any) -> Any:
    """An outcome that takes no time to make, of the work's seed."""
    from pmpnbp.batch.work import Outcome
    from tests.library.test_estimate import RESULT

    return Outcome(result={**RESULT, "seed": work.options["seed"]})
