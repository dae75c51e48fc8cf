"""Is all that is to be seen in the picture from each of the named places, and as large as it can be?"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from app.viewer.places import FIELD_OF_VIEW, ROOM, framed, place
from app.viewer.view_state import Eye, ViewState, merged
from pmpnbp.geometry import poses
from tests.app.scenes import scene

UP = np.array([0.0, 0.0, 1.0])


def seen(eye: Eye, points: Any, aspect: float) -> np.ndarray:
    """(P, 2): where the points are in the picture, -1 to 1 to the right and up; all of them have to be ahead."""
    position = np.array(eye.position)
    forward = np.array(eye.look_at) - position
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, eye.up)
    right /= np.linalg.norm(right)
    offset = np.asarray(points) - position
    depth = offset @ forward
    assert (depth > 0).all()
    half = np.tan((eye.field_of_view or FIELD_OF_VIEW) / 2)
    return np.stack([offset @ right / depth / half / aspect, offset @ np.cross(right, forward) / depth / half], axis=1)


def named(look: Any, aspect: float | None = 1.6, **members: Any) -> Eye:
    newest = scene().snapshots[-1]
    return place(look, newest.placed.part_poses, ViewState(**members), scene().stage, aspect)


@pytest.mark.parametrize("aspect", [0.5, 1.0, 2.5])
@pytest.mark.parametrize("towards", [(1.0, 0.3, -0.4), (-0.2, -1.0, 0.1), (0.0, 0.0, -1.0)])
def test_what_is_framed_fills_the_picture(aspect: float, towards: tuple[float, float, float]) -> None:
    points = np.random.default_rng(3).normal(size=(200, 3)) * [0.2, 0.6, 1.0] + 5
    eye = framed(points, np.array(towards), UP, aspect)
    at = seen(eye if abs(towards[2]) < 1 else eye.model_copy(update={"up": (0.0, 1.0, 0.0)}), points, aspect)
    if abs(towards[2]) < 1:  # straight down any side may be up in the picture
        assert np.abs(at).max() < 1 and np.abs(at).max() > 0.75 / ROOM
    ahead = np.array(eye.look_at) - np.array(eye.position)
    np.testing.assert_allclose(ahead / np.linalg.norm(ahead), np.array(towards) / np.linalg.norm(towards), atol=1e-5)


@pytest.mark.parametrize("look", ["fit", "top"])
@pytest.mark.parametrize("aspect", [0.6, 1.6])
def test_the_whole_estimate_is_seen_or_the_region_where_that_is_shown(look: str, aspect: float) -> None:
    whole = scene()
    shapes = zip(whole.stage.shapes, whole.snapshots[-1].placed.part_poses, strict=True)
    points = np.concatenate([poses.transform_points(p, s.corners.reshape(-1, 3).astype(float)) for s, p in shapes if s])
    assert np.abs(seen(named(look, aspect), points, aspect)).max() < 1
    region = (-3.0, -2.0, 0.0, 4.0, 2.0, 1.0)
    box = np.array([(x, y, z) for x in region[::3] for y in region[1::3] for z in region[2::3]])
    assert not np.allclose(
        named(look, aspect).position, named(look, aspect, region=region, show={"region": True}).position
    )
    around = named(look, aspect, region=region, show={"region": True})
    assert np.abs(seen(around, box, aspect)).max() < 1


def test_it_fits_from_where_it_is_looked_at() -> None:
    before = Eye(position=(3.0, -4.0, 2.0), look_at=(0.5, 0.2, 0.3), up=(0.0, 0.0, 1.0))
    after = named("fit", camera=before)
    one, other = (np.array(eye.look_at) - np.array(eye.position) for eye in (before, after))
    np.testing.assert_allclose(one / np.linalg.norm(one), other / np.linalg.norm(other), atol=1e-5)


@pytest.mark.parametrize("aspect", [0.6, 4 / 3, 2.0])
def test_the_sensors_picture_is_its_image(aspect: float) -> None:
    camera = scene().stage.scans[0].camera
    eye = named("sensor", aspect)
    np.testing.assert_allclose(eye.position, camera.pose_world_camera[:3], atol=1e-6)
    # the image's corners, a metre away: one pair of its sides is at the picture's, and the other within
    half = np.array([camera.width / camera.fx, camera.height / camera.fy]) / 2
    corners = [poses.transform_points(camera.pose_world_camera, np.array([x, y, 1.0])) for x, y in (-half, half)]
    at = seen(eye, corners, aspect)
    np.testing.assert_allclose(at, np.array([[-1, 1], [1, -1]]) * np.abs(at), atol=1e-9)  # as it has them: down is down
    assert np.abs(at).max() == pytest.approx(1, abs=1e-5)


def test_from_the_top_what_is_away_from_the_sensor_is_up() -> None:
    eye, camera = named("top"), scene().stage.scans[0].camera
    down = np.array(eye.look_at) - np.array(eye.position)
    assert down @ UP < -0.999 * np.linalg.norm(down)
    ahead = poses.rotate(camera.pose_world_camera[3:], np.array([0.0, 0.0, 1.0])) * [1, 1, 0]
    near, far = seen(eye, np.array(eye.look_at) + [[0, 0, 0], 0.1 * ahead], 1.6)
    assert far[1] > near[1] + 0.01 and abs(far[0] - near[0]) < 1e-3


def test_another_camera_is_no_named_place_any_more() -> None:
    eye = {"position": (3.0, 0.0, 1.0), "look_at": (0.0, 0.0, 0.0), "up": (0.0, 0.0, 1.0)}
    there = merged(ViewState(), ViewState(look="top", camera=eye))
    assert there.look == "top"
    assert merged(there, ViewState(confidence=0.5)).look == "top"
    assert merged(there, ViewState(camera=eye)).look is None
