"""Which other positions of three joints leave the part behind them where it is?

A forearm rolled by half a turn, the wrist bent the other way and the hand rolled back: all but the wrist lies as
before, and no joint can be moved there alone. The first joint of every three in a row is therefore turned by half, and
the next two are given the positions that bring the part behind them nearest to its place.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.mrf import Mrf
from pmpnbp.potentials.joint_projection import closest_axes
from pmpnbp.scene.articulated_object import ArticulatedObject, Edge


def half_turns(mrf: Mrf, part_poses: Array, joints: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Of each of H configurations, part poses (H, N, 7) and joint vectors (H, D), one for each of F triples of edges in
    a row: joint vectors (H, F, D), and whether the first joint's range has room for half a turn (H, F)."""
    model = mrf.model
    found, possible = [], []
    for first, second, third in _triples(model, mrf):
        coordinate = first.coordinates[0]
        turned = joints[:, coordinate] + np.pi
        turned = np.where(turned > model.upper[coordinate], turned - 2 * np.pi, turned)
        changed = joints.copy()
        changed[:, coordinate] = turned
        moved = poses.multiply(part_poses[:, first.parent], first.pose_parent_child(first.axis_positions(changed)))
        both = in_a_row(second, third)
        axes = closest_axes(both, poses.multiply(poses.inverse(moved), part_poses[:, third.child]))
        coordinates, positions = both.joint_positions(axes)
        changed[:, coordinates] = positions
        found.append(changed)
        possible.append(turned >= model.lower[coordinate])
    if not found:
        return np.zeros((len(joints), 0, model.dof)), np.zeros((len(joints), 0), dtype=bool)
    return np.stack(found, axis=1), np.stack(possible, axis=1)


def in_a_row(first: Edge, second: Edge) -> Edge:
    """Two edges, the second from the first one's child, as one."""
    before = second.poses_before.copy()
    before[0] = poses.multiply(first.pose_after, before[0])
    each = {
        name: np.concatenate([getattr(first, name), getattr(second, name)])
        for name in ("revolute", "axes", "lower", "upper", "wraps", "coordinates", "multiplier", "offset")
    }
    return Edge(
        parent=first.parent,
        child=second.child,
        poses_before=np.concatenate([first.poses_before, before]),
        pose_after=second.pose_after,
        **each,
    )


def _triples(model: ArticulatedObject, mrf: Mrf) -> list[tuple[Edge, Edge, Edge]]:
    """Edges of the tree in a row, of joints of their own; the first one turns."""
    edges = [model.edges[number] for number in mrf.tree]
    found = []
    for first, second, third in product(edges, repeat=3):
        in_line = first.child == second.parent and second.child == third.parent
        if in_line and len(first.axes) == 1 and first.revolute[0] and _independent(first, second, third):
            found.append((first, second, third))
    return found


def _independent(*edges: Edge) -> bool:
    coordinates = np.concatenate([edge.coordinates for edge in edges])
    multipliers = np.concatenate([edge.multiplier for edge in edges])
    return len(set(coordinates.tolist())) == len(coordinates) and bool(np.all(multipliers != 0))
