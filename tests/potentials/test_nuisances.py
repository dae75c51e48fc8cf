"""Depth scales, camera offsets and sizes: a part drawn as it appears under them is the scene that has them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.potentials import nuisances
from pmpnbp.potentials.surfaces import prepare_surfaces
from pmpnbp.potentials.unary import PixelScore, object_scores, render, unary_scores
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.observation import OBJECT, Observation
from pmpnbp.settings import Settings, preset
from tests.inference import small_worlds as worlds
from tests.potentials import posed_parts as parts

MODEL = worlds.cupboard()
ROOT, JOINTS = worlds.cupboard_truth()
SURFACES = prepare_surfaces(MODEL, directions=64, points=256)
VIEWS = 2
CAMERAS = worlds.camera_at((0.0, 0.0, 0.7), ROOT[:3]), worlds.camera_at((0.2, 0.9, 0.6), ROOT[:3])


def seen_by(camera_number: int, values: Array, at: Array | None = None) -> Array:
    """Depth (h, w) that a camera has of the cupboard under nuisances (K,), its parts at poses (3, 7)."""
    camera = CAMERAS[camera_number]
    at = MODEL.part_poses(ROOT, JOINTS) if at is None else at
    there = nuisances.apparent(values, camera_number, VIEWS, camera.pose_world_camera, at, SURFACES.axes_at_zero)
    return render(camera, SURFACES, there)[0].astype(np.float64)


def only(**members: Array | float) -> Array:
    """A vector (K,) that is zero but for `scales`, `offsets` or `sizes`."""
    values = np.zeros(7 * VIEWS + 3)
    for name, part in zip(("scales", "offsets", "sizes"), nuisances.split(values, VIEWS), strict=True):
        part[...] = members.get(name, 0.0)
    return values


def test_none_leave_everything_where_it_is() -> None:
    at = MODEL.part_poses(ROOT, JOINTS)
    there = nuisances.apparent(only(), 1, VIEWS, CAMERAS[1].pose_world_camera, at, SURFACES.axes_at_zero)
    matrices = poses.to_matrix(at)
    np.testing.assert_allclose(there[:, :9], matrices[:, :3, :3].reshape(-1, 9), atol=1e-12)
    np.testing.assert_allclose(there[:, 9:], at[:, :3], atol=1e-12)


def test_a_scale_of_depths_moves_no_outline() -> None:
    plain, scaled = seen_by(0, only()), seen_by(0, only(scales=np.array([0.03, -0.5])))
    np.testing.assert_array_equal(scaled > 0, plain > 0)
    np.testing.assert_allclose(scaled, 1.03 * plain, rtol=1e-6)


def test_a_camera_that_stands_elsewhere_sees_the_scene_from_there() -> None:
    offset = np.array([0.02, -0.01, 0.03, 0.01, -0.02, 0.03])
    moved = np.concatenate([offset[:3], poses.from_rotation_vector(offset[3:])])
    camera = replace(CAMERAS[1], pose_world_camera=poses.multiply(CAMERAS[1].pose_world_camera, moved))
    expected, _ = render(camera, SURFACES, MODEL.part_poses(ROOT, JOINTS))
    found = seen_by(1, only(offsets=np.stack([np.zeros(6), offset])))
    assert np.mean((found > 0) != (expected > 0)) < 1e-3
    both = (found > 0) & (expected > 0)
    np.testing.assert_allclose(found[both], expected[both], atol=2e-5)
    np.testing.assert_array_equal(seen_by(0, only(offsets=np.stack([np.zeros(6), offset]))), seen_by(0, only()))


@pytest.mark.parametrize("sizes", [(0.05, 0.0, 0.0), (-0.1, 0.2, 0.1)])
def test_an_object_of_other_sizes_is_drawn_as_the_one_that_is_made_so(sizes: tuple[float, ...]) -> None:
    there = worlds.larger(MODEL, np.array(sizes))
    at = there.part_poses(ROOT, JOINTS)
    expected = render(CAMERAS[0], prepare_surfaces(there, directions=64, points=256), at)[0]
    found = seen_by(0, only(sizes=np.array(sizes)), at)
    assert np.mean((found > 0) != (expected > 0)) < 1e-3
    both = (found > 0) & (expected > 0)
    np.testing.assert_allclose(found[both], expected[both], atol=2e-5)


def test_a_part_covers_as_much_by_splats_as_by_triangles_under_any_sizes(rng: np.random.Generator) -> None:
    """Before nothing, each covered pixel costs 1. In all over 2,000 ways to lie, as one direction's splats stand for
    those around it, by which thin plates cover 2 to 4 % too much: the sum's own spread is 0.5 %, so that a right one is
    beyond 6 % in one of a million runs."""
    sizes, part = np.array([0.4, -0.3, 0.2]), np.tile([1, 2], 1000)
    camera = CAMERAS[0]
    nothing = np.full((camera.height, camera.width), 10.0, dtype=np.float32)
    scan = parts.observation([parts.view(camera, nothing, np.full(nothing.shape, OBJECT, dtype=np.uint8))] * VIEWS)
    lying = np.concatenate([np.tile(ROOT[:3], (2000, 1)), poses.random_quaternions(rng, (2000,))], axis=1)
    score, surfaces = PixelScore(tolerance=0.02), prepare_surfaces(MODEL)
    splats, triangles = (
        unary_scores(scan, surfaces, part, lying, score, renderer=renderer, nuisances=only(sizes=sizes))  # type: ignore[arg-type]
        for renderer in ("splats", "rasteriser")
    )
    assert splats.sum() / triangles.sum() == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize("renderer", ["splats", "rasteriser"])
def test_a_scene_measured_at_a_scale_scores_as_one_that_is_not(rng: np.random.Generator, renderer: str) -> None:
    """All depths and the tolerance times one factor, and the depth scale taken for it: the same score; float32 decides
    a few pixels."""
    score, at = PixelScore(tolerance=0.02), MODEL.part_poses(ROOT, JOINTS)
    tried = poses.perturb(np.tile(at, (20, 1)), rng.normal(0, 0.01, (60, 3)), rng.normal(0, 0.02, (60, 3)))
    number = np.tile(np.arange(3), 20)
    for factor in (0.97, 1.05):
        plain, scaled = (observed(depth_scale, MODEL, at) for depth_scale in (1.0, factor))
        wider = replace(score, tolerance=factor * score.tolerance, unit_distance=factor)
        taken = only(scales=factor - 1.0)
        expected = unary_scores(plain, SURFACES, number, tried, score, renderer=renderer)  # type: ignore[arg-type]
        found = unary_scores(scaled, SURFACES, number, tried, wider, renderer=renderer, nuisances=taken)  # type: ignore[arg-type]
        np.testing.assert_allclose(found, expected, rtol=0.02, atol=3.0)
        whole = tried.reshape(20, 3, 7)
        np.testing.assert_allclose(
            object_scores(scaled, SURFACES, whole, wider, np.tile(taken, (20, 1))),
            object_scores(plain, SURFACES, whole, score),
            rtol=0.005,
            atol=3.0,
        )


def observed(depth_scale: float, model: ArticulatedObject, at: Array) -> Observation:
    """A model at part poses (N, 7) in both cameras, every depth times `depth_scale`."""
    views = []
    for camera in CAMERAS:
        depth, _ = render(camera, prepare_surfaces(model, directions=64, points=256), at)
        depth = np.where(depth > 0, depth, np.float32(4.0)) * np.float32(depth_scale)
        views.append(parts.view(camera, depth, np.full(depth.shape, OBJECT, dtype=np.uint8)))
    return parts.observation(views)


@pytest.mark.parametrize("name", ["depth_scale_std", "camera_std", "size_std"])
def test_what_moves_nothing_is_fixed(name: str) -> None:
    levers = nuisances.levers(np.array([1.5, 2.0]), np.array([0.3, 0.2, 0.2]))
    none = dict.fromkeys(("depth_scale_std", "camera_std", "size_std"), 0.0)
    for std, free in ((1e-155, False), (1e-8, False), (1e-5, True)):
        assert nuisances.prior_stds(replace(Settings(), **none | {name: std}), levers, VIEWS).any() == free


def test_names_levers_and_priors_go_with_the_values() -> None:
    """A settings' `camera_std` moves the object by as much, shifted or turned, and never the first camera."""
    names = nuisances.names(range(VIEWS))
    levers = nuisances.levers(np.array([1.5, 2.0]), np.array([0.3, 0.2, 0.2]))
    settings = replace(Settings(), depth_scale_std=0.01, camera_std=0.02, size_std=0.03)
    stds = nuisances.prior_stds(settings, levers, VIEWS)
    assert len(names) == len(levers) == len(stds) == 7 * VIEWS + 3
    told = {name: (lever, std) for name, lever, std in zip(names, levers, stds, strict=True)}
    assert told["depth_scale/1"] == (2.0, 0.01)
    assert told["camera/0/x"] == (1.0, 0.0) and told["camera/0/rz"] == (1.5, 0.0)
    assert told["camera/1/z"] == (1.0, 0.02) and told["camera/1/rx"] == (2.0, 0.01)
    assert told["size/x"] == (0.3, 0.03) and told["size/z"] == (0.2, 0.03)
    # by default further cameras' offsets alone are free, and in the paper's preset none is
    by_default = dict(zip(names, nuisances.prior_stds(Settings(), levers, VIEWS), strict=True))
    assert {name for name, std in by_default.items() if std} == {f"camera/1/{axis}" for axis in nuisances.CAMERA_AXES}
    assert not nuisances.prior_stds(preset("paper"), levers, VIEWS).any()
