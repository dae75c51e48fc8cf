"""The pinhole camera: optical frame (x right, y down, z forward), pixels counted from the centre of the first one."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry.poses import IDENTITY, Array


@dataclass(frozen=True)
class Camera:
    """A pinhole camera and where it stands.

    width, height : image size, pixels
    fx, fy, cx, cy : focal lengths and principal point, pixels
    pose_world_camera : (7,), x y z qw qx qy qz, metres, optical frame in world
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    pose_world_camera: Array = field(default_factory=lambda: IDENTITY)

    @property
    def widest_ray(self) -> float:
        """How far to the side a pixel's ray is, along the picture's width or height, at depth 1."""
        across = max(abs(self.cx), abs(self.width - 1 - self.cx)) / self.fx
        return max(across, max(abs(self.cy), abs(self.height - 1 - self.cy)) / self.fy)

    def rays(self) -> NDArray[np.float32]:
        """(height, width, 3): the point of each pixel's ray at depth 1, in the camera frame."""
        u = (np.arange(self.width, dtype=np.float32) - np.float32(self.cx)) / np.float32(self.fx)
        v = (np.arange(self.height, dtype=np.float32) - np.float32(self.cy)) / np.float32(self.fy)
        x, y = np.meshgrid(u, v)
        return np.stack([x, y, np.ones_like(x)], axis=-1)

    def back_project(self, depth: NDArray[np.float32]) -> NDArray[np.float32]:
        """Points (height, width, 3), metres in the camera frame, of a depth image (height, width) in metres."""
        return self.rays() * depth[..., None]

    def project(self, points: Array) -> Array:
        """Pixel coordinates and depth (..., 3): u, v, z of points (..., 3) in the camera frame, z > 0."""
        z = points[..., 2]
        return np.stack([self.fx * points[..., 0] / z + self.cx, self.fy * points[..., 1] / z + self.cy, z], axis=-1)

    def binned(self, column: int, row: int, factor: int, width: int, height: int) -> Camera:
        """The camera whose pixels are blocks of factor × factor of these, from pixel (column, row) on."""
        shift = (factor - 1) / 2
        return Camera(
            width,
            height,
            self.fx / factor,
            self.fy / factor,
            (self.cx - column - shift) / factor,
            (self.cy - row - shift) / factor,
            self.pose_world_camera,
        )
