"""Points on a mesh's surface: spread evenly, the same ones each time, or drawn at random with their normals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry.poses import Array
from pmpnbp.scene.articulated_object import Mesh


def even_points(mesh: Mesh, count: int) -> Array:
    """(count, 3) points spread evenly over the surface by area, the same ones each time."""
    return even_oriented_points(mesh, count)[0]


def even_oriented_points(mesh: Mesh, count: int) -> tuple[Array, Array]:
    """The points (count, 3) of `even_points`, and the unit normals (count, 3) of their triangles.

    Equal steps through the running sum of areas choose the triangles, an additive recurrence (the plastic number's,
    Roberts 2018) the place in each.
    """
    crosses = _crosses(mesh)
    doubled = np.linalg.norm(crosses, axis=1)
    cumulative = np.cumsum(doubled)
    steps = np.arange(count) + 0.5
    face = np.minimum(np.searchsorted(cumulative, steps / count * cumulative[-1]), len(mesh.faces) - 1)
    uv = (steps[:, None] * np.array([0.7548776662466927, 0.5698402909980532])) % 1.0
    return _within(mesh.vertices[mesh.faces[face]], uv), crosses[face] / doubled[face, None]


def area(mesh: Mesh) -> float:
    """Square metres of a mesh's surface."""
    return float(np.linalg.norm(_crosses(mesh), axis=1).sum() / 2)


@dataclass(frozen=True)
class Surface:
    """Meshes made ready to draw points from, triangle by triangle.

    corners : (F, 3, 3) metres; normals : (F, 3) outward, unit length; areas : (F,) square metres
    mesh : (F,) number of the mesh that each is of
    """

    corners: Array
    normals: Array
    areas: Array
    mesh: NDArray[np.int64]

    @cached_property
    def area_up_to(self) -> Array:
        """(F,) the share of all areas that each triangle and those before it have."""
        up_to = np.cumsum(self.areas)
        return up_to / up_to[-1:]


def surface(meshes: Sequence[Mesh]) -> Surface:
    """The surface of meshes, each in its own frame."""
    cross = np.concatenate([_crosses(mesh) for mesh in meshes])
    length = np.linalg.norm(cross, axis=1)
    return Surface(
        np.concatenate([mesh.vertices[mesh.faces] for mesh in meshes]),
        # a face without area has no normal, and is never drawn
        cross / np.where(length > 0, length, 1.0)[:, None],
        length / 2,
        np.repeat(np.arange(len(meshes)), [len(mesh.faces) for mesh in meshes]),
    )


def drawn_points(rng: np.random.Generator, of: Surface, count: int) -> tuple[Array, Array, NDArray[np.int64]]:
    """Points and outward normals (count, 3), uniform over the surface, and the number of the mesh (count,) that each is
    on."""
    face = np.searchsorted(of.area_up_to, rng.random(count), side="right")
    return _within(of.corners[face], rng.random((count, 2))), of.normals[face], of.mesh[face]


def _crosses(mesh: Mesh) -> Array:
    """(F, 3) outward normals, twice as long as the triangles are large."""
    corners = mesh.vertices[mesh.faces]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _within(corners: Array, uv: Array) -> Array:
    """The place (n, 3) in each triangle (n, 3, 3) that two numbers `uv` (n, 2) between 0 and 1 name."""
    uv = np.where(uv.sum(axis=1, keepdims=True) > 1.0, 1.0 - uv, uv)
    a, b, c = np.moveaxis(corners, 1, 0)
    return a + uv[:, :1] * (b - a) + uv[:, 1:] * (c - a)
