"""What hides a part? Of the pixels that it would cover alone, the shares in which it is in sight, behind another part
of the object, or behind something that is not the object: why a link that is not certain is not.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from pmpnbp.geometry.poses import Array
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.pixel_kinds import in_front
from pmpnbp.potentials.unary import render_part, renders
from pmpnbp.readout.placement import VISIBLE_TOLERANCE


@dataclass(frozen=True, kw_only=True)
class Sight:
    """Of one part in the view that sees most of it, shares of the pixels that it would cover alone; they sum to 1.

    view : number of its scan; seen : as `unary.visible_fractions`; behind : by number of the part that hides it,
    largest first; in_front : something is measured in front that is not the object
    """

    view: int
    seen: float
    behind: Mapping[int, float]
    in_front: float


def sights(problem: Problem, part_poses: Array) -> list[Sight | None]:
    """Of every part at poses (N, 7), part in world; None where it covers no pixel of any view: it lies outside the
    image, or has no surface."""
    found: list[Sight | None] = [None] * len(part_poses)
    rendered = renders(problem.observation, problem.surfaces, part_poses, problem.nuisances)
    for scan, (view, seen, depth, number) in zip(problem.observation.scan_numbers, rendered, strict=True):
        blocked = in_front(view.depth, depth, VISIBLE_TOLERANCE)
        for node in range(len(found)):
            alone = render_part(view.camera, problem.surfaces, node, seen[node]) > 0
            covered = np.count_nonzero(alone)
            if not covered:
                continue
            nearest = number[alone & ~blocked]
            behind = np.bincount(nearest[nearest >= 0], minlength=len(found)) / covered
            sight = Sight(
                view=scan,
                seen=float(behind[node]),
                behind={
                    int(other): float(behind[other])
                    for other in np.argsort(-behind, kind="stable")
                    if other != node and behind[other] > 0
                },
                in_front=np.count_nonzero(alone & blocked) / covered,
            )
            known = found[node]
            if known is None or sight.seen > known.seen:
                found[node] = sight
    return found
