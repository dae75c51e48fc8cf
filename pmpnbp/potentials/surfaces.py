"""What the potentials need of a part's shape: its triangles, and its visible surface as points per view direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry.poses import Array
from pmpnbp.potentials.kernels import splat_models
from pmpnbp.scene.articulated_object import ArticulatedObject


@dataclass(frozen=True)
class Surfaces:
    """The surfaces of N parts, in the parts' own frames, metres.

    points : (N, D, 3, P) float32, per view direction P points of the surface that is visible along it, uniform over
        its projected area and in random order, so that the first few are a smaller sample of the same kind
    areas : (N, D) float32, projected visible area, m²; zero for a part without geometry
    centres : (N, 3) middle of each part's bounding box; radii : (N,) half its diagonal
    vertices : (3, V) float32, all parts' vertices; vertex_offsets : (N + 1,) where each part's begin
    faces : (3, F) int32, counted from the part's first vertex; face_offsets : (N + 1,)
    one_sided : (F,) int32, 1 for faces of a closed surface, which turn their outward side to whoever sees them
    """

    points: NDArray[np.float32]
    areas: NDArray[np.float32]
    centres: Array
    radii: Array
    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    one_sided: NDArray[np.int32]
    vertex_offsets: NDArray[np.int64]
    face_offsets: NDArray[np.int64]

    @property
    def mesh(self) -> tuple[NDArray[np.generic], ...]:
        """The triangles as the rasteriser's kernels take them."""
        return (
            self.vertices, self.faces, self.one_sided, self.vertex_offsets, self.face_offsets, self.centres, self.radii
        )  # fmt: skip


def prepare_surfaces(
    model: ArticulatedObject, *, directions: int = 256, points: int = 256, rng: np.random.Generator | None = None
) -> Surfaces:
    """The surfaces of a model's parts, from their inference meshes.

    directions : a square number, cells of an octahedral grid over the sphere; points : per direction
    rng : orders the points; a fixed generator by default, so that a model's surfaces are always the same
    """
    size = int(round(directions**0.5))
    if size * size != directions:
        raise ValueError(f"directions is {directions}; a square number is expected, as 256")
    generator = np.random.default_rng(0) if rng is None else rng
    count = len(model.parts)
    meshes = [part.inference_mesh for part in model.parts]
    vertices = [np.asarray(mesh.vertices, dtype=np.float32).reshape(-1, 3) for mesh in meshes]
    faces = [np.asarray(mesh.faces, dtype=np.int32).reshape(-1, 3) for mesh in meshes]
    centres, radii = np.zeros((count, 3)), np.zeros(count)
    clouds = np.zeros((count, directions, 3, points), dtype=np.float32)
    areas = np.zeros((count, directions), dtype=np.float32)
    for node in range(count):
        if len(faces[node]) == 0:
            vertices[node] = vertices[node][:0]
            continue
        lower, upper = vertices[node].min(axis=0), vertices[node].max(axis=0)
        centres[node], radii[node] = (lower + upper) / 2.0, np.linalg.norm(upper - lower) / 2.0
        order = np.argsort(generator.random((directions, points)), axis=1).astype(np.int32)
        splat_models.sample_directions(
            np.ascontiguousarray(vertices[node].T), np.ascontiguousarray(faces[node].T), size, order,
            clouds[node], areas[node],
        )  # fmt: skip
    return Surfaces(
        points=clouds,
        areas=areas,
        centres=centres,
        radii=radii,
        vertices=np.ascontiguousarray(np.concatenate(vertices).T),
        faces=np.ascontiguousarray(np.concatenate(faces).T),
        one_sided=np.zeros(sum(len(face) for face in faces), dtype=np.int32),
        vertex_offsets=np.concatenate([[0], np.cumsum([len(v) for v in vertices])]).astype(np.int64),
        face_offsets=np.concatenate([[0], np.cumsum([len(f) for f in faces])]).astype(np.int64),
    )
