"""Where do the floor and the walls lie? Large planes at the boundary of a scene, found rather than given.

A support plane is told from an object's own flat front by three things that hold for floors and walls only: next to
nothing of the scan lies behind it, it is large, and it goes on where the object has ended (outside the region of
interest, and out of the picture). A table top has the floor behind it; it counts where the region is given and what
the region holds stands on it.

Every hypothesis is one measured point with its normal, taken at even steps through the scan, so the search is
deterministic without a random draw.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry.poses import Array

MOST_PLANES = 4
# Hypotheses tried for each plane, points each is judged by, and hypotheses judged at once.
HYPOTHESES, JUDGES = 200, 2000
AT_ONCE = 20
# Share of the scan that may lie behind a floor or wall: reflections, sensor noise.
BEHIND = 0.03
# Share of all points, and length and breadth in metres, that a support plane has at least.
LEAST_SHARE = 0.03
LEAST_LENGTH, LEAST_BREADTH = 0.6, 0.1
# Share of its points that lie outside the region of interest, and of the picture's border that shows it.
LEAST_OUTSIDE = 0.3
LEAST_BORDER = 0.04
# Oriented points that a plane is fitted to at least, and share of the scan that is left to be the object.
FEWEST = 20
LEAST_OBJECT = 0.05
# How far a surface's normal may turn from its plane's (cosine of 25 degrees).
ALIGNED = 0.906
# What stands on a table may have this share below it: the table's own edge and legs, noise.
BELOW = 0.1
# A table reaches out of the region less far than the floor does.
LEAST_OUTSIDE_TABLE = 0.15
# Cosine to the vertical of a level plane (15°), and where the vertical is only presumed (60°).
LEVEL, PRESUMED_LEVEL = 0.966, 0.5
# Points this many tolerances from a plane found belong to no further one: the skirts of a noisy wall would be walls.
SKIRT = 3.0


# A plane (4,), and which points (P,) of the scene are on it.
FlatSurface = tuple[Array, NDArray[np.bool_]]


@dataclass(frozen=True)
class ScenePoints:
    """Oriented points of a whole scene, thinned.

    points, normals : (P, 3), world, metres; normals towards the camera that saw them, zero where unknown
    tolerances : (P,) metres, how far a point of a plane may lie from it
    border : (P,) bool, seen at the border of a picture
    inside : (P,) bool, in the region of interest (all False where there is none)
    has_roi : whether a region of interest was given
    """

    points: Array
    normals: Array
    tolerances: Array
    border: NDArray[np.bool_]
    inside: NDArray[np.bool_]
    has_roi: bool


def find_support_planes(scene: ScenePoints, flat: Sequence[FlatSurface], up: Array, *, up_is_known: bool) -> Array:
    """Support planes (K, 4) among the `flat_surfaces` of `scene`, K at most 4, n·x + d = 0 in world, n towards the
    cameras, largest first.

    up : (3,) unit vector, world, away from the ground; up_is_known : False where it is only the picture's upward
        direction, from which the vertical may lean by up to 60°
    """
    planes = large_planes(scene, flat, up, up_is_known=up_is_known)
    return planes if scene.has_roi else leave_an_object(scene, planes, up, up_is_known=up_is_known)


def large_planes(scene: ScenePoints, flat: Sequence[FlatSurface], up: Array, *, up_is_known: bool) -> Array:
    """As `find_support_planes`, with those that may be an object that fills the picture."""
    level = LEVEL if up_is_known else PRESUMED_LEVEL
    planes = [
        plane
        for plane, on_plane in flat
        if _bounds_the_scene(scene, plane, on_plane)
        or _carries_the_object(scene, plane, on_plane, bool(plane[:3] @ up >= level))
    ]
    return np.array(planes[:MOST_PLANES]).reshape(-1, 4)


def flat_surfaces(scene: ScenePoints) -> list[FlatSurface]:
    """The largest planes (4,) of a scene, whatever they are, and which of its points (P,) are on each."""
    free = np.ones(len(scene.points), dtype=bool)
    found: list[FlatSurface] = []
    while len(found) < 3 * MOST_PLANES:
        plane = _largest_plane(scene, free)
        if plane is None:
            break
        distance = np.abs(scene.points @ plane[:3] + plane[3])
        on_plane = distance < scene.tolerances
        if (on_plane & free).sum() < LEAST_SHARE * len(scene.points):
            break
        found.append((plane, on_plane))
        free &= distance >= SKIRT * scene.tolerances
    return found


def leave_an_object(scene: ScenePoints, planes: Array, up: Array, *, up_is_known: bool) -> Array:
    """Without a region, an object that fills the picture would pass for a wall: give up `planes` (K, 4) of
    `large_planes` that are not level, the last found first, until a twentieth of the scan is left to be the object."""
    level = LEVEL if up_is_known else PRESUMED_LEVEL
    on_each = [np.abs(scene.points @ plane[:3] + plane[3]) < scene.tolerances for plane in planes]
    kept = list(range(len(planes)))
    for k in reversed(range(len(planes))):
        taken = np.any([on_each[j] for j in kept], axis=0)
        if taken.mean() > 1 - LEAST_OBJECT and not planes[k, :3] @ up >= level:
            kept.remove(k)
    return planes[kept]


def level_tops(scene: ScenePoints, chosen: NDArray[np.bool_], up: Array) -> list[Array]:
    """Level planes (4,) among the `chosen` points that are as large as a support plane, whatever lies below them: table
    tops, shelves, and the tops of large objects. up : (3,) unit vector, world."""
    left = chosen & (scene.normals @ up > ALIGNED)
    tops: list[Array] = []
    while len(tops) < MOST_PLANES:
        plane = _largest_plane(scene, left)
        if plane is None:
            break
        distance = np.abs(scene.points @ plane[:3] + plane[3])
        on_plane = left & (distance < scene.tolerances)
        if on_plane.sum() < LEAST_SHARE / 2 * len(scene.points):
            break
        if plane[:3] @ up >= LEVEL and _is_large(scene, plane, on_plane, 0.0):
            tops.append(plane)
        left &= distance >= SKIRT * scene.tolerances
    return tops


def _largest_plane(scene: ScenePoints, free: NDArray[np.bool_]) -> Array | None:
    """The plane (4,) with the most points of `free` on it that face its way, refined by least squares; or None."""
    oriented = np.flatnonzero(free & (scene.normals != 0).any(axis=1))
    if len(oriented) < FEWEST:
        return None
    points, normals, tolerances = scene.points[oriented], scene.normals[oriented], scene.tolerances[oriented]
    seeds = np.linspace(0, len(oriented) - 1, min(HYPOTHESES, len(oriented))).astype(int)
    sample = np.linspace(0, len(oriented) - 1, min(JUDGES, len(oriented))).astype(int)
    # Single precision is plenty to rank hypotheses by.
    n = normals[seeds].astype(np.float32)
    d = -np.einsum("hk,hk->h", n, points[seeds].astype(np.float32))
    # A single normal is off by a few degrees, so a hypothesis is judged with three times the tolerance.
    reach = (3 * tolerances[sample]).astype(np.float32)
    best = int(_votes(n, d, points[sample], normals[sample], reach).argmax())
    plane = np.append(n[best], d[best]).astype(np.float64)
    for width in (3.0, 2.0, 1.0, 1.0):
        distance = np.abs(points @ plane[:3] + plane[3])
        chosen = np.flatnonzero((distance < width * tolerances) & (normals @ plane[:3] > ALIGNED))
        if len(chosen) < FEWEST:
            return None
        plane = _fit(points[chosen], tolerances[chosen], plane[:3])
    return plane


def _votes(
    n: NDArray[np.float32], d: NDArray[np.float32], points: Array, normals: Array, reach: NDArray[np.float32]
) -> NDArray[np.int64]:
    """(H,): how many of the oriented `points` (P, 3) are within `reach` (P,), metres, of each plane `n` (H, 3), `d`
    (H,) and face its way: of a few planes at a time, whose numbers stay in the processor's cache."""
    places, ways = (columns.T.astype(np.float32, order="C") for columns in (points, normals))
    votes = np.empty(len(n), dtype=np.int64)
    for begin in range(0, len(n), AT_ONCE):
        some = slice(begin, begin + AT_ONCE)
        close = np.abs(_dot_products(n[some], places) + d[some, None]) < reach
        votes[some] = np.count_nonzero(close & (_dot_products(n[some], ways) > ALIGNED), axis=1)
    return votes


def _dot_products(a: NDArray[np.float32], b: NDArray[np.float32]) -> NDArray[np.float32]:
    """(A, B): of each of `a` (A, 3) with each column of `b` (3, B). Written out: for three columns a call of the matrix
    product, which wakes all its threads, takes longer than the work."""
    return a[:, :1] * b[0] + a[:, 1:2] * b[1] + a[:, 2:] * b[2]


def _fit(points: Array, tolerances: Array, towards: Array) -> Array:
    """Least-squares plane (4,) of `points` (P, 3), weighted by 1 / `tolerances`², its normal on the side `towards`."""
    weights = 1.0 / tolerances**2
    weights /= weights.sum()
    # einsum adds in one order whatever the number of threads, so that planes repeat bit for bit.
    centre = np.einsum("p,pk->k", weights, points)
    offset = points - centre
    _, vectors = np.linalg.eigh(np.einsum("p,pj,pk->jk", weights, offset, offset, optimize=False))
    n = vectors[:, 0] * np.sign(vectors[:, 0] @ towards or 1.0)
    return np.append(n, -n @ centre)


def _bounds_the_scene(scene: ScenePoints, plane: Array, on_plane: NDArray[np.bool_]) -> bool:
    behind = scene.points @ plane[:3] + plane[3] < -2.5 * scene.tolerances
    if behind.mean() > BEHIND:
        return False
    if scene.border[on_plane].sum() < LEAST_BORDER * scene.border.sum():
        return False
    return _is_large(scene, plane, on_plane, LEAST_OUTSIDE)


def _carries_the_object(scene: ScenePoints, plane: Array, on_plane: NDArray[np.bool_], level: bool) -> bool:
    """Whether `plane` is a level top, reaching out of the region, that the region's content stands on."""
    if not scene.has_roi or not level:
        return False
    content = scene.inside & ~on_plane
    below = scene.points[content] @ plane[:3] + plane[3] < 0
    if len(below) < FEWEST or below.mean() > BELOW:
        return False
    return _is_large(scene, plane, on_plane, LEAST_OUTSIDE_TABLE)


def _is_large(scene: ScenePoints, plane: Array, on_plane: NDArray[np.bool_], least_outside: float) -> bool:
    points = scene.points[on_plane]
    if scene.has_roi and (~scene.inside[on_plane]).mean() < least_outside:
        return False
    first = np.cross(plane[:3], np.eye(3)[np.abs(plane[:3]).argmin()])
    first /= np.linalg.norm(first)
    coordinates = points @ np.stack([first, np.cross(plane[:3], first)], axis=1)
    _, axes = np.linalg.eigh(np.cov(coordinates.T))
    low, high = np.quantile(coordinates @ axes, [0.02, 0.98], axis=0)
    breadth, length = np.sort(high - low)
    return bool(length >= LEAST_LENGTH and breadth >= LEAST_BREADTH)
