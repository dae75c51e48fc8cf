"""How else could a chain be bent, with both ends where they are? Four joints in a row about parallel axes have a motion
that moves only the links between them, as in a four-bar linkage.

Draws do not follow it: the motion is curved, all that leaves it is told to a millimetre, and a covariance of twenty
coordinates that is fitted to a few draws is too narrow in just such directions. So the posterior is looked at along the
motion itself, and draws are moved along it. What is told of links that hide each other, or that are as wide as two
pixels, is by how much they may be bent so.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.joint_draws import within_limits
from pmpnbp.inference.mrf import Mrf
from pmpnbp.readout.importance_sampling import standardised

# Joints in a row that a motion goes over; fewer have none that leaves their ends, but by chance.
JOINTS = 4
# Metres that the links between are moved to see what is told of it.
LENGTHS = (0.0005, 0.001, 0.002, 0.003, 0.005, 0.0075, 0.01, 0.015, 0.02, 0.03, 0.045)
# A motion leaves the end where that moves by less than this share of what the links between do.
LEFT = 0.1
# Radians that a joint is moved by for a derivative; times that the end is brought back to its place, and the share of
# what the links between move below which a motion does not move the end back.
LITTLE, BROUGHT_BACK, DAMPED = 1e-4, 3, 0.03

# log density (C,) of root poses (C, 7) and joint vectors (C, D)
LogDensity = Callable[[Array, Array], Array]


@dataclass(frozen=True)
class Bend:
    """A motion of some joints that leaves what hangs on the last of them.

    coordinates : the joints' (J,); direction : (J,) what each moves for a metre that the links between move
    back : (J, 6), what each moves to bring the end's middle and rim back by a metre, see `_displacements`
    end : the part behind the last joint
    """

    coordinates: tuple[int, ...]
    direction: Array
    back: Array
    end: int


def bends(mrf: Mrf, root: Array, joints: Array) -> list[Bend]:
    """Those of a configuration (7,), (D,)."""
    model = mrf.model
    used = [coordinate for edge in model.edges for coordinate in edge.coordinates.tolist()]
    found = []
    for row in mrf.edges_in_a_row(JOINTS):
        # a joint that another one follows moves more than these links
        if any(len(edge.coordinates) != 1 or used.count(edge.coordinates[0]) != 1 for edge in row):
            continue
        coordinates = tuple(int(edge.coordinates[0]) for edge in row)
        moved = np.tile(joints, (1 + JOINTS, 1))
        moved[1 + np.arange(JOINTS), coordinates] += LITTLE
        parts = mrf.part_poses(np.tile(root, (1 + JOINTS, 1)), moved)
        each = [_displacements(mrf, edge.child, parts[0], parts[1:]).T / LITTLE for edge in row]
        within, end = np.concatenate(each[:-1]), each[-1]
        # the motion of the least squares at the end for what moves between
        values, axes = np.linalg.eigh(within.T @ within)
        scaled = axes / np.sqrt(np.maximum(values, 1e-9))
        sides, shares, motions = np.linalg.svd(end @ scaled, full_matrices=False)
        if shares[-1] > LEFT:
            continue
        direction = scaled @ motions[-1]
        # what brings the end back does not move along the motion, and does not go far where the links are in a line
        across = shares[:-1] / (shares[:-1] ** 2 + DAMPED**2)
        back = scaled @ (motions[:-1].T * across) @ sides[:, :-1].T
        found.append(Bend(coordinates, direction, back, row[-1].child))
    return found


def bent(mrf: Mrf, bend: Bend, roots: Array, joints: Array, lengths: Array) -> Array:
    """Joint vectors (C, D) of root poses (C, 7) and joint vectors (C, D) whose links between are moved by `lengths`
    (C,), metres, and the end brought back. Limits are kept."""
    model, chosen = mrf.model, list(bend.coordinates)
    home = mrf.part_poses(roots, joints)
    moved = joints.copy()
    moved[:, chosen] += lengths[:, None] * bend.direction
    for _ in range(BROUGHT_BACK):
        gap = _displacements(mrf, bend.end, home, mrf.part_poses(roots, moved))
        moved[:, chosen] -= gap @ bend.back.T
    return within_limits(moved, model.lower, model.upper, model.wraps)


def bent_otherwise(
    rng: np.random.Generator,
    mrf: Mrf,
    motions: Sequence[Bend],
    middle: tuple[Array, Array],
    covariance: Array,
    draws: tuple[Array, Array],
    log_density: LogDensity,
) -> Array:
    """Joint vectors (K, D) of draws, root poses (K, 7) and joint vectors (K, D), each moved along those motions along
    which a density is wider at their middle, (7,) and (D,), than their covariance (6 + D, 6 + D) is. What cannot be
    moved so far with the end left where it is stays."""
    roots, joints = draws
    scale, correlation = standardised(covariance)
    for bend in motions:
        direction = np.zeros(len(scale))
        direction[6 + np.array(bend.coordinates)] = bend.direction
        # the variance along it, all else as it is, that the covariance stands for
        told = 1 / ((direction / scale) @ np.linalg.solve(correlation, direction / scale))
        variance = spread_along(mrf, bend, *middle, log_density) ** 2
        if variance > told:
            lengths = np.sqrt(variance - told) * rng.standard_normal(len(joints))
            otherwise = bent(mrf, bend, roots, joints, lengths)
            off = _displacements(mrf, bend.end, mrf.part_poses(roots, joints), mrf.part_poses(roots, otherwise))
            left = np.linalg.norm(off, axis=1) <= LEFT * np.abs(lengths)
            joints = np.where(left[:, None], otherwise, joints)
    return joints


def spread_along(mrf: Mrf, bend: Bend, root: Array, joints: Array, log_density: LogDensity) -> float:
    """Metres, the standard deviation of a density about a configuration (7,), (D,) along a motion, all else as it
    is."""
    lengths = np.array([*(-np.array(LENGTHS[::-1])), 0.0, *LENGTHS])
    roots, start = np.tile(root, (len(lengths), 1)), np.tile(joints, (len(lengths), 1))
    log = log_density(roots, bent(mrf, bend, roots, start, lengths))
    weights = np.exp(log - log.max())
    mass = np.trapezoid(weights, lengths)
    mean = np.trapezoid(weights * lengths, lengths) / mass
    return float(np.sqrt(np.trapezoid(weights * (lengths - mean) ** 2, lengths) / mass))


def _displacements(mrf: Mrf, part: int, before: Array, after: Array) -> Array:
    """(C, 6) metres that a part's middle and, by turning, its rim move between part poses (..., N, 7) and (C, N, 7)."""
    shift, turn = poses.perturbation(before[..., part, :], after[:, part], mrf.centres[part])
    return np.concatenate([shift, mrf.radii[part] * turn], axis=-1)
