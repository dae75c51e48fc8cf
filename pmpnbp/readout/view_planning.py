"""From where to look next? Views ranked by how much a scan from there is expected to tell of some links.

Draws of the posterior are rendered from each view. Were one of them the truth, the scan would tell the others from it
by as much as their images differ, scored as the estimate's pixels are; the weights that remain, averaged over which
draw is the truth, give the standard deviations that are expected after the scan. Surfaces that were seen, and that the
object does not explain, block the sight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.log_weights import normalise
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.unary import render, renders
from pmpnbp.readout.object_posterior import confidence
from pmpnbp.readout.posterior import Posterior
from pmpnbp.scene.articulated_object import parts_of_links
from pmpnbp.scene.observation import SUPPORT

# Draws that are told apart; pixels across and down of the images they are told apart in, and their field of view.
DRAWS, WIDTH, HEIGHT, FIELD = 40, 64, 48, np.deg2rad(60.0)
# Candidates around the object: turns, and heights over its middle in shares of the distance; from no higher than this.
TURNS, STEEP = 12, (0.25, 0.65)
# Metres behind the object at which everything else is taken to be.
BEHIND = 1.0
# Metres: no link is expected to be known better than this.
BEST = 5e-4
# Pixels about a blocking point that it hides.
BLOCKED = 1


@dataclass(frozen=True)
class PlannedView:
    """pose : (7,) of the camera in world; cost : what it takes to get there, above 0."""

    pose: Array
    cost: float = 1.0


@dataclass(frozen=True)
class RankedView:
    """A view, what it is expected to tell, nats, and the standard deviations (A, 3), metres, of the asked links'
    positions that are expected after it."""

    view: PlannedView
    gain: float
    std_xyz: Array


def around(problem: Problem, posterior: Posterior) -> list[PlannedView]:
    """Views from all around the object at the first camera's distance, from two heights."""
    middle = _middle(problem, posterior)
    up = problem.observation.up
    eye = np.asarray(problem.observation.views[0].camera.pose_world_camera[:3], dtype=np.float64)
    away = eye - middle
    distance = float(np.linalg.norm(away))
    flat = away - (away @ up) * up
    flat = flat / max(float(np.linalg.norm(flat)), 1e-9)
    across = np.cross(up, flat)
    found = []
    for steep in STEEP:
        for turn in 2 * np.pi * np.arange(TURNS) / TURNS:
            level = np.sqrt(1 - steep**2) * (np.cos(turn) * flat + np.sin(turn) * across)
            found.append(PlannedView(looking_at(middle + distance * (level + steep * up), middle, up)))
    return found


def ranked(
    problem: Problem, posterior: Posterior, links: Sequence[int], views: Sequence[PlannedView]
) -> list[RankedView]:
    """The views, best first: by what they are expected to tell of `links`, numbers in the model's order, over their
    cost."""
    chosen = posterior.even_draws(DRAWS)
    model = problem.mrf.model
    drawn = _places(problem, posterior.drawn_roots[chosen], posterior.drawn_joints[chosen], links)
    roots, joints = _what_is_open(problem, posterior, chosen)
    parts, places = model.part_poses(roots, joints), _places(problem, roots, joints, links)
    # what is known well enough is not told apart, and remains
    rest = np.maximum(drawn.var(axis=0) - places.var(axis=0), 0.0) + BEST**2
    shown = sorted({parts_of_links(model)[model.links[link]] for link in links})
    blocking = _blocking_points(problem, posterior)
    found, in_sight = [], []
    for view in views:
        told, pixels = _told_apart(problem, parts, blocking, view.pose, shown)
        weights = np.exp(normalise(-told))
        means = np.einsum("ij,jac->iac", weights, places)
        squares = np.einsum("ij,jac->iac", weights, places**2)
        after = np.maximum((squares - means**2).mean(axis=0), 0.0)
        gain = 0.5 * np.log((places.var(axis=0) + rest) / (after + rest)).sum()
        found.append(RankedView(view, float(max(gain, 0.0)), np.sqrt(after + rest)))
        in_sight.append(pixels)
    # of views that tell as much, from which more of the links is seen
    order = sorted(range(len(found)), key=lambda k: (-round(found[k].gain, 1), -in_sight[k]))
    return sorted((found[k] for k in order), key=lambda one: -round(one.gain, 1) / one.view.cost)


def _places(problem: Problem, roots: Array, joints: Array, links: Sequence[int]) -> Array:
    """(K, A, 3) positions of links in configurations (K, 7), (K, D)."""
    model = problem.mrf.model
    return model.link_poses(model.part_poses(roots, joints), joints)[:, list(links), :3]


def _what_is_open(problem: Problem, posterior: Posterior, chosen: NDArray[np.int64]) -> tuple[Array, Array]:
    """Roots (K, 7) and joints (K, D) of draws, with those coordinates that are known to within the tolerance put where
    the draw's mode has them: else each draw would be told from all others by its last millimetre, and with it what no
    view shows."""
    roots, joints = posterior.drawn_roots[chosen].copy(), posterior.drawn_joints[chosen].copy()
    of_draw = posterior.mode[chosen]
    levers = np.where(problem.joint_turns, float(problem.mrf.radii.max()), 1.0)
    for number, mode in enumerate(posterior.modes):
        own = of_draw == number
        if not own.any():
            continue
        if roots[own, :3].std(axis=0).max() < problem.tolerance_end:
            roots[own] = mode.root
        known = joints[own].std(axis=0) * levers < problem.tolerance_end
        joints[np.ix_(own, known)] = mode.joints[known]
    return roots, joints


def looking_at(eye: Array, target: Array, up: Array) -> Array:
    """(7,) the camera at `eye` (3,) that looks at `target` (3,), `up` (3,) being up in its picture."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    side = np.cross(forward, up)
    if np.linalg.norm(side) < 1e-6:  # straight from above or below
        side = np.cross(forward, np.roll(up, 1) + 1e-3)
    side = side / np.linalg.norm(side)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([side, np.cross(forward, side), forward], axis=1)
    matrix[:3, 3] = eye
    return poses.from_matrix(matrix)


def _middle(problem: Problem, posterior: Posterior) -> Array:
    parts = problem.mrf.part_poses(posterior.root, posterior.joints)
    corners = poses.transform_points(parts, problem.mrf.centres)
    found: Array = (corners.min(axis=0) + corners.max(axis=0)) / 2
    return found


def _told_apart(
    problem: Problem, parts: Array, blocking: Array, pose: Array, shown: Sequence[int]
) -> tuple[Array, float]:
    """(K, K) nats by which a scan from `pose` would tell draw j of part poses (K, N, 7) from draw i, were i the truth;
    and how many pixels of the parts `shown` it would have, in the mean."""
    focal = WIDTH / (2 * np.tan(FIELD / 2))
    camera = Camera(WIDTH, HEIGHT, focal, focal, (WIDTH - 1) / 2, (HEIGHT - 1) / 2, pose)
    images = [render(camera, problem.surfaces, draw) for draw in parts]
    depth = np.array([image.ravel() for image, _ in images])
    number = np.array([which.ravel() for _, which in images])
    # where something stands before all draws nothing is told
    open_to_sight = (depth > 0) & (depth <= _blocked(camera, blocking))
    pixels = float(np.count_nonzero(np.isin(number, shown) & open_to_sight)) / len(parts)
    seen = open_to_sight.any(axis=0)
    if not seen.any():
        return np.zeros((len(parts), len(parts))), 0.0
    depth = depth[:, seen].astype(np.float64)
    depth = np.where(depth > 0, depth, depth.max() + BEHIND)
    # a pixel weighs by the square of its distance, as in the score, and as many of the working images' as it holds
    working = problem.observation.views[0].camera
    area = (depth.min(axis=0) / problem.unit_distance) ** 2 * (working.fx / focal) ** 2
    told = np.array([np.minimum(((depth - one) / problem.tolerance_end) ** 2, 1.0) @ area for one in depth])
    return confidence(problem) * told, pixels


def _blocking_points(problem: Problem, posterior: Posterior) -> Array:
    """(B, 3) points in world that were measured, that no support plane holds and the estimate does not explain."""
    parts = problem.mrf.part_poses(posterior.root, posterior.joints)
    found = []
    for view, _, depth, _ in renders(problem.observation, problem.surfaces, parts, problem.nuisances):
        near = (depth > 0) & (np.abs(view.depth - depth) < 2 * problem.tolerance_end)
        chosen = (view.depth > 0) & (view.category != SUPPORT) & ~near
        points = view.camera.back_project(view.depth)[chosen]
        found.append(poses.transform_points(np.asarray(view.camera.pose_world_camera, dtype=np.float64), points))
    return np.concatenate(found) if found else np.zeros((0, 3))


def _blocked(camera: Camera, points: Array) -> NDArray[np.float32]:
    """(h w,) metres from which on pixels are hidden by points (B, 3) in world; infinite where none is."""
    nearest = np.full(camera.width * camera.height, np.inf, dtype=np.float32)
    if len(points):
        inside = poses.transform_points(poses.inverse(np.asarray(camera.pose_world_camera, dtype=np.float64)), points)
        inside = inside[inside[:, 2] > 0.05]
        pixel = np.rint(camera.project(inside)[:, :2]).astype(np.int64)
        within = np.all((pixel >= 0) & (pixel < [camera.width, camera.height]), axis=1)
        np.minimum.at(nearest, pixel[within, 1] * camera.width + pixel[within, 0], inside[within, 2].astype(np.float32))
    size = 2 * BLOCKED + 1
    spread = ndimage.minimum_filter(nearest.reshape(camera.height, camera.width), size=size, mode="nearest")
    found: NDArray[np.float32] = spread.ravel()
    return found
