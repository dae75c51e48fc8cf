"""Points on a mesh's surface: spread evenly, the same ones each time, or drawn at random with their normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry.poses import Array
from pmpnbp.scene.articulated_object import Mesh


def even_points(mesh: Mesh, count: int) -> Array:
    """(count, 3) points spread evenly over the surface by area, the same ones each time.

    Equal steps through the running sum of areas choose the triangles, an additive recurrence (the plastic number's,
    Roberts 2018) the place in each.
    """
    cumulative = np.cumsum(np.linalg.norm(_crosses(mesh), axis=1))
    steps = np.arange(count) + 0.5
    face = np.minimum(np.searchsorted(cumulative, steps / count * cumulative[-1]), len(mesh.faces) - 1)
    return _within(mesh, face, (steps[:, None] * np.array([0.7548776662466927, 0.5698402909980532])) % 1.0)


@dataclass(frozen=True)
class Surface:
    """A mesh made ready to draw points from. normals : (F, 3) outward, unit length; areas : (F,) square metres"""

    mesh: Mesh
    normals: Array
    areas: Array

    @property
    def area(self) -> float:
        """Square metres."""
        return float(self.areas.sum())


def surface(mesh: Mesh) -> Surface:
    """The surface of a mesh."""
    cross = _crosses(mesh)
    length = np.linalg.norm(cross, axis=1)
    # a face without area has no normal, and is never drawn
    return Surface(mesh, cross / np.where(length > 0, length, 1.0)[:, None], length / 2)


def drawn_points(rng: np.random.Generator, of: Surface, count: int) -> tuple[Array, Array]:
    """Points and outward normals (count, 3), uniform over the surface."""
    face = rng.choice(len(of.areas), size=count, p=of.areas / of.areas.sum())
    return _within(of.mesh, face, rng.random((2, count, 1))[..., 0].T), of.normals[face]


def _crosses(mesh: Mesh) -> Array:
    """(F, 3) outward normals, twice as long as the triangles are large."""
    corners = mesh.vertices[mesh.faces]
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def _within(mesh: Mesh, face: NDArray[np.integer], uv: Array) -> Array:
    """The place (n, 3) in each triangle `face` (n,) that two numbers `uv` (n, 2) between 0 and 1 name."""
    uv = np.where(uv.sum(axis=1, keepdims=True) > 1.0, 1.0 - uv, uv)
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces[face]], 1, 0)
    return a + uv[:, :1] * (b - a) + uv[:, 1:] * (c - a)
