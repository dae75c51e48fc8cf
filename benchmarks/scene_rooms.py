"""Where do hard scenes stand? On a table or on the floor of a room, before a wall, with clutter and a camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from sample_data import surroundings
from sample_data.rendering import posed
from sample_data.scenes import Scene, camera_before


@dataclass(frozen=True)
class HardScene:
    """scene : what is there; urdf : what the inference is told is there; orientation : "upright" or "any"; depth_scale
    : of all measured depths; noise : standard deviation at one metre, metres, growing with depth squared; further : a
    second camera, and how far it is off from where it is said to be, metres, and turned as far, standard deviations."""

    scene: Scene
    urdf: str
    orientation: str = "upright"
    depth_scale: float = 1.0
    noise: float = 0.0
    further: tuple[Camera, float] | None = None


def table_scene(rng: np.random.Generator, urdf: str, joints: dict[str, float], lift: float, near: float) -> Scene:
    """On a table with a few things, in front of a wall, from `near` metres or a bit more; `lift` metres: where the
    root link's origin is above the top."""
    height = rng.uniform(0.65, 0.8)
    pose = poses.from_xyz_rpy([*rng.uniform(-0.5, 0.5, 2), height], [0.0, 0.0, rng.uniform(-np.pi, np.pi)])
    surfaces = posed(urdf, joints, _lifted(pose, lift))
    camera = _camera(rng, surfaces, pose, near, 0.05)
    table = poses.from_xyz_rpy([rng.uniform(-0.1, 0.2), 0.0, -0.015], [0.0, 0.0, 0.0])
    size = np.array([rng.uniform(0.7, 0.9), rng.uniform(1.2, 1.7), 0.03])
    around = [surroundings.floor(), surroundings.block(size, poses.multiply(pose, table))]
    around.append(surroundings.wall(surfaces, poses.to_rpy(pose[3:])[2], rng.uniform(0.25, 0.5)))
    ground = np.array([-0.3, -0.55, 0.3, 0.55])
    around += surroundings.clutter(surfaces, pose, int(rng.integers(1, 4)), rng, ground)
    return Scene(urdf, joints, _lifted(pose, lift), camera, tuple(around))


def _lifted(pose: Array, lift: float) -> Array:
    return poses.multiply(pose, poses.from_xyz_rpy([0.0, 0.0, lift], [0.0, 0.0, 0.0]))


def _camera(rng: np.random.Generator, surfaces: dict, pose: Array, near: float, aim: float) -> Camera:
    for attempt in range(200):
        distance = rng.uniform(near, 1.3 * near + attempt / 100)
        camera = camera_before(pose, rng.uniform(-40, 40), distance, rng.uniform(0.45, 0.9) * distance, aim)
        if surroundings.in_view(surfaces, camera):
            return camera
    raise ValueError("no camera sees the whole object")


def floor_scene(
    rng: np.random.Generator, urdf: str, joints: dict[str, float], near: float, aim: float, things: int = 3
) -> Scene:
    """On the floor before a wall, with `things` beside it."""
    pose = surroundings.standing_at(*rng.uniform(-0.8, 0.8, 2), rng.uniform(-np.pi, np.pi))
    surfaces = posed(urdf, joints, pose)
    camera = _camera(rng, surfaces, pose, near, aim)
    yaw = poses.to_rpy(pose[3:])[2] + np.deg2rad(rng.uniform(-8, 8))
    around = [surroundings.floor(), surroundings.wall(surfaces, yaw, rng.uniform(0.05, 0.4))]
    around += surroundings.clutter(surfaces, pose, things, rng)
    return Scene(urdf, joints, pose, camera, tuple(around))


def above_ground(
    rng: np.random.Generator, urdf: str, limits: dict[str, tuple[float, float]], links: Sequence[str], least: float
) -> dict[str, float]:
    """Joint positions within `limits` at which the `links` are higher than `least` metres above what the root stands
    on."""
    while True:
        joints = {name: rng.uniform(low, high) for name, (low, high) in limits.items()}
        surfaces = posed(urdf, joints, poses.IDENTITY)
        if min(surfaces[name].vertices[:, 2].min() for name in links) > least:
            return joints
