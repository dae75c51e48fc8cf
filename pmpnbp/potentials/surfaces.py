"""What the potentials need of a part's shape: its triangles, and its visible surface as points per view direction."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from threading import Lock

import numpy as np
from cachetools import LRUCache, cached
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from pmpnbp.geometry.poses import Array
from pmpnbp.potentials.kernels import splat_models
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.meshes import KEPT, content
from pmpnbp.scene.sizes import axes_at_zero


@dataclass(frozen=True)
class Surfaces:
    """The surfaces of N parts, in the parts' own frames, metres.

    points : (N, D, 3, P) float32, per view direction P points of the surface that is visible along it, uniform over
        its projected area and in random order, so that the first few are a smaller sample of the same kind
    areas : (N, D) float32, projected visible area, m²; zero for a part without geometry
    centres : (N, 3) middle of each part's bounding box
    axes_at_zero : (N, 3, 3) of each part, rotation matrix from its frame to the root part's with all joints at zero
    vertices : (3, V) float32, all parts' vertices; vertex_offsets : (N + 1,) where each part's begin
    faces : (3, F) int32, counted from the part's first vertex; face_offsets : (N + 1,)
    one_sided : (F,) int32, 1 for faces of a closed surface, which turn their outward side to whoever sees them
    """

    points: NDArray[np.float32]
    areas: NDArray[np.float32]
    centres: Array
    axes_at_zero: Array
    vertices: NDArray[np.float32]
    faces: NDArray[np.int32]
    one_sided: NDArray[np.int32]
    vertex_offsets: NDArray[np.int64]
    face_offsets: NDArray[np.int64]

    @property
    def mesh(self) -> tuple[NDArray[np.generic], ...]:
        """The triangles as the rasteriser's kernels take them."""
        return self.vertices, self.faces, self.one_sided, self.vertex_offsets, self.face_offsets

    @property
    def splats(self) -> tuple[NDArray[np.float32], NDArray[np.float32], Array]:
        """Points, areas and centres as the splatting kernel takes them."""
        return self.points, self.areas, self.centres

    def without(self, parts: Sequence[int]) -> Surfaces:
        """The same, some parts having no surface that could be seen."""
        gone = np.isin(np.arange(len(self.centres)), parts)
        (vertices, corners), (faces, triangles) = (
            (np.repeat(~gone, counts), np.concatenate([[0], np.cumsum(np.where(gone, 0, counts))]))
            for counts in (np.diff(self.vertex_offsets), np.diff(self.face_offsets))
        )
        return replace(
            self,
            areas=np.where(gone[:, None], np.float32(0.0), self.areas),
            vertices=np.ascontiguousarray(self.vertices[:, vertices]),
            faces=np.ascontiguousarray(self.faces[:, faces]),
            one_sided=self.one_sided[faces],
            vertex_offsets=corners,
            face_offsets=triangles,
        )


def _content(model: ArticulatedObject, *, directions: int = 256, points: int = 256) -> bytes:
    return content([part.inference_mesh for part in model.parts], directions, points) + axes_at_zero(model).tobytes()


def _bytes(made: Surfaces) -> int:
    return sum(array.nbytes for array in vars(made).values())


@cached(LRUCache(maxsize=KEPT, getsizeof=_bytes), key=_content, lock=Lock())
def prepare_surfaces(model: ArticulatedObject, *, directions: int = 256, points: int = 256) -> Surfaces:
    """The surfaces of a model's parts, from their inference meshes; a model's are always the same.

    directions : a square number, cells of an octahedral grid over the sphere; points : per direction
    """
    size = round(directions**0.5)
    if size * size != directions:
        raise ValueError(f"directions is {directions}; a square number is expected, as 256")
    rng = np.random.default_rng(0)  # orders the points
    count = len(model.parts)
    meshes = [part.inference_mesh for part in model.parts]
    vertices = [np.asarray(mesh.vertices, dtype=np.float32).reshape(-1, 3) for mesh in meshes]
    faces = [np.asarray(mesh.faces, dtype=np.int32).reshape(-1, 3) for mesh in meshes]
    one_sided = [np.zeros(len(face), dtype=np.int32) for face in faces]
    centres = np.zeros((count, 3))
    clouds = np.zeros((count, directions, 3, points), dtype=np.float32)
    areas = np.zeros((count, directions), dtype=np.float32)
    for node in range(count):
        if len(faces[node]) == 0:
            vertices[node] = vertices[node][:0]
            continue
        lower, upper = vertices[node].min(axis=0), vertices[node].max(axis=0)
        centres[node] = (lower + upper) / 2.0
        faces[node], one_sided[node] = _outward(vertices[node], faces[node])
        order = np.argsort(rng.random((directions, points)), axis=1).astype(np.int32)
        jitter = rng.random((directions, points))
        columns = np.ascontiguousarray(vertices[node].T), np.ascontiguousarray(faces[node].T)
        splat_models.sample_directions(*columns, size, order, jitter, clouds[node], areas[node])
    return Surfaces(
        points=clouds,
        areas=areas,
        centres=centres,
        axes_at_zero=axes_at_zero(model),
        vertices=np.ascontiguousarray(np.concatenate(vertices).T),
        faces=np.ascontiguousarray(np.concatenate(faces).T),
        one_sided=np.concatenate(one_sided),
        vertex_offsets=np.concatenate([[0], np.cumsum([len(v) for v in vertices])]).astype(np.int64),
        face_offsets=np.concatenate([[0], np.cumsum([len(f) for f in faces])]).astype(np.int64),
    )


def _outward(vertices: NDArray[np.float32], faces: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Faces (F, 3) with those of closed pieces turned outward, and (F,) 1 for these, 0 for the rest.

    A piece is closed where each of its edges belongs to two faces that run along it in opposite ways, vertices at the
    same place being the same and faces without area left aside; it faces outward where the volume it encloses is
    positive.
    """
    _, same = np.unique(vertices, axis=0, return_inverse=True)
    welded = same.reshape(-1)[faces].astype(np.int64)
    count = int(welded.max()) + 1
    first, second = welded, np.roll(welded, -1, axis=1)
    flat = np.any(first == second, axis=1)
    there, back = first * count + second, second * count + first
    directed, occurrences = np.unique(there[~flat], return_counts=True)
    paired = np.isin(there, directed[occurrences == 1]) & np.isin(back, directed[occurrences == 1])
    links = coo_array((np.ones(first.size), (first.ravel(), second.ravel())), shape=(count, count))
    pieces, piece_of_vertex = connected_components(links, directed=False)
    piece = piece_of_vertex[welded[:, 0]]
    a, b, c = (vertices[faces[:, k]].astype(np.float64) - vertices[faces[0, 0]] for k in range(3))
    volume = np.bincount(piece, np.einsum("fi,fi->f", a, np.cross(b, c)), minlength=pieces)
    closed = np.bincount(piece, ~(paired.all(axis=1) | flat), minlength=pieces) == 0
    turned = np.where((closed & (volume < 0))[piece][:, None], faces[:, ::-1], faces)
    return turned.astype(np.int32), (closed & (volume != 0))[piece].astype(np.int32)
