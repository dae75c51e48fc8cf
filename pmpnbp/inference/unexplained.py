"""What does a place of the object leave unexplained, and might the object be there instead?

A look-alike that is in better view explains more pixels than the object itself, and a search that is taken in by a part
of the object, or of something else, comes back to it. Neither does once what was explained is out of the race.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from pmpnbp.geometry.poses import Array
from pmpnbp.inference.confirmation import confirmation
from pmpnbp.inference.problem import Problem
from pmpnbp.scene.observation import OBJECT
from pmpnbp.scene.observe import without_pixels

# Pixels, weighed as the score is, that are too few for an object to be found in.
FEWEST = 60.0


@dataclass(frozen=True, kw_only=True)
class Rest:
    """What a place leaves. problem : that in which what the place explains cannot be the object; left : how much else
    there is that may be it, weighed as the score is, as a multiple of what is explained, 0 where that is too little to
    find anything in; outside : whether the place is largely outside the region of interest."""

    problem: Problem
    left: float
    outside: bool


def unexplained(problem: Problem, root: Array, joints: Array) -> Rest:
    """Of a configuration (7,), (D,)."""
    seen, left, explained = confirmation(problem, root, joints), 0.0, 0.0
    for view, _, confirmed in seen.pixels:
        weight = (view.depth / problem.unit_distance) ** 2
        may_be = view.category == OBJECT
        explained += float(weight[confirmed & may_be].sum())
        left += float(weight[may_be & ~confirmed].sum())
    others = without_pixels(problem.observation, [confirmed for _, _, confirmed in seen.pixels])
    if left < FEWEST or not len(others.points):
        left = 0.0
    return Rest(
        problem=replace(problem, observation=others), left=left / max(explained, 1.0), outside=seen.outside_region
    )


def is_within_region(problem: Problem, root: Array, joints: Array) -> bool:
    """Whether a configuration (7,), (D,) is within the region, and as much of it as a further view has to confirm lies
    where something is measured, whether that goes on or not: look-alikes may stand in a row."""
    seen = confirmation(problem, root, joints)
    return not seen.outside_region and seen.confirmed >= problem.settings.view_explained * (seen.covered - seen.hidden)
