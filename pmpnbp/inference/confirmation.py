"""How much of what should be seen of an object does the scan confirm? Pixel by pixel, where it is rendered at a place.

A pixel confirms the object by the depth that it should have; what is behind denies it, and what is in front hides it. A
surface that should end where the object does and goes on beyond it confirms nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pmpnbp.geometry.poses import Array
from pmpnbp.inference.mrf import Mrf
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.nuisances import of_last_views
from pmpnbp.potentials.pixel_kinds import PixelKind, pixel_kinds
from pmpnbp.potentials.unary import object_scores, renders
from pmpnbp.scene.depth_noise import NORMAL_MEDIAN, told_noise
from pmpnbp.scene.observation import SUPPORT, View

# A part is missed where less than this share of its pixels confirms it, of so many that can be seen, and of this share
# of its own.
MISSED, FEWEST_PIXELS, IN_SIGHT = 0.25, 20, 0.3
# A part is denied where a larger share of its pixels that are in sight, of as many at least, is seen through: of all of
# them, or in clumps of so many within its outline, as where a handle is not, or the side of a drawer. Along outlines a
# pixel here and there always is: there one counts for a part of one, as a frame or a narrow strip has most of its own
# there. The root, which all others hang on, is so for more of the latter.
DENIED, DENIED_WITHIN, ROOT_DENIED, CLUMP = 0.15, 0.015, 0.08, 4
ALONG_OUTLINE = 0.33
# A part that is denied is held where it is by one that hangs on it, if this share of what is in sight of that is
# confirmed, and it is not denied itself: the links of a real arm are seen through where the camera or the shape is a
# little off, and yet are between what they join.
HELD = 0.5
# Pixels that touch one another, at corners too.
TOUCHING = np.ones((3, 3))
# Share of the largest distance between a part's mesh and the one of fewer triangles by which its depths are off.
REDUCED = 0.2
# Share of the object's pixels that may be outside the region of interest, which is to hold it.
OUTSIDE_REGION = 0.3
# What covers the object without hiding it: it can be seen there, or through it.
_IN_SIGHT = (PixelKind.EXPLAINED, PixelKind.ON_SUPPORT, PixelKind.SEEN_THROUGH, PixelKind.GOES_ON)


@dataclass(frozen=True, kw_only=True)
class Confirmation:
    """What the views say of an object at a place.

    score : the whole-object robust score without a prior; expected : the score if all that is in sight were confirmed
    covered, hidden, confirmed, outside : pixels, of all views: where it is rendered, behind something, as it should be,
        and as something is that lies outside the region of interest
    missed : names of parts that are not where they should be seen; denied : of those that are seen through, and
    denied_share : the share of `covered` that they have; root_denied : whether the root is one
    beyond : names of the parts but the root of which so much lies outside the region of interest, and so little is
        confirmed within it, that only what they would hide says where they are
    held : those of the denied, and of those beyond, that cannot be elsewhere, see HELD
    off, noise : metres, deviation of the confirmed depths within its outline, by their median, which passes over what
        another surface has of a pixel, and that which the scan's own errors and fewer triangles are known to give them;
        0 where there are none
    pixels : of each view (h, w) bool, where the object is rendered, and where it is confirmed
    """

    score: float
    expected: float
    covered: int
    hidden: int
    confirmed: int
    outside: int
    missed: tuple[str, ...]
    denied: tuple[str, ...]
    held: tuple[str, ...]
    beyond: tuple[str, ...]
    denied_share: float
    root_denied: bool
    off: float
    noise: float
    pixels: tuple[tuple[View, NDArray[np.bool_], NDArray[np.bool_]], ...]

    @property
    def explained(self) -> float:
        """The share of what should be seen that is confirmed, 0 to 1, weighed as the score is; 0 where nothing is in
        sight."""
        return float(np.clip(self.score / self.expected, 0.0, 1.0)) if self.expected > 0 else 0.0

    @property
    def outside_region(self) -> bool:
        """Whether the object is largely outside the region that is to hold it."""
        return self.outside > OUTSIDE_REGION * self.covered


def confirmation(problem: Problem, root: Array, joints: Array, tolerance: float | None = None) -> Confirmation:
    """What the problem's views say of a configuration (7,), (D,), at a tolerance in metres, or the last one."""
    parts, part_poses = problem.mrf.model.parts, problem.mrf.part_poses(root, joints)
    tolerance = problem.tolerance_end if tolerance is None else tolerance
    covered = hidden = confirmed = 0
    expected = 0.0
    # pixels of each part: covered, in sight, confirmed, seen through, that within the outline, that in clumps, and
    # outside the region
    own = np.zeros((7, problem.mrf.nodes))
    # by how much confirmed depths are off, and the square of by how much they may be
    apart, may_be, pixels = [np.zeros(0)], [np.zeros(0)], []
    noise = float(told_noise(problem.noise, problem.noise_area).max(initial=0.0))
    known = noise**2 + (REDUCED * np.array([part.deviation for part in parts])) ** 2
    for view, _, depth, number in renders(problem.observation, problem.surfaces, part_poses, problem.nuisances):
        kinds = pixel_kinds(view.depth, view.category, depth, tolerance)
        in_sight = np.isin(kinds, _IN_SIGHT)
        near = in_sight & (np.abs(view.depth - depth) < tolerance)
        covered += int(np.count_nonzero(depth))
        hidden += int(np.count_nonzero(kinds == PixelKind.IN_FRONT))
        confirmed += int(np.count_nonzero(near))
        counted = np.where(near, view.depth, depth)[in_sight]
        expected += float(((counted / problem.unit_distance) ** 2).sum())
        through = kinds == PixelKind.SEEN_THROUGH
        inside: NDArray[np.bool_] = ndimage.binary_erosion(depth > 0, TOUCHING)
        within = inside & _clumps(through & (view.depth > depth))
        out = kinds == PixelKind.OUTSIDE_ROI
        for row, chosen in enumerate((depth > 0, in_sight, near, through, through & inside, within, out)):
            own[row] += np.bincount(number[chosen], minlength=problem.mrf.nodes)
        amid = near & inside & (view.category != SUPPORT)
        smooth = (view.distortion * view.distance) ** 2
        apart.append(np.abs(view.depth - depth)[amid])
        may_be.append(known[number[amid]] + smooth)
        pixels.append((view, depth > 0, near))
    # a share of what should be seen: each pixel that is not confirmed counts once
    scoring = replace(problem.plain_score(tolerance), form="robust")
    score = object_scores(problem.observation, problem.surfaces, part_poses[None], scoring, problem.nuisances)[0]
    seen = (own[1] >= FEWEST_PIXELS) & (own[1] >= IN_SIGHT * own[0])
    most_within = np.full(problem.mrf.nodes, DENIED_WITHIN)
    most_within[0] = ROOT_DENIED
    clumps = (own[5] >= CLUMP) & (own[5] > most_within * own[1])
    through = own[4] + ALONG_OUTLINE * (own[3] - own[4])
    denied = np.flatnonzero((own[1] >= FEWEST_PIXELS) & (clumps | (through > DENIED * own[1])))
    beyond = np.flatnonzero((own[6] >= FEWEST_PIXELS) & (own[2] < FEWEST_PIXELS) & (np.arange(problem.mrf.nodes) > 0))
    names, squares = [part.name for part in parts], np.concatenate(may_be)
    return Confirmation(
        score=float(score),
        expected=expected,
        covered=covered,
        hidden=hidden,
        confirmed=confirmed,
        outside=int(own[6].sum()),
        missed=tuple(names[node] for node in np.flatnonzero(seen & (own[2] < MISSED * own[1]))),
        denied=tuple(names[node] for node in denied),
        held=tuple(names[node] for node in _held(problem.mrf, np.union1d(denied, beyond), own[1], own[2])),
        beyond=tuple(names[node] for node in beyond),
        denied_share=float(own[0, denied].sum() / max(covered, 1)),
        root_denied=0 in denied,
        off=_deviation(np.concatenate(apart)),
        noise=float(np.sqrt(squares.sum() / max(len(squares), 1))),
        pixels=tuple(pixels),
    )


def _deviation(apart: Array) -> float:
    """The standard deviation of errors of the sizes (P,), were they normal; 0 where there are none."""
    return float(np.median(apart) / NORMAL_MEDIAN) if len(apart) else 0.0


def _held(mrf: Mrf, denied: NDArray[np.int64], in_sight: Array, confirmed: Array) -> list[int]:
    """Those of the parts `denied` that are held at both ends: they hang on one part, and one that hangs on them is
    confirmed. in_sight, confirmed : (N,) pixels"""
    holds = (in_sight >= FEWEST_PIXELS) & (confirmed >= HELD * in_sight)
    holds[denied] = False
    holding = {edge.parent for edge in (mrf.model.edges[number] for number in mrf.tree) if holds[edge.child]}
    return [node for node in denied.tolist() if node in holding and node != 0]


def _clumps(through: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Those pixels that are seen `through` (h, w), that are in clumps of CLUMP at least."""
    clumps = ndimage.label(through, TOUCHING)[0]
    found: NDArray[np.bool_] = through & (np.bincount(clumps.ravel())[clumps] >= CLUMP)
    return found


def by_last_views(problem: Problem, first: int) -> Problem:
    """The problem as the views of scans from number `first` on alone have it, to ask what these confirm."""
    observation, nuisances = problem.observation, problem.nuisances
    views, before = observation.views, sum(number < first for number in observation.scan_numbers)
    return replace(
        problem,
        observation=replace(observation, views=views[before:], showing=None),
        nuisances=None if nuisances is None else of_last_views(nuisances, len(views), before),
    )
