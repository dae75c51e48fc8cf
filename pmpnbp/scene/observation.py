"""What the sensor saw, prepared for the potentials: depth images at working size, support planes, oriented points."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.firm_pixels import firm_pixels
from pmpnbp.scene.patches import smooth_patches

# What a pixel of a view is to the unary potential.
NO_DEPTH, OBJECT, SUPPORT, OUTSIDE, CONTINUED = 0, 1, 2, 3, 4


@dataclass(frozen=True)
class Scan:
    """One depth image as read from a file.

    camera : its camera; depth : (height, width) float32, metres along z, 0 where nothing was measured
    frame_id : the name of the world frame; stamp : seconds, or None
    """

    camera: Camera
    depth: NDArray[np.float32]
    frame_id: str = "world"
    stamp: float | None = None


def points_in_world(camera: Camera, depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """(..., 3) metres, world, of a camera's depths; float32, because whole images pass through here."""
    matrix = poses.to_matrix(camera.pose_world_camera).astype(np.float32)
    return camera.back_project(depth) @ matrix[:3, :3].T + matrix[:3, 3]


@dataclass(frozen=True, eq=False)
class View:
    """A scan cropped to the region of interest and binned to working size, see `work_image`. Equal to itself only, so
    that what is made of it can be kept by it.

    camera : of the small image, turned about its axis by `turn` radians against the scan's
    depth : (h, w) float32, metres, 0 where nothing was measured
    category : (h, w) uint8: NO_DEPTH, OBJECT (may be the object), SUPPORT (on a support plane), OUTSIDE (measured,
        but outside the region of interest), CONTINUED (on a smooth surface longer than any part of the object)
    normals : (h, w, 3) float32, in the camera frame, towards the camera; zero where unknown
    distortion : deviation of smooth errors of the depth, as a share of it, see `scene/depth_distortion.py`
    binned : so many pixels of the scan, across and down, are one of these
    """

    camera: Camera
    depth: NDArray[np.float32]
    category: NDArray[np.uint8]
    normals: NDArray[np.float32]
    turn: float = 0.0
    distortion: float = 0.0
    binned: int = 1

    @cached_property
    def pose_world_scan(self) -> Array:
        """(7,) of the scan's own camera."""
        back = np.concatenate([np.zeros(3), poses.from_rotation_vector(np.array([0.0, 0.0, -self.turn]))])
        return poses.multiply(np.asarray(self.camera.pose_world_camera, dtype=np.float64), back)

    @cached_property
    def points(self) -> NDArray[np.float32]:
        """(h, w, 3) metres, world: what each pixel sees."""
        return points_in_world(self.camera, self.depth)

    @cached_property
    def patches(self) -> NDArray[np.int16]:
        """(h, w): the smooth surface that each pixel lies on, 1, 2, ..., or 0: see `scene/patches.py`."""
        return smooth_patches(self.depth)

    @cached_property
    def firm(self) -> NDArray[np.bool_]:
        """(h, w): where the depth is that of one smooth surface, see `scene/firm_pixels.py`."""
        return firm_pixels(self.depth)

    def with_category(self, category: NDArray[np.uint8]) -> View:
        """The view with other categories (h, w), which are its own from now on; what is of the depth alone stays."""
        category.setflags(write=False)
        view = replace(self, category=category)
        view.__dict__.update(patches=self.patches, points=self.points, firm=self.firm)
        return view

    @cached_property
    def distance(self) -> float:
        """Metres along the camera's axis to what may be the object, in the median; 0 where nothing is."""
        depth = self.depth[self.category == OBJECT]
        return float(np.median(depth)) if len(depth) else 0.0


@dataclass(frozen=True)
class Observation:
    """All that is known of a scene.

    views : one per scan that shows something of the region; the unary potential is the product over them
    points, normals : (P, 3) float64, world, metres: the OBJECT pixels of all views with a normal
    planes : (K, 4) support planes n·x + d = 0 in world, n towards the cameras
    up : (3,) unit vector, world: the direction away from the ground, which `upright` priors refer to
    roi : (6,) x0 y0 z0 x1 y1 z1 in world, or None
    showing : of each scan, whether there is a view of it; None: of every one
    """

    views: tuple[View, ...]
    points: Array
    normals: Array
    planes: Array
    up: Array
    roi: Array | None
    frame_id: str = "world"
    stamp: float | None = None
    showing: tuple[bool, ...] | None = None

    @property
    def scan_count(self) -> int:
        """How many scans there are."""
        return len(self.views) if self.showing is None else len(self.showing)

    @property
    def scan_numbers(self) -> tuple[int, ...]:
        """(V,) which of the scans each view is of, counted from 0."""
        return tuple(number for number in range(self.scan_count) if self.showing is None or self.showing[number])

    def by_scan(self, values: Iterable[float]) -> tuple[float | None, ...]:
        """`values` (V,) of the views as one of each scan; None of one that shows nothing of the region."""
        found: list[float | None] = [None] * self.scan_count
        for number, value in zip(self.scan_numbers, values, strict=True):
            found[number] = float(value)
        return tuple(found)
