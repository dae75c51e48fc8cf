"""Could the model stand where these points were measured? A coarse fit, by which things of like size are told apart.

The model is laid on a thing in those of its joint configurations that are as large, in level turns, and is shifted and
turned to it. What was measured far from its surface speaks against it, and so does surface where a scan sees through to
what lies behind: a box may be as large as an open laptop, but is none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.sizes_over_joints import configurations, reaches, sides
from pmpnbp.scene.surface_points import area, even_points

# Points on the model's surface, and on each part at least.
SURFACE_POINTS, LEAST_POINTS = 1500, 20
# Joint configurations that are tried, and level turns of each; of all these so many are followed.
TRIED, TURNS, FOLLOWED = 48, 16, 12
# Points of the thing and of the surface that are looked at when all are tried, and when some are followed.
FEW, MANY = (32, 60), (80, 240)
# Times that one which is followed is shifted and turned to the nearest points.
ROUNDS = 4
# Metres that a point is off at most.
FARTHEST = 0.1
# Metres that surface lies before what was measured where that is seen through: more than a coarse fit is off.
BEFORE = 0.05
# Share of a thing's length that its points are off which costs as much as all of the surface seen through.
AS_BAD = 0.1


@dataclass(frozen=True)
class Shapes:
    """The model's surface in each of its S `configurations`.

    points : (S, P, 3) metres, z upward, about the middle of their box
    """

    points: Array
    _trees: dict[int, cKDTree] = field(default_factory=dict)

    def tree(self, number: int) -> cKDTree:
        """Of the points of configuration `number`, made when it is first tried: most never are."""
        if number not in self._trees:
            self._trees[number] = cKDTree(self.points[number])
        return self._trees[number]


@dataclass(frozen=True)
class Fit:
    """The model laid on a thing. cost : by how much that is wrong: the share of its surface that is seen through, and
    1 more where the thing's points are AS_BAD of its length off in the mean; surface : (P, 3) metres, upright"""

    cost: float
    surface: Array


def shapes(model: ArticulatedObject) -> Shapes:
    """Of all `configurations` of the model."""
    seen = [(number, part.mesh) for number, part in enumerate(model.parts) if part.visible]
    areas = np.array([area(mesh) for _, mesh in seen])
    counts = np.maximum(LEAST_POINTS, SURFACE_POINTS * areas / areas.sum()).astype(int)
    part_poses = model.part_poses(poses.IDENTITY, configurations(model))
    each = [
        poses.transform_points(part_poses[:, None, number], even_points(mesh, int(count)))
        for (number, mesh), count in zip(seen, counts, strict=True)
    ]
    points = np.concatenate(each, axis=1)
    points -= (points.min(axis=1, keepdims=True) + points.max(axis=1, keepdims=True)) / 2
    return Shapes(points)


def best_fit(own: Array, model: Shapes, likest: NDArray[np.int64], scans: Sequence[Scan], to_world: Array) -> Fit:
    """The best that is found of the upright model on the points `own` (P, 3) of a thing, z upward.

    likest : the configurations in the order in which they are tried; to_world : (4,) what turns `own` to world
    """
    middle = (own.min(axis=0) + own.max(axis=0)) / 2
    angles = np.arange(TURNS) * 2 * np.pi / TURNS
    as_bad = AS_BAD * float(np.linalg.norm(sides(reaches(own))))
    tried = []
    few = _evenly(own, FEW[0])
    for number in likest[:TRIED]:
        shift = np.tile(middle, (TURNS, 1))
        _, nearest = _nearest(few, model, number, angles, shift)
        apart = few - shift[:, None] - _turned(nearest, angles)
        step = apart.mean(axis=1, keepdims=True)
        shift = shift + step[:, 0]
        off = np.minimum(np.linalg.norm(apart - step, axis=-1), FARTHEST).mean(axis=-1)
        surface = _turned(_evenly(model.points[number], FEW[1]), angles) + shift[:, None]
        through = _seen_through(poses.rotate(to_world, surface), scans)
        tried += [
            (float(through[k] + off[k] / as_bad), int(number), angles[k : k + 1], shift[k : k + 1])
            for k in range(TURNS)
        ]
    tried.sort(key=lambda one: one[0])
    found = [_followed(_evenly(own, MANY[0]), model, *one[1:], as_bad, scans, to_world) for one in tried[:FOLLOWED]]
    return min(found, key=lambda fit: fit.cost)


def _followed(
    own: Array,
    model: Shapes,
    number: int,
    angle: Array,
    shift: Array,
    as_bad: float,
    scans: Sequence[Scan],
    to_world: Array,
) -> Fit:
    """The fit that configuration `number`, turned by `angle` (1,) and shifted by `shift` (1, 3), comes to."""
    for _ in range(ROUNDS):
        off, nearest = _nearest(own, model, number, angle, shift)
        weight = np.exp(-off[0] / FARTHEST)[:, None]  # what is far from it is more likely of another thing
        weight /= weight.sum()
        middle, target = (weight * own).sum(axis=0), (weight * nearest[0]).sum(axis=0)
        a, b = nearest[0] - target, own - middle
        sine = (weight[:, 0] * (a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])).sum()
        angle = np.array([np.arctan2(sine, (weight * a * b)[:, :2].sum())])
        shift = middle - _turned(target[None], angle)[:, 0]
    off, _ = _nearest(own, model, number, angle, shift)
    surface = _turned(model.points[number], angle)[0] + shift
    through = _seen_through(poses.rotate(to_world, _evenly(surface, MANY[1])), scans)
    return Fit(float(through + off.mean() / as_bad), surface)


def _nearest(own: Array, model: Shapes, number: int, angles: Array, shifts: Array) -> tuple[Array, Array]:
    """(A, P) metres from `own` (P, 3) to the surface turned by `angles` (A,) and shifted by `shifts` (A, 3), at most
    FARTHEST, and its nearest points (A, P, 3), before that."""
    distance, nearest = model.tree(number).query(_turned(own - shifts[:, None], -angles))
    return np.minimum(distance, FARTHEST), model.points[number][nearest]


def _evenly(points: Array, count: int) -> Array:
    return points[np.linspace(0, len(points) - 1, min(count, len(points))).astype(int)]


def _turned(points: Array, angles: Array) -> Array:
    """(A, P, 3): `points` (P, 3) or (A, P, 3) turned about the z axis by `angles` (A,)."""
    cosine, sine = np.cos(angles)[:, None], np.sin(angles)[:, None]
    x, y, z = points[..., 0], points[..., 1], points[..., 2]
    z = np.broadcast_to(z, (len(angles), z.shape[-1]))
    return np.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=-1)


def _seen_through(points: Array, scans: Sequence[Scan]) -> Array:
    """(...): the share of the world's points (..., P, 3) that some scan measured something behind."""
    through = np.zeros(points.shape[:-1], dtype=bool)
    for scan in scans:
        camera = scan.camera
        local = poses.transform_points(poses.inverse(camera.pose_world_camera), points)
        ahead = local[..., 2] > BEFORE
        pixels = camera.project(np.where(ahead[..., None], local, 1.0))[..., :2]
        ahead &= ((pixels > -0.5) & (pixels < np.array([camera.width, camera.height]) - 0.5)).all(axis=-1)
        column, row = np.moveaxis(np.rint(np.where(ahead[..., None], pixels, 0.0)).astype(int), -1, 0)
        through |= ahead & (scan.depth[row, column] > local[..., 2] + BEFORE)
    return np.asarray(through.mean(axis=-1))
