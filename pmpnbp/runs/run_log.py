"""Which runs have been made? A file of results, one line a run, so that an experiment that was stopped goes on."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pmpnbp.errors import RunError
from pmpnbp.files import written_whole
from pmpnbp.version import version

NAME = "runs.jsonl"
Asked = Mapping[str, Any]
Result = dict[str, Any]


class RunLog:
    """The results in `folder`, by what was asked for; both are what JSON can hold.

    Raises RunError where the file there is of another experiment or version, whose figures must not be mixed.
    """

    def __init__(self, folder: Path, experiment: str) -> None:
        self.path = folder / NAME
        self._results: dict[str, Result] = {}
        head = {"experiment": experiment, "version": version()}
        folder.mkdir(parents=True, exist_ok=True)
        lines = self._lines()
        if not lines:
            self._write([head])
            return
        if lines[0] != head:
            raise RunError(
                f"'{self.path}' holds runs of {_named(lines[0])}, and this is {_named(head)}; name another folder with "
                f"--out, or remove that file"
            )
        for line in lines[1:]:
            self._results[_key(line["asked"])] = line["result"]
        self._write(lines)  # without a last line that was cut off

    def get(self, asked: Asked) -> Result | None:
        """What came of a run; None where it has not been made."""
        return self._results.get(_key(asked))

    def results(self, asked: Sequence[Asked]) -> list[Result]:
        """What came of runs that have been made. Raises KeyError where one has not."""
        found = [self.get(one) for one in asked]
        if None in found:
            raise KeyError(f"{found.count(None)} of {len(found)} runs have not been made")
        return [result for result in found if result is not None]

    def add(self, asked: Asked, result: Result) -> None:
        """Keep what came of a run: once this returns it is on disk."""
        self._results[_key(asked)] = result
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps({"asked": asked, "result": result}) + "\n")
            file.flush()
            os.fsync(file.fileno())

    def _lines(self) -> list[Any]:
        if not self.path.is_file():
            return []
        lines: list[Any] = []
        for text in self.path.read_text(encoding="utf-8", errors="replace").splitlines():
            try:
                line = json.loads(text)
            except (ValueError, RecursionError):
                break
            if lines and not (isinstance(line, dict) and "asked" in line and "result" in line):
                break
            lines.append(line)
        return lines

    def _write(self, lines: list[Any]) -> None:
        with written_whole(self.path) as part:
            part.write_text("".join(json.dumps(line) + "\n" for line in lines), encoding="utf-8")


def _key(asked: Asked) -> str:
    return json.dumps(asked, sort_keys=True)


def _named(head: Any) -> str:
    known = head if isinstance(head, dict) else {}
    return f"{known.get('experiment', 'something else')} (version {known.get('version', 'unknown')})"
