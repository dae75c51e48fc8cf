"""How few triangles will do for inference, and how far from the surface are they then?

Quadric edge collapse (Garland and Heckbert 1997) by fast_simplification. The deviation is measured, not promised: the
largest distance between the two surfaces, both ways, from points spread evenly over each.
"""

from __future__ import annotations

import fast_simplification
import numpy as np
import open3d

from pmpnbp.geometry.poses import Array
from pmpnbp.scene.articulated_object import Mesh
from pmpnbp.scene.meshes import joined, welded

SAMPLES = 4000


def decimate(mesh: Mesh, budget: int) -> Mesh:
    """The mesh with at most `budget` triangles or so: collapsing stops where a further step would tear the surface.

    A mesh within the budget is returned as it is. Orientation of faces is kept. Deterministic.
    """
    whole = welded(mesh)
    if len(whole.faces) <= budget:
        return mesh
    vertices, faces = fast_simplification.simplify(
        np.ascontiguousarray(whole.vertices, dtype=np.float64),
        np.ascontiguousarray(whole.faces, dtype=np.int32),
        target_count=budget,
    )[:2]
    return welded(Mesh(np.asarray(vertices, dtype=np.float64), np.asarray(faces, dtype=np.int32)))


def reduced(exact: list[Mesh], scanned: list[Mesh], budget: int) -> tuple[Mesh, Mesh, float]:
    """A part's whole mesh, its inference mesh and the deviation between them, metres.

    `exact` are primitives, which are kept as they are where they fit into half of the budget; `scanned` are meshes
    from files, which share what is left of it.
    """
    mesh = joined([*exact, *scanned])
    primitives, files = joined(exact), joined(scanned)
    if len(mesh.faces) <= budget:
        return mesh, mesh, 0.0
    if len(primitives.faces) <= budget // 2 or not scanned and len(primitives.faces) <= budget:
        small = joined([primitives, decimate(files, budget - len(primitives.faces))])
    else:
        small = decimate(mesh, budget)
    return mesh, small, deviation(mesh, small)


def deviation(a: Mesh, b: Mesh) -> float:
    """The largest distance, metres, from the surface of `a` to that of `b` and back (the Hausdorff distance, sampled)."""
    if len(a.faces) == 0 or len(b.faces) == 0:
        return 0.0
    return max(_furthest(a, b), _furthest(b, a))


def surface_points(mesh: Mesh, count: int) -> Array:
    """(count, 3) points spread evenly over the surface by area, the same ones each time.

    Equal steps through the running sum of areas choose the triangles, an additive recurrence (the plastic number's,
    Roberts 2018) the place in each.
    """
    corners = mesh.vertices[mesh.faces]
    edges = corners[:, 1:] - corners[:, :1]
    area = np.cumsum(np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=-1))
    steps = np.arange(count) + 0.5
    chosen = np.minimum(np.searchsorted(area, steps / count * area[-1]), len(corners) - 1)
    uv = (steps[:, None] * np.array([0.7548776662466927, 0.5698402909980532])) % 1.0
    uv = np.where(uv.sum(axis=1, keepdims=True) > 1.0, 1.0 - uv, uv)
    return corners[chosen, 0] + np.einsum("nk,nkd->nd", uv, edges[chosen])


def _furthest(source: Mesh, target: Mesh) -> float:
    # Corners first: between flat faces they are where the distance is largest.
    stride = max(1, len(source.vertices) // SAMPLES)
    points = np.concatenate([source.vertices[::stride], surface_points(source, SAMPLES)])
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(target.vertices.astype(np.float32), target.faces.astype(np.uint32))
    return float(scene.compute_distance(points.astype(np.float32)).numpy().max())
