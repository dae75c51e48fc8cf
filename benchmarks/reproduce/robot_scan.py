"""What would a depth camera see of a robot that there is only a URDF of? Joints anywhere within their limits, standing
on the floor before the camera, rendered with the sample data's room and sensor.

Surfaces and poses are those of `pmpnbp.scene`, which reads what no other reader here does: zips, mesh packages, mimic
joints. So the scan is no test of how URDFs are read, as the sample scans are.
"""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path

import numpy as np
import trimesh
from numpy.typing import NDArray

from pmpnbp.errors import RunError
from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.urdf import load_model
from pmpnbp.settings import SENSORS
from sample_data import sensor, surroundings
from sample_data.rendering import Truth, bounds, cast, covered_pixels
from sample_data.scan_folders import write_scan
from sample_data.scenes import camera_before

# Draws of joint positions, and of cameras, before there is none that would do.
DRAWS = 200
# Metres: how far below its first part a robot may reach.
BELOW = 0.01


def write(folder: Path, urdf: Path) -> None:
    """Depth image, camera, truth and region of interest into `folder`, the same for the same URDF.

    Raises ModelError for a URDF that cannot be used, RunError for a robot that cannot be placed.
    """
    model = load_model(urdf)
    rng = np.random.default_rng([14, 0])
    x, y = rng.uniform(-0.5, 0.5, 2)
    pose = surroundings.standing_at(x, y, rng.uniform(-np.pi, np.pi))
    root, joints = _standing(model, pose, rng)
    part_poses = model.part_poses(root, joints)
    surfaces = posed(model, part_poses)
    camera = _camera(surfaces, pose, rng)
    yaw = poses.to_rpy(pose[3:])[2]
    around = [
        surroundings.floor(),
        surroundings.wall(surfaces, yaw + np.deg2rad(rng.uniform(-6, 6)), rng.uniform(0.08, 0.25)),
        *surroundings.clutter(surfaces, pose, 3, rng),
    ]
    depth, visible, alone = measured(surfaces, around, camera, rng)
    matrices = poses.to_matrix(model.link_poses(part_poses, joints))
    positions = {
        joint.name: float(joint.positions(joints)[0])
        for joint in model.joints
        if len(joint.coordinates) == 1 and joint.mimic is None
    }
    truth = Truth(positions, dict(zip(model.links, matrices, strict=True)), visible, alone, bounds(surfaces))
    write_scan(folder, depth, camera, truth)


def posed(model: ArticulatedObject, part_poses: Array) -> dict[str, trimesh.Trimesh]:
    """The surfaces of the parts at `part_poses` (N, 7), in world, by the name of the part, which is that of a link of
    it."""
    return {
        part.name: trimesh.Trimesh(poses.transform_points(pose, part.mesh.vertices), part.mesh.faces, process=False)
        for part, pose in zip(model.parts, part_poses, strict=True)
        if part.visible
    }


def measured(
    surfaces: dict[str, trimesh.Trimesh],
    around: Sequence[trimesh.Trimesh],
    camera: Camera,
    rng: np.random.Generator,
    kind: str = SENSORS[0],
) -> tuple[NDArray[np.uint16], dict[str, float], dict[str, int]]:
    """What a `kind` of sensor makes of surfaces, in world, among what is `around` them: depth (height, width),
    millimetres, 0 where nothing was measured; and by name the share of the pixels that each would cover alone in which
    it is measured, and how many these are."""
    seen = cast([*surfaces.values(), *around], camera)
    depth = sensor.measured(seen.depth, seen.cosine, rng, kind)
    alone = {name: covered_pixels(surface, camera) for name, surface in surfaces.items()}
    visible = {
        name: float(np.sum((seen.index == index) & (depth > 0)) / max(alone[name], 1))
        for index, name in enumerate(surfaces)
    }
    return depth, visible, alone


def digest(folder: Path, urdf: Path) -> str:
    """What changes with the scan or the URDF, so that runs on another one are not taken for runs on this."""
    return sha256((folder / "depth.png").read_bytes() + urdf.read_bytes()).hexdigest()[:16]


def _standing(model: ArticulatedObject, pose_world_foot: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Root pose (7,) and joint vector (D,): the first part's lowest point on the floor, no other part below it."""
    for _ in range(DRAWS):
        joints = rng.uniform(model.lower, model.upper)
        for joint in model.joints:  # what carries the whole object about is at rest
            if joint.kind in ("planar", "floating"):
                joints[list(joint.coordinates)] = 0.0
        lowest = [mesh.bounds[0, 2] for mesh in posed(model, model.part_poses(poses.IDENTITY, joints)).values()]
        if min(lowest) > lowest[0] - BELOW:
            up = poses.from_xyz_rpy([0.0, 0.0, -min(lowest)], [0.0, 0.0, 0.0])
            return poses.multiply(pose_world_foot, up), joints
    raise RunError(f"'{model.name}' reaches below its first part at {DRAWS} draws of its joints' positions")


def _camera(surfaces: dict[str, trimesh.Trimesh], pose_world_foot: Array, rng: np.random.Generator) -> Camera:
    """One that has the whole robot in view, from as near as that goes."""
    box = bounds(surfaces)
    size, height = float(np.linalg.norm(box[3:] - box[:3])), float(box[5])
    for draw in range(DRAWS):
        distance = max(0.6, size) * (1 + 2 * draw / DRAWS)
        above = rng.uniform(0.6, 0.9) * max(height, 0.5 * distance)
        camera = camera_before(pose_world_foot, rng.uniform(-35, 35), distance, above, aim=0.45 * height)
        if surroundings.in_view(surfaces, camera):
            return camera
    raise RunError(f"no camera sees the whole robot, {size:.2f} m large")
