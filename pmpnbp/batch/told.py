"""What is said of a row once it is made? A few words and numbers of its result, for the table and the report."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from pmpnbp.errors import EstimateError
from pmpnbp.library.estimate import Estimate, standings
from pmpnbp.library.estimated import JointEstimate

# What can be said of a row, worst first: what somebody has to look at stands at the top.
ERROR, NOT_FOUND, NO_VERDICT, DOUBTFUL, FOUND, CERTAIN, WAITING = (
    "error",
    "not found",
    "no verdict",
    "doubtful",
    "found",
    "certain",
    "waiting",
)
VERDICTS = (ERROR, NOT_FOUND, NO_VERDICT, DOUBTFUL, FOUND, CERTAIN, WAITING)
_OF_FIT = {"none": NOT_FOUND, None: NO_VERDICT, "doubtful": DOUBTFUL, "good": FOUND}


@dataclass(frozen=True, kw_only=True)
class Told:
    """verdict : one of VERDICTS; sentence : the same in words; fit, explained, iterations, seconds : as result.json has
    them; certain, links : how many links are certain, of how many; standings : name and place of each joint, in words
    joints : the same in numbers; result, picture : files, relative to the report, or None where there are none"""

    name: str
    verdict: str
    sentence: str
    model: str | None = None
    fit: str | None = None
    explained: float | None = None
    certain: int | None = None
    links: int | None = None
    iterations: int | None = None
    seconds: float | None = None
    standings: tuple[tuple[str, str], ...] = ()
    joints: tuple[JointEstimate, ...] = field(default=(), compare=False)
    result: str | None = None
    picture: str | None = None


def told(name: str, out: Path, result: Path, picture: Path) -> Told:
    """What the result in the file `result` says. Names of files are given relative to the folder `out`."""
    try:
        found = Estimate.load(result)
    except EstimateError as error:  # it was there, and somebody has changed it
        return Told(name=name, verdict=ERROR, sentence=str(error))
    certain = sum(link.certain for link in found.links.values())
    verdict = _OF_FIT[found.fit]
    return Told(
        name=name,
        verdict=CERTAIN if verdict == FOUND and certain == len(found.links) else verdict,
        sentence=found.verdict,
        model=found.model,
        fit=found.fit,
        explained=found.explained,
        certain=certain,
        links=len(found.links),
        iterations=found.iteration,
        seconds=found.seconds,
        standings=tuple(standings(found)),
        joints=tuple(found.joints.values()),
        result=result.relative_to(out).as_posix(),
        picture=picture.relative_to(out).as_posix() if picture.is_file() else None,
    )
