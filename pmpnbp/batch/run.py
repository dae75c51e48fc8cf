"""How is a batch made? Row by row, wherever there is room; what is made is kept as it comes, then told in a table and a
report.

A row is done when its result is in its file and a line of the log says of what it was made. So a batch that was ended,
by whatever, goes on where it was; rows whose files or options have changed since are made anew, and so are those that
ended with an error.
"""

from __future__ import annotations

import fcntl
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from pmpnbp.batch.report import report
from pmpnbp.batch.row import Row
from pmpnbp.batch.table import table
from pmpnbp.batch.told import ERROR, WAITING, Told, told
from pmpnbp.batch.work import Outcome, Work, killed, pack, perform
from pmpnbp.errors import PmpnbpError, RunError
from pmpnbp.files import written_whole
from pmpnbp.json_text import json_to_read
from pmpnbp.recording.inputs import model_zip
from pmpnbp.runs.run_log import RunLog
from pmpnbp.runs.workers import spread

RESULTS, PICTURES, TABLE, REPORT, LOCK = "results", "pictures", "table.csv", "report.html", ".lock"
# Models of which the zip is kept: most batches have one.
KEPT_MODELS = 4
# Called with a row's name, and with its error where it came to nothing.
OnRow = Callable[[str, str | None], object]


@dataclass(frozen=True)
class Made:
    """What there is of a batch. report, table : files; counts : rows by verdict, see `pmpnbp.batch.told`; first_error :
    of the first row that came to nothing its name and why"""

    report: Path
    table: Path
    counts: Mapping[str, int]
    first_error: tuple[str, str] | None


def batch(
    rows: Sequence[Row],
    out: Path,
    *,
    title: str = "Batch",
    processes: int = 1,
    on: str | None = None,
    began: Callable[[int], object] = lambda done: None,
    on_row: OnRow = lambda name, error: None,
) -> Made:
    """Make the estimates of `rows` that are not in the folder `out` yet; the table and report are of all of them, also
    where this is interrupted.

    processes, on : where, as `pmpnbp.runs.workers.spread` takes them
    began : called with the number of rows that are done already; on_row : called with each as it comes
    Raises RunError: where `out` cannot be written or another batch is being made there, or where no worker can be had.
    """
    try:
        with _alone(out):
            return _Batch(rows, out, title, on_row).make(processes, on, began)
    except OSError as error:
        raise RunError(f"'{out}' cannot be written: {error.strerror or error}") from None


@contextmanager
def _alone(out: Path) -> Iterator[None]:
    """While no other process makes a batch in the folder, which is made. Raises RunError where one does."""
    for folder in (out, out / RESULTS, out / PICTURES):
        folder.mkdir(parents=True, exist_ok=True)
    with (out / LOCK).open("w") as file:
        try:
            fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise RunError(f"another batch is being made in '{out}'; name another folder with --out") from None
        yield


class _Batch:
    """What has come of the rows so far: by name, None or an error."""

    def __init__(self, rows: Sequence[Row], out: Path, title: str, on_row: OnRow) -> None:
        self._rows, self._out, self._title, self._on_row = rows, out, title, on_row
        self._log = RunLog(out, "batch")
        self._archive = lru_cache(KEPT_MODELS)(model_zip)
        self._ended: dict[str, str | None] = {}
        # of results that were there: none is read twice
        self._known: dict[str, Told] = {}

    def make(self, processes: int, on: str | None, began: Callable[[int], object]) -> Made:
        try:
            self._ended = {row.name: None for row in self._rows if self._done(row)}
            began(len(self._ended))
            left = [row for row in self._rows if row.name not in self._ended]
            if left:
                for work, outcome in spread(perform, self._works(left), processes, on, killed):
                    self._keep(work, outcome)
        except BaseException:
            self._write()
            raise
        return self._write()

    def _done(self, row: Row) -> bool:
        if not self._result(row.name).is_file():
            return False
        try:
            kept = self._log.get(_asked(pack(row, self._archive)))
        except PmpnbpError:  # which is told when the row's turn comes
            return False
        if kept is None or kept.get("error") is not None:
            return False
        found = self._of_result(row.name)
        if found.verdict != ERROR:  # it may be there, and be damaged
            self._known[row.name] = found
        return row.name in self._known

    def _works(self, rows: Sequence[Row]) -> Iterator[Work]:
        for row in rows:
            try:
                yield pack(row, self._archive)
            except PmpnbpError as error:
                self._end(row.name, str(error))

    def _keep(self, work: Work, outcome: Outcome) -> None:
        """The files first, then the line that says they are whole."""
        if outcome.picture is not None:
            _replace(self._picture(work.name), outcome.picture)
        if outcome.result is not None:
            _replace(self._result(work.name), json_to_read(outcome.result).encode())
        self._log.add(_asked(work), {"error": outcome.error})
        self._end(work.name, outcome.error)

    def _end(self, name: str, error: str | None) -> None:
        if error is not None:  # what an earlier form of the row gave is not its result
            for path in (self._result(name), self._picture(name)):
                path.unlink(missing_ok=True)
        self._ended[name] = error
        self._on_row(name, error)

    def _write(self) -> Made:
        rows = [self._told(row.name) for row in self._rows]
        made = Made(
            self._out / REPORT,
            self._out / TABLE,
            Counter(row.verdict for row in rows),
            next(((row.name, row.sentence) for row in rows if row.verdict == ERROR), None),
        )
        _replace(made.table, table(rows).encode())
        _replace(made.report, report(rows, self._title).encode())
        return made

    def _told(self, name: str) -> Told:
        if name not in self._ended:
            return Told(name=name, verdict=WAITING, sentence="It has not been made yet")
        error = self._ended[name]
        if error is not None:
            return Told(name=name, verdict=ERROR, sentence=error)
        return self._known.get(name) or self._of_result(name)

    def _of_result(self, name: str) -> Told:
        return told(name, self._out, self._result(name), self._picture(name))

    def _result(self, name: str) -> Path:
        return self._out / RESULTS / f"{name}.json"

    def _picture(self, name: str) -> Path:
        return self._out / PICTURES / f"{name}.png"


def _asked(work: Work) -> dict[str, str]:
    return {"name": work.name, "digest": work.digest}


def _replace(path: Path, content: bytes) -> None:
    """Have the file hold this: at any instant it is the old one or the new one."""
    with written_whole(path) as part:
        part.write_bytes(content)
