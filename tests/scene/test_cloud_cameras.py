"""The camera fitted to an organised cloud, under noise, holes and outliers, and where there is none to fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmpnbp.errors import ScanError
from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.scene.cloud_cameras import fit_camera, look_at_loose_cloud

CAMERA = Camera(80, 60, 71.0, 69.5, 41.2, 28.7)


def points_of(camera: Camera, rng: np.random.Generator) -> np.ndarray:
    depth = rng.uniform(0.8, 2.5, (camera.height, camera.width)).astype(np.float32)
    return camera.back_project(depth)


def test_outliers_and_holes_do_not_move_the_fit(rng: np.random.Generator) -> None:
    points = points_of(CAMERA, rng)
    draw = rng.random(points.shape[:2])
    points[draw < 0.3] = np.nan
    points[draw > 0.9] += rng.uniform(-0.5, 0.5, points[draw > 0.9].shape).astype(np.float32)
    camera, _ = fit_camera(points, poses.IDENTITY, "a.pcd")
    for name in ("fx", "fy", "cx", "cy"):
        assert getattr(camera, name) == pytest.approx(getattr(CAMERA, name), abs=1e-2)


def test_lens_noise_of_a_tenth_of_a_pixel(rng: np.random.Generator) -> None:
    """4800 pixels with 0.1 pixels of noise place fx (71 pixels per unit of slope, whose deviation is 0.33) to about
    0.1/0.33/70 = 0.004 and the centre to 0.0015; six standard deviations: false alarms below 1 in 10^8."""
    points = points_of(CAMERA, rng)
    points[..., 0] += (0.1 / 71.0 * rng.standard_normal(points.shape[:2]) * points[..., 2]).astype(np.float32)
    camera, _ = fit_camera(points, poses.IDENTITY, "a.pcd")
    assert camera.fx == pytest.approx(71.0, abs=0.026)
    assert camera.cx == pytest.approx(41.2, abs=0.009)


@pytest.mark.parametrize("kind", ["turned", "shuffled", "mirrored", "flat", "empty", "orthographic"])
def test_what_no_pinhole_camera_took(kind: str, rng: np.random.Generator) -> None:
    points = points_of(CAMERA, rng)
    match kind:
        case "turned":
            points = poses.transform_points(poses.from_xyz_rpy([0.1, 0, 0], [0.3, 0.2, 0.1]), points)
        case "shuffled":
            points = rng.permutation(points.reshape(-1, 3)).reshape(points.shape)
        case "mirrored":
            points = points * [-1, 1, 1]
        case "flat":
            points[..., :2] = 0
        case "empty":
            points[:] = np.nan
        case "orthographic":
            points[..., 0] /= points[..., 2]
    with pytest.raises(
        ScanError, match=r"no pinhole camera puts the points of scan 'a\.pcd' at their rows and columns"
    ):
        fit_camera(points, poses.IDENTITY, "a.pcd")


@pytest.mark.parametrize("count", [1, 2, 50, 5000, 200_000])
def test_a_virtual_camera_has_about_as_many_pixels_as_points(count: int, rng: np.random.Generator) -> None:
    slopes = rng.uniform([-0.4, -0.2], [0.3, 0.5], (count, 2))
    z = rng.uniform(1.0, 1.1, (count, 1))
    camera, depth = look_at_loose_cloud(np.concatenate([slopes * z, z], axis=1), poses.IDENTITY, None, "a.xyz")
    assert depth.shape == (camera.height, camera.width)
    assert camera.fx == camera.fy
    assert 1 <= (depth > 0).sum() <= count
    if count >= 5000:
        # Poisson scatter at 1.5 points a pixel fills 1 - exp(-1.5) = 78 %
        assert (depth > 0).mean() == pytest.approx(0.78, abs=0.04)
        # the slopes span 0.7 both ways
        assert camera.width / camera.height == pytest.approx(1.0, abs=0.05)


def test_points_beside_the_view_are_left_out() -> None:
    points = np.array([[0.0, 0.0, 1.0], [0.1, 0.1, 1.0], [50.0, 0.0, 1.0]])
    camera, depth = look_at_loose_cloud(points, poses.IDENTITY, None, "a.xyz")
    assert (depth > 0).sum() == 2
    assert max(camera.width, camera.height) <= 2048
    with pytest.raises(ScanError, match="no point within 65 degrees"):
        look_at_loose_cloud(points[2:], poses.IDENTITY, None, "a.xyz")


def test_points_outside_the_given_picture() -> None:
    with pytest.raises(ScanError, match=r"no point of scan 'a\.xyz' is in the picture of its camera"):
        look_at_loose_cloud(np.array([[5.0, 0.0, 1.0]]), poses.IDENTITY, CAMERA, "a.xyz")


@pytest.mark.parametrize("seen_as_it_is", [0, 30])
def test_a_cloud_in_the_worlds_frame_is_not_taken_for_one_in_its_cameras(
    seen_as_it_is: int, rng: np.random.Generator
) -> None:
    """Without a word thirteen of twelve thousand points were kept, those that happened to lie before the camera."""
    camera = replace(CAMERA, pose_world_camera=poses.from_xyz_rpy([-2.0, 0.0, 0.8], [-np.pi / 2, 0.0, -np.pi / 2]))
    local = points_of(camera, rng).reshape(-1, 3)[:1000]
    world = poses.transform_points(camera.pose_world_camera, local.astype(np.float64))
    mixed = np.concatenate([local[:seen_as_it_is], world[seen_as_it_is:]])
    with pytest.raises(ScanError, match=r"of the 1000 points of scan 'a\.xyz' are in the picture.* the world's frame"):
        look_at_loose_cloud(mixed, poses.IDENTITY, camera, "a.xyz")
    _, depth = look_at_loose_cloud(local, poses.IDENTITY, camera, "a.xyz")
    assert (depth > 0).sum() > 300


def test_a_cloud_of_which_the_camera_sees_little_is_taken(rng: np.random.Generator) -> None:
    """A scanner sees all round, its camera a part of that; in the world's frame no more of it would be seen."""
    camera = replace(CAMERA, pose_world_camera=poses.from_xyz_rpy([-2.0, 0.0, 0.8], [-np.pi / 2, 0.0, -np.pi / 2]))
    round_about = rng.uniform(-3, 3, (5000, 3))
    _, depth = look_at_loose_cloud(round_about, poses.IDENTITY, camera, "a.xyz")
    assert 0 < (depth > 0).sum() < 2000
