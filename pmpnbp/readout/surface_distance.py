"""How far is each part of an object from where another configuration has it? The mean distance over its surface (eq.
12), between two poses of the same part.

A part that is round repeats itself in every turn about its axis, and no such turn moves it: of it the points' feet on
the axis are compared, and the tilt of the axis at the surface's mean distance from it.
"""

from __future__ import annotations

from dataclasses import dataclass
from threading import Lock

import numpy as np
from cachetools import LRUCache, cached
from scipy.spatial import cKDTree

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.articulated_object import ArticulatedObject, Part
from pmpnbp.scene.meshes import KEPT, content
from pmpnbp.scene.surface_points import area, even_points

# Points of a part's surface that are averaged over.
POINTS = 100
# Points that tell whether a part is round, turned by an angle, radians, in which no shape of up to twelve like sides or
# arms repeats itself.
TOLD_BY, ANGLE = 8000, 0.3
# A round part is as wide one way as the other, by this share. A surface is on itself when its points are as near to
# others of it as this, in multiples of their spacing: in the mean (half of it, were they strewn at random), and all
# but a thousandth. Of 52 cylinders, cones, rings, spheres and turned shapes of 12 to 64 sides, turned, that is 1.7 at
# most; of a knob with a pointer it is more.
WIDTHS, NEAR, FAR, BUT = 0.03, 0.7, 2.3, 0.001


@dataclass(frozen=True)
class PartSurface:
    """points : (m, 3) of a part's surface, in its frame, no rows where it has none; of a round part their feet on its
    axis. axis : (3,) of a round part, else zero; radius : metres, the surface's mean distance from it, else 0."""

    points: Array
    axis: Array
    radius: float


def part_surfaces(model: ArticulatedObject) -> tuple[PartSurface, ...]:
    """Of each part."""
    return tuple(part_surface(part) for part in model.parts)


def _content(part: Part) -> bytes:
    return content([part.mesh])


def _bytes(made: PartSurface) -> int:
    return made.points.nbytes + made.axis.nbytes


@cached(LRUCache(maxsize=KEPT, getsizeof=_bytes), key=_content, lock=Lock())
def part_surface(part: Part) -> PartSurface:
    """That of one part, which is always the same."""
    if not part.visible:
        return PartSurface(np.zeros((0, 3)), np.zeros(3), 0.0)
    points = even_points(part.mesh, POINTS)
    axis = _round_axis(part)
    if axis is None:
        return PartSurface(points, np.zeros(3), 0.0)
    feet = part.centre + np.outer((points - part.centre) @ axis, axis)
    return PartSurface(feet, axis, float(np.linalg.norm(points - feet, axis=1).mean()))


def distances(surfaces: tuple[PartSurface, ...], here: Array, there: Array) -> Array:
    """(..., N) metres from each part at `here` (N, 7) to itself at `there` (..., N, 7); NaN without a surface."""
    found = np.full(there.shape[:-1], np.nan)
    for node, surface in enumerate(surfaces):
        if not len(surface.points):
            continue
        moved = poses.transform_points(there[..., node, None, :], surface.points)
        apart = moved - poses.transform_points(here[node], surface.points)
        found[..., node] = np.sqrt(np.einsum("...pi,...pi->...p", apart, apart)).mean(axis=-1)
        if surface.radius > 0:
            axis_there, axis_here = (poses.rotate(some[..., node, 3:], surface.axis) for some in (there, here))
            found[..., node] += surface.radius * np.linalg.norm(np.cross(axis_there, axis_here), axis=-1)
    return found


def turns(surfaces: tuple[PartSurface, ...], here: Array, there: Array) -> Array:
    """(..., N) radians, 0 to pi, that each part at `here` (N, 7) is turned by at `there` (..., N, 7); of a round part
    by how much its axis is."""
    found = poses.rotation_angle(here[:, 3:], there[..., 3:])
    for node, surface in enumerate(surfaces):
        if surface.axis.any():
            before, after = (poses.rotate(at[..., node, 3:], surface.axis) for at in (here, there))
            found[..., node] = np.arccos(np.clip(after @ before, -1, 1))
    return found


def turn_agreement(surfaces: tuple[PartSurface, ...], here: Array, there: Array) -> Array:
    """(N,): how far the turns of round parts about their axes from `here` (N, 7) to `there` (K, N, 7) agree: the length
    of their mean on the unit circle, 0 to 1; NaN for a part that is not round."""
    found = np.full(len(surfaces), np.nan)
    for node, surface in enumerate(surfaces):
        if surface.axis.any():
            turn = poses.multiply(poses.inverse(here[node]), there[:, node])[:, 3:]
            angle = 2 * np.arctan2(turn[:, 1:] @ surface.axis, turn[:, 0])
            found[node] = np.abs(np.exp(1j * angle).mean())
    return found


def looks_the_same(part: Part, here: Array, there: Array) -> bool:
    """Whether a part with a surface has it where it is at one pose (7,) at the other (7,), too, turned."""
    points = even_points(part.mesh, TOLD_BY)
    moved = poses.transform_points(poses.multiply(poses.inverse(here), there), points)
    # what comes back to itself keeps its middle
    middles_apart = float(np.linalg.norm((moved - points).mean(axis=0)))
    return middles_apart < FAR * _spacing(part) and _is_on(points, moved, part)


def _round_axis(part: Part) -> Array | None:
    """(3,) the axis of a part's frame about which it is round, as one with a surface may be, or None."""
    extents = part.extents
    for number, axis in enumerate(np.eye(3)):
        across = np.delete(extents, number)
        if across.max() == 0 or np.ptp(across) > WIDTHS * across.max():
            continue
        points = even_points(part.mesh, TOLD_BY) - part.centre
        if _is_on(points, poses.rotate(poses.from_rotation_vector(ANGLE * axis), points), part):
            return axis
    return None


def _is_on(points: Array, moved: Array, part: Part) -> bool:
    """Whether points (TOLD_BY, 3) of a part's surface are on it when they are `moved` (TOLD_BY, 3)."""
    apart = cKDTree(points).query(moved)[0] / _spacing(part)
    return bool(apart.mean() < NEAR and np.quantile(apart, 1 - BUT) < FAR)


def _spacing(part: Part) -> float:
    return float(np.sqrt(area(part.mesh) / TOLD_BY))
