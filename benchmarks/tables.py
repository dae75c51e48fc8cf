"""How are figures written down? Markdown tables, and rates with their intervals."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence

from benchmarks.statistics import wilson
from benchmarks.trials import Case, Trial


def markdown(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table whose cells are text, or whatever `str` makes of them."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(str(cell) for cell in line) + " |" for line in lines)


def rate(successes: int, trials: int) -> str:
    """`49 of 50, 98 % (90–100)`: the count, the rate and Wilson's 95 % interval."""
    if trials == 0:
        return "none"
    low, high = wilson(successes, trials)
    return f"{successes} of {trials}, {100 * successes / trials:.0f} % ({100 * low:.0f}–{100 * high:.0f})"


def centimetres(case: Case, trial: Trial, above: float = -1.0) -> str:
    """`drawer1 0.12, drawer2 3.40`: errors of the judged parts that are larger than `above` metres, in centimetres."""
    named = zip(case.model.parts, trial.errors, case.judged, strict=True)
    return ", ".join(f"{part.name} {100 * error:.2f}" for part, error, judged in named if judged and error > above)


def progress(line: str) -> None:
    """One line to stderr, where it is not mixed up with the tables."""
    print(line, file=sys.stderr, flush=True)
