"""Is a model laid on what was measured of it, and is it told where it cannot stand?"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.shape_fit import Shapes, best_fit, shapes
from pmpnbp.scene.urdf import load_model

CABINET = Path(__file__).resolve().parents[2] / "sample_data" / "cabinet" / "cabinet.urdf"
# The camera looks along world's x, 3 m before the origin.
CAMERA = Camera(
    160, 120, 140.0, 140.0, 79.5, 59.5, np.array([-3.0, 0.0, 0.3, *poses.from_rpy([-np.pi / 2, 0.0, -np.pi / 2])])
)
NO_TURN = poses.IDENTITY[3:]
FIRST = np.arange(4)


@pytest.fixture(scope="module")
def cabinet() -> Shapes:
    return shapes(load_model(CABINET))


def scan(depth: float) -> Scan:
    return Scan(CAMERA, np.full((CAMERA.height, CAMERA.width), depth, dtype=np.float32))


def placed(cabinet: Shapes, configuration: int, angle: float, at: tuple[float, float, float]) -> Array:
    pose = np.array([*at, *poses.from_rpy([0.0, 0.0, angle])])
    return poses.transform_points(pose, cabinet.points[configuration])


def test_the_model_lies_where_it_was_put(cabinet: Shapes) -> None:
    own = placed(cabinet, 2, 0.5, (0.2, -0.1, 0.3))
    fit = best_fit(own, cabinet, FIRST, [scan(1.0)], NO_TURN)
    assert fit.cost < 0.1
    for axis in range(3):
        assert fit.surface[:, axis].min() == pytest.approx(own[:, axis].min(), abs=0.04)
        assert fit.surface[:, axis].max() == pytest.approx(own[:, axis].max(), abs=0.04)


def test_what_is_seen_through_is_none_of_it(cabinet: Shapes) -> None:
    own = placed(cabinet, 0, 0.0, (0.0, 0.0, 0.3))
    before, behind = (best_fit(own, cabinet, FIRST, [scan(depth)], NO_TURN).cost for depth in (1.0, 6.0))
    assert behind == pytest.approx(before + 1.0, abs=0.1)  # all of it is before a wall 6 m away
    nothing = best_fit(own, cabinet, FIRST, [scan(0.0)], NO_TURN).cost
    assert nothing == pytest.approx(before, abs=0.01)  # where nothing is measured nothing is seen through


def test_another_shape_costs_more(cabinet: Shapes) -> None:
    own = placed(cabinet, 0, 0.0, (0.0, 0.0, 0.3))
    middle = own.mean(axis=0)
    ball = middle + 0.4 * (own - middle) / np.linalg.norm(own - middle, axis=1, keepdims=True)
    costs = [best_fit(points, cabinet, FIRST, [scan(1.0)], NO_TURN).cost for points in (own, ball)]
    assert costs[1] > costs[0] + 0.2
