"""Smooth errors of depth are read off flat surfaces; noise, of single pixels or of neighbours, is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.depth_distortion import depth_distortion
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.observe import observe
from tests.inference import small_worlds as worlds

CAMERA = worlds.camera_at((0.0, 0.0, 1.2), (2.0, 0.3, 0.2), width=320, height=240)
# floor and back wall, and the tolerance about them
PLANES, TOLERANCE = np.array([[0.0, 0.0, 1.0, 0.0], [-1.0, 0.0, 0.0, 3.0]]), (0.01, 0.002)


def room() -> Array:
    """(h, w) metres: the floor, and the wall that stands on it."""
    pose = np.asarray(CAMERA.pose_world_camera)
    rays = np.asarray(CAMERA.rays(), dtype=np.float64) @ worlds.poses.to_matrix(pose)[:3, :3].T
    heights = PLANES[:, :3] @ pose[:3] + PLANES[:, 3]
    with np.errstate(divide="ignore"):
        depths = [np.where(rays @ n[:3] < 0, h / -(rays @ n[:3]), np.inf) for n, h in zip(PLANES, heights, strict=True)]
    return np.minimum(*depths)


def found(share: Array | float, planes: Array = PLANES) -> float:
    """What is told of the room's depths that are wrong by so much of them."""
    return depth_distortion(CAMERA, (room() * (1 + share)).astype(np.float32), planes, *TOLERANCE)


def smooth(rng: np.random.Generator, window: float) -> Array:
    """Deviates of deviation 1 that neighbours within a window, a standard deviation in pixels, share."""
    wide = ndimage.gaussian_filter(rng.standard_normal((640, 720)), window)[200:-200, 200:-200]
    return np.asarray(wide / wide.std(), dtype=np.float64)


@pytest.mark.parametrize("share", [0.0007, 0.0015, 0.003])
@pytest.mark.parametrize("noise", [0.0, 0.002])
def test_a_smooth_error_is_told_whatever_noise_is_on_it(rng: np.random.Generator, share: float, noise: float) -> None:
    """What of it is a plane is not told: of 150 seeds it was 0.84 of it, with a deviation of 0.085, so that chance
    leaves these bounds once in 10,000 times."""
    error = share * smooth(rng, 20.0) + noise * rng.standard_normal((240, 320))
    assert share / 2 < found(error) < 1.2 * share


@pytest.mark.parametrize("noise", [0.001, 0.004])
@pytest.mark.parametrize("window", [0.0, 1.0, 2.5])
def test_noise_is_none(rng: np.random.Generator, noise: float, window: float) -> None:
    """The variance that pairs share over that which tells them apart was, of 150 seeds, 1.45 in a window of 2.5 pixels,
    with a deviation of 0.12, and less in a smaller one: 2 is beyond chance."""
    assert found(noise * (smooth(rng, window) if window else rng.standard_normal((240, 320)))) == 0.0


def test_what_is_linear_in_inverse_depth_is_another_plane_and_no_error() -> None:
    row, column = np.indices((240, 320)) / 320 - 0.4
    assert found(room() * (0.002 * row - 0.001 * column)) < 1e-5


def test_without_planes_or_depth_there_is_none(rng: np.random.Generator) -> None:
    assert found(0.002 * smooth(rng, 20.0), np.zeros((0, 4))) == 0.0
    assert found(-1.0) == 0.0
    # a picture of one row, through which there are many planes
    row = replace(CAMERA, height=1, cy=CAMERA.cy - 200)
    assert depth_distortion(row, room()[200:201].astype(np.float32), PLANES, *TOLERANCE) < 1e-5
    # a plane that the camera is behind, and one that nothing lies on
    assert found(0.002 * smooth(rng, 20.0), np.array([[0, 0, 1, -5.0], [0.0, 0.0, 1.0, -0.4]])) == 0.0


@given(width=st.integers(1, 400), height=st.integers(1, 300), seed=st.integers(0, 999), planes=st.integers(0, 3))
@settings(max_examples=40, deadline=None)
def test_any_picture_has_one_that_is_a_number(width: int, height: int, seed: int, planes: int) -> None:
    rng = np.random.default_rng(seed)
    camera = replace(CAMERA, width=width, height=height, cx=width / 2, cy=height / 2)
    depth: NDArray[np.float32] = rng.uniform(-1, 4, (height, width)).clip(0).astype(np.float32)
    normals = rng.normal(size=(planes, 4))
    normals[:, :3] /= np.linalg.norm(normals[:, :3], axis=1, keepdims=True)
    told = depth_distortion(camera, depth, normals, *TOLERANCE)
    assert np.isfinite(told) and told >= 0


def test_each_view_of_an_observation_has_its_own(rng: np.random.Generator) -> None:
    model, (root, joints) = worlds.cupboard(), worlds.cupboard_truth()
    part_poses, scans = model.part_poses(root, joints), []
    for share in (0.0, 0.002):
        camera: Camera = worlds.camera_at((0.0, 0.0, 1.0), (1.4, 0.0, 0.2), width=320, height=240)
        depth = np.asarray(worlds.scan(model, part_poses, camera).depth, dtype=np.float64)
        rays = np.asarray(camera.rays(), dtype=np.float64) @ worlds.poses.to_matrix(camera.pose_world_camera)[:3, :3].T
        floor = np.where(rays[..., 2] < 0, 1.0 / np.maximum(-rays[..., 2], 1e-9), np.inf)
        depth = np.minimum(depth, floor) * (1 + share * smooth(rng, 20.0))
        scans.append(Scan(camera, depth.astype(np.float32)))
    first, second = observe(scans).views
    assert first.distortion < 1e-6
    assert 0.001 < second.distortion < 0.0032
