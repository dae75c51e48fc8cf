"""How few triangles will do for inference, and how far from the surface are they then?

What no ray from outside reaches (motors and screws inside a housing) is left out first: no depth sensor sees it, and
it took up to two thirds of a robot part's triangles. The rest is reduced by quadric edge collapse (Garland and Heckbert
1997). Of the two programs at hand Open3D's was taken: on the Fetch robot and the xArm, at 500 triangles a part,
fast_simplification missed the budget on several and strayed up to 168 mm; Open3D's keeps the budget. But its corners
lie on the surface or within it, so that a round shape becomes smaller and is found nearer to the camera than it is: the
Fetch's base by 3 mm. Corners are therefore moved until the faces lie about the surface, as far before it as behind.
The deviation is measured, not promised: the largest distance between the two surfaces, both ways, from points spread
evenly over each.
"""

from __future__ import annotations

from threading import Lock
from typing import TYPE_CHECKING

import numpy as np
from cachetools import LRUCache, cached
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from pmpnbp.scene.articulated_object import Mesh
from pmpnbp.scene.meshes import KEPT, content, joined, welded
from pmpnbp.scene.surface_points import even_oriented_points, even_points

if TYPE_CHECKING:
    import open3d

SAMPLES = 4000
VIEW_DIRECTIONS = 64
# Corners of a reduced mesh are fitted to so many points of the surface for each, so many times; a corner is held where
# it is by a share of what its points pull. A point belongs to the nearest face, where that looks the same way (cosine).
POINTS_EACH, FITS, HELD, FACING = 16, 4, 0.05, 0.3


def _content(exact: list[Mesh], scanned: list[Mesh], budget: int) -> bytes:
    return content([*exact, *scanned], len(exact), budget)


def _bytes(found: tuple[Mesh, Mesh, float]) -> int:
    return sum(mesh.vertices.nbytes + mesh.faces.nbytes for mesh in found[:2])


@cached(LRUCache(maxsize=KEPT, getsizeof=_bytes), key=_content, lock=Lock())
def reduced(exact: list[Mesh], scanned: list[Mesh], budget: int) -> tuple[Mesh, Mesh, float]:
    """A part's whole mesh, its inference mesh and the deviation of the latter, metres.

    `exact` are primitives, which are kept as they are where they fit into half of the budget (all of it where there is
    nothing else); `scanned` are meshes from files, which share what is left of it.
    """
    mesh = joined([*exact, *scanned])
    if len(mesh.faces) <= budget:
        return mesh, mesh, 0.0
    kept = sum(len(piece.faces) for piece in exact)
    if kept > budget // 2:
        exact, scanned, kept = [], [mesh], 0
    outside = seen_from_outside(joined(scanned))
    small = decimate(outside, budget - kept)
    return mesh, joined([*exact, small]), deviation(outside, small)


def decimate(mesh: Mesh, budget: int) -> Mesh:
    """The mesh with about `budget` triangles at most; as it is where it has no more than that already.

    Equal vertices are made one first. Orientation of faces is kept. Deterministic.
    """
    whole = welded(mesh)
    if len(whole.faces) <= budget:
        return whole
    import open3d  # here, as it takes over a second to import

    shape = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(whole.vertices), open3d.utility.Vector3iVector(whole.faces)
    )
    shape = shape.simplify_quadric_decimation(budget)
    vertices, faces = np.asarray(shape.vertices, dtype=np.float64), np.asarray(shape.triangles, dtype=np.int32)
    return _fitted(welded(Mesh(vertices.copy(), faces.copy())), whole)


def _fitted(small: Mesh, whole: Mesh) -> Mesh:
    """`small` with its corners where the squared distances of `whole`'s surface to its faces are least, each point of
    that surface tied to the place on a face that is nearest to it (Hoppe et al. 1993, "Mesh optimization", whose
    triangles stay what they are)."""
    if len(small.faces) == 0:
        return small
    points, normals = even_oriented_points(whole, max(SAMPLES, POINTS_EACH * len(small.vertices)))
    for _ in range(FITS):
        closest = _ray_caster(small).compute_closest_points(points.astype(np.float32))
        face = closest["primitive_ids"].numpy()
        same_way = np.einsum("pk,pk->p", closest["primitive_normals"].numpy(), normals) > FACING
        if not same_way.any():
            return small
        u, v = closest["primitive_uvs"].numpy()[same_way].astype(np.float64).T
        shares, count = np.stack([1 - u - v, u, v], axis=1), int(same_way.sum())
        places = (np.repeat(np.arange(count), 3), small.faces[face[same_way]].ravel())
        of_corners = sparse.csr_matrix((shares.ravel(), places), shape=(count, len(small.vertices)))
        held = HELD * count / len(small.vertices)
        pulls = sparse.csc_matrix(of_corners.T @ of_corners + held * sparse.identity(len(small.vertices)))
        small = Mesh(splu(pulls).solve(of_corners.T @ points[same_way] + held * small.vertices), small.faces)
    return small


def seen_from_outside(mesh: Mesh) -> Mesh:
    """The triangles, from whichever side, whose middle is seen from one of 64 directions, and their neighbours.

    Neighbours (by a common vertex) stand in for triangles that are seen in part, but not in the middle.
    """
    whole = welded(mesh)
    if len(whole.faces) == 0:
        return whole
    scene = _ray_caster(whole)
    middles = whole.vertices[whole.faces].mean(axis=1)
    clear = 1e-4 * float(np.ptp(whole.vertices, axis=0).max())  # to leave the triangle itself behind
    hidden = np.arange(len(middles))
    for direction in _directions(VIEW_DIRECTIONS):
        origins = middles[hidden] + clear * direction
        rays = np.concatenate([origins, np.broadcast_to(direction, origins.shape)], axis=1).astype(np.float32)
        hidden = hidden[scene.test_occlusions(rays).numpy()]
        if len(hidden) == 0:
            return whole
    seen = np.ones(len(middles), dtype=np.bool_)
    seen[hidden] = False
    if not seen.any():
        return whole
    touched = np.zeros(len(whole.vertices), dtype=np.bool_)
    touched[whole.faces[seen]] = True
    return welded(Mesh(whole.vertices, whole.faces[touched[whole.faces].any(axis=1)]))


def deviation(a: Mesh, b: Mesh) -> float:
    """The largest distance, metres, from the surface of `a` to that of `b` and back (the Hausdorff distance, sampled).

    0 where either has no triangle.
    """
    if len(a.faces) == 0 or len(b.faces) == 0:
        return 0.0
    return max(_furthest(a, b), _furthest(b, a))


def _furthest(source: Mesh, target: Mesh) -> float:
    # Corners first: between flat faces they are where the distance is largest.
    stride = -(-len(source.vertices) // SAMPLES)
    points = np.concatenate([source.vertices[::stride], even_points(source, SAMPLES)])
    return float(_ray_caster(target).compute_distance(points.astype(np.float32)).numpy().max())


def _ray_caster(mesh: Mesh) -> open3d.t.geometry.RaycastingScene:
    import open3d

    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32))
    return scene


def _directions(count: int) -> NDArray[np.float64]:
    """(count, 3) unit vectors spread evenly over the sphere (a Fibonacci lattice)."""
    steps = np.arange(count) + 0.5
    z = 1.0 - 2.0 * steps / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * steps
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1)
