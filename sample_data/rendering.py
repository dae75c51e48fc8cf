"""What does the camera see of an object whose pose is known? URDF to triangles, ray casting, and the truth."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import open3d as o3d
import trimesh
import yourdfpy
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from sample_data import sensor

Array = NDArray[np.float64]
BACKGROUND = -1


@dataclass(frozen=True)
class Truth:
    """Where everything is, and how much of it the sensor measured.

    joints : position of every moving joint, metres or radians
    links : 4x4 T_world_link of every link
    visible_fraction : of the pixels that a link would cover if it stood alone, the share where it is measured; links
        without geometry are not listed
    pixels_alone : how many pixels that would be, to weigh the links of one part by
    bounds : (6,) x0 y0 z0 x1 y1 z1, the object's box in world, metres
    """

    joints: dict[str, float]
    links: dict[str, Array]
    visible_fraction: dict[str, float]
    pixels_alone: dict[str, int]
    bounds: Array


@dataclass(frozen=True)
class RayCast:
    """depth : (height, width), metres along z, 0 where nothing is hit; index : which mesh, BACKGROUND where none;
    cosine : between the ray and the surface normal."""

    depth: Array
    index: NDArray[np.int64]
    cosine: Array


def load(urdf: str, folder: Path | None = None) -> yourdfpy.URDF:
    """The model of `urdf` text; meshes are found beside `folder`. Geometry is not loaded here."""
    return yourdfpy.URDF.load(
        io.BytesIO(urdf.encode()), load_meshes=False, build_scene_graph=True, mesh_dir=str(folder or "")
    )


def _shape(geometry: yourdfpy.urdf.Geometry, folder: Path | None) -> trimesh.Trimesh:
    if geometry.box is not None:
        return trimesh.creation.box(extents=geometry.box.size)
    if geometry.cylinder is not None:
        return trimesh.creation.cylinder(geometry.cylinder.radius, geometry.cylinder.length, sections=48)
    if geometry.sphere is not None:
        return trimesh.creation.icosphere(subdivisions=3, radius=geometry.sphere.radius)
    if folder is None:
        raise ValueError(f"mesh {geometry.mesh.filename} needs the folder that its URDF lies in")
    shape = trimesh.load_mesh(folder / geometry.mesh.filename)
    if geometry.mesh.scale is not None:
        shape.apply_transform(np.diag([*np.broadcast_to(geometry.mesh.scale, 3), 1.0]))
    return shape


def link_meshes(model: yourdfpy.URDF, folder: Path | None = None) -> dict[str, trimesh.Trimesh]:
    """The visual surface of every link that has one, in the link's frame."""
    meshes = {}
    for name, link in model.link_map.items():
        shapes = []
        for visual in link.visuals:
            shape = _shape(visual.geometry, folder)
            if visual.origin is not None:
                shape.apply_transform(visual.origin)
            shapes.append(shape)
        if shapes:
            whole = trimesh.util.concatenate(shapes)
            assert isinstance(whole, trimesh.Trimesh)
            meshes[name] = whole
    return meshes


def link_matrices(model: yourdfpy.URDF, joint_positions: dict[str, float], pose_world_base: Array) -> dict[str, Array]:
    """4x4 T_world_link of every link for named joint positions and the base link's pose (7,)."""
    unknown = set(joint_positions) - set(model.actuated_joint_names)
    if unknown:
        raise ValueError(f"joints {sorted(unknown)} are not in the model; it has {model.actuated_joint_names}")
    model.update_cfg({name: joint_positions.get(name, 0.0) for name in model.actuated_joint_names})
    world_base = poses.to_matrix(pose_world_base)
    return {name: world_base @ model.get_transform(name, model.base_link) for name in model.link_map}


def cast(meshes: Sequence[trimesh.Trimesh], camera: Camera) -> RayCast:
    """The nearest of `meshes` (in world) along the ray through every pixel's centre."""
    scene = o3d.t.geometry.RaycastingScene(nthreads=2)
    for mesh in meshes:
        scene.add_triangles(
            o3d.core.Tensor(np.asarray(mesh.vertices, dtype=np.float32)),
            o3d.core.Tensor(np.asarray(mesh.faces, dtype=np.uint32)),
        )
    directions = poses.rotate(camera.pose_world_camera[3:], camera.rays().astype(np.float64))
    origins = np.broadcast_to(camera.pose_world_camera[:3], directions.shape)
    hit = scene.cast_rays(o3d.core.Tensor(np.concatenate([origins, directions], axis=-1).astype(np.float32)))
    distance = hit["t_hit"].numpy().astype(np.float64)  # the rays have depth 1 along z, so this is depth
    found = np.isfinite(distance)
    normals = hit["primitive_normals"].numpy().astype(np.float64)
    length = np.linalg.norm(directions, axis=-1)
    cosine = np.where(found, np.abs(np.sum(normals * directions, axis=-1)) / length, 0.0)
    index = np.where(found, hit["geometry_ids"].numpy().astype(np.int64), BACKGROUND)
    return RayCast(np.where(found, distance, 0.0), index, cosine)


def covered_pixels(mesh: trimesh.Trimesh, camera: Camera) -> int:
    """How many pixels `mesh` (in world) covers if nothing else is there."""
    vertices = poses.transform_points(poses.inverse(camera.pose_world_camera), mesh.vertices)
    if np.any(vertices[:, 2] <= 0):
        return int(np.sum(cast([mesh], camera).index == 0))
    # Rays through the mesh's own box of pixels only: most links are small in the image.
    pixels = camera.project(vertices)[:, :2]
    size = np.array([camera.width, camera.height])
    first = np.clip(np.floor(pixels.min(axis=0)).astype(int) - 1, 0, size)
    width, height = np.clip(np.ceil(pixels.max(axis=0)).astype(int) + 2, 0, size) - first
    if min(width, height) <= 0:
        return 0
    crop = camera.binned(int(first[0]), int(first[1]), 1, int(width), int(height))
    return int(np.sum(cast([mesh], crop).index == 0))


def posed(
    urdf: str, joint_positions: dict[str, float], pose_world_base: Array, folder: Path | None = None
) -> dict[str, trimesh.Trimesh]:
    """The surface of every link that has one, in world."""
    model = load(urdf, folder)
    matrices = link_matrices(model, joint_positions, pose_world_base)
    return {name: mesh.copy().apply_transform(matrices[name]) for name, mesh in link_meshes(model, folder).items()}


def bounds(meshes: dict[str, trimesh.Trimesh]) -> Array:
    """(6,): the axis-aligned box x0 y0 z0 x1 y1 z1 around `meshes`."""
    corners = np.array([mesh.bounds for mesh in meshes.values()])
    return np.concatenate([corners[:, 0].min(axis=0), corners[:, 1].max(axis=0)])


def render_scan(
    urdf: str,
    joint_positions: dict[str, float],
    pose_world_base: Array,
    camera: Camera,
    clutter: Sequence[trimesh.Trimesh],
    rng: np.random.Generator,
    folder: Path | None = None,
    dark: Sequence[str] = (),
    kind: str = "structured_light",
) -> tuple[NDArray[np.uint16], Truth]:
    """A scan of the object among `clutter` (everything else: floor, wall, occluders; meshes in world).

    joint_positions : by name, those not named at 0; pose_world_base : (7,) of the URDF's root link; folder : where the
    URDF's meshes lie; dark : links that are measured in patches only; kind : of depth camera, one of `sensor.KINDS`.
    Returns depth (height, width), uint16 millimetres, 0 where nothing was measured; and the truth.
    """
    model = load(urdf, folder)
    surfaces = posed(urdf, joint_positions, pose_world_base, folder)
    seen = cast([*surfaces.values(), *clutter], camera)
    depth = sensor.measured(seen.depth, seen.cosine, rng, kind)
    if dark:
        numbers = [index for index, name in enumerate(surfaces) if name in dark]
        depth[sensor.lost_in_patches(np.isin(seen.index, numbers), rng)] = 0
    visible, alone = {}, {}
    for index, (name, surface) in enumerate(surfaces.items()):
        alone[name] = covered_pixels(surface, camera)
        visible[name] = float(np.sum((seen.index == index) & (depth > 0)) / max(alone[name], 1))
    joints = {name: float(joint_positions.get(name, 0.0)) for name in model.actuated_joint_names}
    matrices = link_matrices(model, joint_positions, pose_world_base)
    return depth, Truth(joints, matrices, visible, alone, bounds(surfaces))
