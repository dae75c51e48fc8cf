"""The splat kernel against its specification, and what its surface points must be."""

from __future__ import annotations

import numba
import numpy as np
import pytest
import trimesh

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.potentials.kernels import reference, splat_models, splatting
from pmpnbp.potentials.surfaces import Surfaces, prepare_surfaces
from pmpnbp.potentials.unary import PixelScore, unary_scores
from pmpnbp.scene.observation import OBJECT
from tests.potentials import posed_parts

FORMS = [PixelScore("robust", tolerance=0.03, firm_cost=6.0, firm_step=0.02, edge_weight=0.4), PixelScore("distance")]


@pytest.fixture(scope="module")
def surfaces() -> Surfaces:
    return prepare_surfaces(posed_parts.object_of([*posed_parts.shapes().values(), posed_parts.NOTHING]))


def cell_of(surfaces: Surfaces, eye: Camera, node: int, pose: np.ndarray) -> int:
    """The view direction's cell, by nearest direction and not by the grid's formula."""
    centre = posed_parts.in_camera(eye, pose, surfaces.centres[node][None])[0]
    turn = poses.multiply(poses.inverse(eye.pose_world_camera), pose)[3:]
    along = poses.rotate(poses.quaternion_conjugate(turn), centre / np.linalg.norm(centre))
    return splatting.direction_cell(*along, 16)


@pytest.mark.parametrize("score", FORMS, ids=lambda score: score.form)
@pytest.mark.parametrize("points", [256, 100])
def test_splat_scores_are_those_of_the_reference(
    rng: np.random.Generator, surfaces: Surfaces, score: PixelScore, points: int
) -> None:
    """Some 500 poses, many partly outside the image or behind the camera. A point that falls within float32 rounding
    of a pixel's border may be looked up next door: a few poses may differ by a point or two."""
    eye = posed_parts.camera(rng)
    ahead = poses.transform_points(eye.pose_world_camera, np.array([0.0, 0.0, 0.7]))
    truth = posed_parts.random_poses(rng, (5,), ahead, 0.1)
    seen = posed_parts.rough_view(rng, eye, surfaces, truth)
    part = rng.integers(0, 5, 500)
    pose = posed_parts.random_poses(rng, (500,), ahead, 0.5)
    fast = unary_scores(posed_parts.observation([seen]), surfaces, part, pose, score, points=points)
    lens = np.array([eye.fx, eye.fy, eye.cx, eye.cy])
    slow, one = np.zeros(500), np.zeros(500)
    for i in range(500):
        cell = cell_of(surfaces, eye, part[i], pose[i])
        cloud = posed_parts.in_camera(eye, pose[i], surfaces.points[part[i], cell, :, :points].T)
        area = float(surfaces.areas[part[i], cell])
        slow[i] = reference.splat_score(
            seen.depth, seen.category, lens, cloud, area, score.terms, score.form == "robust", seen.firm
        )
        # what one point can be worth
        one[i] = 2.0 * area * eye.fx * eye.fy / max(cloud[:, 2].min(), 0.05) ** 2 / points
    close = np.isclose(fast, slow, rtol=1e-4, atol=1e-3)
    assert np.mean(close) > 0.97
    assert np.all(np.abs(fast - slow)[~close] <= 3.0 * one[~close])
    assert np.abs(slow).max() > 100 * score.terms[0]


def test_views_add_up(rng: np.random.Generator, surfaces: Surfaces) -> None:
    eyes = [posed_parts.camera(rng), posed_parts.camera(rng, 60, 50)]
    pose = posed_parts.random_poses(rng, (5,), np.zeros(3), 0.1)
    views = [posed_parts.rough_view(rng, eye, surfaces, pose) for eye in eyes]
    many = posed_parts.random_poses(rng, (200,), np.zeros(3), 0.2)
    part = rng.integers(0, 5, 200)
    for renderer in ("splats", "rasteriser"):
        single = [
            unary_scores(posed_parts.observation([one]), surfaces, part, many, FORMS[0], renderer=renderer)
            for one in views
        ]
        both = unary_scores(posed_parts.observation(views), surfaces, part, many, FORMS[0], renderer=renderer)
        np.testing.assert_allclose(both, single[0] + single[1], rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("renderer", ["splats", "rasteriser"])
def test_scores_do_not_depend_on_the_number_of_threads_nor_on_the_batch(
    rng: np.random.Generator, surfaces: Surfaces, renderer: str
) -> None:
    eye = posed_parts.camera(rng)
    ahead = poses.transform_points(eye.pose_world_camera, np.array([0.0, 0.0, 0.7]))
    seen = posed_parts.rough_view(rng, eye, surfaces, posed_parts.random_poses(rng, (5,), ahead, 0.1))
    scene = posed_parts.observation([seen])
    count = splatting.PARALLEL_FROM + 500
    part, pose = rng.integers(0, 5, count), posed_parts.random_poses(rng, (count,), ahead, 0.2)
    results = []
    before = numba.get_num_threads()
    try:
        for threads in (1, before):
            numba.set_num_threads(threads)
            results.append(unary_scores(scene, surfaces, part, pose, FORMS[0], renderer=renderer))
    finally:
        numba.set_num_threads(before)
    alone = unary_scores(scene, surfaces, part[-7:], pose[-7:], FORMS[0], renderer=renderer)
    np.testing.assert_array_equal(results[0], results[1])
    np.testing.assert_array_equal(results[1][-7:], alone)


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e30])
def test_a_pose_without_a_place_is_refused(rng: np.random.Generator, surfaces: Surfaces, bad: float) -> None:
    seen = posed_parts.rough_view(rng, Camera(20, 20, 20, 20, 10, 10), surfaces, np.tile(poses.IDENTITY, (5, 1)))
    pose = np.tile(poses.IDENTITY, (3, 1))
    pose[1, 2] = bad
    with pytest.raises(ValueError, match="not finite, or further than 1000 km"):
        unary_scores(posed_parts.observation([seen]), surfaces, np.zeros(3, dtype=int), pose, FORMS[0])


def test_a_part_number_that_does_not_exist_is_refused(rng: np.random.Generator, surfaces: Surfaces) -> None:
    seen = posed_parts.rough_view(rng, Camera(20, 20, 20, 20, 10, 10), surfaces, np.tile(poses.IDENTITY, (5, 1)))
    pose = np.tile(poses.IDENTITY, (2, 1))
    with pytest.raises(ValueError, match="parts 0 to 5 were named; there are 5"):
        unary_scores(posed_parts.observation([seen]), surfaces, np.array([0, 5]), pose, FORMS[0])


def test_the_direction_grid_finds_the_cell_a_direction_was_made_for() -> None:
    for cell in range(256):
        assert splatting.direction_cell(*splat_models.cell_direction(cell, 16), 16) == cell


def test_any_direction_is_looked_along_to_within_a_cell(rng: np.random.Generator) -> None:
    grid = np.array([splat_models.cell_direction(cell, 16) for cell in range(256)])
    any_direction = rng.normal(size=(2000, 3))
    any_direction /= np.linalg.norm(any_direction, axis=1, keepdims=True)
    found = np.array([splatting.direction_cell(*direction, 16) for direction in any_direction])
    cosine = np.sum(grid[found] * any_direction, axis=1)
    # the cells are largest about the octahedron's corners
    assert np.rad2deg(np.arccos(cosine.min())) < 14.5
    assert np.rad2deg(np.arccos(cosine)).mean() < 6.0


def test_areas_are_the_projected_areas() -> None:
    """A ball's is that of a disc from everywhere, a box's the sum of its three faces' shares."""
    both = prepare_surfaces(posed_parts.object_of([posed_parts.shapes()["ball"], posed_parts.shapes()["box"]]))
    # the faceted ball lies within the round one
    np.testing.assert_allclose(both.areas[0], np.pi * 0.12**2, rtol=0.03)
    directions = np.abs([splat_models.cell_direction(cell, 16) for cell in range(256)])
    np.testing.assert_allclose(both.areas[1], directions @ [0.2 * 0.25, 0.3 * 0.25, 0.3 * 0.2], rtol=0.02)


def test_points_lie_on_the_visible_surface_and_spread_over_the_projected_area() -> None:
    """Seen along each direction, a box's points lie on its faces that are turned to the viewer, each face holding its
    share of the projected area. The shares are systematic samples of pixels: within 3 % of the points."""
    surfaces = prepare_surfaces(posed_parts.object_of([posed_parts.shapes()["box"]]))
    half = np.array([0.15, 0.1, 0.125])
    for cell in range(0, 256, 5):
        direction = np.array(splat_models.cell_direction(cell, 16))
        points = surfaces.points[0, cell].T
        off_face = np.abs(points + np.sign(direction) * half)
        assert off_face.min(axis=1).max() < 1e-5
        shares = np.abs(direction) * np.array([0.2 * 0.25, 0.3 * 0.25, 0.3 * 0.2])
        found = np.bincount(off_face.argmin(axis=1), minlength=3) / 256
        np.testing.assert_allclose(found, shares / shares.sum(), atol=0.03)


def test_the_first_points_are_a_sample_of_all() -> None:
    """The mean of the first 64 points of a direction differs from that of all 256 by what chance makes of it: over
    the 256 directions and 3 axes the mean square of the difference, in its own standard deviations, is 1 to within
    0.35 (some 500 independent values: five standard deviations, a false alarm in a million)."""
    surfaces = prepare_surfaces(posed_parts.object_of([posed_parts.shapes()["ball"]]))
    points = surfaces.points[0].astype(np.float64)
    spread = points.std(axis=2)
    expected = spread * np.sqrt((1 - 64 / 256) / 64 * 256 / 255)
    difference = points[:, :, :64].mean(axis=2) - points.mean(axis=2)
    assert np.mean((difference / expected) ** 2) == pytest.approx(1.0, abs=0.35)


def test_surfaces_are_the_same_every_time_and_made_once() -> None:
    model = posed_parts.object_of([posed_parts.shapes()["tube"]])
    first, fresh = prepare_surfaces(model), prepare_surfaces.__wrapped__(model)  # type: ignore[attr-defined]
    for name, array in vars(fresh).items():
        np.testing.assert_array_equal(getattr(first, name), array)
    assert prepare_surfaces(posed_parts.object_of([posed_parts.shapes()["tube"]])) is first
    box = prepare_surfaces(posed_parts.object_of([posed_parts.shapes()["box"]]))
    assert box.points.shape == first.points.shape and np.any(box.points != first.points)
    assert prepare_surfaces(model, points=64).points.shape[-1] == 64


def test_directions_must_be_a_square_number() -> None:
    with pytest.raises(ValueError, match="directions is 200; a square number"):
        prepare_surfaces(posed_parts.object_of([posed_parts.shapes()["box"]]), directions=200)


def test_splats_and_rasteriser_agree_on_a_fronto_parallel_plate() -> None:
    """Seen straight on every approximation of the splats vanishes, but for their share of the outline's pixels."""
    plate = posed_parts.mesh_of(trimesh.creation.box((0.3, 0.2, 0.002)))
    surfaces = prepare_surfaces(posed_parts.object_of([plate]))
    eye = Camera(160, 120, 140.0, 140.0, 79.5, 59.5)
    depth = np.full((120, 160), 0.801, dtype=np.float32)
    seen = posed_parts.view(eye, depth, np.full(depth.shape, OBJECT, dtype=np.uint8))
    pose = np.array([[0.0, 0.0, 0.8, 1.0, 0.0, 0.0, 0.0]])
    scores = [
        unary_scores(posed_parts.observation([seen]), surfaces, np.array([0]), pose, FORMS[0], renderer=renderer)[0]
        for renderer in ("splats", "rasteriser")
    ]
    assert scores[0] == pytest.approx(scores[1], rel=0.03)
