"""What might the camera see? A true placement drawn from the prior, in a room, as a depth camera measures it.

The truth is drawn as the inference would have it before the scan: anywhere in the region, upright and turned by any
angle (or as prior.json says), joints anywhere within their limits. Placements are drawn again where the object is not
whole within the region, or too little of it is in the picture. A floor is right below the object and a wall behind the
region; both are the scan's to tell. Where the object is absent, boxes of about its size stand in the region.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from benchmarks.calibrate.task import Task, unseen, vertices
from benchmarks.reproduce import robot_scan
from pmpnbp.errors import RunError
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.initialisation import prior_roots, random_joints, upright
from pmpnbp.inference.problem import Problem
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.prior import GaussianPrior
from sample_data.surroundings import block

# Placements that are drawn at a time and times that they are, before there is none; scenes that are rendered.
BATCH, BATCHES, RENDERED = 64, 400, 20
# Share of the object's points that has to be in the picture, metres from the camera at least, and pixels that have to
# be measured on it.
IN_PICTURE, NEAREST, FEWEST = 0.5, 0.3, 200
# Metres behind the region at which a wall is, from and to; a camera that looks steeply down, with a horizontal share of
# its direction below this, sees the floor only.
BEHIND, STEEP = (0.05, 0.6), 0.3
# Boxes in the place of an absent object, and their sides, in the object's.
BOXES, SIDES = 3, (0.2, 0.7)


@dataclass(frozen=True)
class Scene:
    """scan : what the camera measured; root (7,), joints (D,) : where the object is; shares : (N,) of each part, how
    much of the pixels that it would cover alone is measured, all 0 where the object is absent."""

    scan: Scan
    root: Array
    joints: Array
    shares: Array


def draw(task: Task, seed: int, *, absent: bool = False) -> Scene:
    """The scene of a seed: the same for the same task. Raises RunError where the object cannot be placed."""
    rng = np.random.default_rng([61, seed])
    model = task.model
    problem = unseen(model, task.prior, task.settings, task.up)
    for _ in range(RENDERED):
        root, joints = _placement(rng, task, problem)
        part_poses = model.part_poses(root, joints)
        surfaces = robot_scan.posed(model, part_poses)
        corners = np.concatenate([surface.vertices for surface in surfaces.values()])
        foot = float((corners @ task.up).min())
        around = _room(rng, task, foot)
        if absent:
            surfaces, around = {}, [*around, *_boxes(rng, task, foot, np.ptp(corners, axis=0))]
        depth, visible, alone = robot_scan.measured(surfaces, around, task.camera, rng, task.sensor)
        if absent or sum(visible[name] * alone[name] for name in visible) >= FEWEST:
            scan = Scan(task.camera, (depth / 1000.0).astype(np.float32))
            return Scene(scan, root, joints, np.array([visible.get(part.name, 0.0) for part in model.parts]))
    raise RunError(
        f"the camera measures fewer than {FEWEST} pixels of '{model.name}' in {RENDERED} scenes; name another "
        f"camera or region"
    )


def _placement(rng: np.random.Generator, task: Task, problem: Problem) -> tuple[Array, Array]:
    """Root pose (7,) and joint vector (D,) from the prior, given that the object is within the region and in the
    picture."""
    model, inside = problem.mrf.model, 0
    low, size = task.region[:3], task.region[3:] - task.region[:3]
    for _ in range(BATCHES):
        joints = random_joints(rng, problem, BATCH)
        if isinstance(task.prior, GaussianPrior):
            roots = prior_roots(rng, problem, joints)
            corners = vertices(model, model.part_poses(roots, joints))
            fits = np.all((corners >= low) & (corners <= low + size), axis=(1, 2))
        else:
            roots = np.concatenate([np.zeros((BATCH, 3)), _orientations(rng, problem)], axis=1)
            corners = vertices(model, model.part_poses(roots, joints))
            room = size - np.ptp(corners, axis=1)
            # as often as it would be inside, were it thrown anywhere; then anywhere inside
            fits = rng.random(BATCH) < np.prod(np.maximum(room, 0.0) / size, axis=1)
            moved = low + rng.random((BATCH, 3)) * np.maximum(room, 0.0) - corners.min(axis=1)
            roots[:, :3] += moved
            corners = corners + moved[:, None]
        inside += int(fits.sum())
        for row in np.flatnonzero(fits):
            if _share_in_picture(task, corners[row]) >= IN_PICTURE:
                return roots[row], joints[row]
    tried = BATCH * BATCHES
    if inside:
        raise RunError(
            f"of {inside} placements of '{model.name}' in the region {task.region.round(3).tolist()} none has half of "
            f"it in the camera's picture; name another camera or region"
        )
    raise RunError(
        f"'{model.name}' is not whole within the region {task.region.round(3).tolist()} in any of {tried} placements "
        f"from the prior; name a larger region"
    )


def _orientations(rng: np.random.Generator, problem: Problem) -> Array:
    """(BATCH, 4) quaternions of a uniform prior."""
    if problem.any_orientation:
        return poses.random_quaternions(rng, (BATCH,))
    turn = np.zeros((BATCH, 3))
    turn[:, 2] = rng.uniform(-np.pi, np.pi, BATCH)
    return poses.quaternion_multiply(upright(problem.observation.up), poses.from_rotation_vector(turn))


def _share_in_picture(task: Task, corners: Array) -> float:
    """Of points (V, 3) in world."""
    seen = poses.transform_points(poses.inverse(task.camera.pose_world_camera), corners)
    if np.any(seen[:, 2] < NEAREST):
        return 0.0
    u, v, _ = np.moveaxis(task.camera.project(seen), -1, 0)
    return float(np.mean((u >= 0) & (v >= 0) & (u <= task.camera.width - 1) & (v <= task.camera.height - 1)))


def _room(rng: np.random.Generator, task: Task, foot: float) -> list[trimesh.Trimesh]:
    """A floor `foot` metres up, and a wall where the camera sees one."""
    up, middle = task.up, (task.region[:3] + task.region[3:]) / 2
    on_floor = middle + (foot - middle @ up) * up
    flat = upright(up)
    room = [block(np.array([10.0, 10.0, 0.1]), np.concatenate([on_floor - 0.05 * up, flat]))]
    forward = poses.rotate(task.camera.pose_world_camera[3:], np.array([0.0, 0.0, 1.0]))
    across = forward - (forward @ up) * up
    length = float(np.linalg.norm(across))
    gap = rng.uniform(*BEHIND)
    if length > STEEP:
        across /= length
        # the farthest corner of the region that way
        reach = float(np.maximum(across * task.region[:3], across * task.region[3:]).sum())
        yaw = poses.rotate(poses.quaternion_conjugate(flat), across)
        turn = poses.from_rotation_vector(np.array([0.0, 0.0, np.arctan2(yaw[1], yaw[0])]))
        place = on_floor + (reach - on_floor @ across + gap + 0.05) * across + 2.95 * up
        room.append(block(np.array([0.1, 10.0, 6.0]), np.concatenate([place, poses.quaternion_multiply(flat, turn)])))
    return room


def _boxes(rng: np.random.Generator, task: Task, foot: float, extents: Array) -> list[trimesh.Trimesh]:
    """Boxes on the floor within the region, each side a share of the sides (3,) of the object's."""
    flat, boxes = upright(task.up), []
    for _ in range(BOXES):
        size = rng.uniform(*SIDES, 3) * extents.mean()
        place = rng.uniform(task.region[:3], task.region[3:])
        place = place + (foot + size[2] / 2 - place @ task.up) * task.up
        turn = poses.from_rotation_vector(np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)]))
        boxes.append(block(size, np.concatenate([place, poses.quaternion_multiply(flat, turn)])))
    return boxes
