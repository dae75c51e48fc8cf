"""The budget is kept, the measured deviation is the true one, and what can be seen is not lost."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pmpnbp.geometry import poses
from pmpnbp.scene.articulated_object import Mesh
from pmpnbp.scene.decimation import decimate, deviation, reduced, seen_from_outside
from pmpnbp.scene.meshes import EMPTY, box, joined, sphere, transformed, welded


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
