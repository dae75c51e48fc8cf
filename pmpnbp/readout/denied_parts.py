"""Where may a part be that is not where it was found? A board within reach of a hidden drawer is taken for its front,
but it is no drawer: beside it one looks through where the front should be.

Of such a part the scan says only where it is not. Its joint goes over its whole range, but for where the part, and what
hangs on it, would be seen through. As little does it say of a part that the region of interest leaves out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pmpnbp.geometry.poses import Array
from pmpnbp.inference.mrf import Mrf
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.pixel_kinds import PixelKind, pixel_kinds
from pmpnbp.potentials.unary import renders
from pmpnbp.readout.first_proposal import CELLS
from pmpnbp.readout.importance_sampling import Grid
from pmpnbp.readout.log_posterior import confidence

# The share of draws that stay where the part was found.
STAYING = 0.2


def drawn_anew(
    rng: np.random.Generator, problem: Problem, root: Array, joints: Array, denied: Sequence[int], drawn: Array
) -> Array:
    """Draws of the joint vector (K, D), those joints drawn anew that place the parts numbered `denied`, all others
    being where an estimate (7,), (D,) has them. A fifth stays where this has it, since the model may be a little wrong
    instead; and as it was drawn a part that not one coordinate alone moves, within limits."""
    mrf = problem.mrf
    model, drawn = mrf.model, drawn.copy()
    for node in denied:
        coordinate = _own_coordinate(mrf, node)
        if coordinate is None:
            continue
        lower, upper = float(model.lower[coordinate]), float(model.upper[coordinate])
        tried = np.tile(joints, (CELLS, 1))
        tried[:, coordinate] = lower + (upper - lower) * (np.arange(CELLS) + 0.5) / CELLS
        part_poses = mrf.part_poses(np.tile(root, (CELLS, 1)), tried)
        cost = np.array([_seen_through(problem, placed, moving(mrf, node)) for placed in part_poses])
        weights = np.exp(confidence(problem) * (cost.min() - cost)) + np.finfo(float).tiny
        anew = rng.random(len(drawn)) > STAYING
        drawn[~anew, coordinate] = joints[coordinate]
        drawn[anew, coordinate] = Grid(coordinate, lower, upper, weights / weights.sum()).draw(rng, int(anew.sum()))
    return drawn


def without(problem: Problem, denied: Sequence[int]) -> Problem:
    """The problem in which the parts numbered `denied`, and what hangs on them, are not to be seen: where they were
    found is something else, which would draw the others after it."""
    gone = [node for one in denied for node in moving(problem.mrf, one)]
    return replace(problem, surfaces=problem.surfaces.without(gone))


def moving(mrf: Mrf, node: int) -> list[int]:
    """A part and all those that hang on it."""
    found = [node]
    for number in mrf.tree:  # each after the one that reaches its parent
        edge = mrf.model.edges[number]
        if edge.parent in found:
            found.append(edge.child)
    return found


def _own_coordinate(mrf: Mrf, node: int) -> int | None:
    """The entry of the joint vector that moves a part against its parent, and no other part against its own; None
    where there is none, or several, or it has no limits."""
    used = [entry for edge in mrf.model.edges for entry in edge.coordinates.tolist()]
    edges = [mrf.model.edges[number] for number in mrf.tree if mrf.model.edges[number].child == node]
    own = [entry for edge in edges for entry in edge.coordinates.tolist()]
    if len(own) != 1 or used.count(own[0]) != 1:
        return None
    span = mrf.model.upper[own[0]] - mrf.model.lower[own[0]]
    return int(own[0]) if 0 < span < np.inf else None


def _seen_through(problem: Problem, part_poses: Array, nodes: Sequence[int]) -> float:
    """Pixels in which any of the parts `nodes` is seen through, the object being at poses (N, 7), weighed as the score
    is."""
    found = 0.0
    for view, _, depth, number in renders(problem.observation, problem.surfaces, part_poses, problem.nuisances):
        kinds = pixel_kinds(view.depth, view.category, depth, problem.tolerance_end)
        through = (kinds == PixelKind.SEEN_THROUGH) & np.isin(number, nodes)
        found += float(((depth / problem.unit_distance) ** 2)[through].sum())
    return found
