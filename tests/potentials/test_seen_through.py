"""What stands out of a part and is not in the scan speaks more against it amid a smooth surface than beside a step."""

from __future__ import annotations

import numpy as np
import trimesh

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.potentials.surfaces import prepare_surfaces
from pmpnbp.potentials.unary import PixelScore, normal_equations, object_scores, render, unary_scores
from pmpnbp.scene.observation import OBJECT, View
from tests.potentials import posed_parts

EYE = Camera(100, 80, 90.0, 90.0, 49.5, 39.5)
SCORE = PixelScore(tolerance=0.012, firm_cost=6.0)
# A drawer's front a metre away, and its handle, which stands 4 cm before it.
FRONT = trimesh.creation.box((0.5, 0.4, 0.02))
HANDLE = trimesh.creation.box((0.2, 0.06, 0.02)).apply_translation([0.0, 0.0, -0.04])
DRAWER = prepare_surfaces(posed_parts.object_of([posed_parts.mesh_of(trimesh.util.concatenate([FRONT, HANDLE]))]))
PLATE = prepare_surfaces(posed_parts.object_of([posed_parts.mesh_of(FRONT)]))
PLACE = np.concatenate([[0.0, 0.0, 1.01], poses.IDENTITY[3:]])[None]


def seen(depth: np.ndarray) -> View:
    return posed_parts.view(EYE, depth.astype(np.float32), np.full(depth.shape, OBJECT, dtype=np.uint8))


def told(view: View, firm: bool) -> View:
    """The view, with all of its pixels firm, or none."""
    view.__dict__["firm"] = np.full(view.depth.shape, firm)
    return view


def test_a_handle_before_a_smooth_board_costs_six_times_its_pixels() -> None:
    board = np.where(render(EYE, PLATE, PLACE)[0] > 0, 1.0, 1.5)
    with_handle, _ = render(EYE, DRAWER, PLACE)
    handle = (with_handle > 0) & (with_handle < 0.98)
    view = seen(board)
    assert np.count_nonzero(handle) > 80 and view.firm[handle].all()
    found, loose = (
        float(object_scores(posed_parts.observation([one]), DRAWER, PLACE[None], SCORE)[0])
        for one in (view, told(seen(board), firm=False))
    )
    # each by what it covers at its distance
    np.testing.assert_allclose(loose - found, (SCORE.firm_cost - 1) * np.sum(with_handle[handle] ** 2), rtol=1e-3)


def test_only_what_is_seen_through_tells_firm_pixels_from_others(rng: np.random.Generator) -> None:
    """Registration, what goes on beyond the outline, and a part within the tolerance have the same numbers."""
    depth = render(EYE, DRAWER, PLACE)[0]
    depth = np.where(depth > 0, depth, 1.015) + rng.normal(0.0, 0.001, depth.shape)
    firm, others = (posed_parts.observation([told(seen(depth), firm)]) for firm in (True, False))
    moved = np.tile(PLACE, (2, 1, 1))
    moved[1, 0, 2] += 0.004
    for score in (SCORE, PixelScore(tolerance=0.06, firm_cost=6.0), PixelScore("distance")):
        np.testing.assert_array_equal(*(object_scores(one, PLATE, moved, score) for one in (firm, others)))
        for renderer in ("rasteriser", "splats"):
            np.testing.assert_array_equal(
                *(unary_scores(one, PLATE, [0, 0], moved[:, 0], score, renderer=renderer) for one in (firm, others))  # type: ignore[arg-type]
            )
    equations = [
        normal_equations(one, DRAWER, moved[None], np.array([[0.004]]), SCORE, np.array([0.02]), 8.0)
        for one in (firm, others)
    ]
    assert equations[0][0].min() > 1.0
    np.testing.assert_array_equal(*(information for information, _ in equations))
    np.testing.assert_array_equal(*(gradient for _, gradient in equations))
