"""What would the camera see of the parts at given poses? Depth, part number and surface normal of every pixel, drawn
off screen by OpenGL through EGL.

OpenGL's objects belong to the thread that made them, so one PartImages lives in one thread; `pmpnbp.pictures.pictures`
sees to that. Normals are drawn as colours without any lighting, so that all shading is done where the picture is
composed.
"""

from __future__ import annotations

import logging
import os
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh
from cachetools import LRUCache
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.articulated_object import ArticulatedObject, Mesh, Part

NOTHING = -1
# Edges sharper than this, radians, stay edges; flatter ones belong to a curved surface and are smoothed.
CREASE = np.deg2rad(35)
# A part of more triangles than this is drawn by its inference mesh.
MAX_TRIANGLES = 200_000
# How many models stay prepared.
KEPT = 8
# Metres: nothing nearer is drawn.
NEAREST = 0.01


class DrawingError(Exception):
    """This machine cannot draw off screen; the text says why."""


@dataclass(frozen=True)
class PartImage:
    """depth : (h, w) float32, metres along z, 0 where no part is
    part : (h, w) int32, its number, NOTHING where none is
    normal : (h, w, 3) float32, unit vectors in the camera frame, towards the camera; zero where no part is
    cosine : (h, w) float32, between the normal and the way to the camera; 1 where no part is
    """

    depth: NDArray[np.float32]
    part: NDArray[np.int32]
    normal: NDArray[np.float32]
    cosine: NDArray[np.float32]


class PartImages:
    """Draws parts. Make, use and close it in one thread. Raises DrawingError where OpenGL cannot be had."""

    def __init__(self) -> None:
        # pyrender reads this when it is first imported; every other platform needs a screen
        os.environ.setdefault("PYOPENGL_PLATFORM", "egl")
        # it tells of every optional part that is not installed
        logging.getLogger("OpenGL").setLevel(logging.WARNING)
        try:
            import pyrender

            self._pyrender = pyrender
            self._renderer = pyrender.OffscreenRenderer(64, 64)
        except Exception as error:  # whatever the driver and its wrappers raise: ImportError, AssertionError, GLError
            reason = " ".join(str(error).split()) or type(error).__name__
            raise DrawingError(
                f"pictures cannot be drawn on this machine: OpenGL through EGL fails ({reason})"
            ) from None
        self._scenes: LRUCache[int, tuple[ArticulatedObject, Any, list[Any]]] = LRUCache(KEPT)

    def close(self) -> None:
        """Free what OpenGL holds."""
        self._scenes.clear()
        self._renderer.delete()

    def draw(self, camera: Camera, model: ArticulatedObject, part_poses: Array) -> PartImage:
        """The parts of `model` at `part_poses` (N, 7), part in world, each before what lies behind it."""
        relative = poses.multiply(poses.inverse(camera.pose_world_camera), part_poses)
        nearest, farthest = _depth_range(model, relative)
        if farthest <= nearest:
            return _empty(camera)
        scene, nodes = self._prepared(model)
        for node, matrix in zip(nodes, poses.to_matrix(relative), strict=True):
            if node is not None:
                scene.set_pose(node, matrix)
        # ours count from the middle of the first pixel, OpenGL's from the picture's corner; it looks along -z, y up
        lens = self._pyrender.IntrinsicsCamera(
            camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5, znear=nearest, zfar=farthest
        )
        eye = scene.add(lens, pose=np.diag([1.0, -1.0, -1.0, 1.0]))
        scene.main_camera_node = eye
        try:
            return self._read(camera, scene, nodes, relative)
        finally:
            scene.remove_node(eye)

    def _read(self, camera: Camera, scene: Any, nodes: list[Any], relative: Array) -> PartImage:
        self._renderer.viewport_width, self._renderer.viewport_height = camera.width, camera.height
        flags = self._pyrender.RenderFlags
        codes = {node: _code(part) for part, node in enumerate(nodes) if node is not None}
        colour, depth = self._renderer.render(scene, flags=flags.SEG | flags.SKIP_CULL_FACES, seg_node_map=codes)
        code = colour[..., :3].astype(np.int32)
        part = code[..., 0] + 256 * code[..., 1] + NOTHING
        colour, _ = self._renderer.render(scene, flags=flags.FLAT | flags.SKIP_CULL_FACES)
        covered = np.flatnonzero(part != NOTHING)
        in_part = colour.reshape(-1, colour.shape[-1])[covered, :3].astype(np.float32) / 127.5 - 1.0
        turned = np.einsum("pij,pj->pi", _rotations(relative)[part.ravel()[covered]], in_part)
        turned /= np.maximum(np.linalg.norm(turned, axis=-1, keepdims=True), 1e-6)
        rays = camera.rays().reshape(-1, 3)[covered]
        along = np.einsum("pi,pi->p", turned, rays) / np.linalg.norm(rays, axis=-1)
        normal, cosine = np.zeros((part.size, 3), np.float32), np.ones(part.size, np.float32)
        normal[covered] = np.where(along > 0, -1, 1)[:, None] * turned  # meshes need not be wound outward
        cosine[covered] = np.abs(along)
        return PartImage(
            np.where(part != NOTHING, depth, np.float32(0)),
            part,
            normal.reshape(*part.shape, 3),
            cosine.reshape(part.shape),
        )

    def _prepared(self, model: ArticulatedObject) -> tuple[Any, list[Any]]:
        """The model's scene and its parts' nodes, None for a part without a surface."""
        key = id(model)
        if key not in self._scenes:
            scene = self._pyrender.Scene(bg_color=np.zeros(4))
            nodes = [scene.add(self._shape(drawn(part))) if part.visible else None for part in model.parts]
            self._scenes[key] = model, scene, nodes  # with the model, so that no other one can have its id
        return self._scenes[key][1:]

    def _shape(self, mesh: Mesh) -> Any:
        corners, normals = smoothed(mesh)
        colours = np.concatenate([(normals + 1.0) / 2.0, np.ones((len(normals), 1))], axis=1)
        material = self._pyrender.MetallicRoughnessMaterial(alphaMode="OPAQUE", doubleSided=True)
        primitive = self._pyrender.Primitive(positions=corners, color_0=colours.astype(np.float32), material=material)
        return self._pyrender.Mesh([primitive])


def drawn(part: Part) -> Mesh:
    """The mesh that a part is drawn by."""
    return part.mesh if len(part.mesh.faces) <= MAX_TRIANGLES else part.inference_mesh


def smoothed(mesh: Mesh) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Corners (3 F, 3) of the triangles and unit normals (3 F, 3) there: of the faces around a corner those count that
    are turned against its own face by less than CREASE."""
    shape = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    shape.merge_vertices(merge_norm=True, merge_tex=True)
    faces, own = np.asarray(shape.faces), np.asarray(shape.face_normals)
    weighted = own * np.asarray(shape.area_faces)[:, None]
    corner_face = np.repeat(np.arange(len(faces)), 3)
    vertex = faces.ravel()
    order = np.argsort(vertex, kind="stable")
    starts = np.searchsorted(vertex[order], np.arange(len(shape.vertices) + 1))
    around = np.diff(starts)[vertex]
    # every corner against every face at its vertex
    first = np.repeat(np.arange(len(vertex)), around)
    offset = np.arange(len(first)) - np.repeat(np.cumsum(around) - around, around)
    other = corner_face[order[starts[vertex[first]] + offset]]
    alike = np.einsum("kc,kc->k", own[corner_face[first]], own[other]) > np.cos(CREASE)
    normals = np.zeros((len(vertex), 3))
    for axis in range(3):
        normals[:, axis] = np.bincount(first, np.where(alike, weighted[other, axis], 0.0), len(vertex))
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.where(length > 0, normals / np.maximum(length, 1e-300), own[corner_face])
    return np.asarray(shape.vertices)[vertex].astype(np.float32), normals.astype(np.float32)


def _code(part: int) -> tuple[int, int, int]:
    """The colour that stands for a part; black is none."""
    return (part - NOTHING) % 256, (part - NOTHING) // 256, 0


def _rotations(relative: Array) -> NDArray[np.float32]:
    """(N, 3, 3) of poses (N, 7)."""
    return poses.to_matrix(relative)[:, :3, :3].astype(np.float32)


def _depth_range(model: ArticulatedObject, relative: Array) -> tuple[float, float]:
    """The nearest and farthest depth at which there can be a surface, metres."""
    depths = [
        poses.transform_points(relative[index], part.mesh.vertices)[:, 2]
        for index, part in enumerate(model.parts)
        if part.visible
    ]
    if not depths:
        return NEAREST, 0.0
    near, far = min(float(depth.min()) for depth in depths), max(float(depth.max()) for depth in depths)
    return max(0.9 * near, NEAREST), 1.1 * far


def _empty(camera: Camera) -> PartImage:
    size = camera.height, camera.width
    nothing = np.full(size, NOTHING, np.int32)
    return PartImage(np.zeros(size, np.float32), nothing, np.zeros((*size, 3), np.float32), np.ones(size, np.float32))
