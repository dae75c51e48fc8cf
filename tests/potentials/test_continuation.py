"""What a surface that goes on beyond the outline is worth: laws of plates before a wall, and the kernels' twin."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.potentials.kernels import reference
from pmpnbp.potentials.surfaces import Surfaces, prepare_surfaces
from pmpnbp.potentials.unary import PixelScore, object_scores, render
from pmpnbp.scene.articulated_object import Mesh
from pmpnbp.scene.observation import OBJECT, View
from tests.potentials import posed_parts

EYE = Camera(160, 120, 150.0, 150.0, 79.5, 59.5)
SCORE = PixelScore(tolerance=0.02, continued_reward=0.1, firm_cost=6.0)


def plate(width: float, height: float) -> Surfaces:
    corners = np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    return prepare_surfaces(posed_parts.object_of([Mesh(corners * [width / 2, height / 2, 1.0], faces)]))


def at(x: float, y: float, z: float = 1.0) -> Array:
    return np.array([[x, y, z, 1.0, 0.0, 0.0, 0.0]])


def seen(depth: Array) -> View:
    return posed_parts.view(EYE, depth.astype(np.float32), np.full(depth.shape, OBJECT, dtype=np.uint8))


def share_kept(depth: Array, surfaces: Surfaces, pose: Array) -> float:
    """Of the reward that the pixels would earn on their own."""
    scored = object_scores(posed_parts.observation([seen(depth)]), surfaces, pose[None], SCORE)
    covered = np.count_nonzero(render(EYE, surfaces, pose)[0])
    assert covered > 100
    return float(scored[0]) / covered


@pytest.mark.parametrize("size", [0.1, 0.3, 0.6])
def test_a_plate_anywhere_on_a_wall_is_worth_a_tenth_however_large(size: float) -> None:
    wall = np.ones((EYE.height, EYE.width))
    assert share_kept(wall, plate(size, size), at(0.0, 0.0)) == pytest.approx(0.1, abs=0.01)


def test_a_plate_that_the_picture_cuts_off_is_judged_by_the_sides_that_are_seen() -> None:
    """Laid onto a table's near corner, it was worth almost all of its pixels, and a laptop further back fewer. Pixels
    at the picture's own border, where no smoothness can be told, belong to no patch and keep theirs."""
    wall = np.ones((EYE.height, EYE.width))
    surfaces, pose = plate(0.7, 0.5), at(-0.4, 0.3)
    drawn = render(EYE, surfaces, pose)[0] > 0
    beside = np.count_nonzero(drawn & (seen(wall).patches == 0)) / np.count_nonzero(drawn)
    assert beside < 0.15
    assert share_kept(wall, surfaces, pose) == pytest.approx(0.1 + 0.9 * beside, abs=0.01)


@pytest.mark.parametrize("size", [0.1, 0.3, 0.6])
def test_a_plate_that_ends_where_the_surface_does_keeps_its_reward(size: float) -> None:
    surfaces, pose = plate(size, size), at(0.05, -0.03)
    drawn = render(EYE, surfaces, pose)[0]
    assert share_kept(np.where(drawn > 0, drawn, 1.5), surfaces, pose) == pytest.approx(1.0, abs=0.01)


def test_what_is_beyond_the_picture_says_nothing() -> None:
    wall = np.ones((EYE.height, EYE.width))
    assert share_kept(wall, plate(3.0, 3.0), at(0.0, 0.0)) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize("edge_weight", [1.0, 0.4])
def test_scores_are_those_of_the_reference(rng: np.random.Generator, edge_weight: float) -> None:
    """Plates at random places before a room of smooth surfaces, some of which go on beyond them and some do not."""
    depth = np.full((EYE.height, EYE.width), 1.3)
    depth[:, 70:] = np.linspace(1.3, 0.9, EYE.width - 70)
    depth[20:60, 20:90] = 1.0
    depth[75:100, 40:140] = 0.8
    view = seen(depth)
    assert view.patches.max() == 3
    surfaces = plate(0.4, 0.3)
    lens = np.array([EYE.fx, EYE.fy, EYE.cx, EYE.cy])
    place = rng.uniform([-0.5, -0.35, 0.78], [0.5, 0.35, 1.32], (60, 3))
    place[::3, 2] = 1.0
    pose = np.concatenate([place, np.tile([1.0, 0.0, 0.0, 0.0], (60, 1))], axis=1)[:, None]
    score = replace(SCORE, edge_weight=edge_weight)
    fast = object_scores(posed_parts.observation([view]), surfaces, pose, score)
    vertices, faces = surfaces.vertices.T.astype(np.float64), surfaces.faces.T
    terms = score.terms.astype(np.float64)
    weighed = 0
    for k in range(60):
        cloud = poses.transform_points(pose[k, 0], vertices)
        slow, plain = (
            reference.object_score(view.depth, view.category, lens, [cloud], [faces], terms, True, view.firm, patches)
            for patches in (view.patches, None)
        )
        # a pixel on an edge, or at the tolerance, may go either way, and with it a little of a patch's weight
        assert fast[k] == pytest.approx(slow, rel=0.02, abs=5.0)
        weighed += abs(slow - plain) > 50.0
    assert weighed > 10
