"""What stands in a scan, apart from floor, walls and tables? Boxes that may be an object's region of interest.

What is left of a thinned scan without its support planes falls into clusters of near neighbours. A table is not told
from a wide low object by its looks, so both are tried: the clusters with what carries them, and those without the level
tops. One thing may be several clusters, as an open drawer hides what joins it to its chest; where the model is known,
neighbours are put together as long as that makes them more like the model in one of its joint configurations. Things of
like size are told apart by laying the model on them (`shape_fit`); where that fits, the box holds what is hidden, too.

Nothing here is certain: the boxes are proposals that a person chooses from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.common_scene import common_frame, has_pose
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.observe import presumed_up, scene_points, up_direction
from pmpnbp.scene.region import Region
from pmpnbp.scene.shape_fit import Shapes, best_fit, shapes
from pmpnbp.scene.sizes_over_joints import reaches, sides, sides_over_joints, united
from pmpnbp.scene.support_planes import (
    ALIGNED,
    LEAST_BREADTH,
    ScenePoints,
    flat_surfaces,
    large_planes,
    leave_an_object,
    level_tops,
)
from pmpnbp.scene.support_planes import LEAST_LENGTH as LEAST_LENGTH_OF_TOP

MOST_REGIONS = 6
# Metres that a box is larger than its points on every side. The planes' tolerances, the sensor's noise and gaps in what
# is seen take the lowest and the outermost of a thing's points away; a joint need not have room to move, as the region
# is only to hold what was measured.
MARGIN = 0.1
# Metres above what carries them in which things may touch each other.
FEET = 0.07
# Metres that a box is larger than the fitted model: less than about points, as a wide box takes in other things.
FIT_MARGIN = 0.03
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
# Things that the model is fitted to at most; of two that share more than SAME of the larger's points one will do.
MOST_FITTED, SAME = 16, 0.9
# What a fit's cost counts, beside the logarithms of sizes.
FIT = 0.7
# A fit is good enough to tell where hidden parts are below this.
GOOD = 0.5
# Of two proposals that share more than this of the points of either the better one stays.
SHARED = 0.5
# A thing so unlike the model is not proposed beside more likely ones.
UNLIKELY = 1.5
# Sine of the angle between the camera's axis and the vertical below which the one says nothing across the other.
LEAST_ACROSS = 0.02


@dataclass(frozen=True, kw_only=True)
class _Thing:
    """own : (P,) indices of its points; cost : by how much it is unlike the model; fitted : (F, 3) metres, upright,
    where the model's surface may be, empty without a good fit; on_feet : False where its feet are none of its points"""

    own: NDArray[np.int64]
    cost: float
    fitted: Array
    on_feet: bool


def propose_regions(scans: Sequence[Scan], model: ArticulatedObject | None = None) -> list[Region]:
    """The things that stand in one scene seen in `scans`, at most MOST_REGIONS, those that are likest `model` first,
    else those with the most points; none where nothing stands out. The same input gives the same regions.

    Raises ScanError where there is no scan, or the scans' world frames differ.
    """
    common_frame(scans)
    to_camera = poses.inverse(scans[0].camera.pose_world_camera)
    scene = _thinned(scene_points(scans), to_camera)
    presumed, known = presumed_up(scans, None), has_pose(scans)
    every = large_planes(scene, flat_surfaces(scene), presumed, up_is_known=known)
    planes = leave_an_object(scene, every, presumed, up_is_known=known)
    up = up_direction(scans, planes, None)
    to_upright = _to_upright(up, scans[0].camera.pose_world_camera)
    upright = poses.rotate(to_upright, scene.points)
    free = _off(scene, planes)
    if model is None:
        level, _ = _on_tops(scene, upright, free, up)
        clusters = _clusters(upright, scene.tolerances, free & ~level)
        things = [_Thing(own=np.sort(one), cost=0.0, fitted=np.zeros((0, 3)), on_feet=True) for one in clusters]
    else:
        likeness = sides_over_joints(model)
        groups: dict[frozenset[int], tuple[float, bool]] = {}
        for chosen, on_feet in _segmentations(scene, every, upright, free, up):
            found = _put_together(upright, _clusters(upright, scene.tolerances, chosen), likeness)
            groups = {members: (cost, on_feet) for members, cost in found.items()} | groups
        to_world = poses.quaternion_conjugate(to_upright)
        things = _fitted(upright, groups, likeness, shapes(model), scans, to_world)
    chosen_things: list[_Thing] = []
    for thing in things:
        if thing.cost > things[0].cost + UNLIKELY:
            break
        if all(_shared(thing.own, other.own) < SHARED for other in chosen_things):
            chosen_things.append(thing)
    return [
        _region(scene.points, upright, thing, to_upright, None if model is None else thing.cost)
        for thing in chosen_things[:MOST_REGIONS]
    ]


def _segmentations(
    scene: ScenePoints, every: Array, upright: Array, free: NDArray[np.bool_], up: Array
) -> list[tuple[NDArray[np.bool_], bool]]:
    """The points (P,) that may be of things, told apart in all the ways that may be right, and whether things have
    their feet. A wall behind a slim object is nearly all of the scan, so that what `free` leaves may have walls in it;
    a level top may carry what is looked for, be its own, or be of others at the same height."""
    found: list[tuple[NDArray[np.bool_], bool]] = []
    for rest in (free, _off(scene, every)):
        level, large = _on_tops(scene, upright, rest, up)
        above = rest & _above_feet(scene, rest, every, up)
        for chosen, on_feet in ((rest & ~level, True), (rest & ~large, True), (rest, True), (above, False)):
            if not any(np.array_equal(chosen, other) for other, _ in found):
                found.append((chosen, on_feet))
    return found


def _above_feet(scene: ScenePoints, free: NDArray[np.bool_], planes: Array, up: Array) -> NDArray[np.bool_]:
    """(P,): which points are not just above a floor or a level top: things that touch there stand apart higher up, and
    a box's margin holds their feet all the same."""
    above = np.ones(len(free), dtype=bool)
    for plane in (*planes[planes[:, :3] @ up > ALIGNED], *level_tops(scene, free, up)):
        height = scene.points @ plane[:3] + plane[3]
        above &= (height < -scene.tolerances) | (height > FEET)
    return above


def _fitted(
    upright: Array,
    groups: dict[frozenset[int], tuple[float, bool]],
    likeness: Array,
    model: Shapes,
    scans: Sequence[Scan],
    to_world: Array,
) -> list[_Thing]:
    """The things of the likest sizes with a cost that says how well the model could stand there, best first."""
    ordered = sorted(groups.items(), key=lambda item: (item[1][0], -len(item[0]), min(item[0])))
    tried: list[NDArray[np.int64]] = []
    things: list[_Thing] = []
    likest_cost = np.inf
    for members, (cost, on_feet) in ordered:
        own = np.array(sorted(members))
        if len(tried) == MOST_FITTED or cost > ordered[0][1][0] + UNLIKELY:
            break
        if any(_shared(own, other, of_larger=True) > SAME for other in tried):
            continue
        tried.append(own)
        if cost > likest_cost:  # however well the model fits there, another thing is likelier
            things.append(_Thing(own=own, cost=cost + FIT * GOOD, fitted=np.zeros((0, 3)), on_feet=on_feet))
            continue
        likest = np.argsort(_difference(np.maximum(sides(reaches(upright[own])), 1e-3), likeness), kind="stable")
        fit = best_fit(upright[own], model, likest, scans, to_world)
        hidden = fit.surface if fit.cost < GOOD else np.zeros((0, 3))
        things.append(_Thing(own=own, cost=cost + FIT * fit.cost, fitted=hidden, on_feet=on_feet))
        likest_cost = min(likest_cost, things[-1].cost)
    return sorted(things, key=lambda thing: thing.cost)


def _shared(one: NDArray[np.int64], other: NDArray[np.int64], *, of_larger: bool = False) -> float:
    """Share of the points of the smaller, or larger, of two things that are the other's, too."""
    size = (max if of_larger else min)(len(one), len(other))
    return len(np.intersect1d(one, other, assume_unique=True)) / size


def _off(scene: ScenePoints, planes: Array) -> NDArray[np.bool_]:
    """(P,): which points lie on none of the `planes` (K, 4), nor a little behind one, where its noise lies."""
    distance = scene.points @ planes[:, :3].T + planes[:, 3]
    reach = scene.tolerances[:, None]
    return np.asarray(((distance > reach) | (distance < -3 * reach)).all(axis=1))


def _on_tops(
    scene: ScenePoints, upright: Array, free: NDArray[np.bool_], up: Array
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """(P,): which of the `free` points lie on level tops, and which of these on a piece that is as large as a support
    plane by itself: at the height of a thing's own top others' tops lie, too."""
    level, large = np.zeros(len(free), dtype=bool), np.zeros(len(free), dtype=bool)
    for top in level_tops(scene, free, up):
        on_plane = free & (np.abs(scene.points @ top[:3] + top[3]) < 1.5 * scene.tolerances)
        level |= on_plane
        for piece in _clusters(upright, scene.tolerances, on_plane):
            _, length, breadth = sides(reaches(upright[piece]))
            large[piece] |= length >= LEAST_LENGTH_OF_TOP and breadth >= LEAST_BREADTH
    return level, large


def _thinned(scene: ScenePoints, to_camera: Array) -> ScenePoints:
    """One point of each GRAIN: what is near to the camera has many more than clusters need. The grains are the
    camera's, so that the same are taken however the world's axes lie."""
    grains = np.floor(poses.transform_points(to_camera, scene.points) / GRAIN).astype(np.int64)
    _, kept = np.unique(grains, axis=0, return_index=True)
    kept.sort()
    return replace(
        scene,
        points=scene.points[kept],
        normals=scene.normals[kept],
        tolerances=scene.tolerances[kept],
        border=scene.border[kept],
        inside=scene.inside[kept],
    )


def _to_upright(up: Array, pose_world_camera: Array) -> Array:
    """(4,): the turn from world to a frame whose z axis is `up` (3,), and whose y axis is level and lies across the
    camera's view, so that the frame is the same to the scene however the world's axes lie."""
    axes = poses.to_matrix(pose_world_camera)[:3, :3]
    across = np.cross(up, axes[:, 2])
    if np.linalg.norm(across) < LEAST_ACROSS:  # it looks straight down
        across = np.cross(up, axes[:, 1])
    y = across / np.linalg.norm(across)
    turn = np.eye(4)
    turn[:3, :3] = np.stack([np.cross(y, up), y, up])
    return poses.from_matrix(turn)[3:]


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


def _region(points: Array, upright: Array, thing: _Thing, to_upright: Array, unlikeness: float | None) -> Region:
    own = upright[thing.own]
    feet = own if thing.on_feet else own - np.array([0.0, 0.0, FEET])
    to_world = poses.quaternion_conjugate(to_upright)
    held = np.concatenate([points[thing.own], poses.rotate(to_world, feet)])
    low, high = held.min(axis=0) - MARGIN, held.max(axis=0) + MARGIN
    if len(thing.fitted):
        fitted = poses.rotate(to_world, thing.fitted)
        low = np.minimum(low, fitted.min(axis=0) - FIT_MARGIN)
        high = np.maximum(high, fitted.max(axis=0) + FIT_MARGIN)
    share = len(thing.own) / len(points)
    return Region(roi=np.concatenate([low, high]), size=sides(reaches(own)), points=share, unlikeness=unlikeness)
