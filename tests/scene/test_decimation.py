"""The budget is kept, the measured deviation is the true one, and what can be seen is not lost."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.scene.articulated_object import Mesh
from pmpnbp.scene.decimation import decimate, deviation, reduced, seen_from_outside
from pmpnbp.scene.meshes import EMPTY, box, joined, sphere, transformed, welded
from pmpnbp.scene.surface_points import even_oriented_points, even_points


def fine_sphere(radius: float = 1.0) -> Mesh:
    shape = trimesh.creation.icosphere(subdivisions=4, radius=radius)
    return Mesh(np.asarray(shape.vertices), np.asarray(shape.faces, dtype=np.int32))


def shifted(mesh: Mesh, x: float) -> Mesh:
    return transformed(mesh, np.array([x, 0, 0, 1, 0, 0, 0.0]))


@pytest.mark.parametrize("budget", [100, 500, 2000])
def test_a_sphere_is_reduced_to_the_budget_and_stays_a_sphere(budget: int) -> None:
    mesh = fine_sphere()
    small = decimate(mesh, budget)
    assert 0.9 * budget <= len(small.faces) <= budget
    radius = np.linalg.norm(small.vertices, axis=1)
    assert np.abs(radius - 1).max() < 8 / budget  # the sagitta of a triangle of area 4 pi / budget, twice over
    corners = small.vertices[small.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.all(np.einsum("nd,nd->n", normals, corners.mean(axis=1)) > 0)  # outward still


def radii(mesh: Mesh) -> NDArray[np.float64]:
    """How far points all over a mesh are from the origin."""
    return np.linalg.norm(even_points(mesh, 20_000), axis=1)


@pytest.mark.parametrize("budget", [60, 200, 1000])
def test_a_reduced_sphere_is_neither_smaller_nor_larger_than_it_was(budget: int) -> None:
    before, after = radii(fine_sphere()), radii(decimate(fine_sphere(), budget))
    # of faces whose corners lie on the sphere every point is within it, by two thirds of a sagitta in the mean
    sagitta = 4 * np.pi / budget / 3**1.5
    assert abs(after.mean() - before.mean()) < sagitta / 20
    assert np.sqrt(np.mean((after - before.mean()) ** 2)) < sagitta


def test_a_bent_sheet_of_two_sides_keeps_its_thickness_and_lies_where_it_was() -> None:
    flat = trimesh.creation.box([1.0, 1.0, 0.004])
    for _ in range(6):
        flat = flat.subdivide()
    bent = np.asarray(flat.vertices) + 0.05 * np.sin(4 * np.asarray(flat.vertices)[:, :1]) * [0.0, 0.0, 1.0]
    sheet = Mesh(bent, np.asarray(flat.faces, dtype=np.int32))
    small = decimate(sheet, 300)
    assert len(small.faces) <= 300 < len(sheet.faces)
    points, normals = even_oriented_points(small, 20_000)
    height = points[:, 2] - 0.05 * np.sin(4 * points[:, 0])
    for way in (1.0, -1.0):
        side = height[way * normals[:, 2] > 0.5]
        assert np.mean(side) == pytest.approx(0.002 * way, abs=1e-4)
        assert np.std(side) < 5e-4


@given(seed=st.integers(0, 10_000), corners=st.integers(8, 60), faces=st.integers(20, 200), budget=st.integers(4, 60))
@settings(max_examples=40, deadline=None)
def test_any_heap_of_triangles_stays_where_it_was(seed: int, corners: int, faces: int, budget: int) -> None:
    rng = np.random.default_rng(seed)
    heap = Mesh(rng.normal(size=(corners, 3)), rng.integers(corners, size=(faces, 3)).astype(np.int32))
    small, whole = decimate(heap, budget), welded(heap)
    assert len(small.faces) <= len(whole.faces)
    reach = np.ptp(whole.vertices, axis=0)
    assert np.all(small.vertices > whole.vertices.min(axis=0) - 0.2 * reach)
    assert np.all(small.vertices < whole.vertices.max(axis=0) + 0.2 * reach)


def test_reducing_never_adds_and_always_gives_the_same() -> None:
    assert len(decimate(box([1, 1, 1]), 500).faces) == 12
    first, second = decimate(fine_sphere(), 300), decimate(fine_sphere(), 300)
    np.testing.assert_array_equal(first.vertices, second.vertices)
    np.testing.assert_array_equal(first.faces, second.faces)


def test_a_part_within_the_budget_is_left_exactly_as_it_is() -> None:
    mesh, small, distance = reduced([box([1, 2, 3])], [sphere(0.1)], 500)
    assert small is mesh
    assert distance == 0


def test_a_mesh_is_reduced_once_and_again_where_anything_of_it_differs() -> None:
    first = reduced([], [fine_sphere()], 300)
    assert reduced([], [fine_sphere()], 300) is first
    larger, coarser, exact = (
        reduced([], [fine_sphere(1.001)], 300),
        reduced([], [fine_sphere()], 200),
        reduced([fine_sphere()], [], 300),
    )
    assert larger is not first and np.abs(larger[0].vertices).max() == pytest.approx(1.001)
    assert coarser is not first and len(coarser[1].faces) <= 200
    assert exact is not first


def test_primitives_stay_exact_beside_a_reduced_mesh() -> None:
    plate = shifted(box([1, 2, 3]), 5)
    mesh, small, distance = reduced([plate], [fine_sphere()], 500)
    assert len(mesh.faces) == 12 + 5120
    assert len(small.faces) <= 500
    corners = small.vertices[small.vertices[:, 0] > 4]
    assert {tuple(corner) for corner in corners} == {tuple(corner) for corner in plate.vertices}
    assert 0 < distance < 0.03


def test_primitives_beyond_the_budget_are_reduced_too() -> None:
    balls = [shifted(sphere(0.1), 0.5 * k) for k in range(5)]
    mesh, small, distance = reduced(balls, [], 500)
    assert len(mesh.faces) == 1600
    assert len(small.faces) <= 500
    assert 0 < distance < 0.02


def test_the_deviation_is_measured_both_ways_and_is_the_distance_between_known_shapes() -> None:
    unit = box([1, 1, 1])
    assert deviation(unit, box([1.02, 1, 1])) == pytest.approx(0.01, abs=1e-6)
    assert deviation(fine_sphere(1.0), fine_sphere(0.9)) == pytest.approx(0.1, abs=2e-3)
    more = joined([unit, shifted(box([0.1, 0.1, 0.1]), 2)])
    for a, b in ((unit, more), (more, unit)):  # the small box reaches from 1.95 to 2.05, the large one ends at 0.5
        assert deviation(a, b) == pytest.approx(1.55, abs=1e-6)
    assert deviation(unit, unit) == pytest.approx(0, abs=1e-6)
    assert deviation(unit, EMPTY) == 0


def test_what_is_shut_in_is_left_out_and_nothing_else() -> None:
    housing, motor = box([1, 1, 1]), fine_sphere(0.3)
    outside = seen_from_outside(joined([housing, motor]))
    assert len(outside.faces) == 12
    lid_off = Mesh(housing.vertices, housing.faces[~np.all(housing.vertices[housing.faces][..., 2] > 0, axis=1)])
    opened = seen_from_outside(joined([lid_off, motor]))
    assert len(opened.faces) > 12 + 0.4 * len(motor.faces)  # the inside of the box and the motor's upper half


@pytest.mark.parametrize("turned", [False, True])
def test_a_lone_surface_is_seen_whole_from_either_side(rng: np.random.Generator, turned: bool) -> None:
    pose = np.concatenate([rng.normal(size=3), poses.random_quaternions(rng, ())])
    mesh = transformed(fine_sphere(), pose)
    inside_out = Mesh(mesh.vertices, np.ascontiguousarray(mesh.faces[:, ::-1]))
    assert len(seen_from_outside(inside_out if turned else mesh).faces) == len(welded(mesh).faces)
