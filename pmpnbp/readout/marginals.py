"""What does the belief about a link say of one number at a time? Weighted histograms of where it is, how it is turned,
and how far the joints that hold it are moved.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.problem import Problem
from pmpnbp.readout import particle_statistics
from pmpnbp.readout.placement import Placement, place
from pmpnbp.scene.articulated_object import parts_of_links

# Of the belief's weight so much may lie beyond either end of a histogram: far and light particles would leave the rest
# a single bar.
BEYOND = 0.001
# A histogram is at least so wide, metres or radians.
NARROWEST = 1e-4


@dataclass(frozen=True)
class Marginal:
    """A histogram.

    name : x, y, z, roll, pitch, yaw, or `joint NAME` (`joint NAME/x` for joints with several axes); unit : m or rad
    edges : (bins + 1,) ascending; density : (bins,) of the belief, per unit; its integral is the share of the weight
        that lies within the edges
    estimate : the same number of the estimate, within the edges
    """

    name: str
    unit: Literal["m", "rad"]
    edges: Array
    density: Array
    estimate: float


def marginals(
    problem: Problem, report: IterationReport, link: str, bins: int = 40, placed: Placement | None = None
) -> list[Marginal]:
    """The marginals of a link of the model: x, y, z (metres, in world), roll, pitch, yaw (radians, about world's fixed
    X, Y, Z in this order), then each joint between its part and the part it hangs on.

    Angles are counted from the estimate, at most half a turn to either side, so that none is torn apart where a full
    turn ends; they may lie beyond ±pi. Joint positions are those of the particles where a particle is a whole object,
    else those at pairs of particles of both parts (`particle_statistics.joint_draws`).

    placed : what `place` gave, where it is there already
    """
    placed = placed or place(problem, report)
    model, belief = problem.mrf.model, report.belief
    node, row = parts_of_links(model)[link], model.links.index(link)
    pose, particles, weights = placed.link_poses[row], placed.particles[:, row], np.exp(belief.log_weights[node])
    found = [
        histogram(name, "m", particles[:, axis], weights, float(pose[axis]), bins) for axis, name in enumerate("xyz")
    ]
    angles, at = poses.to_rpy(particles[:, 3:]), poses.to_rpy(pose[3:])
    for axis, name in enumerate(("roll", "pitch", "yaw")):
        found.append(histogram(name, "rad", around(angles[:, axis], at[axis]), weights, float(at[axis]), bins))
    return found + _joint_marginals(problem, report, node, placed.joint_positions, bins)


def histogram(
    name: str, unit: Literal["m", "rad"], values: Array, weights: Array, estimate: float, bins: int
) -> Marginal:
    """The marginal of values (T,) with weights (T,), which need not sum to one."""
    share = weights / weights.sum()
    order = np.argsort(values, kind="stable")
    below = np.cumsum(share[order])
    first, last = np.searchsorted(below, (BEYOND, 1 - BEYOND))
    low = min(float(values[order[first]]), estimate)
    high = max(float(values[order[min(last, len(order) - 1)]]), estimate)
    if high - low < NARROWEST:
        middle = (low + high) / 2
        low, high = middle - NARROWEST / 2, middle + NARROWEST / 2
    edges = np.linspace(low, high, bins + 1)
    mass, _ = np.histogram(values, edges, weights=share)
    return Marginal(name, unit, edges, mass / np.diff(edges), estimate)


def _joint_marginals(problem: Problem, report: IterationReport, node: int, joints: Array, bins: int) -> list[Marginal]:
    model, belief = problem.mrf.model, report.belief
    rng = np.random.default_rng([problem.seed, report.iteration])
    found = []
    for edge in (model.edges[number] for number in problem.mrf.tree if model.edges[number].child == node):
        if belief.joint_positions is None:
            moved = particle_statistics.joint_draws(rng, edge, belief)
            weights = np.ones(len(moved))
        else:
            moved, weights = edge.axis_positions(belief.joint_positions), np.exp(belief.log_weights[0])
        at = edge.axis_positions(joints)
        for axis, name in enumerate(model.edge_axis_names(edge)):
            values = around(moved[:, axis], at[axis]) if edge.wraps[axis] else moved[:, axis]
            unit: Literal["m", "rad"] = "rad" if edge.revolute[axis] else "m"
            found.append(histogram(f"joint {name}", unit, values, weights, float(at[axis]), bins))
    return found


def around(angles: Array, middle: Array | float) -> Array:
    """The same angles, at most half a turn from `middle`, which is one for all or one for each."""
    return middle + (angles - middle + np.pi) % (2 * np.pi) - np.pi
