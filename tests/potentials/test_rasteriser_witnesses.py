"""The rasteriser against two independent witnesses, an Open3D ray caster and pyrender, on primitives and real meshes.

At most one covered pixel in a thousand may differ, in coverage or by another surface being in front; depth agrees
within 0.1 mm elsewhere.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
import trimesh

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.potentials.surfaces import prepare_surfaces
from pmpnbp.potentials.unary import render
from pmpnbp.scene.articulated_object import Mesh
from tests.potentials import posed_parts

EYE = Camera(640, 480, 600.0, 590.0, 318.2, 243.6)
POSES = 2


def real_meshes(folder: Path) -> list[tuple[str, Mesh]]:
    """The real meshes that can be had as they are, in metres, of at most 30 000 triangles to keep the tests quick."""
    files = sorted(folder.glob("fetch/**/*.STL")) + sorted(folder.glob("real_xarm7/meshes/collision/*.obj"))
    found = []
    for file in files:
        shape = trimesh.load(file, force="mesh")
        if 0 < len(shape.faces) <= 30_000:
            found.append((file.name, posed_parts.mesh_of(shape)))
    return found


def disagreement(ours: Array, theirs: Array) -> tuple[int, int]:
    """How many pixels either covers, and how many of them only one covers or both at depths more than 0.1 mm apart:
    another surface in front, or one seen so nearly edge on that the witness's own rounding moves it so far."""
    covered = (ours > 0) | (theirs > 0)
    other = ((ours > 0) != (theirs > 0)) | (np.abs(ours - theirs) > 1e-4)
    return np.count_nonzero(covered), np.count_nonzero(other)


def placed(rng: np.random.Generator, mesh: Mesh) -> Iterator[Array]:
    """Poses that fill about a third of the image's height, in the middle."""
    centre = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2
    size = np.linalg.norm(mesh.vertices.max(axis=0) - mesh.vertices.min(axis=0))
    for q in poses.random_quaternions(rng, (POSES,)):
        middle = np.array([0.0, 0.0, max(2.5 * size, 0.3)])
        yield np.concatenate([middle - poses.rotate(q, centre), q])


def ray_caster(mesh: Mesh, pose: Array) -> Array:
    scene = o3d.t.geometry.RaycastingScene()
    vertices = poses.transform_points(pose, mesh.vertices).astype(np.float32)
    scene.add_triangles(vertices, mesh.faces.astype(np.uint32))
    directions = EYE.rays()
    rays = np.concatenate([np.zeros_like(directions), directions], axis=-1)
    hit = scene.cast_rays(o3d.core.Tensor(rays), nthreads=1)["t_hit"].numpy()
    return np.where(np.isfinite(hit), hit, 0.0)


class Pyrender:
    """Depth images drawn by OpenGL.

    pyrender draws with several samples to a pixel and hands out the depth of the first, which is not in the pixel's
    middle: the driver is asked where it is (column, row of the image, both from the pixel's upper left corner).
    """

    def __init__(self) -> None:
        import pyrender
        from OpenGL import GL

        self.pyrender = pyrender
        self.renderer = pyrender.OffscreenRenderer(EYE.width, EYE.height)
        self.sample = (0.5, 0.5)
        self(posed_parts.shapes()["box"], np.array([0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0]))
        GL.glBindFramebuffer(GL.GL_FRAMEBUFFER, self.renderer._renderer._main_fb_ms)
        # from the lower left corner
        position = np.zeros(2, dtype=np.float32)
        GL.glGetMultisamplefv(GL.GL_SAMPLE_POSITION, 0, position)
        self.sample = (float(position[0]), 1.0 - float(position[1]))

    def __call__(self, mesh: Mesh, pose: Array) -> Array:
        vertices = poses.transform_points(pose, mesh.vertices)
        near, far = float(vertices[:, 2].min()), float(vertices[:, 2].max())
        # a tight depth range for its 24 bits
        cx, cy = EYE.cx + self.sample[0], EYE.cy + self.sample[1]
        lens = self.pyrender.IntrinsicsCamera(EYE.fx, EYE.fy, cx, cy, znear=0.95 * near, zfar=1.05 * far)
        scene = self.pyrender.Scene()
        # OpenGL looks along -z with y up
        scene.add(lens, pose=np.diag([1.0, -1.0, -1.0, 1.0]))
        shape = trimesh.Trimesh(vertices, mesh.faces, process=False)
        scene.add(self.pyrender.Mesh.from_trimesh(shape, smooth=False))
        flags = self.pyrender.RenderFlags.DEPTH_ONLY | self.pyrender.RenderFlags.SKIP_CULL_FACES
        return np.asarray(self.renderer.render(scene, flags=flags))


@pytest.fixture(scope="module")
def pyrender_depth() -> Iterator[Pyrender]:
    """Skips where there is no OpenGL, but not in CI, which installs it."""
    try:
        witness = Pyrender()
    except Exception as error:
        if os.environ.get("CI") == "true":
            raise
        pytest.skip(f"no off-screen OpenGL: {error}")
    yield witness
    witness.renderer.delete()


def check(rng: np.random.Generator, meshes: list[tuple[str, Mesh]], witness: object) -> None:
    for name, mesh in meshes:
        surfaces = prepare_surfaces(posed_parts.object_of([mesh]), directions=4, points=8)
        for pose in placed(rng, mesh):
            ours, _ = render(EYE, surfaces, pose[None])
            covered, other = disagreement(ours, witness(mesh, pose))  # type: ignore[operator]
            assert covered > 500, name
            assert other <= covered / 1000, (name, other, covered)


def test_primitives_against_the_ray_caster(rng: np.random.Generator) -> None:
    check(rng, list(posed_parts.shapes().items()), ray_caster)


def test_primitives_against_pyrender(rng: np.random.Generator, pyrender_depth: Pyrender) -> None:
    check(rng, list(posed_parts.shapes().items()), pyrender_depth)


def test_real_meshes_against_the_ray_caster(rng: np.random.Generator, shared_data: Path) -> None:
    check(rng, real_meshes(shared_data), ray_caster)


def test_real_meshes_against_pyrender(rng: np.random.Generator, shared_data: Path, pyrender_depth: Pyrender) -> None:
    check(rng, real_meshes(shared_data), pyrender_depth)
