"""Can the object's root be turned without anything to see? A round plate can, and a round foot whose joints turn about
its own axis: what of an angle is the foot's, and what the joint's, no scan tells.

Draws would find such a turn only slowly, as it goes round while all else stays. It is known beforehand, so each draw is
moved along it to anywhere that the joints' limits allow.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.readout.surface_distance import part_surface
from pmpnbp.scene.articulated_object import ArticulatedObject, Edge

# Joint and part turn about one line where their axes are as parallel as this (cosine), and as near, metres.
PARALLEL, NEAR = 0.9999, 0.001


@dataclass(frozen=True)
class FreeTurn:
    """axis, middle : (3,) the line that the root part turns about, in its frame
    coordinates : (M,) of joints that turn back by as much; back : (M,) what each moves for a radian of the part's."""

    axis: Array
    middle: Array
    coordinates: tuple[int, ...]
    back: tuple[float, ...]


def free_turn(model: ArticulatedObject) -> FreeTurn | None:
    """That of a model's root, or None where something tells how it is turned."""
    root = model.parts[0]
    axis = part_surface(root).axis
    if not axis.any():
        return None
    used = [coordinate for edge in model.edges for coordinate in edge.coordinates.tolist()]
    coordinates, back = [], []
    for edge in model.edges:
        if edge.child == 0:
            return None
        if edge.parent != 0:
            continue
        turned = _turned(edge, axis, root.centre)
        coordinate = int(edge.coordinates[0])
        if turned is None or used.count(coordinate) > 1:
            return None
        coordinates.append(coordinate)
        back.append(turned)
    return FreeTurn(axis, root.centre, tuple(coordinates), tuple(back))


def turned_anyhow(
    rng: np.random.Generator, model: ArticulatedObject, free: FreeTurn, roots: Array, joints: Array
) -> tuple[Array, Array]:
    """Root poses (K, 7) and joint vectors (K, D), each turned by an angle that is as likely as any other."""
    low, high = np.full(len(roots), -np.pi), np.full(len(roots), np.pi)
    for coordinate, back in zip(free.coordinates, free.back, strict=True):
        if not model.wraps[coordinate]:
            ends = (np.array([model.lower, model.upper])[:, coordinate, None] - joints[:, coordinate]) / back
            low, high = np.maximum(low, ends.min(axis=0)), np.minimum(high, ends.max(axis=0))
    angle = rng.uniform(low, high)
    turn = poses.from_rotation_vector(angle[:, None] * free.axis)
    about = np.concatenate([free.middle - poses.rotate(turn, free.middle), turn], axis=-1)
    joints = joints.copy()
    joints[:, free.coordinates] += angle[:, None] * free.back
    return poses.multiply(roots, about), joints


def _turned(edge: Edge, axis: Array, middle: Array) -> float | None:
    """What the first joint coordinate of an edge from the root has to move, for a radian of the root about a line, so
    that nothing behind it does; None where it cannot make up for that."""
    before, multiplier = edge.poses_before[0], float(edge.multiplier[0])
    along = float(poses.rotate(before[3:], edge.axes[0]) @ axis)
    aside = np.linalg.norm(np.cross(before[:3] - middle, axis))
    if not edge.revolute[0] or abs(along) < PARALLEL or aside > NEAR or multiplier == 0:
        return None
    return -np.sign(along) / multiplier
