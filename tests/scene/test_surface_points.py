"""Points on a surface: where they lie, how many on each face, which way their normals point."""

from __future__ import annotations

import numpy as np
import pytest

from pmpnbp.scene.articulated_object import Mesh
from pmpnbp.scene.meshes import box
from pmpnbp.scene.surface_points import drawn_points, even_points, surface

HALF = np.array([0.5, 1.0, 2.0])
MESH = box(2 * HALF)


def test_even_points_lie_on_the_surface_in_proportion_to_area() -> None:
    points = even_points(MESH, 2800)
    on_face = np.isclose(np.abs(points), HALF)
    assert np.all(np.abs(points) <= HALF + 1e-12)
    assert np.all(on_face.any(axis=1))
    # faces across x, y, z have 8, 4, 2 of every 14 units of area on their two sides
    np.testing.assert_allclose(on_face.sum(axis=0), [1600, 800, 400], atol=30)
    for axis in range(3):  # and evenly so within each
        np.testing.assert_allclose(points[on_face[:, axis]].mean(axis=0), 0, atol=0.05 * 4)
    np.testing.assert_array_equal(points, even_points(MESH, 2800))


def test_drawn_points_are_uniform_and_their_normals_point_out(rng: np.random.Generator) -> None:
    """Counts on the faces are multinomial: 14000 draws give 8000, 4000 and 2000 with standard deviations of at most 59;
    they are met within five (false alarms below one in a million)."""
    points, normals, _ = drawn_points(rng, surface([MESH]), 14_000)
    on_face = np.isclose(np.abs(points), HALF)
    np.testing.assert_allclose(on_face.sum(axis=0), [8000, 4000, 2000], atol=5 * 59)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)
    axis = np.abs(normals).argmax(axis=1)
    rows = np.arange(len(points))
    np.testing.assert_allclose(points[rows, axis], normals[rows, axis] * HALF[axis], atol=1e-12)


def test_meshes_are_drawn_from_by_their_areas(rng: np.random.Generator) -> None:
    """10000 draws give the larger box 8000 with a standard deviation of 40: met within five (false alarms below one in
    a million)."""
    nothing = Mesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32))
    points, _, which = drawn_points(rng, surface([box(HALF), nothing, MESH]), 10_000)
    assert set(which) == {0, 2}
    assert (which == 2).sum() == pytest.approx(8000, abs=5 * 40)
    for mesh, half in ((0, HALF / 2), (2, HALF)):
        on_face = np.isclose(np.abs(points[which == mesh]), half)
        assert np.all(on_face.any(axis=1))


def test_areas_are_those_of_the_faces() -> None:
    assert surface([MESH]).areas.sum() == pytest.approx(2 * (8 + 4 + 2))
    assert surface([Mesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int32))]).areas.sum() == 0.0
