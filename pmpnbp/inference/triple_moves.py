"""Which other positions of three joints leave the part behind them where it is?

A forearm rolled by half a turn, the wrist bent the other way and the hand rolled back: all but the wrist lies as
before, and no joint can be moved there alone. The first joint of every three in a row is therefore turned by half. An
elbow may be bent the other way, too: where the three turn about parallel axes, the first is turned as far beyond the
line from it to the third as it was before that. Either way the next two are given the positions that bring the part
behind them nearest to its place.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.mrf import Mrf
from pmpnbp.potentials.joint_projection import closest_axes
from pmpnbp.scene.articulated_object import Edge

# Axes are parallel whose cosine is this; an elbow is bent that is out of the line by more than so many radians.
PARALLEL, BENT = 0.999, 0.03

Triple = tuple[Edge, Edge, Edge]


def triple_moves(mrf: Mrf, part_poses: Array, joints: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Of each of H configurations, part poses (H, N, 7) and joint vectors (H, D), half a turn for each of F triples of
    edges in a row, then an elbow bent the other way for each of E: joint vectors (H, F + E, D), and whether the first
    joint's range has room for it (H, F + E)."""
    model = mrf.model
    triples = _triples(mrf)
    turns = [(triple, np.full(len(joints), np.pi)) for triple in triples]
    turns += [(triple, _beyond_the_line(triple, part_poses)) for triple in triples if _is_elbow(mrf, triple)]
    found, possible = [], []
    for triple, angle in turns:
        coordinate = triple[0].coordinates[0]
        lower, upper = model.lower[coordinate], model.upper[coordinate]
        turned = joints[:, coordinate] + angle
        turned = np.where(turned > upper, turned - 2 * np.pi, np.where(turned < lower, turned + 2 * np.pi, turned))
        found.append(_followed(triple, part_poses, joints, turned))
        possible.append((turned >= lower) & (turned <= upper) & (np.abs(angle) > 2 * BENT))
    if not found:
        return np.zeros((len(joints), 0, model.dof)), np.zeros((len(joints), 0), dtype=bool)
    return np.stack(found, axis=1), np.stack(possible, axis=1)


def _followed(triple: Triple, part_poses: Array, joints: Array, turned: Array) -> Array:
    """Joint vectors (H, D) whose first joint is at `turned` (H,), the next two where the part behind them is nearest to
    its place."""
    first, second, third = triple
    changed = joints.copy()
    changed[:, first.coordinates[0]] = turned
    moved = poses.multiply(part_poses[:, first.parent], first.pose_parent_child(first.axis_positions(changed)))
    both = in_a_row(second, third)
    axes = closest_axes(both, poses.multiply(poses.inverse(moved), part_poses[:, third.child]))
    coordinates, positions = both.joint_positions(axes)
    changed[:, coordinates] = positions
    return changed


def _beyond_the_line(triple: Triple, part_poses: Array) -> Array:
    """(H,) what the first joint coordinate of an elbow moves to bend it the other way."""
    places, axes = _axes(triple, part_poses)
    near, far = (place - places[0] for place in places[1:])
    near, far = (gap - (gap * axes[0]).sum(axis=1, keepdims=True) * axes[0] for gap in (near, far))
    angle = np.arctan2((np.cross(near, far) * axes[0]).sum(axis=1), (near * far).sum(axis=1))
    found: Array = 2 * angle / triple[0].multiplier[0]
    return found


def _is_elbow(mrf: Mrf, triple: Triple) -> bool:
    """Whether all three turn about parallel axes, which they do in every configuration or in none."""
    if not all(len(edge.axes) == 1 and edge.revolute[0] for edge in triple):
        return False
    model = mrf.model
    _, axes = _axes(triple, mrf.part_poses(poses.IDENTITY, np.clip(0.0, model.lower, model.upper))[None])
    return all(abs(float(axes[0][0] @ axis[0])) > PARALLEL for axis in axes[1:])


def _axes(triple: Triple, part_poses: Array) -> tuple[list[Array], list[Array]]:
    """A point (H, 3) on the axis of each joint and its direction (H, 3), in world."""
    places = [poses.multiply(part_poses[:, edge.parent], edge.poses_before[0]) for edge in triple]
    directions = [poses.rotate(place[:, 3:], edge.axes[0]) for place, edge in zip(places, triple, strict=True)]
    return [place[:, :3] for place in places], directions


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


def _triples(mrf: Mrf) -> list[Triple]:
    """Edges of the tree in a row, of joints of their own; the first one turns."""
    return [
        (first, second, third)
        for first, second, third in mrf.edges_in_a_row(3)
        if len(first.axes) == 1 and first.revolute[0] and _independent(first, second, third)
    ]


def _independent(*edges: Edge) -> bool:
    coordinates = np.concatenate([edge.coordinates for edge in edges])
    multipliers = np.concatenate([edge.multiplier for edge in edges])
    return len(set(coordinates.tolist())) == len(coordinates) and bool(np.all(multipliers != 0))
