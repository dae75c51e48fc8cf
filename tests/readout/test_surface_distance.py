"""Distances between two poses of a part: eq. 12 point by point, and of round parts none for a turn about the axis."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.readout.metrics import add, model_points
from pmpnbp.readout.surface_distance import distances, part_surfaces, turns
from pmpnbp.scene.articulated_object import ArticulatedObject, Joint, Mesh
from pmpnbp.scene.parts import LinkSurface
from tests.inference.small_worlds import Z, articulated, at, block


def of_shapes(*shapes: LinkSurface) -> ArticulatedObject:
    joints = [
        Joint(f"slide{k}", "prismatic", "link0", f"link{k}", at(), Z, -1.0, 1.0, (k - 1,))
        for k in range(1, len(shapes))
    ]
    return articulated(joints, {f"link{k}": shape for k, shape in enumerate(shapes)})


def round_bar(radius: float, length: float) -> LinkSurface:
    return of_mesh(trimesh.creation.cylinder(radius, length, sections=48))


def of_mesh(made: trimesh.Trimesh) -> LinkSurface:
    mesh = Mesh(np.asarray(made.vertices, dtype=np.float64), np.asarray(made.faces, dtype=np.int32))
    return LinkSurface(exact=(mesh,))


def moved(rng: np.random.Generator, count: int, metres: float, radians: float) -> Array:
    return poses.perturb(
        poses.IDENTITY, metres * rng.standard_normal((count, 3)), radians * rng.standard_normal((count, 3))
    )


def test_a_box_is_as_far_as_eq_12_says(rng: np.random.Generator) -> None:
    """A hundred points of the surface instead of a thousand: a few hundredths off."""
    model = of_shapes(block([0.3, 0.2, 0.1]), LinkSurface())
    surfaces, points = part_surfaces(model), model_points(model.parts[0].mesh)
    here, there = moved(rng, 1, 0.3, 0.5), moved(rng, 6, 0.02, 0.1)
    both = np.stack([poses.multiply(here, there), there], axis=1)
    found = distances(surfaces, np.stack([here[0], here[0]])[: len(surfaces)], both[:, : len(surfaces)])
    expected = [add(points, here[0], pose) for pose in both[:, 0]]
    np.testing.assert_allclose(found[:, 0], expected, rtol=0.05)


def test_a_part_without_a_surface_has_no_distance() -> None:
    model = of_shapes(block([0.1, 0.1, 0.3]))
    bare = part_surfaces(model)[0].__class__(np.zeros((0, 3)), np.zeros(3), 0.0)
    assert np.isnan(distances((bare,), poses.IDENTITY[None], poses.IDENTITY[None, None])).all()


def test_a_round_bar_is_nowhere_else_when_it_is_turned_about_its_axis_only() -> None:
    surfaces = part_surfaces(of_shapes(round_bar(0.05, 0.4)))
    here = at(0.4, -0.2, 1.0, roll=0.4, yaw=2.0)
    turned = poses.multiply(here, at(yaw=1.3))
    shifted = poses.multiply(turned, at(z=0.02))
    tilted = poses.multiply(here, at(roll=0.1))
    found = distances(surfaces, here[None], np.stack([turned, shifted, tilted])[:, None])[:, 0]
    assert found[0] == pytest.approx(0.0, abs=1e-9)
    assert found[1] == pytest.approx(0.02)
    # its feet on the axis move by a tenth of a quarter of its length in the mean, its surface by as much of its radius
    assert found[2] == pytest.approx(0.1 * 0.1 + 0.1 * 0.05, rel=0.25)


@pytest.mark.parametrize("size", [[0.3, 0.3, 0.1], [0.2, 0.2, 0.6]])
def test_a_square_box_is_not_round(size: list[float]) -> None:
    surfaces = part_surfaces(of_shapes(block(size)))
    found = distances(surfaces, poses.IDENTITY[None], at(yaw=np.pi / 2)[None, None])
    assert found.item() > 0.1


def star(arms: int) -> trimesh.Trimesh:
    """As many bars that lie on a hub, one end over its middle."""
    bars = [trimesh.creation.cylinder(0.05, 0.03, sections=48)]
    for number in range(arms):
        bar = trimesh.creation.box((0.2, 0.03, 0.03))
        bar.apply_translation((0.1, 0.0, 0.0))
        bar.apply_transform(trimesh.transformations.rotation_matrix(2 * np.pi * number / arms, (0, 0, 1)))
        bars.append(bar)
    return trimesh.util.concatenate(bars)


def knob() -> trimesh.Trimesh:
    """A dial with a pointer across its face that stands out by 4 mm."""
    pointer = trimesh.creation.box((0.018, 0.004, 0.004))
    pointer.apply_translation((0.009, 0.0, 0.012))
    return trimesh.util.concatenate([trimesh.creation.cylinder(0.02, 0.02, sections=48), pointer])


def dish() -> trimesh.Trimesh:
    """A turntable with something small near its edge: four hundredths of its surface."""
    small = trimesh.creation.box((0.02, 0.05, 0.02))
    small.apply_translation((0.1, 0.0, 0.015))
    return trimesh.util.concatenate([trimesh.creation.cylinder(0.13, 0.01, sections=48), small])


@pytest.mark.parametrize(
    "made",
    [
        *(star(arms) for arms in range(3, 11)),
        *(trimesh.creation.cylinder(0.1, 0.1, sections=n) for n in (5, 6)),
        knob(),
        dish(),
    ],
)
def test_what_has_arms_or_sides_or_a_pointer_is_not_round(made: trimesh.Trimesh) -> None:
    (surface,) = part_surfaces(of_shapes(of_mesh(made)))
    assert not surface.axis.any() and surface.radius == 0.0


@pytest.mark.parametrize("sections", [12, 16, 24, 48])
def test_what_is_turned_on_a_lathe_is_round(sections: int) -> None:
    outline = [[0, 0], [0.08, 0], [0.1, 0.1], [0.05, 0.15], [0.03, 0.15], [0.03, 0.3], [0, 0.3]]
    shapes = [
        trimesh.creation.cylinder(0.1, 0.02, sections=sections),
        trimesh.creation.cylinder(0.02, 0.6, sections=sections),
        trimesh.creation.cone(0.1, 0.2, sections=sections),
        trimesh.creation.revolve(np.array(outline), sections=sections),
    ]
    for surface in part_surfaces(of_shapes(*map(of_mesh, shapes))):
        np.testing.assert_array_equal(surface.axis, [0, 0, 1])


def test_a_turn_is_the_rotation_s_angle_and_of_what_is_round_its_axis_s(rng: np.random.Generator) -> None:
    surfaces = part_surfaces(of_shapes(block([0.3, 0.2, 0.1]), round_bar(0.05, 0.4)))
    here = np.tile(at(0.4, -0.2, 1.0, roll=0.4, yaw=2.0), (2, 1))
    spun, tilted = poses.multiply(here, at(yaw=1.3)), poses.multiply(here, at(roll=0.1))
    both = poses.multiply(tilted, at(0.5, yaw=1.3))
    found = turns(surfaces, here, np.stack([here, spun, tilted, both]))
    angle = float(poses.rotation_angle(here[0, 3:], both[0, 3:]))
    np.testing.assert_allclose(found, [[0, 0], [1.3, 0], [0.1, 0.1], [angle, 0.1]], atol=1e-7)
