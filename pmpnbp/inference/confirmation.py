"""How much of what should be seen of an object does the scan confirm? Pixel by pixel, where it is rendered at a place.

A pixel confirms the object by the depth that it should have; what is behind denies it, and what is in front hides it. A
surface that should end where the object does and goes on beyond it confirms nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry.poses import Array
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.nuisances import of_last_views
from pmpnbp.potentials.pixel_kinds import PixelKind, pixel_kinds
from pmpnbp.potentials.unary import object_scores, renders
from pmpnbp.scene.observation import View

# A part is missed where less than this share of its pixels confirms it, of so many that can be seen, and of this share
# of its own.
MISSED, FEWEST_PIXELS, IN_SIGHT = 0.25, 20, 0.3
# A part is denied where it is seen through in a larger share of its pixels that are in sight, of as many at least.
DENIED = 0.15
# What covers the object without hiding it: it can be seen there, or through it.
_IN_SIGHT = (PixelKind.EXPLAINED, PixelKind.ON_SUPPORT, PixelKind.SEEN_THROUGH, PixelKind.GOES_ON)


@dataclass(frozen=True, kw_only=True)
class Confirmation:
    """What the views say of an object at a place.

    score : the whole-object robust score without a prior; expected : the score if all that is in sight were confirmed
    covered, hidden, confirmed : pixels, of all views: where it is rendered, behind something, and as it should be
    missed : names of parts that are not where they should be seen; denied : of those that much is seen through
    pixels : of each view (h, w) bool, where the object is rendered, and where it is confirmed
    """

    score: float
    expected: float
    covered: int
    hidden: int
    confirmed: int
    missed: tuple[str, ...]
    denied: tuple[str, ...]
    pixels: tuple[tuple[View, NDArray[np.bool_], NDArray[np.bool_]], ...]

    @property
    def explained(self) -> float:
        """The share of what should be seen that is confirmed, 0 to 1, weighed as the score is; 0 where nothing is in
        sight."""
        return float(np.clip(self.score / self.expected, 0.0, 1.0)) if self.expected > 0 else 0.0


def confirmation(problem: Problem, root: Array, joints: Array) -> Confirmation:
    """What the problem's views say of a configuration (7,), (D,), at its last tolerance."""
    part_poses = problem.mrf.part_poses(root, joints)
    tolerance = problem.tolerance_end
    covered = hidden = confirmed = 0
    expected = 0.0
    own = np.zeros((4, problem.mrf.nodes))  # pixels of each part: covered, in sight, confirmed, seen through
    pixels = []
    for view, _, depth, number in renders(problem.observation, problem.surfaces, part_poses, problem.nuisances):
        kinds = pixel_kinds(view.depth, view.category, depth, tolerance)
        in_sight = np.isin(kinds, _IN_SIGHT)
        near = in_sight & (np.abs(view.depth - depth) < tolerance)
        covered += int(np.count_nonzero(depth))
        hidden += int(np.count_nonzero(kinds == PixelKind.IN_FRONT))
        confirmed += int(np.count_nonzero(near))
        expected += float(((depth / problem.unit_distance) ** 2)[in_sight].sum())
        for row, chosen in enumerate((depth > 0, in_sight, near, kinds == PixelKind.SEEN_THROUGH)):
            own[row] += np.bincount(number[chosen], minlength=problem.mrf.nodes)
        pixels.append((view, depth > 0, near))
    scoring = replace(problem.score(tolerance), form="robust")
    score = object_scores(problem.observation, problem.surfaces, part_poses[None], scoring, problem.nuisances)[0]
    seen = (own[1] >= FEWEST_PIXELS) & (own[1] >= IN_SIGHT * own[0])
    through = (own[1] >= FEWEST_PIXELS) & (own[3] > DENIED * own[1])
    names = [part.name for part in problem.mrf.model.parts]
    return Confirmation(
        score=float(score),
        expected=expected,
        covered=covered,
        hidden=hidden,
        confirmed=confirmed,
        missed=tuple(names[node] for node in np.flatnonzero(seen & (own[2] < MISSED * own[1]))),
        denied=tuple(names[node] for node in np.flatnonzero(through)),
        pixels=tuple(pixels),
    )


def by_last_views(problem: Problem, first: int) -> Problem:
    """The problem as the views from number `first` on alone have it, to ask what these confirm."""
    observation, nuisances = problem.observation, problem.nuisances
    views = observation.views
    return replace(
        problem,
        observation=replace(observation, views=views[first:]),
        nuisances=None if nuisances is None else of_last_views(nuisances, len(views), first),
    )


def some_of(names: Sequence[str]) -> str:
    """The first three of some names, as part of a sentence."""
    return ", ".join(names[:3]) + (" and others" if len(names) > 3 else "")
