"""What an image's grain hides: of a plain picture counted by hand, of objects as by least squares written out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import mrf as fields
from pmpnbp.inference import problem as problems
from pmpnbp.inference.held_part import Held, shown
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials import nuisances
from pmpnbp.potentials.unary import render
from pmpnbp.readout import image_grain
from pmpnbp.readout.image_grain import (
    AS_ONE,
    DISTORTED,
    INWARD,
    LEAST,
    NOISY,
    UNTOLD,
    WHOLE,
    distorted,
    distorted_as_one,
    grain,
    hidden_by_grain,
    unknown_camera,
)
from pmpnbp.readout.pixel_information import ALIKE, EDGE, FACE, JUMP, Stretch, facing, outlines, told_of_parts
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.depth_noise import SHARED
from pmpnbp.scene.observation import OUTSIDE, SUPPORT
from pmpnbp.scene.observe import observe
from pmpnbp.scene.prior import UniformPrior
from tests.inference import small_worlds as worlds

STEP, BINNED = 1e-5, 4
OBJECTS = {"cupboard": worlds.cupboard(), "chain": worlds.hinged_chain(6), "star": worlds.star(4)}


def counted(depth: Array, number: Array, shown: Array, tolerance: float) -> list[int]:
    """Outline pixels of parts 0 and 1."""
    (row, column), _ = outlines(depth, shown, tolerance)
    return np.bincount(number[row, column], minlength=2).tolist()


def test_outline_pixels_are_those_beside_which_something_is_farther_off() -> None:
    """Part 1 stands before part 0, 1 cm before its left half and 10 cm before its right one."""
    depth, number = np.zeros((9, 12), dtype=np.float32), np.full((9, 12), -1, dtype=np.int16)
    depth[1:8, 1:11], number[1:8, 1:11] = 1.0, 0
    depth[1:8, 1:6] = 0.91
    depth[3:6, 3:9], number[3:6, 3:9] = 0.9, 1
    shown = depth > 0
    # part 0: its rim, 7 x 10, and the column at its step where part 1 is not; part 1: three sides of its right half
    rim, step, sides = 2 * 10 + 2 * 5, 2, 3 + 3 + 3 - 2
    # pixels touch at corners, too: of part 1's upper and lower side the one to the left of the step sees over it
    assert counted(depth, number, shown, 0.02) == [rim + step, sides + 2]
    assert counted(depth, number, shown, 0.11 / JUMP) == [rim, 0]
    shown[:, 6:] = False
    assert counted(depth, number, shown, 0.02)[0] == 5 + 7 + 5 - 2 + step


def test_outlines_point_to_what_is_farther_off() -> None:
    depth = np.zeros((8, 9), dtype=np.float32)
    depth[1:7, 1:8] = 1.0
    (row, column), across = outlines(depth, depth > 0, 0.02)
    found = {(int(r), int(c)): tuple(np.round(to, 6)) for r, c, to in zip(row, column, across, strict=True)}
    assert found[3, 1] == (-1.0, 0.0) and found[3, 7] == (1.0, 0.0)
    assert found[1, 4] == (0.0, -1.0) and found[6, 4] == (0.0, 1.0)
    np.testing.assert_allclose(found[1, 1], [-(0.5**0.5), -(0.5**0.5)], atol=1e-6)
    # a line one pixel wide has nothing beside it on either side
    depth[1:3], depth[4:] = 0.0, 0.0
    assert not set(zip(*outlines(depth, depth > 0, 0.02)[0], strict=True)) & {(3, column) for column in range(2, 7)}


def test_an_outline_beyond_the_picture_tells_nothing() -> None:
    depth = np.ones((4, 5), dtype=np.float32)
    assert len(outlines(depth, depth > 0, 0.01)[1]) == 0


def test_surfaces_that_face_the_camera_have_their_normals(rng: np.random.Generator) -> None:
    """Of planes, whose points' products with the normal are 1; what is seen at less than ten degrees is left out, and a
    pixel that is alone of its part."""
    camera = Camera(20, 15, 30.0, 33.0, 9.0, 8.0)
    plane = np.array([0.2, -0.3, 0.6])
    depth = (1 / (camera.rays() @ plane)).astype(np.float32)
    number = np.where(np.arange(20) < 11, 0, 1).astype(np.int16) * np.ones((15, 1), dtype=np.int16)
    number[4, 5] = 2
    (row, column), normals = facing(camera, depth, number, depth > 0)
    assert len(row) == 15 * 20 - 1 and (4, 5) not in set(zip(row, column, strict=True))
    np.testing.assert_allclose(normals, np.tile(plane, (len(row), 1)), atol=2e-4)
    slanted = (1 / (camera.rays() @ np.array([20.0, 0.0, 8.0]))).astype(np.float32)
    cosine = 1 / (np.linalg.norm([20.0, 8.0]) * slanted * np.linalg.norm(camera.rays(), axis=-1))
    (row, column), _ = facing(camera, slanted, np.zeros_like(number), slanted > 0)
    assert set(zip(row, column, strict=True)) == set(zip(*np.nonzero((slanted > 0) & (cosine > 0.17)), strict=True))


def test_pixels_tell_how_far_their_part_is_off_in_their_own_direction() -> None:
    """As written out pixel by pixel: of an outline by what a small motion moves it across, in pixels, and of a surface
    by the change of its depth."""
    made, root, joints = looked_at((0.0, 0.3, 0.7))
    (view,), mrf = made.observation.views, made.mrf
    here = mrf.part_poses(root, joints)
    middles = poses.transform_points(here, mrf.centres)
    depth, number = render(view.camera, made.surfaces, here)
    shown = (depth > 0) & (np.indices(depth.shape).sum(axis=0) % 3 > 0)
    expected = np.zeros((mrf.nodes, 6, 6))
    pose, camera = np.asarray(view.camera.pose_world_camera), view.camera

    def moved(point: Array, part: int, which: int) -> Array:
        """A point of the camera's frame as it is there once the part has moved by a step."""
        twist = np.zeros(6)
        twist[which] = STEP
        arm = poses.transform_points(pose, point) - middles[part]
        turned = poses.rotate(poses.from_rotation_vector(twist[3:]), arm)
        return poses.transform_points(poses.inverse(pose), middles[part] + turned + twist[:3])

    def gather(pixels: tuple[Array, Array], change: Callable[[int, Array, Array], float], off: float) -> None:
        for place, (row, column) in enumerate(zip(*pixels, strict=True)):
            part, z = int(number[row, column]), float(depth[row, column])
            point = z * camera.rays()[row, column].astype(np.float64)
            slope = np.array([change(place, point, moved(point, part, which)) / STEP for which in range(6)])
            expected[part] += np.outer(slope, slope) / (
                off**2 if off else np.hypot(FACE * z / camera.fx / np.sqrt(BINNED), NOISY * 0.002) ** 2
            )

    edge, across = outlines(depth, shown, made.tolerance_end)
    # by how many pixels, as wide as they are across the picture, along the outline's direction
    gather(
        edge,
        lambda place, before, after: float((after[:2] / after[2] - before[:2] / before[2]) @ across[place] * camera.fx),
        EDGE / np.sqrt(BINNED),
    )
    face, normals = facing(camera, depth, number, shown)
    # a ray meets the plane n . p = 1 that has moved along with the point nearer or farther off by so much of its depth
    gather(face, lambda place, before, after: float(normals[place] @ (after - before) * before[2]), 0.0)
    found = told_of_parts(camera, depth, number, shown, middles, made.tolerance_end, NOISY * 0.002, binned=BINNED)
    scale = np.sqrt(np.maximum(np.einsum("nii->ni", expected), 1e-9))
    np.testing.assert_allclose(
        found / scale[:, :, None] / scale[:, None], expected / scale[:, :, None] / scale[:, None], atol=2e-3
    )


def test_a_coarser_render_tells_what_the_image_would() -> None:
    """Of half as many pixels a side, each of which stands for four of the image's, two of its outline's."""
    made, root, joints = looked_at((0.0, 0.3, 0.7))
    (view,), mrf = made.observation.views, made.mrf
    here = mrf.part_poses(root, joints)
    middles = poses.transform_points(here, mrf.centres)
    told = []
    for camera, finer in (
        (view.camera, 1.0),
        (view.camera.binned(0, 0, 2, view.camera.width // 2, view.camera.height // 2), 2.0),
    ):
        depth, number = render(camera, made.surfaces, here)
        of_scan = NOISY * 0.002, finer, BINNED
        told.append(told_of_parts(camera, depth, number, depth > 0, middles, made.tolerance_end, *of_scan))
    ratio = np.divide(*(np.einsum("nii->ni", each) for each in told))
    # boards' edges are a pixel or two wide, and have fewer of them in proportion
    assert abs(np.median(ratio) - 1) < 0.1
    assert ratio.min() > 0.5 and ratio.max() < 2


def moved_parts(model: ArticulatedObject, root: Array, joints: Array) -> tuple[Array, Array]:
    """Parts (1, 1 + P, N, 7) as they are and with each coordinate moved, one after the other; steps (1, P)."""
    centre = fields.build(model).centres[0]
    found = [model.part_poses(root, joints)]
    for place in range(6 + model.dof):
        move = np.zeros(6 + model.dof)
        move[place] = STEP
        found.append(model.part_poses(poses.perturb(root, move[:3], move[3:6], centre), joints + move[6:]))
    return np.array(found)[None], np.full((1, len(found) - 1), STEP)


def some_told(rng: np.random.Generator, nodes: int) -> Array:
    """(N, 6, 6) as of a few dozen pixels each."""
    rows = rng.standard_normal((nodes, 40, 6)) * [1, 1, 1, 0.1, 0.1, 0.1] * rng.uniform(300, 3000, (nodes, 1, 1))
    return np.einsum("nri,nrj->nij", rows, rows)


def by_one_view(told: Array, steps: Array) -> list[tuple[Array, Array]]:
    """What is `told` (N, 6, 6), by a view that has nothing wrong of the object as one."""
    return [(told[None], np.zeros((1, steps.shape[1], steps.shape[1])))]


@pytest.mark.parametrize("name", OBJECTS)
def test_it_is_the_covariance_of_a_fit_to_parts_that_are_off(name: str, rng: np.random.Generator) -> None:
    model = OBJECTS[name]
    mrf = fields.build(model)
    told = some_told(rng, mrf.nodes)
    root = worlds.at(0.3, -0.2, 0.1, *rng.uniform(-1, 1, 3))
    parts, steps = moved_parts(model, root, rng.uniform(model.lower, model.upper))
    designs, weights = [], []
    for node, radius in enumerate(mrf.radii):
        here = parts[0, 0, node]
        columns = []
        for there in parts[0, 1:, node]:
            middle = poses.transform_points(there, mrf.centres[node]) - poses.transform_points(here, mrf.centres[node])
            turn = poses.quaternion_multiply(there[3:], poses.quaternion_conjugate(here[3:]))
            columns.append(np.concatenate([middle, poses.to_rotation_vector(turn)]) / STEP)
        designs.append(np.array(columns).T)
        besides = (LEAST**2 + (WHOLE * radius) ** 2) * np.array([1.0, 1.0, 1.0, *[3 / radius**2] * 3])
        weights.append(np.linalg.inv(np.linalg.inv(told[node]) + np.diag(besides)))
    (found,) = hidden_by_grain(mrf, parts, steps, by_one_view(told, steps))
    expected = np.linalg.inv(sum(d.T @ w @ d for d, w in zip(designs, weights, strict=True)))
    scale = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-4)
    # the others tell of a part, too: none is hidden by more than it would be alone
    for design, weight in zip(designs, weights, strict=True):
        left = np.linalg.eigvalsh(np.linalg.inv(weight) - design @ found @ design.T)
        assert left.min() > -1e-4 * np.trace(np.linalg.inv(weight))


def test_the_end_of_a_chain_is_known_as_well_as_its_beginning() -> None:
    model = OBJECTS["chain"]
    mrf, nodes = fields.build(model), len(model.parts)
    parts, steps = moved_parts(model, worlds.at(), np.full(model.dof, 0.2))
    told = np.tile(np.diag([1e6] * 3 + [1e6 * mrf.radii[0] ** 2 / 3] * 3), (nodes, 1, 1))
    (found,) = hidden_by_grain(mrf, parts, steps, by_one_view(told, steps))
    slopes = (
        poses.transform_points(parts[0, 1:], mrf.centres) - poses.transform_points(parts[0, 0], mrf.centres)
    ) / STEP
    spread = np.sqrt(np.einsum("pna,pq,qna->n", slopes, found, slopes))
    assert spread.max() / spread.min() < 2
    # as joints that were each off on their own would not leave it
    alone = np.sqrt(np.einsum("pna,p,pna->n", slopes, np.diag(found), slopes))
    assert alone[-1] / alone[0] > 3


def test_a_camera_whose_place_is_not_known_tells_as_much_as_least_squares_over_its_offset(
    rng: np.random.Generator,
) -> None:
    """Of a chain that two cameras see, the second one off by an offset with a prior, which is a parameter there."""
    model = OBJECTS["chain"]
    mrf, nodes = fields.build(model), len(model.parts)
    root = worlds.at(0.3, -0.2, 0.1, *rng.uniform(-1, 1, 3))
    parts, steps = moved_parts(model, root, rng.uniform(model.lower, model.upper))
    stds, camera = np.array([0.004, 0.006, 0.005, 0.003, 0.002, 0.004]), worlds.camera_at((0.1, 0.2, 1.2), root[:3])
    first, second = some_told(rng, nodes), some_told(rng, nodes)
    unknown = unknown_camera(camera, stds, root[None], mrf.centres[0], parts.shape[1] - 1)
    known = by_one_view(first, steps)
    (found,) = hidden_by_grain(mrf, parts, steps, [*known, (second[None], unknown)])
    size = parts.shape[1] - 1
    expected = np.zeros((size + 6, size + 6))
    expected[size:, size:] = np.diag(stds**-2)
    pose = np.asarray(camera.pose_world_camera)
    for node, radius in enumerate(mrf.radii):
        here, columns = parts[0, 0, node], []
        for number in range(size + 6):
            if number < size:
                there = parts[0, 1 + number, node]
            else:
                # the true camera stands off: what it sees seems to be moved the other way
                offset = STEP * (np.arange(6) == number - size)
                stands = np.concatenate([offset[:3], poses.from_rotation_vector(offset[3:])])
                seen = poses.multiply(poses.inverse(poses.multiply(pose, stands)), here)
                there = poses.multiply(pose, seen)
            shift = poses.transform_points(there, mrf.centres[node]) - poses.transform_points(here, mrf.centres[node])
            turn = poses.to_rotation_vector(poses.quaternion_multiply(there[3:], poses.quaternion_conjugate(here[3:])))
            columns.append(np.concatenate([shift, turn]) / STEP)
        design = np.array(columns).T
        besides = (LEAST**2 + (WHOLE * radius) ** 2) * np.diag([1.0, 1.0, 1.0, *[3 / radius**2] * 3])
        for told, slopes in ((first, design * (np.arange(size + 6) < size)), (second, design)):
            expected += slopes.T @ np.linalg.inv(np.linalg.inv(told[node]) + besides) @ slopes
    covariance = np.linalg.inv(expected)[:size, :size]
    scale = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(found / np.outer(scale, scale), covariance / np.outer(scale, scale), atol=1e-3)
    (sharp,) = hidden_by_grain(mrf, parts, steps, [*known, *by_one_view(second, steps)])
    assert np.all(np.diag(found)[:3] > 1.05 * np.diag(sharp)[:3])


def test_many_pixels_tell_more_but_not_without_end(rng: np.random.Generator) -> None:
    """A block alone, of which no end of pixels tells, is off by a share of its radius."""
    model = worlds.articulated([], {"link0": worlds.block([0.3, 0.2, 0.1])})
    mrf = fields.build(model)
    parts, steps = moved_parts(model, worlds.at(), np.zeros(0))
    told = some_told(rng, 1)
    stds = [
        np.sqrt(np.diag(hidden_by_grain(mrf, parts, steps, by_one_view(share * told, steps))[0])[:3])
        for share in (1.0, 4.0, 1e9)
    ]
    assert np.all(stds[0] > stds[1]) and np.all(stds[1] > stds[2])
    np.testing.assert_allclose(stds[2], np.sqrt(LEAST**2 + (WHOLE * mrf.radii[0]) ** 2), rtol=1e-3)


def looked_at(eye: tuple[float, float, float], **settings: float) -> tuple[Problem, Array, Array]:
    """Through an image whose pixels are BINNED of a scan's, as a work image's are."""
    model, (root, joints) = worlds.cupboard(), worlds.cupboard_truth()
    camera = worlds.camera_at(eye, root[:3] + [0, 0, 0.2])
    observation = worlds.seen(model, root, joints, camera)
    observation = replace(observation, views=tuple(replace(view, binned=BINNED) for view in observation.views))
    chosen = worlds.settings(**settings)
    return problems.build(model, observation, UniformPrior("upright"), chosen, particles=20), root, joints


def grained(made: Problem, root: Array, joints: Array) -> Array:
    """Held by its root."""
    return grain(made, Held(made.mrf, 0, root, joints))


def test_what_no_outline_tells_has_no_grain() -> None:
    """From low behind the closed back the drawer is not seen, and all the rest hides less than a millimetre."""
    made, root, joints = looked_at((2.9, -0.4, 0.3))
    found = grained(made, root, joints)
    assert found[6, 6] == pytest.approx(0.0, abs=UNTOLD**2 / 1e6)
    assert 1e-4 < np.sqrt(found[0, 0]) < 1e-3
    from_front, root, joints = looked_at((0.0, 0.0, 0.7))
    assert 1e-4 < np.sqrt(grained(from_front, root, joints)[6, 6]) < 2e-3


@pytest.mark.parametrize("category", [SUPPORT, OUTSIDE])
def test_what_may_be_something_else_tells_as_little_as_what_was_not_measured(category: int) -> None:
    """The lower half of the picture, where the cupboard stands, all but counts for nothing in its score as well."""
    made, root, joints = looked_at((0.0, 0.3, 0.7))
    (view,) = made.observation.views
    lower = np.indices(view.depth.shape)[0] > view.depth.shape[0] // 2
    known, labelled, lost = (
        grained(replace(made, observation=replace(made.observation, views=(one,))), root, joints)
        for one in (
            view,
            replace(view, category=np.where(lower, category, view.category).astype(np.uint8)),
            replace(view, depth=np.where(lower, np.float32(0), view.depth)),
        )
    )
    np.testing.assert_array_equal(labelled, lost)
    assert np.linalg.eigvalsh(labelled[:6, :6] - known[:6, :6])[-1] > 0.3 * np.linalg.eigvalsh(known[:6, :6])[-1]


def test_two_views_have_their_own_grain_each(monkeypatch: pytest.MonkeyPatch) -> None:
    """What the model has wrong is the same in both."""
    made, root, joints = looked_at((0.0, 0.0, 0.7))
    (view,) = made.observation.views
    twice = replace(
        made,
        observation=replace(made.observation, views=(view, view)),
        nuisance_std=np.zeros(17),
        noise=np.tile(made.noise, 2),
        noise_area=np.tile(made.noise_area, 2),
    )
    one, both = (np.diag(grained(each, root, joints)) for each in (made, twice))
    assert np.all(both < one) and np.all(both > one / 2)
    monkeypatch.setattr(image_grain, "LEAST", 0.0)
    monkeypatch.setattr(image_grain, "WHOLE", 0.0)
    np.testing.assert_allclose(grained(twice, root, joints), grained(made, root, joints) / 2, rtol=1e-6, atol=1e-15)


def test_pixels_that_err_together_tell_as_much_as_fewer_do() -> None:
    """As pixels that each err on their own do with so much more noise, SHARED times of which count already."""
    made, root, joints = looked_at((0.0, 0.0, 0.7))
    known, noisier, apart = (
        grained(replace(made, noise=np.array([noise]), noise_area=np.array([area])), root, joints)
        for noise, area in ((0.001, 9.0), (0.001 * 3.0 / SHARED, 1.0), (0.001, 1.0))
    )
    np.testing.assert_allclose(known, noisier, rtol=1e-9)
    assert np.all(np.diag(known) > np.diag(apart))


def test_what_is_told_of_a_part_and_its_own_smooth_error_add_up(rng: np.random.Generator) -> None:
    """Two Gaussians, one after the other, have the sum of their covariances."""
    told, middles, radii = some_told(rng, 3), np.array([[1.0, 0.2, 0.3], [2.0, 0.0, 0.1], [1.5, -1.0, 0.0]]), np.ones(3)
    camera = worlds.camera_at((0.0, 0.0, 0.7), (1.0, 0.0, 0.2))
    left = np.linalg.inv(distorted(told, camera, 0.002, middles, 0.3 * radii)) - np.linalg.inv(told)
    for part, middle in enumerate(middles):
        sight = middle - [0.0, 0.0, 0.7]
        along = np.outer(sight, sight) / (sight @ sight)
        off = DISTORTED * 0.002 * np.linalg.norm(sight)
        expected = np.zeros((6, 6))
        expected[:3, :3], expected[3:, 3:] = off**2 * along, (off / 0.3) ** 2 * (np.eye(3) - along)
        np.testing.assert_allclose(left[part], expected, atol=1e-3 * off**2)
    assert distorted(told, camera, 0.0, middles, radii) is told


@pytest.mark.parametrize("finer", [1.0, 2.0])
def test_smooth_errors_leave_a_face_as_many_depths_as_it_has_patches(finer: float) -> None:
    """A plate that fills the picture, 2 m away, whose depths err alike over patches of ALIKE radians: its distance is
    told as by one depth of each, however many pixels a patch has."""
    width, height = round(160 / finer), round(120 / finer)
    camera = Camera(width, height, 200 / finer, 200 / finer, width / 2 - 0.5, height / 2 - 0.5)
    depth, number = np.full((height, width), 2.0, dtype=np.float32), np.zeros((height, width), dtype=np.int16)
    shown, distortion = np.ones(depth.shape, dtype=bool), 0.05
    (told,) = told_of_parts(camera, depth, number, shown, np.array([[0.0, 0.0, 2.0]]), 0.01, 0.0, finer, 1, distortion)
    patches = (160 / 200) * (120 / 200) / ALIKE**2
    # what a pixel holds of its neighbours comes on top
    assert told[2, 2] == pytest.approx(patches / (distortion * 2.0) ** 2, rel=2e-3)


def test_smooth_errors_move_and_tilt_the_object_as_one(rng: np.random.Generator) -> None:
    """Drawn: the object is moved along the line of sight and tilted about its middle, one part's pose is looked at."""
    camera, radii = worlds.camera_at((0.0, 0.0, 0.7), (1.0, 0.0, 0.2)), np.array([0.1, 0.2, 0.15])
    middles = np.array([[1.0, 0.2, 0.3], [2.0, 0.0, 0.1], [1.5, -1.0, 0.0]])
    middle = middles.mean(axis=0)
    reach = max(np.linalg.norm(middles - middle, axis=1) + radii)
    sight = middle - [0.0, 0.0, 0.7]
    off, (across, up) = AS_ONE * 0.002 * np.linalg.norm(sight), np.linalg.svd(sight[None])[2][1:]
    amounts = off * rng.standard_normal((100_000, 3))
    turns = (amounts[:, 1:2] * across + amounts[:, 2:] * up) / reach
    shifts = amounts[:, :1] * sight / np.linalg.norm(sight) + np.cross(turns, middles[1] - middle)
    drawn = np.cov(np.concatenate([shifts, turns], axis=1).T)
    found = distorted_as_one(camera, 0.002, np.array([middles, middles + 0.1]), radii, 1, 8)
    assert found.shape == (2, 8, 8) and not found[:, 6:].any() and not found[:, :, 6:].any()
    # six standard deviations of a covariance's estimate: a false alarm in 10^7 runs
    scale = np.sqrt(np.diag(drawn))
    np.testing.assert_allclose(found[0, :6, :6] / np.outer(scale, scale), drawn / np.outer(scale, scale), atol=0.03)
    assert not distorted_as_one(camera, 0.0, middles, radii, 1, 8).any()


def test_smooth_errors_of_depth_let_the_object_be_nearer_or_farther(monkeypatch: pytest.MonkeyPatch) -> None:
    made, root, joints = looked_at((0.0, 0.0, 0.7))
    (view,) = made.observation.views
    wavy = replace(made, observation=replace(made.observation, views=(replace(view, distortion=0.003),)))
    still, moved = grained(made, root, joints), grained(wavy, root, joints)
    sight = poses.transform_points(made.mrf.part_poses(root, joints), made.mrf.centres)[0] - [0.0, 0.0, 0.7]
    along, as_one = sight / np.linalg.norm(sight), AS_ONE * 0.003 * np.linalg.norm(sight)
    off = np.hypot(DISTORTED * 0.003 * np.linalg.norm(sight), as_one)
    # by where outlines are they tell of its distance, too
    assert 2 * np.sqrt(along @ still[:3, :3] @ along) < np.sqrt(along @ moved[:3, :3] @ along) < off
    # across it is moved only as the object is tilted as one
    across = np.cross(along, [0.0, 0.0, 1.0])
    assert np.sqrt(across @ moved[:3, :3] @ across) < as_one
    assert 2 * np.sqrt(still[6, 6]) < np.sqrt(moved[6, 6]) < 2 * off
    # of one view what is wrong of the object as one comes on top
    middles = poses.transform_points(made.mrf.part_poses(root, joints), made.mrf.centres)
    expected = distorted_as_one(view.camera, 0.003, middles, made.mrf.radii, 0, len(moved))
    monkeypatch.setattr(image_grain, "AS_ONE", 0.0)
    np.testing.assert_allclose(moved - grained(wavy, root, joints), expected, atol=1e-6 * expected.max())


def stretch_of(made: Problem, here: Array) -> Stretch:
    axes = made.surfaces.axes_at_zero
    return Stretch(origins=here[:, :3], axes=np.array([axes[n] @ poses.to_matrix(here[n])[:3, :3].T for n in range(3)]))


def test_what_pixels_tell_of_scale_and_sizes_is_how_far_these_move_what_is_seen() -> None:
    """Each pixel's surface is moved by one of them after the other, as it would appear to be."""
    made, root, joints = looked_at((0.0, 0.0, 0.7), depth_scale_std=0.01, size_std=0.02)
    (view,), here = made.observation.views, made.mrf.part_poses(root, joints)
    camera, pose = view.camera, np.asarray(view.camera.pose_world_camera)
    depth, number = render(camera, made.surfaces, here)
    middles, shown = poses.transform_points(here, made.mrf.centres), depth > 0
    of_scan = made.tolerance_end, 0.001, 1.0, BINNED
    told = told_of_parts(camera, depth, number, shown, middles, *of_scan, stretch=stretch_of(made, here))
    moved = []
    for place in (0, 7, 8, 9):
        offset = STEP * (np.arange(10) == place)
        moved.append(nuisances.apparent(offset, 0, 1, pose, here, made.surfaces.axes_at_zero))

    def row(y: int, x: int, direction: Array) -> Array:
        """What is told of by a pixel that tells in a direction of the camera's frame."""
        part, straight = number[y, x], poses.rotate(pose[3:], direction)
        ray = np.array([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, 1.0])
        point = poses.transform_points(pose, ray * depth[y, x])
        local = poses.transform_points(poses.inverse(here[part]), point)
        there = [maps[part, :9].reshape(3, 3) @ local + maps[part, 9:] for maps in moved]
        rigid = np.concatenate([straight, np.cross(point - middles[part], straight)])
        return np.append(rigid, [straight @ (one - point) / STEP for one in there])

    expected, pixel = np.zeros_like(told), 1 / (camera.fx * np.sqrt(BINNED))
    (ys, xs), across = outlines(depth, shown, made.tolerance_end)
    for y, x, (right, down) in zip(ys, xs, across, strict=True):
        away = (right * (x - camera.cx) / camera.fx + down * (y - camera.cy) / camera.fy) * -1
        one = row(y, x, np.array([right, down, away]) / (EDGE * depth[y, x] * pixel))
        expected[number[y, x]] += np.outer(one, one)
    (ys, xs), normals = facing(camera, depth, number, shown)
    for y, x, normal in zip(ys, xs, normals, strict=True):
        z = float(depth[y, x])
        one = row(y, x, normal * z / np.hypot(z * FACE * pixel, 0.001))
        expected[number[y, x]] += np.outer(one, one)
    size = np.sqrt(np.einsum("nii->ni", expected))
    size = size[:, :, None] * size[:, None]
    np.testing.assert_allclose(told / size, expected / size, atol=1e-6)
    plain = told_of_parts(camera, depth, number, shown, middles, *of_scan)
    np.testing.assert_allclose(told[:, :6, :6], plain, rtol=1e-12, atol=1e-9 * plain.max())


def test_scale_and_sizes_are_part_of_the_fit_and_off_by_what_outlines_have_wrong() -> None:
    """Least squares written out, over root, joints, a scale, sizes; then each of these is off, all else following."""
    stds = np.array([0.01, 0.02, 0.02, 0.02])
    made, root, joints = looked_at((0.0, 0.0, 0.7), depth_scale_std=0.01, size_std=0.02)
    (view,), here = made.observation.views, made.mrf.part_poses(root, joints)
    depth, number = render(view.camera, made.surfaces, here)
    seen = shown(made, view, depth) & (view.category != SUPPORT) & (view.category != OUTSIDE)
    middles, noise = poses.transform_points(here, made.mrf.centres), float(image_grain.noise_apart(made)[0])
    told = told_of_parts(
        view.camera,
        depth,
        number,
        seen,
        middles,
        made.tolerance_end,
        noise,
        binned=BINNED,
        stretch=stretch_of(made, here),
    )
    information = np.diag([*np.zeros(8), *stds**-2.0])
    for node, radius in enumerate(made.mrf.radii):
        columns = []
        for place in range(12):
            move, sizes = np.zeros(12), np.zeros(10)
            move[place], sizes[7:] = STEP, STEP * (np.arange(9, 12) == place)
            moved_root = poses.perturb(root, move[:3], move[3:6], made.mrf.centres[0])
            there = made.part_poses(moved_root[None], (joints + move[6:8])[None], sizes[None])[0, node]
            middle = poses.transform_points(there, made.mrf.centres[node]) - middles[node]
            turn = poses.quaternion_multiply(there[3:], poses.quaternion_conjugate(here[node, 3:]))
            own = np.arange(8, 12) == place
            columns.append(np.concatenate([middle / STEP, poses.to_rotation_vector(turn) / STEP, own]))
        design, besides = (
            np.array(columns).T,
            (LEAST**2 + (WHOLE * radius) ** 2) * np.array([1.0] * 3 + [3 / radius**2] * 3),
        )
        inner = np.linalg.inv(np.eye(10) + told[node] @ np.diag([*besides, *np.zeros(4)])) @ told[node]
        information += design.T @ inner @ design
    expected = np.linalg.inv(information)
    reach = max(np.linalg.norm(middles - middles.mean(axis=0), axis=1) + made.mrf.radii)
    off = np.minimum(INWARD * view.distance / view.camera.fx / reach, stds)
    follows = expected[8:] / np.diag(expected)[8:, None]
    expected += follows.T @ np.diag(off**2) @ follows
    found, size = grained(made, root, joints), np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / size, expected / size, atol=2e-3)


def test_where_a_further_camera_stands_hides_the_rest_and_is_hidden_itself() -> None:
    """The rest as if it were told by a camera whose place is not known (above); where it stands as least squares over
    the offset alone has it, once the rest is known."""
    model, (root, joints) = worlds.cupboard(), worlds.cupboard_truth()
    cameras = [worlds.camera_at(eye, root[:3] + [0, 0, 0.2]) for eye in ((0.0, 0.0, 0.7), (0.4, -0.8, 0.8))]
    here, roi = model.part_poses(root, joints), np.array([*(root[:3] - 0.5), *(root[:3] + [0.5, 0.5, 0.8])])
    observation = observe([worlds.scan(model, here, camera) for camera in cameras], roi, up=worlds.UP)
    made = problems.build(model, observation, UniformPrior("upright"), worlds.settings(camera_std=0.005), particles=20)
    middles, noise, stds = (
        poses.transform_points(here, made.mrf.centres),
        image_grain.noise_apart(made),
        made.nuisance_std,
    )
    told = []
    for place, view in enumerate(observation.views):
        depth, number = render(view.camera, made.surfaces, here)
        seen = shown(made, view, depth) & (view.category != SUPPORT) & (view.category != OUTSIDE)
        of_scan = made.tolerance_end, float(noise[place]), 1.0, view.binned
        told.append(told_of_parts(view.camera, depth, number, seen, middles, *of_scan))
    parts, steps = moved_parts(model, root, joints)
    offset_stds, given = nuisances.split(stds, 2)[1][1], observation.views[1].pose_world_scan
    stands = replace(observation.views[1].camera, pose_world_camera=given)
    unknown = unknown_camera(stands, offset_stds, root[None], made.mrf.centres[0], 8)
    (expected,) = hidden_by_grain(made.mrf, parts, steps, [*by_one_view(told[0], steps), (told[1][None], unknown)])
    found = grained(made, root, joints)
    assert found.shape == (14, 14)
    size = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found[:8, :8] / size, expected / size, atol=2e-3)
    information = np.diag(offset_stds**-2.0)
    for node, radius in enumerate(made.mrf.radii):
        columns = []
        for place in range(6):
            offset = STEP * (np.arange(6) == place)
            stood = poses.multiply(given, np.append(offset[:3], poses.from_rotation_vector(offset[3:])))
            there = poses.multiply(given, poses.multiply(poses.inverse(stood), here[node]))
            turn = poses.quaternion_multiply(there[3:], poses.quaternion_conjugate(here[node, 3:]))
            shift = poses.transform_points(there, made.mrf.centres[node]) - middles[node]
            columns.append(np.append(shift, poses.to_rotation_vector(turn)) / STEP)
        besides = (LEAST**2 + (WHOLE * radius) ** 2) * np.diag([1.0, 1.0, 1.0, *[3 / radius**2] * 3])
        design = np.array(columns).T
        information += design.T @ np.linalg.inv(np.eye(6) + told[1][node] @ besides) @ told[1][node] @ design
    known = np.linalg.inv(np.linalg.inv(found)[8:, 8:])
    least = np.linalg.inv(information)
    size = np.sqrt(np.outer(np.diag(least), np.diag(least)))
    np.testing.assert_allclose(known / size, least / size, atol=2e-3)


def test_a_free_depth_scale_lets_the_object_be_nearer_or_farther() -> None:
    """Nearly along the line of sight: along a ray to the outlines that hold the object."""
    fixed, root, joints = looked_at((0.0, 0.0, 0.7))
    free, _, _ = looked_at((0.0, 0.0, 0.7), depth_scale_std=0.01)
    more = grained(free, root, joints)[:8, :8] - grained(fixed, root, joints)
    middles = poses.transform_points(fixed.mrf.part_poses(root, joints), fixed.mrf.centres)
    sight = middles.mean(axis=0) - [0.0, 0.0, 0.7]
    variances, axes = np.linalg.eigh(more[:3, :3])
    np.testing.assert_allclose(variances[:2], 0.0, atol=0.02 * variances[2])
    assert abs(axes[:, 2] @ sight) > 0.95 * np.linalg.norm(sight)
    assert 1e-3 < np.sqrt(variances[2]) < 5e-3
    # a scale that is all but known lets it be no farther off than that
    known, _, _ = looked_at((0.0, 0.0, 0.7), depth_scale_std=1e-5)
    least = grained(known, root, joints)[:3, :3] - grained(fixed, root, joints)[:3, :3]
    assert np.sqrt(np.trace(least)) < 2 * 1e-5 * np.linalg.norm(sight)


def test_parts_whose_sizes_are_free_are_known_less_well() -> None:
    fixed, root, joints = looked_at((0.0, 0.0, 0.7))
    free, _, _ = looked_at((0.0, 0.0, 0.7), size_std=0.02)
    more = np.diag(grained(free, root, joints))[:8] / np.diag(grained(fixed, root, joints))
    assert np.all(more > 1) and np.all(more[:3] > 9)
