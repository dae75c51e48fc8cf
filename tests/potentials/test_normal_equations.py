"""The normal equations of registration, where they are known exactly: of plates, each of one plane."""

from __future__ import annotations

import numpy as np
import trimesh
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.potentials import nuisances
from pmpnbp.potentials.surfaces import prepare_surfaces
from pmpnbp.potentials.unary import PixelScore, normal_equations, render
from pmpnbp.scene.articulated_object import Mesh
from pmpnbp.scene.observation import OBJECT, View
from tests.potentials import posed_parts

SCORE = PixelScore(tolerance=0.01)
TWO_TRIANGLES = np.array([[0, 1, 2], [1, 3, 2]])
# Both plates are in the plane x = 0.1 of their frames.
PLATES = prepare_surfaces(
    posed_parts.object_of(
        [
            Mesh(np.array([[0.1, -0.4, -0.3], [0.1, y, -0.3], [0.1, -0.4, 0.3], [0.1, y, 0.3]]), TWO_TRIANGLES)
            for y in (-0.05, 0.4)
        ]
    )
)
EYE = Camera(90, 70, 100.0, 95.0, 42.0, 36.5)
STEEP = 8.0


def places(rng: np.random.Generator) -> Array:
    """(2, 7) of the plates: before the camera, seen aslant, the second behind the first and to its right."""
    turned = poses.from_rotation_vector(np.array([0.0, np.pi / 2, 0.0]))
    tilts = poses.from_rotation_vector(rng.uniform(-0.5, 0.5, (2, 3)))
    return np.concatenate([[[-0.1, 0.05, 1.2], [0.2, 0.0, 1.5]], poses.quaternion_multiply(tilts, turned)], axis=1)


def seen(rng: np.random.Generator, depth: NDArray[np.float32]) -> View:
    """A scan of which some pixels are near what is rendered and others are not, none of them just at a gate."""
    beside = rng.choice([-0.1, -0.045, -0.02, -0.005, 0.005, 0.02, 0.045], depth.shape)
    scan = np.where(depth > 0, depth, 2.0) + beside + rng.uniform(-0.004, 0.004, depth.shape)
    return posed_parts.view(EYE, scan.astype(np.float32), np.full(depth.shape, OBJECT, dtype=np.uint8))


def expected(view: View, maps: Array, moved: Array, probes: Array, gates: Array) -> tuple[Array, Array]:
    """As `normal_equations`, of maps (2, 12) and moved (P, 2, 12): v = how a point moves, n = the plane's normal."""
    depth, number = render(EYE, PLATES, maps)
    rows, columns = np.nonzero(number >= 0)
    z, part = depth[rows, columns].astype(np.float64), number[rows, columns]
    rays = np.stack([(columns - EYE.cx) / EYE.fx, (rows - EYE.cy) / EYE.fy, np.ones(len(z))], axis=1)
    matrix, origin = maps[:, :9].reshape(-1, 3, 3), maps[:, 9:]
    own = np.linalg.solve(matrix[part], (z[:, None] * rays - origin[part])[..., None])
    normals = np.linalg.inv(matrix)[part, 0]  # the inverse's transpose, of the axis x
    towards = np.sum(normals * rays, axis=1)
    slopes = []
    for k, probe in enumerate(probes):
        there = (moved[k, :, :9].reshape(-1, 3, 3)[part] @ own)[..., 0] + moved[k, part, 9:]
        slopes.append(np.sum(normals * (there - z[:, None] * rays), axis=1) / towards / probe)
    slope = np.array(slopes)
    residual = view.depth[rows, columns] - z
    flat = np.linalg.norm(normals, axis=1) < STEEP * np.abs(towards)
    used = flat & (np.abs(residual) < gates[:, None])
    weights = used * (z / SCORE.unit_distance) ** 2 / SCORE.tolerance**2
    return np.einsum("ip,gp,jp->gij", slope, weights, slope), np.einsum("ip,gp,p->gi", slope, weights, residual)


def test_plates_tell_what_their_planes_do(rng: np.random.Generator) -> None:
    """Each part and both of them moved and turned, under every nuisance: the maps are no rigid motions then."""
    gates = np.array([0.03, 0.01, 0.06])
    for _ in range(5):
        here = places(rng)
        probes = rng.uniform(1e-5, 5e-5, (1, 9)) * rng.choice([-1.0, 1.0], 9)
        moves = np.zeros((9, 2, 6))
        for k in range(6):
            moves[k, [[0], [1], [0, 1]][k % 3]] = probes[0, k] * rng.normal(0.0, 1.0, 6)
        moved = poses.perturb(np.tile(here, (9, 1, 1)), moves[..., :3], moves[..., 3:], np.zeros(3))
        part_poses = np.concatenate([here[None], moved])
        offsets = np.tile(rng.normal(0.0, 0.02, 10), (10, 1))
        # a depth scale, a turn of the camera, a size
        for k, which in ((6, 0), (7, 5), (8, 7)):
            offsets[1 + k, which] += probes[0, k]
        maps = nuisances.apparent(offsets, 0, 1, EYE.pose_world_camera, part_poses, PLATES.axes_at_zero)
        view = seen(rng, render(EYE, PLATES, maps[0])[0])
        found = normal_equations(
            posed_parts.observation([view]), PLATES, part_poses[None], probes, SCORE, gates, STEEP, offsets[None]
        )
        information, gradient = expected(view, maps[0], maps[1:], probes[0], gates)
        assert np.all(np.diagonal(information, axis1=1, axis2=2) > 0.0)
        scale = np.sqrt(np.diagonal(information, axis1=1, axis2=2))
        assert np.all(np.abs(found[0][0] - information) < 1e-5 * scale[:, :, None] * scale[:, None, :])
        # the packed image has depths to a micrometre
        micrometres = 1e-6 * scale * np.sqrt(np.count_nonzero(view.depth)) / SCORE.tolerance
        assert np.all(np.abs(found[1][0] - gradient) < micrometres)
        assert np.any(np.abs(gradient) > 100 * micrometres)


def test_what_is_seen_edge_on_tells_nothing() -> None:
    """A plate whose plane passes within a hundredth of its distance of the camera."""
    turned = poses.from_rotation_vector(np.array([0.0, 0.01, 0.0]))
    here = np.array([[0.0, 0.0, 1.2, *turned], [9.0, 0.0, 0.5, *turned]])
    near = here + np.array([0.0, 0.0, 1e-5, 0.0, 0.0, 0.0, 0.0])
    depth, number = render(EYE, PLATES, here)
    assert np.count_nonzero(number == 0) > 3
    one = posed_parts.observation([posed_parts.view(EYE, depth, np.where(depth > 0, OBJECT, 0).astype(np.uint8))])
    told = [
        normal_equations(one, PLATES, np.stack([here, near])[None], np.array([[1e-5]]), SCORE, np.array([0.01]), most)
        for most in (STEEP, 1e6)
    ]
    assert not told[0][0].any() and not told[0][1].any()
    assert told[1][0].min() > 0.0


def test_a_part_that_is_not_moved_has_no_slope(rng: np.random.Generator) -> None:
    here = places(rng)
    moved = np.stack([here, here, here])
    moved[1, 0, 2] += 1e-5
    view = seen(rng, render(EYE, PLATES, here)[0])
    information, gradient = normal_equations(
        posed_parts.observation([view]), PLATES, moved[None], np.full((1, 2), 1e-5), SCORE, np.array([0.05]), STEEP
    )
    assert information[0, 0, 0, 0] > 0.0 and gradient[0, 0, 0] != 0.0
    assert np.all(information[0, 0, 1] == 0.0) and gradient[0, 0, 1] == 0.0


def test_a_floor_before_and_behind_the_camera_is_a_plane_too() -> None:
    """A floor's vertices cannot be projected, some of which lie before the near plane. Its planes are known all the
    same."""
    floor = trimesh.creation.box((8.0, 8.0, 0.02))
    surfaces = prepare_surfaces(posed_parts.object_of([posed_parts.mesh_of(floor)]))
    # the camera looks along z, the floor's normal is along y and its upper side 0.5 below
    here = np.array([[0.0, 0.51, 1.0, *poses.from_rotation_vector(np.array([np.pi / 2, 0.0, 0.0]))]])
    up = here + np.array([0.0, -1e-5, 0.0, 0.0, 0.0, 0.0, 0.0])
    depth, number = render(EYE, surfaces, here)
    assert np.count_nonzero(number == 0) > 1000
    one = posed_parts.observation([posed_parts.view(EYE, depth, np.where(depth > 0, OBJECT, 0).astype(np.uint8))])
    information, _ = normal_equations(
        one, surfaces, np.stack([here, up])[None], np.array([[1e-5]]), SCORE, np.array([0.01]), STEEP
    )
    rows, columns = np.nonzero(depth > 0)
    rays = np.stack([(columns - EYE.cx) / EYE.fx, (rows - EYE.cy) / EYE.fy, np.ones(len(rows))], axis=1)
    slope = -1.0 / rays[:, 1]
    flat = np.abs(slope) < STEEP
    z = depth[rows, columns].astype(np.float64)
    np.testing.assert_allclose(
        information[0, 0, 0, 0],
        np.sum((slope**2 * (z / SCORE.unit_distance) ** 2)[flat]) / SCORE.tolerance**2,
        rtol=0.02,
    )
