"""Normals of planes and spheres whose normals are known, at steps, and where nothing was measured."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from pmpnbp.geometry.camera import Camera
from pmpnbp.scene.normals import surface_normals

CAMERA = Camera(60, 50, 60.0, 62.0, 29.0, 25.5)
RAYS = CAMERA.rays().astype(np.float64)


def plane_depth(normal: NDArray[np.float64], distance: float) -> NDArray[np.float32]:
    """Depth of the plane n·P = -distance, 0 where it is behind the camera or the ray grazes it."""
    with np.errstate(divide="ignore"):
        depth = -distance / (RAYS @ normal)
    return np.where((depth > 0.1) & (depth < 4.0), depth, 0.0).astype(np.float32)


def degrees(found: NDArray[np.float32], truth: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.degrees(np.arccos(np.clip((found * truth).sum(axis=-1), -1, 1)))


@pytest.mark.parametrize("tilt", [0.0, 0.4, 0.8, 1.1])
@pytest.mark.parametrize("direction", [0.0, 1.0, 2.5, 4.0])
def test_planes_are_exact(tilt: float, direction: float) -> None:
    normal = np.array([np.sin(tilt) * np.cos(direction), np.sin(tilt) * np.sin(direction), -np.cos(tilt)])
    depth = plane_depth(normal, 1.0)
    found = surface_normals(depth, CAMERA)
    known = (found != 0).any(axis=-1)
    cosine = -(RAYS @ normal) / np.linalg.norm(RAYS, axis=-1)
    # steep planes differ by more than the gate from pixel to pixel far away; what faces the camera is all known
    facing = (depth > 0) & (depth < 1.5) & (cosine > 0.5)
    assert known[facing].mean() > 0.9
    assert degrees(found[known], normal).max() < 0.1
    np.testing.assert_allclose(np.linalg.norm(found[known], axis=-1), 1.0, atol=1e-5)


def test_a_sphere(rng: np.random.Generator) -> None:
    centre, radius = np.array([0.05, -0.1, 1.2]), 0.35
    b = RAYS @ centre
    a = (RAYS**2).sum(axis=-1)
    root = b**2 - a * (centre @ centre - radius**2)
    depth = np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a, 0.0).astype(np.float32)
    truth = (RAYS * depth[..., None] - centre) / radius
    found = surface_normals(depth, CAMERA)
    central = (depth > 0) & (truth[..., 2] < -0.7)
    assert (found[central] != 0).any(axis=-1).all()
    assert degrees(found[central], truth[central]).max() < 3.0
    # with noise of 1 mm over windows of about 10 cm a normal is off by a few degrees and never by a lot:
    # a false alarm would be an error of more than ten standard deviations
    noisy = depth + np.float32(0.001) * rng.standard_normal(depth.shape).astype(np.float32) * (depth > 0)
    assert np.median(degrees(surface_normals(noisy, CAMERA)[central], truth[central])) < 3.0


def test_a_step_does_not_bend_the_normals_beside_it() -> None:
    depth = np.full((50, 60), 1.0, dtype=np.float32)
    depth[:, 30:] = 1.3
    found = surface_normals(depth, CAMERA)
    assert (found[2:-2, 2:-2] != 0).any(axis=-1).all()
    assert degrees(found[2:-2, 2:-2], np.array([0.0, 0.0, -1.0])).max() < 0.01


def test_unknown_where_little_was_measured() -> None:
    depth = np.zeros((50, 60), dtype=np.float32)
    depth[10, 10] = depth[20, 20:24] = depth[40:42, 40:43] = 1.0
    depth[30, 5:55] = 1.0
    assert not surface_normals(depth, CAMERA).any()


def test_unknown_on_rubble(rng: np.random.Generator) -> None:
    """Depths scattered over 8 cm lie on no plane to within a centimetre, but for windows with few points at the rim:
    fewer than a tenth are taken for a surface, against 4 % to 5 % over a dozen draws."""
    depth = (1.0 + rng.uniform(-0.04, 0.04, (50, 60))).astype(np.float32)
    assert (surface_normals(depth, CAMERA) != 0).any(axis=-1).mean() < 0.1
