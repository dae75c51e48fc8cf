"""What stands in a scan, apart from floor, walls and tables? Boxes that may be an object's region of interest.

What is left of a thinned scan without its support planes falls into clusters of near neighbours. A table is not told
from a wide low object by its looks, so both are tried: the clusters with what carries them, and those without the level
tops. One thing may be several clusters, as an open drawer hides what joins it to its chest; where the model is known,
neighbours are put together as long as that makes them more like the model in one of its joint configurations.

Nothing here is certain: the boxes are proposals that a person chooses from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.observe import common_frame, has_pose, presumed_up, scene_points, up_direction
from pmpnbp.scene.region import Region
from pmpnbp.scene.sizes_over_joints import reaches, sides, sides_over_joints, united
from pmpnbp.scene.support_planes import ScenePoints, find_support_planes, level_tops

MOST_REGIONS = 6
# Metres that a box is larger than its points on every side. The planes' tolerances, the sensor's noise and gaps in what
# is seen take the lowest and the outermost of a thing's points away; a joint need not have room to move, as the region
# is only to hold what was measured.
MARGIN = 0.1
# Metres: of the points in one such cube one is taken.
GRAIN = 0.012
# Metres between neighbours of one cluster, and in tolerances of a plane, which grow with the distance; at most so many.
LINK, LINK_TOLERANCES, MOST_LINK = 0.02, 2.0, 0.08
# Points of a cluster at least, and metres that it is long.
FEWEST, LEAST_LENGTH = 15, 0.05
# Clusters that are put together with others, largest first, and metres between them at most.
MOST_CLUSTERS, GAP = 40, 0.4
# Metres between those that touch; what does not has to make it as much more like the model.
TOUCHING, GAIN = 0.06, 0.02
# How much worse it is for a thing to be larger than the model by some factor than smaller: what is hidden is missing
# from every thing, height the least, as the ground that it stands on is seen.
TOO_LARGE = 3.0
TOO_SMALL = np.array([1.0, 0.7, 0.3])
# Logarithm of the factor by which a side may be wrong before that says anything.
FREE = 0.1
# As much as a factor that a thing costs which is like the model only in another orientation than upright.
NOT_UPRIGHT = 0.3
# Of two proposals that share more than this of the points of either the better one stays.
SHARED = 0.5
# A thing so unlike the model is not proposed beside more likely ones.
UNLIKELY = 1.5


def propose_regions(scans: Sequence[Scan], model: ArticulatedObject | None = None) -> list[Region]:
    """The things that stand in one scene seen in `scans`, at most MOST_REGIONS, those that are likest `model` first,
    else those with the most points; none where nothing stands out. The same input gives the same regions.

    Raises ScanError where there is no scan, or the scans' world frames differ.
    """
    common_frame(scans)
    scene = _thinned(scene_points(scans))
    planes = find_support_planes(scene, presumed_up(scans, None), up_is_known=has_pose(scans))
    up = up_direction(scans, planes, None)
    free = np.ones(len(scene.points), dtype=bool)
    for plane in planes:
        distance = scene.points @ plane[:3] + plane[3]
        free &= (distance > scene.tolerances) | (distance < -3 * scene.tolerances)
    upright = _upright(scene.points, up)
    on_top = np.zeros(len(free), dtype=bool)
    for top in level_tops(scene, free, up):
        on_top |= np.abs(scene.points @ top[:3] + top[3]) < 1.5 * scene.tolerances
    things = _clusters(upright, scene.tolerances, free & ~on_top)
    if model is None:
        likeness = None
        groups = {frozenset(thing.tolist()): 0.0 for thing in things}
    else:
        likeness = sides_over_joints(model)
        groups = {}
        for clusters in (things, _clusters(upright, scene.tolerances, free)) if on_top.any() else (things,):
            groups |= _put_together(upright, clusters, likeness)
    ordered = sorted(groups.items(), key=lambda item: (item[1], -len(item[0]), min(item[0])))
    chosen: list[tuple[NDArray[np.int64], float]] = []
    for members, cost in ordered:
        own = np.array(sorted(members))
        if chosen and cost > chosen[0][1] + UNLIKELY:
            break
        if all(len(np.intersect1d(own, other)) < SHARED * min(len(own), len(other)) for other, _ in chosen):
            chosen.append((own, cost))
    return [_region(scene.points, upright, own, None if model is None else cost) for own, cost in chosen[:MOST_REGIONS]]


def _thinned(scene: ScenePoints) -> ScenePoints:
    """One point of each GRAIN: what is near to the camera has many more than clusters need."""
    _, kept = np.unique(np.floor(scene.points / GRAIN).astype(np.int64), axis=0, return_index=True)
    kept.sort()
    return replace(
        scene,
        points=scene.points[kept],
        normals=scene.normals[kept],
        tolerances=scene.tolerances[kept],
        border=scene.border[kept],
        inside=scene.inside[kept],
    )


def _upright(points: Array, up: Array) -> Array:
    """`points` (P, 3) in a frame whose z axis is `up`."""
    axis = np.cross(up, [0.0, 0.0, 1.0])
    angle = np.arctan2(np.linalg.norm(axis), up[2])
    if np.linalg.norm(axis) < 1e-9:
        axis = np.array([1.0, 0.0, 0.0])
    turn = poses.from_rotation_vector(angle * axis / np.linalg.norm(axis))
    return poses.rotate(turn, points)


def _clusters(points: Array, tolerances: Array, chosen: NDArray[np.bool_]) -> list[NDArray[np.int64]]:
    """Indices of the `chosen` points of each cluster, largest first."""
    own = np.flatnonzero(chosen)
    if len(own) < FEWEST:
        return []
    reach = np.minimum(LINK + LINK_TOLERANCES * tolerances[own], MOST_LINK)
    pairs = cKDTree(points[own]).query_pairs(float(reach.max()), output_type="ndarray")
    apart = np.linalg.norm(points[own[pairs[:, 0]]] - points[own[pairs[:, 1]]], axis=1)
    pairs = pairs[apart < reach[pairs].max(axis=1)]
    graph = coo_array((np.ones(len(pairs), dtype=bool), (pairs[:, 0], pairs[:, 1])), shape=(len(own), len(own)))
    _, labels = connected_components(graph, directed=False)
    counts = np.bincount(labels)
    found = [own[labels == number] for number in np.argsort(-counts, kind="stable")[:MOST_CLUSTERS]]
    return [one for one in found if len(one) >= FEWEST and np.ptp(points[one], axis=0).max() >= LEAST_LENGTH]


def _put_together(points: Array, clusters: Sequence[NDArray[np.int64]], likeness: Array) -> dict[frozenset[int], float]:
    """Each cluster, and the neighbours that make it more like the model, as sets of points with their unlikeness; a
    neighbour that touches it need only not make it less so."""
    if not clusters:
        return {}
    each = np.stack([reaches(points[one]) for one in clusters])
    boxes = np.stack([[points[one].min(axis=0), points[one].max(axis=0)] for one in clusters])
    found: dict[frozenset[int], float] = {}
    for seed in range(len(clusters)):
        group, reach, box = [seed], each[seed], boxes[seed]
        cost = float(_unlikeness(sides(reach), likeness))
        while True:
            between = np.maximum(0.0, np.maximum(boxes[:, 0] - box[1], box[0] - boxes[:, 1]))
            gaps = np.linalg.norm(between, axis=1)
            gaps[group] = np.inf
            near = np.flatnonzero(gaps < GAP)
            costs = _unlikeness(sides(united(reach, each[near])), likeness)
            costs = costs + np.where(gaps[near] < TOUCHING, 0.0, GAIN)
            if not len(near) or costs.min() > cost:
                break
            best = near[costs.argmin()]
            group, reach = [*group, int(best)], united(reach, each[best])
            box = np.stack([np.minimum(box[0], boxes[best, 0]), np.maximum(box[1], boxes[best, 1])])
            cost = min(cost, float(_unlikeness(sides(reach), likeness)))
        found[frozenset(np.concatenate([clusters[one] for one in group]).tolist())] = cost
    return found


def _unlikeness(own: Array, likeness: Array) -> Array:
    """(...) by how much `sides` (..., 3) are unlike the likest of the model's sides (S, 3)."""
    own = np.maximum(own, 1e-3)[..., None, :]
    upright = _difference(own, likeness).min(axis=-1)
    lying = _difference(-np.sort(-own, axis=-1), -np.sort(-likeness, axis=-1)).min(axis=-1) + NOT_UPRIGHT
    return np.asarray(np.minimum(upright, lying))


def _difference(own: Array, likeness: Array) -> Array:
    factor = np.log(own / np.maximum(likeness, 1e-3))
    wrong = np.maximum(np.abs(factor) - FREE, 0.0)
    return (wrong * np.where(factor > 0, TOO_LARGE, TOO_SMALL)).sum(axis=-1)


def _region(points: Array, upright: Array, own: NDArray[np.int64], unlikeness: float | None) -> Region:
    roi = np.concatenate([points[own].min(axis=0) - MARGIN, points[own].max(axis=0) + MARGIN])
    return Region(roi=roi, size=sides(reaches(upright[own])), points=len(own) / len(points), unlikeness=unlikeness)
