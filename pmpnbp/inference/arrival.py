"""Which scans is an iteration made with? Those at the beginning, and those that came: each joins the others, as a
further view of the same scene, or replaces them all, as the scene has moved on.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar, get_args

ScanMode = Literal["joins", "replaces"]
SCAN_MODES: tuple[str, ...] = get_args(ScanMode)

Kind = TypeVar("Kind")


@dataclass(frozen=True)
class Arrival:
    """The newest views of a problem.

    after_iteration : the last iteration that was made without them
    first : the number of the first of them; all views from there on came together. 0 where the scene has moved on
    moves : how often the scene has moved on so far
    """

    after_iteration: int
    first: int
    moves: int = 0

    @property
    def replaces(self) -> bool:
        """Whether the scene has moved on with these views."""
        return self.first == 0


def present(
    began: Sequence[Kind], came: Iterable[tuple[int, Kind, ScanMode]], iteration: int | None = None
) -> tuple[tuple[Kind, ...], Arrival | None]:
    """The scans that iteration `iteration` is made with, or else the next one, and their arrival; None where none came.

    began : those at the beginning, or whatever stands for them
    came : the later ones in order: the iteration it came after, the scan, and its mode
    """
    scans, arrival, moves = tuple(began), None, 0
    for after, scan, mode in came:
        if iteration is not None and after >= iteration:
            break
        together = arrival is not None and arrival.after_iteration == after
        if mode == "replaces":
            scans, first, moves = (), 0, moves + 1
        else:
            first = arrival.first if arrival is not None and together else len(scans)
        scans, arrival = (*scans, scan), Arrival(after, first, moves)
    return scans, arrival
