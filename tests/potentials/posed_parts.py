"""Parts, poses and observations for the tests of the unary potential."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.potentials.surfaces import Surfaces
from pmpnbp.potentials.unary import render
from pmpnbp.scene.articulated_object import ArticulatedObject, Edge, Mesh, Part
from pmpnbp.scene.observation import CONTINUED, NO_DEPTH, OBJECT, OUTSIDE, SUPPORT, Observation, View

NOTHING = Mesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32))


def mesh_of(shape: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(shape.vertices, dtype=np.float64), np.asarray(shape.faces, dtype=np.int32))


def shapes() -> dict[str, Mesh]:
    """A closed box, ball, tube and an open plate with a hole's worth of triangles missing."""
    plate = trimesh.creation.box((0.3, 0.2, 0.01)).subdivide()
    return {
        "box": mesh_of(trimesh.creation.box((0.3, 0.2, 0.25))),
        "ball": mesh_of(trimesh.creation.icosphere(2, 0.12)),
        "tube": mesh_of(trimesh.creation.annulus(0.05, 0.08, 0.3, sections=20)),
        "open plate": Mesh(np.asarray(plate.vertices), np.asarray(plate.faces[:-7], dtype=np.int32)),
    }


def object_of(meshes: list[Mesh]) -> ArticulatedObject:
    """Parts that slide along the first one, each by itself."""
    names = tuple(f"part{k}" for k in range(len(meshes)))
    count = len(meshes) - 1
    parts = tuple(
        Part(name, (name,), poses.IDENTITY[None], mesh, mesh, 0.0) for name, mesh in zip(names, meshes, strict=True)
    )
    here, along = poses.IDENTITY[None], np.array([[1.0, 0.0, 0.0]])
    one, none, no = np.ones(1), np.zeros(1), np.zeros(1, dtype=np.bool_)
    edges = tuple(
        Edge(0, k + 1, here, poses.IDENTITY, no, along, -one, one, no, np.array([k]), one, none) for k in range(count)
    )
    ends, wraps = np.ones(count), np.zeros(count, dtype=np.bool_)
    return ArticulatedObject("parts", parts, edges, (), names, names[1:], -ends, ends, wraps)


def random_poses(rng: np.random.Generator, shape: tuple[int, ...], centre: Array, spread: float) -> Array:
    """Any orientation; positions (metres) normal about `centre` (3,)."""
    position = rng.normal(centre, spread, (*shape, 3))
    return np.concatenate([position, poses.random_quaternions(rng, shape)], axis=-1)


def camera(rng: np.random.Generator, width: int = 80, height: int = 60) -> Camera:
    """A camera somewhere, whose pixels are not square and whose principal point is off the middle."""
    pose = np.concatenate([rng.normal(0.0, 1.0, 3), poses.random_quaternions(rng, ())])
    return Camera(width, height, 0.9 * width, 0.93 * width, 0.47 * width, 0.52 * height, pose)


def observation(views: list[View]) -> Observation:
    nothing = np.zeros((0, 3))
    return Observation(tuple(views), nothing, nothing, np.zeros((0, 4)), np.array([0.0, 0.0, 1.0]), None)


def view(eye: Camera, depth: NDArray[np.float32], category: NDArray[np.uint8]) -> View:
    return View(eye, depth, category, np.zeros((*depth.shape, 3), dtype=np.float32))


def rough_view(rng: np.random.Generator, eye: Camera, surfaces: Surfaces, pose: Array) -> View:
    """What `eye` would see of the parts, made rough: noise, all categories mixed, holes."""
    depth, _ = render(eye, surfaces, pose)
    depth = np.where(depth > 0, depth, 2.0) + rng.normal(0.0, 0.02, depth.shape)
    kinds, shares = [NO_DEPTH, OBJECT, SUPPORT, OUTSIDE, CONTINUED], [0.1, 0.5, 0.2, 0.1, 0.1]
    category = rng.choice(kinds, depth.shape, p=shares).astype(np.uint8)
    return view(eye, np.where(category == NO_DEPTH, 0.0, depth).astype(np.float32), category)


def in_camera(eye: Camera, pose_world_part: Array, points: Array) -> Array:
    """Points (P, 3) of a part in the camera's frame."""
    pose_camera_part = poses.multiply(poses.inverse(eye.pose_world_camera), pose_world_part)
    return poses.transform_points(pose_camera_part, points.astype(np.float64))
