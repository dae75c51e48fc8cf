"""What else is in the picture? Floor, wall, things on the floor, an arm or a cloth in front: meshes in world."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera

Array = NDArray[np.float64]
IMAGE_MARGIN = 8


def standing_at(x: float, y: float, yaw: float) -> Array:
    """Pose (7,) of something upright on the floor, turned by `yaw`, radians."""
    return poses.from_xyz_rpy([x, y, 0.0], [0.0, 0.0, yaw])


def looking_at(eye: Array, target: Array, roll: float = 0.0) -> Camera:
    """A 640x480 camera, focal length 525 px, at `eye` (3,) with `target` (3,) in its middle, both in world; `roll` in
    radians about the line of sight."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right, down, forward], axis=1)
    matrix[:3, 3] = eye
    turn = np.concatenate([np.zeros(3), poses.from_rotation_vector(np.array([0.0, 0.0, roll]))])
    return Camera(640, 480, 525.0, 525.0, 319.5, 239.5, poses.multiply(poses.from_matrix(matrix), turn))


def in_view(meshes: dict[str, trimesh.Trimesh], camera: Camera) -> bool:
    """Whether every vertex projects into the image, `IMAGE_MARGIN` pixels from its border, in front of the camera."""
    vertices = np.concatenate([mesh.vertices for mesh in meshes.values()])
    inside = poses.transform_points(poses.inverse(camera.pose_world_camera), vertices)
    if np.any(inside[:, 2] < 0.3):
        return False
    u, v, _ = np.moveaxis(camera.project(inside), -1, 0)
    return bool(
        u.min() > IMAGE_MARGIN
        and v.min() > IMAGE_MARGIN
        and u.max() < camera.width - IMAGE_MARGIN
        and v.max() < camera.height - IMAGE_MARGIN
    )


def block(size: Array, pose_world_block: Array) -> trimesh.Trimesh:
    """A box of `size` (3,), metres, centred at `pose_world_block` (7,)."""
    return trimesh.creation.box(extents=size, transform=poses.to_matrix(pose_world_block))


def floor() -> trimesh.Trimesh:
    """The floor: z = 0, 10 m square."""
    return block(np.array([10.0, 10.0, 0.1]), poses.from_xyz_rpy([0.0, 0.0, -0.05], [0.0, 0.0, 0.0]))


def wall(meshes: dict[str, trimesh.Trimesh], yaw: float, gap: float) -> trimesh.Trimesh:
    """A wall whose front faces the direction `yaw` (radians, world), `gap` metres behind the hindmost of `meshes`."""
    facing = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    hindmost = min(float((mesh.vertices @ facing).min()) for mesh in meshes.values())
    x, y, _ = facing * (hindmost - gap - 0.05)
    return block(np.array([0.1, 8.0, 3.0]), poses.from_xyz_rpy([x, y, 1.5], [0.0, 0.0, yaw]))


def clutter(
    meshes: dict[str, trimesh.Trimesh],
    pose_world_base: Array,
    count: int,
    rng: np.random.Generator,
    ground: Array | None = None,
) -> list[trimesh.Trimesh]:
    """`count` boxes and a ball to the left and right of the object, clear of its box in its own frame.

    They stand on the plane that the object stands on. ground : (4,) x0 y0 x1 y1 in the object's frame, the extent of
    that plane, which they keep within; or None for a floor without end.
    """
    pose_base_world = poses.inverse(pose_world_base)
    own = np.concatenate([poses.transform_points(pose_base_world, mesh.vertices) for mesh in meshes.values()])
    lower, upper = own.min(axis=0), own.max(axis=0)
    things = []
    for number in range(count + 1):
        size = rng.uniform([0.08, 0.08, 0.06], [0.22, 0.22, 0.35])
        reach = float(np.hypot(size[0], size[1])) / 2
        side = 1 if number % 2 else -1
        beside = upper[1] if side > 0 else -lower[1]
        y = side * (beside + reach + rng.uniform(0.03, 0.25))
        x = rng.uniform(lower[0] + reach, upper[0] + 0.2)
        if ground is not None:
            x, y = np.clip([x, y], ground[:2] + reach, ground[2:] - reach)
        on_floor = poses.multiply(pose_world_base, poses.from_xyz_rpy([x, y, 0.0], [0.0, 0.0, rng.uniform(0, np.pi)]))
        if number < count:
            up = poses.from_xyz_rpy([0.0, 0.0, size[2] / 2], [0.0, 0.0, 0.0])
            things.append(block(size, poses.multiply(on_floor, up)))
        else:
            radius = rng.uniform(0.06, 0.11)
            ball = trimesh.creation.icosphere(subdivisions=3, radius=radius)
            things.append(ball.apply_translation(on_floor[:3] + [0.0, 0.0, radius]))
    return things


def arm(joints: Array, radii: Array) -> list[trimesh.Trimesh]:
    """A robot arm in front: cylinders between consecutive `joints` (K, 3), world, of `radii` (K - 1,), with a ball at
    each joint between them."""
    segments = [
        trimesh.creation.cylinder(radius, segment=[a, b], sections=32)
        for a, b, radius in zip(joints[:-1], joints[1:], radii, strict=True)
    ]
    knuckles = [
        trimesh.creation.icosphere(subdivisions=2, radius=1.15 * radius).apply_translation(joint)
        for joint, radius in zip(joints[1:-1], radii[:-1], strict=True)
    ]
    return segments + knuckles


def cloth(profile: Array, y0: float, y1: float, pose_world_base: Array) -> trimesh.Trimesh:
    """A sheet hanging along `profile` (K, 2), x and z in the object's frame, from y0 to y1, with folds that deepen
    towards the profile's end."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(profile, axis=0), axis=1))])
    along = np.linspace(0.0, lengths[-1], 60)
    x, z = (np.interp(along, lengths, profile[:, axis]) for axis in (0, 1))
    y = np.linspace(y0, y1, 60)
    fold = 0.012 * (along[:, None] / along[-1]) * np.sin(2 * np.pi * y[None] / 0.11 + 4 * along[:, None])
    sheet = np.stack(np.broadcast_arrays(x[:, None] + fold, y[None], z[:, None]), axis=-1).reshape(-1, 3)
    corner = (np.arange(59)[:, None] * 60 + np.arange(59)).ravel()
    faces = np.concatenate(
        [np.stack([corner, corner + 1, corner + 60], 1), np.stack([corner + 1, corner + 61, corner + 60], 1)]
    )
    return trimesh.Trimesh(poses.transform_points(pose_world_base, sheet), faces, process=False)
