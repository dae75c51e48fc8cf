"""Rooms of boxes with a floor and walls, seen by a depth camera: scenes whose planes and surfaces are known exactly."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.observation import Scan

# x0 y0 z0 x1 y1 z1; the floor and the wall are boxes whose near face lies at z = 0 and x = 0.
FLOOR = (-5.0, -5.0, -0.1, 5.0, 5.0, 0.0)
WALL = (-0.1, -5.0, -1.0, 0.0, 5.0, 4.0)


def camera_at(position: Sequence[float], target: Sequence[float], *, width: int = 320, height: int = 240) -> Camera:
    """A camera with 60° across that stands at `position` and looks at `target`, both world, without roll."""
    forward = np.subtract(target, position).astype(float)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    matrix[:3, 3] = position
    focal = width / 2 / np.tan(np.pi / 6)
    return Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, poses.from_matrix(matrix))


def see(camera: Camera, boxes: Sequence[Sequence[float]], rng: np.random.Generator | None = None) -> Scan:
    """What `camera` sees of axis-aligned `boxes`; with `rng`, with a depth sensor's noise that grows with z²."""
    rays = camera.rays().astype(np.float64).reshape(-1, 3)
    directions = poses.rotate(camera.pose_world_camera[3:], rays)
    origin = camera.pose_world_camera[:3]
    depth = np.full(len(rays), np.inf)
    for box in boxes:
        with np.errstate(divide="ignore"):
            ends = (np.array(box).reshape(2, 3)[:, None] - origin) / directions
        near, far = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
        depth = np.where((near <= far) & (near > 0) & (near < depth), near, depth)
    depth[np.isinf(depth)] = 0.0
    if rng is not None:
        depth += (depth > 0) * rng.standard_normal(len(depth)) * (0.0012 + 0.0019 * np.maximum(depth - 0.4, 0) ** 2)
    return Scan(camera, depth.reshape(camera.height, camera.width).astype(np.float32))


def without_pose(scan: Scan) -> Scan:
    """The same scan, of a camera whose place in the world nobody knows."""
    c = scan.camera
    return Scan(Camera(c.width, c.height, c.fx, c.fy, c.cx, c.cy), scan.depth)


def has_plane(planes: Array, plane: Sequence[float], angle: float = 1.0, offset: float = 0.01) -> bool:
    """Whether one of `planes` (K, 4) is `plane` to within `angle`, degrees, and `offset`, metres."""
    wanted = np.array(plane, dtype=float)
    return any(p[:3] @ wanted[:3] > np.cos(np.radians(angle)) and abs(p[3] - wanted[3]) < offset for p in planes)
