"""The rasteriser against its specification: coverage, depth, scores, and what a z-buffer must never do."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import Delaunay

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.potentials.kernels import rasteriser, reference
from pmpnbp.potentials.surfaces import Surfaces, prepare_surfaces
from pmpnbp.potentials.unary import (
    PixelScore,
    object_scores,
    object_scores_by_each,
    render,
    unary_scores,
    visible_fractions,
)
from pmpnbp.scene.articulated_object import Mesh
from pmpnbp.scene.observation import OBJECT
from tests.potentials import posed_parts

FORMS = [PixelScore("robust", tolerance=0.03, firm_cost=6.0, firm_step=0.02, edge_weight=0.4), PixelScore("distance")]
EYE = Camera(80, 60, 75.0, 73.0, 38.2, 31.3)


@pytest.fixture(scope="module")
def surfaces() -> Surfaces:
    return prepare_surfaces(posed_parts.object_of([*posed_parts.shapes().values(), posed_parts.NOTHING]))


def lens(eye: Camera) -> Array:
    return np.array([eye.fx, eye.fy, eye.cx, eye.cy])


def part_mesh(surfaces: Surfaces, node: int) -> tuple[Array, np.ndarray]:
    begin, end = surfaces.vertex_offsets[node : node + 2]
    first, last = surfaces.face_offsets[node : node + 2]
    return surfaces.vertices[:, begin:end].T.astype(np.float64), surfaces.faces[:, first:last].T


def slow_depth(surfaces: Surfaces, node: int, eye: Camera, pose: Array) -> Array:
    vertices, faces = part_mesh(surfaces, node)
    return reference.draw(posed_parts.in_camera(eye, pose, vertices), faces, lens(eye), eye.width, eye.height)


def single(mesh: Mesh) -> Surfaces:
    return prepare_surfaces(posed_parts.object_of([mesh]))


@pytest.mark.parametrize("distance", [0.8, 0.25, 0.0], ids=["ahead", "close", "around the camera"])
def test_every_pixel_is_that_of_the_reference(rng: np.random.Generator, surfaces: Surfaces, distance: float) -> None:
    """Also where parts lie across the near plane, or hold the camera. Single precision may decide otherwise where a
    pixel's centre lies on an edge: at most one covered pixel in a thousand, and depth within 0.01 mm per metre but for
    surfaces seen edge on."""
    differing, covered, worst = 0, 0, []
    for _ in range(12):
        eye = posed_parts.camera(rng)
        ahead = poses.transform_points(eye.pose_world_camera, np.array([0.0, 0.0, distance]))
        pose = posed_parts.random_poses(rng, (5,), ahead, 0.1)
        for node in range(4):
            slow = slow_depth(surfaces, node, eye, pose[node])
            fast = rasteriser.part_depth(node, pose[node], view_of(eye), surfaces.mesh)
            both = (slow > 0) & (fast > 0)
            relative = np.abs(fast - slow)[both] / slow[both]
            differing += np.count_nonzero((slow > 0) != (fast > 0)) + np.count_nonzero(relative > 1e-3)
            covered += np.count_nonzero(slow > 0)
            worst.append(np.sort(relative)[: int(0.999 * len(relative))].max(initial=0.0))
    assert covered > 5000
    assert differing <= covered / 1000
    assert max(worst) < 1e-5


def view_of(eye: Camera) -> tuple[Array, Array, int, int]:
    return lens(eye), poses.inverse(eye.pose_world_camera), eye.width, eye.height


@pytest.mark.parametrize("score", FORMS, ids=lambda score: score.form)
def test_part_scores_are_those_of_the_reference(
    rng: np.random.Generator, surfaces: Surfaces, score: PixelScore
) -> None:
    ahead = np.array([0.0, 0.0, 0.7])
    truth = posed_parts.random_poses(rng, (5,), ahead, 0.1)
    seen = posed_parts.rough_view(rng, EYE, surfaces, truth)
    count = 60
    part, pose = rng.integers(0, 5, count), posed_parts.random_poses(rng, (count,), ahead, 0.3)
    fast = unary_scores(posed_parts.observation([seen]), surfaces, part, pose, score, renderer="rasteriser")
    slow = np.zeros(count)
    for i in range(count):
        vertices, faces = part_mesh(surfaces, part[i])
        cloud = posed_parts.in_camera(EYE, pose[i], vertices)
        terms = score.terms.astype(np.float64)
        slow[i] = reference.part_score(
            seen.depth, seen.category, lens(EYE), cloud, faces, terms, score.form == "robust", seen.firm
        )
    # a pixel on an edge, or at the tolerance, may go either way
    close = np.isclose(fast, slow, rtol=1e-3, atol=0.02)
    assert np.mean(close) > 0.9
    np.testing.assert_allclose(fast, slow, rtol=1e-3, atol=2.5)
    assert np.abs(slow).max() > 50


@pytest.mark.parametrize("score", FORMS, ids=lambda score: score.form)
@pytest.mark.parametrize("count", [1, 40])
def test_objects_drawn_once_have_the_scores_of_each(
    rng: np.random.Generator, surfaces: Surfaces, score: PixelScore, count: int
) -> None:
    pose = posed_parts.random_poses(rng, (count, 5), np.array([0.0, 0.0, 0.8]), 0.12)
    seen = posed_parts.observation([posed_parts.rough_view(rng, EYE, surfaces, pose[0])])
    wider = [replace(score, tolerance=tolerance) for tolerance in (0.005, 0.02, 0.05)]
    found = object_scores_by_each(seen, surfaces, pose, wider)
    assert found.shape == (count, 3)
    for column, one in zip(found.T, wider, strict=True):
        np.testing.assert_array_equal(column, object_scores(seen, surfaces, pose, one))


@pytest.mark.parametrize("score", FORMS, ids=lambda score: score.form)
@pytest.mark.parametrize("count", [2, 40])
def test_object_scores_are_those_of_the_reference(
    rng: np.random.Generator, surfaces: Surfaces, score: PixelScore, count: int
) -> None:
    ahead = np.array([0.0, 0.0, 0.8])
    pose = posed_parts.random_poses(rng, (count, 5), ahead, 0.12)
    seen = posed_parts.rough_view(rng, EYE, surfaces, pose[0])
    totals = object_scores(posed_parts.observation([seen]), surfaces, pose, score)
    for i in range(2):
        meshes = [part_mesh(surfaces, node) for node in range(5)]
        clouds = [posed_parts.in_camera(EYE, pose[i, node], meshes[node][0]) for node in range(5)]
        slow = reference.object_score(
            seen.depth,
            seen.category,
            lens(EYE),
            clouds,
            [faces for _, faces in meshes],
            score.terms.astype(np.float64),
            score.form == "robust",
            seen.firm,
            seen.patches,
        )
        # a pixel on an edge, or at the tolerance, may go either way
        np.testing.assert_allclose(totals[i], slow, rtol=2e-3, atol=2.5)


def test_a_mesh_of_slivers_has_no_cracks(rng: np.random.Generator) -> None:
    """A square, cut into triangles at random vertices, some of them exactly on pixel centres: every pixel within the
    square is covered, at the square's depth."""
    points = np.concatenate(
        [
            [[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]],
            rng.uniform(-0.2, 0.2, (60, 2)),
            np.round(rng.uniform(-18, 18, (60, 2))) / 100.0,
            np.stack([np.linspace(-0.19, 0.19, 60), np.linspace(-0.19, 0.1901, 60)], axis=1),
        ]
    )
    faces = Delaunay(points).simplices.astype(np.int32)
    mesh = Mesh(np.column_stack([points, np.ones(len(points))]), faces)
    eye = Camera(60, 60, 100.0, 100.0, 30.0, 30.0)
    depth, number = render(eye, single(mesh), poses.IDENTITY[None])
    within = np.zeros((60, 60), dtype=bool)
    within[11:50, 11:50] = True
    assert np.all(number[within] == 0)
    np.testing.assert_allclose(depth[within], 1.0, rtol=1e-6)
    assert not depth[:10].any() and not depth[51:].any() and not depth[:, :10].any() and not depth[:, 51:].any()


def test_leaving_out_what_turns_away_changes_no_picture(rng: np.random.Generator) -> None:
    for name, mesh in posed_parts.shapes().items():
        surfaces = single(mesh)
        assert bool(surfaces.one_sided.all()) == (name != "open plate")
        assert bool(surfaces.one_sided.any()) == (name != "open plate")
        both_sides = Surfaces(**{**vars(surfaces), "one_sided": np.zeros_like(surfaces.one_sided)})
        for _ in range(20):
            pose = posed_parts.random_poses(rng, (1,), np.array([0.0, 0.0, 0.7]), 0.2)
            one, two = render(EYE, surfaces, pose)[0], render(EYE, both_sides, pose)[0]
            assert np.count_nonzero(np.abs(one - two) > 1e-4) <= 1


def test_a_mesh_that_is_inside_out_or_welded_by_place_only_is_still_closed() -> None:
    """As read from STL every triangle has its own vertices; and some files have all faces turned."""
    box = posed_parts.shapes()["box"]
    soup = Mesh(box.vertices[box.faces].reshape(-1, 3), np.arange(box.faces.size, dtype=np.int32).reshape(-1, 3))
    turned = Mesh(soup.vertices, soup.faces[:, ::-1])
    plain, from_soup, from_turned = single(box), single(soup), single(turned)
    assert from_soup.one_sided.all() and from_turned.one_sided.all()
    pose = np.array([[0.0, 0.0, 0.9, 0.9, 0.1, 0.4, 0.1]])
    pose[:, 3:] /= np.linalg.norm(pose[:, 3:])
    expected = render(EYE, plain, pose)[0]
    assert expected.any()
    for surfaces in (from_soup, from_turned):
        np.testing.assert_allclose(render(EYE, surfaces, pose)[0], expected, atol=1e-5)


def test_a_camera_inside_a_closed_part_sees_its_inner_side() -> None:
    depth, _ = render(EYE, single(posed_parts.shapes()["box"]), poses.IDENTITY[None])
    np.testing.assert_allclose(depth[31, 38], 0.125, rtol=1e-5)
    assert np.all(depth > 0)


def test_a_part_behind_the_camera_or_beside_the_image_covers_nothing(surfaces: Surfaces) -> None:
    seen = posed_parts.view(EYE, np.ones((60, 80), dtype=np.float32), np.full((60, 80), OBJECT, dtype=np.uint8))
    pose = np.tile(poses.IDENTITY, (3, 1))
    pose[:, :3] = [[0.0, 0.0, -1.0], [5.0, 0.0, 1.0], [0.0, -5.0, 1.0]]
    for renderer in ("splats", "rasteriser"):
        scores = unary_scores(
            posed_parts.observation([seen]), surfaces, np.zeros(3, dtype=int), pose, FORMS[0], renderer=renderer
        )
        np.testing.assert_array_equal(scores, 0.0)


def test_render_says_which_part_is_in_front(surfaces: Surfaces) -> None:
    pose = np.tile(poses.IDENTITY, (5, 1))
    pose[:, 2] = [1.0, 0.6, 3.0, 3.0, 0.4]
    pose[2:4, 0] = 50.0
    depth, number = render(EYE, surfaces, pose)
    assert number[31, 38] == 1 and depth[31, 38] == pytest.approx(0.48, abs=1e-3)
    assert set(np.unique(number)) == {-1, 0, 1}
    np.testing.assert_array_equal(depth > 0, number >= 0)


def test_poses_of_a_recording_need_no_kernel_of_their_own(surfaces: Surfaces) -> None:
    """They are read-only, which is a type of its own to numba."""
    pose = np.tile(poses.IDENTITY, (len(surfaces.centres), 1))
    expected, _ = render(EYE, surfaces, pose)
    compiled = len(rasteriser.object_depth.signatures)
    pose.setflags(write=False)
    np.testing.assert_array_equal(render(EYE, surfaces, pose)[0], expected)
    assert len(rasteriser.object_depth.signatures) == compiled


def test_visible_fractions(surfaces: Surfaces) -> None:
    """A box half behind something the sensor saw in front, a ball wholly in front of the box, a tube behind it, and a
    plate outside the image."""
    pose = np.tile(poses.IDENTITY, (5, 1))
    pose[:, :3] = [[0.0, 0.0, 1.0], [0.12, 0.05, 0.7], [0.0, 0.0, 2.0], [50.0, 0.0, 1.0], [0.0, 0.0, 0.5]]
    depth, number = render(EYE, surfaces, pose)
    depth[:, :38] = np.where(number[:, :38] == 0, 0.5, depth[:, :38])
    seen = posed_parts.view(EYE, depth, np.full(depth.shape, OBJECT, dtype=np.uint8))
    found = visible_fractions(posed_parts.observation([seen]), surfaces, pose, 0.02)
    alone = np.count_nonzero(rasteriser.part_depth(0, pose[0], view_of(EYE), surfaces.mesh))
    expected = np.count_nonzero(number[:, 38:] == 0) / alone
    assert 0.1 < expected < 0.5
    np.testing.assert_allclose(found, [expected, 1.0, 0.0, 0.0, 0.0], atol=1e-12)
    # a second view in which nothing is hidden counts for the best
    clear = posed_parts.view(EYE, np.zeros_like(depth), np.zeros(depth.shape, dtype=np.uint8))
    best = visible_fractions(posed_parts.observation([seen, clear]), surfaces, pose, 0.02)
    np.testing.assert_allclose(best[0], np.count_nonzero(number == 0) / alone)


def test_no_parts_to_score_and_no_views(surfaces: Surfaces) -> None:
    empty = posed_parts.observation([])
    pose = np.tile(poses.IDENTITY, (5, 1))
    for renderer in ("splats", "rasteriser"):
        scores = unary_scores(empty, surfaces, np.arange(5), pose, FORMS[0], renderer=renderer)
        np.testing.assert_array_equal(scores, 0.0)
    seen = posed_parts.view(EYE, np.ones((60, 80), dtype=np.float32), np.ones((60, 80), dtype=np.uint8))
    for renderer in ("splats", "rasteriser"):
        nothing = unary_scores(
            posed_parts.observation([seen]),
            surfaces,
            np.zeros(0, dtype=int),
            np.zeros((0, 7)),
            FORMS[0],
            renderer=renderer,
        )
        assert nothing.shape == (0,)
