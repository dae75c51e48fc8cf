"""Smooth patches of a depth image: what goes on is one, what steps or bends is none; and how long they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.scene.observation import CONTINUED, NO_DEPTH, OBJECT, OUTSIDE, Observation, View
from pmpnbp.scene.observe import without_longer_surfaces
from pmpnbp.scene.patches import BEND, BEND_GROWTH, FEWEST, REACH, length, patch_lengths, smooth_patches

CAMERA = Camera(80, 60, 70.0, 70.0, 39.5, 29.5)


def box_on_a_wall(step: float, tilt: float = 0.4) -> np.ndarray:
    """Depth (60, 80), metres: a tilted wall, and on it a plate, 20 x 24 pixels, `step` metres nearer."""
    column, _ = np.meshgrid(np.arange(80), np.arange(60))
    # a plane is linear in inverse depth
    depth = 1.0 / (1.0 / 1.2 + tilt * (column - 39.5) / 70.0)
    depth[20:40, 30:54] -= step
    return depth.astype(np.float32)


def test_a_plate_before_a_wall_is_one_patch_and_the_wall_another() -> None:
    patches = smooth_patches(box_on_a_wall(0.1))
    assert sorted(np.unique(patches)) == [1, 2]
    plate, wall = patches[30, 42], patches[30, 10]
    assert plate != wall and plate > 0 and wall > 0
    # both up to the edge between them, which second differences alone leave to neither
    inside = np.zeros(patches.shape, dtype=bool)
    inside[20:40, 30:54] = True
    assert np.mean(patches[inside] == plate) > 0.97 and np.mean(patches[~inside] == wall) > 0.97
    assert not np.any(patches[inside] == wall) and not np.any(patches[~inside] == plate)


def test_noise_leaves_edges_where_they_are(rng: np.random.Generator) -> None:
    """3 mm at 1.2 m, half of what a surface may be off its plane by."""
    depth = box_on_a_wall(0.1)
    patches = smooth_patches((depth + rng.normal(0, 0.003, depth.shape)).astype(np.float32))
    plate, wall = patches[30, 42], patches[30, 10]
    assert plate != wall
    inside = np.zeros(patches.shape, dtype=bool)
    inside[20:40, 30:54] = True
    assert np.mean(patches[inside] == plate) > 0.85 and np.mean(patches[~inside] == wall) > 0.85
    assert not np.any(patches[inside] == wall) and not np.any(patches[~inside] == plate)


def test_a_low_step_parts_though_noise_hides_some_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """A plate 2.6 times the limit before its wall, noise of 8 mm at 3.6 m: in 20 pictures plate and wall are never one
    patch. By second differences alone they are in some, a few pixels across."""
    depth = 3.0 * box_on_a_wall(0.013, 0.2)
    pictures = []
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(0, 0.008, depth.shape)
        pictures.append((depth + noise).astype(np.float32))

    def joined() -> int:
        found = [smooth_patches(picture) for picture in pictures]
        plates = [np.bincount(patches[22:38, 32:52].ravel()).argmax() for patches in found]
        return sum(
            np.bincount(patches[:, :26].ravel()).argmax() == plate for patches, plate in zip(found, plates, strict=True)
        )

    assert joined() == 0
    monkeypatch.setattr("pmpnbp.scene.patches._parted", lambda patches, inverse, limit: patches)
    assert joined() > 0


def test_a_step_below_the_limit_is_passed_over() -> None:
    limit = BEND + BEND_GROWTH * 1.2
    assert smooth_patches(box_on_a_wall(0.3 * limit)).max() == 1
    assert smooth_patches(box_on_a_wall(3.0 * limit)).max() == 2


def test_a_crease_parts_two_walls() -> None:
    column, _ = np.meshgrid(np.arange(80), np.arange(60))
    corner = (1.0 / (0.7 + 0.9 * np.abs(column - 40) / 70.0)).astype(np.float32)
    patches = smooth_patches(corner)
    assert patches[30, 20] != patches[30, 60] and patches.max() == 2


def test_what_is_not_measured_or_small_is_no_patch(rng: np.random.Generator) -> None:
    assert not smooth_patches(np.zeros((60, 80), np.float32)).any()
    holes = box_on_a_wall(0.1)
    holes[::3] = 0.0  # in reach of every row
    assert not smooth_patches(holes).any()
    assert not smooth_patches(rng.uniform(0.5, 2.0, (60, 80)).astype(np.float32)).any()
    scrap = np.zeros((60, 80), np.float32)
    scrap[10 : 14 + 2 * REACH, 10 : 14 + 2 * REACH] = 1.0  # smooth over 4 x 4 pixels
    assert FEWEST > 16 and not smooth_patches(scrap).any()
    for shape in ((1, 80), (3, 3), (0, 5)):
        assert not smooth_patches(np.ones(shape, np.float32)).any()


def test_length_is_from_end_to_end_whichever_way_points_lie(rng: np.random.Generator) -> None:
    rod = np.stack([np.linspace(0.0, 0.7, 50), rng.uniform(-0.05, 0.05, 50), np.zeros(50)], axis=1)
    turned = poses.rotate(poses.random_quaternions(rng, ()), rod) + rng.normal(size=3)
    assert length(rod) == pytest.approx(0.7, rel=0.02)
    assert length(turned) == pytest.approx(length(rod))
    assert length(rod[:1]) == 0.0


def test_what_lies_on_a_longer_surface_is_not_matched() -> None:
    depth = box_on_a_wall(0.1)
    points = CAMERA.back_project(depth)
    category = np.full(depth.shape, OBJECT, np.uint8)
    category[:, 70:], category[0] = OUTSIDE, NO_DEPTH
    normals = np.zeros((*depth.shape, 3), np.float32)
    normals[..., 2] = -1.0
    view = View(CAMERA, depth, category, normals)
    flat = points[category == OBJECT].astype(np.float64)
    whole = Observation((view,), flat, flat, np.zeros((0, 4)), np.array([0.0, 0.0, 1.0]), None)
    lengths = patch_lengths(view.patches, points)
    wall, plate = lengths[view.patches[30, 10]], lengths[view.patches[30, 42]]
    assert wall > 1.0 > 0.5 > plate > 0.25
    left = without_longer_surfaces(whole, 0.5)
    on_wall = view.patches == view.patches[30, 10]
    assert np.all(left.views[0].category[on_wall & (category == OBJECT)] == CONTINUED)
    np.testing.assert_array_equal(left.views[0].category[~on_wall], category[~on_wall])
    np.testing.assert_array_equal(left.views[0].category[category != OBJECT], category[category != OBJECT])
    assert len(left.points) == len(left.normals) == np.count_nonzero(left.views[0].category == OBJECT)
    assert without_longer_surfaces(whole, 10.0).points.shape == flat.shape
    # nothing to match would help nobody
    bare = replace(whole, views=(View(CAMERA, depth, np.where(on_wall, category, OUTSIDE), normals),))
    assert without_longer_surfaces(bare, 0.5) is bare
