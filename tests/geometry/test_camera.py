"""The pinhole camera: what is projected comes back along the same ray, and a binned camera sees the same places."""

from __future__ import annotations

import numpy as np
import pytest

from pmpnbp.geometry.camera import Camera

CAMERA = Camera(width=64, height=48, fx=60.0, fy=62.0, cx=30.7, cy=24.2)


def test_the_principal_ray_goes_straight_ahead_with_x_right_and_y_down() -> None:
    camera = Camera(5, 3, 10.0, 20.0, 2.0, 1.0)
    rays = camera.rays()
    assert rays.shape == (3, 5, 3)
    assert rays.dtype == np.float32
    np.testing.assert_array_equal(rays[1, 2], [0, 0, 1])
    np.testing.assert_allclose(rays[1, 3], [0.1, 0, 1], rtol=1e-6)
    np.testing.assert_allclose(rays[2, 2], [0, 0.05, 1], rtol=1e-6)


def test_projection_undoes_back_projection(rng: np.random.Generator) -> None:
    depth = rng.uniform(0.3, 4.0, size=(48, 64)).astype(np.float32)
    points = CAMERA.back_project(depth)
    assert points.shape == (48, 64, 3)
    u, v, z = np.moveaxis(CAMERA.project(points.astype(np.float64)), -1, 0)
    rows, columns = np.mgrid[:48, :64]
    np.testing.assert_allclose(u, columns, atol=1e-4)
    np.testing.assert_allclose(v, rows, atol=1e-4)
    np.testing.assert_array_equal(z, depth)


def test_a_pixel_without_depth_stays_at_the_camera() -> None:
    np.testing.assert_array_equal(CAMERA.back_project(np.zeros((48, 64), np.float32)), 0)


@pytest.mark.parametrize("factor", [1, 2, 3, 4])
def test_a_binned_pixel_looks_along_the_middle_of_its_block(factor: int) -> None:
    column, row, width, height = 5, 7, 10, 8
    binned = CAMERA.binned(column, row, factor, width, height)
    assert (binned.width, binned.height) == (width, height)
    block = CAMERA.rays()[row : row + height * factor, column : column + width * factor]
    middle = block.reshape(height, factor, width, factor, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(binned.rays(), middle, atol=1e-6)


def test_binning_twice_is_binning_once_by_the_product() -> None:
    twice = CAMERA.binned(4, 6, 2, 24, 16).binned(0, 0, 3, 8, 5)
    once = CAMERA.binned(4, 6, 6, 8, 5)
    for name in ("fx", "fy", "cx", "cy"):
        assert getattr(twice, name) == pytest.approx(getattr(once, name))


def test_a_binned_camera_stands_where_the_camera_stood() -> None:
    pose = np.array([1.0, 2, 3, 0, 1, 0, 0])
    camera = Camera(64, 48, 60.0, 60.0, 32.0, 24.0, pose)
    np.testing.assert_array_equal(camera.binned(0, 0, 2, 32, 24).pose_world_camera, pose)
