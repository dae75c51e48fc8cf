"""What does the trace say of each iteration? A row, JSON, that the session wrote beside the iteration.

A recording from elsewhere may have none, as `pmpnbp estimate` writes none, or one that lies: what is no row about its
model counts as none, and the row is made from the iteration itself when it is first asked for.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from contextlib import suppress

from pmpnbp.errors import RecordingError
from pmpnbp.json_text import json_bytes
from pmpnbp.readout.snapshot import Row, phase_of
from pmpnbp.recording.reader import Recording

# A member that rows have since they tell of posteriors, and how the one that came last begins.
_SINCE_POSTERIORS, _NEWEST = "particle_std_xyz", '"phase":"'

# What is told of the newest iteration where there is none.
NO_ROW: Row = {"iteration": None, "phase": None, "converged": False, "certain": False, "fit": None, "fit_reason": None}


def current(row: Row) -> Row:
    """A row as it is written now. Before there were posteriors `std_xyz` was the particles'; which links were certain
    was not told at first, nor a log likelihood that can be compared, nor the phase."""
    if "phase" in row:
        return row
    phase = phase_of(row["stage"], row["converged"])
    row = {"certain_by_link": None, "final_log_likelihood": None, **row, "phase": phase}
    if _SINCE_POSTERIORS in row:
        return row
    nothing = {"std_xyz": None, "certain": False, "fit": None, "fit_reason": None, "posterior_iteration": None}
    return {**row, _SINCE_POSTERIORS: row["std_xyz"], **nothing}


class OwnRows:
    """The rows that this program wrote into its own recording, as they stand there."""

    def row(self, recording: Recording, iteration: int) -> Row:
        """The row of an iteration. Raises RecordingError where there is none."""
        text = recording.summary(iteration)
        if text is None:
            newest = recording.newest()
            there = "none" if newest is None else f"iterations 0 to {newest}"
            raise RecordingError(f"iteration {iteration} is not in recording '{recording.name}'; it has {there}")
        return current(json.loads(text))

    def texts(self, recording: Recording, after: int, last: int) -> list[str]:
        """The rows, JSON, of the iterations beyond `after` and up to `last`, ascending."""
        return [
            text if _NEWEST in text else json_bytes(current(json.loads(text))).decode()
            for text in recording.summaries(after, last)
        ]


class ForeignRows:
    """The rows of a recording from elsewhere, up to iteration `last`.

    check : the row that a text is, or None; make : the row of an iteration, made from it, raises RecordingError
    """

    def __init__(
        self, recording: Recording, last: int, check: Callable[[str], Row | None], make: Callable[[Recording, int], Row]
    ) -> None:
        self._make = make
        readable = [number for number in recording.iterations() if number <= last]
        self._rows: dict[int, Row | None] = dict.fromkeys(readable)
        for text in _summaries(recording, readable, last):
            row = check(text)
            if row is not None and row["iteration"] <= last:
                self._rows[row["iteration"]] = row

    def row(self, recording: Recording, iteration: int) -> Row:
        """The row of an iteration. Raises RecordingError where it is not, or not whole."""
        row = self._rows.get(iteration)
        if row is None:
            row = self._rows[iteration] = self._make(recording, iteration)
        return row

    def texts(self, recording: Recording, after: int, last: int) -> list[str]:
        """The rows, JSON, of the iterations beyond `after` and up to `last` that have one or can be read, ascending."""
        found = []
        for number in sorted(self._rows):
            if after < number <= last:
                with suppress(RecordingError):  # damaged in the midst of whole ones
                    found.append(json_bytes(self.row(recording, number)).decode())
        return found


Rows = OwnRows | ForeignRows


def event_of(iteration: int) -> int:
    """The number that stands for the event of an iteration of a recording from elsewhere, which has one each."""
    return iteration + 1


def _summaries(recording: Recording, readable: Iterable[int], last: int) -> list[str]:
    """The texts up to iteration `last`; where one is damaged, those of the `readable` iterations that are not."""
    try:
        return recording.summaries(last=last)
    except RecordingError:
        texts = []
        for number in readable:
            with suppress(RecordingError):
                texts.append(recording.summary(number) or "")
        return texts
