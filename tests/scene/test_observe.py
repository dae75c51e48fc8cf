"""From scans to the Observation: binning, cropping, categories, several views, and what is said of bad input."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pmpnbp.errors import ScanError
from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.scene.observation import NO_DEPTH, OBJECT, OUTSIDE, SUPPORT, Scan, View
from pmpnbp.scene.observe import MARGIN, observe
from pmpnbp.scene.work_image import turned_back
from tests.scene.box_rooms import FLOOR, WALL, camera_at, see

BOX = (0.2, -0.2, 0.0, 0.5, 0.2, 0.5)
ROI = np.array([0.1, -0.3, -0.1, 0.6, 0.3, 0.6])
SCAN = see(camera_at([1.8, 0.6, 1.2], [0.3, 0.0, 0.3], width=640, height=480), [FLOOR, WALL, BOX])


def points_of(view: View) -> np.ndarray:
    """(h, w, 3) metres, world: what each pixel of a view sees."""
    return poses.transform_points(
        view.camera.pose_world_camera, view.camera.back_project(view.depth).astype(np.float64)
    )


def test_the_whole_picture_without_a_roi() -> None:
    (view,) = observe([SCAN]).views
    # 160 by 120 blocks of four pixels, turned
    assert abs(np.count_nonzero(view.depth) - 120 * 160) < 0.05 * 120 * 160
    assert (view.category != OUTSIDE).all()
    # never blown up
    assert observe([SCAN], width=640).views[0].depth.shape == (480, 640)
    assert observe([SCAN], width=2000).views[0].depth.shape == (480, 640)


@pytest.mark.parametrize("width", [80, 160, 320])
def test_the_image_holds_the_roi_and_a_margin(width: int) -> None:
    observation = observe([SCAN], ROI, width=width)
    (view,) = observation.views
    points = points_of(view)
    inside = ((points >= ROI[:3]) & (points <= ROI[3:])).all(axis=-1) & (view.depth > 0)
    rows, columns = np.nonzero(turned_back(inside, view.turn, view.camera))
    margin = min(MARGIN, width // 8)
    assert max(np.ptp(rows), np.ptp(columns)) <= width - 2 * margin + 1
    rows, columns = np.nonzero(inside)
    # the box is in the middle of the picture, so that the margin is whole on every side
    for least in (rows.min(), columns.min(), len(inside) - 1 - rows.max(), inside.shape[1] - 1 - columns.max()):
        assert margin - 1 <= least <= margin + 2
    assert (view.category[inside] != OUTSIDE).all()
    assert np.isin(view.category[~inside], [OUTSIDE, SUPPORT, NO_DEPTH]).all()


def test_work_pixels_look_where_the_scan_measured() -> None:
    """Planes in the scan are the same planes in the binned picture: floor points of the view lie at z = 0."""
    (view,) = observe([SCAN], ROI).views
    points = points_of(view)
    floor = (view.category == SUPPORT) & (points[..., 0] > 0.05)
    assert floor.sum() > 1000
    # half a work pixel is 3 mm of floor at this distance and slope; the median is nearer
    assert np.abs(points[floor][:, 2]).mean() < 0.002


def test_categories_points_and_normals_of_a_box() -> None:
    observation = observe([SCAN], ROI)
    (view,) = observation.views
    assert set(np.unique(view.category).tolist()) <= {NO_DEPTH, OBJECT, SUPPORT, OUTSIDE}
    assert ((view.category == NO_DEPTH) == (view.depth == 0)).all()
    assert (
        len(observation.points)
        == len(observation.normals)
        == ((view.category == OBJECT) & (view.normals != 0).any(axis=-1)).sum()
    )
    np.testing.assert_allclose(np.linalg.norm(observation.normals, axis=1), 1.0, atol=1e-5)
    # each point lies on a face of the box, within a work pixel, and on the flat of a face its normal is the face's
    low, high = np.array(BOX).reshape(2, 3)
    assert (observation.points > low - 0.02).all() and (observation.points < high + 0.02).all()
    for axis in (0, 1, 2):
        other = [k for k in range(3) if k != axis]
        margin = observation.points[:, other]
        flat = (np.abs(observation.points[:, axis] - high[axis]) < 0.005) & (
            (margin > low[other] + 0.05) & (margin < high[other] - 0.05)
        ).all(axis=1)
        assert flat.sum() > 20
        assert (observation.normals[flat, axis] > np.cos(np.radians(3))).mean() > 0.98
    for array in (view.depth, view.category, view.normals):
        assert not array.flags.writeable


@pytest.mark.parametrize(("thick", "of_wall"), [(0.035, False), (0.005, True)])
def test_a_shut_door_is_not_its_wall_nor_the_floor_before_it(
    thick: float, of_wall: bool, rng: np.random.Generator
) -> None:
    """From 3.5 m, where a wall's pixels may be 35 mm off: a door as thick is no part of it, a poster is. Their lowest
    rows are within a centimetre of the floor, and told by nothing."""
    door = (0.0, -0.45, 0.0, thick, 0.45, 2.0)
    scan = see(camera_at([3.4, 0.6, 1.4], [0.0, 0.0, 1.0], width=640, height=480), [FLOOR, WALL, door], rng)
    observation = observe([scan], np.array([-0.2, -0.7, -0.1, 0.4, 0.7, 2.2]))
    assert len(observation.planes) == 2
    (view,) = observation.views
    points = points_of(view)
    across = (np.abs(points[..., 1]) < 0.42) & (np.abs(points[..., 0] - thick) < 0.03) & (view.depth > 0)
    upper, lowest = across & (points[..., 2] > 0.1) & (points[..., 2] < 1.95), across & (points[..., 2] < 0.01)
    assert upper.sum() > 500 and lowest.sum() > 5
    assert np.mean(view.category[upper] == (SUPPORT if of_wall else OBJECT)) > 0.97
    assert np.all(view.category[lowest] == SUPPORT)


def test_two_views_of_one_scene() -> None:
    other = see(camera_at([1.2, -1.3, 1.0], [0.3, 0.0, 0.3], width=320, height=240), [FLOOR, WALL, BOX])
    both = observe([replace(SCAN, stamp=2.0), replace(other, stamp=5.0)], ROI)
    assert len(both.views) == 2
    assert both.stamp == 5.0
    assert len(both.planes) == 2
    alone = [observe([scan], ROI) for scan in (SCAN, other)]
    assert abs(len(both.points) - sum(len(one.points) for one in alone)) < 20
    # the side that only one camera sees is there
    assert (both.normals[:, 1] < -0.9).sum() > 50 > (alone[0].normals[:, 1] < -0.9).sum()


def test_a_view_that_misses_the_roi_is_left_out() -> None:
    away = see(camera_at([1.8, 0.6, 1.2], [3.0, 3.0, 0.5]), [FLOOR, WALL, BOX])
    assert len(observe([SCAN, away], ROI).views) == 1
    found = observe([away, SCAN, away, SCAN], ROI)
    assert (found.scan_count, found.scan_numbers) == (4, (1, 3))
    assert found.by_scan([0.5, 0.25]) == (None, 0.5, None, 0.25)


def test_up() -> None:
    np.testing.assert_array_equal(observe([SCAN]).up, [0, 0, 1])
    np.testing.assert_allclose(observe([SCAN], up=np.array([0.0, 3.0, 4.0])).up, [0, 0.6, 0.8])
    wall_only = Scan(Camera(64, 48, 60.0, 60.0, 31.5, 23.5), np.full((48, 64), 2.0, dtype=np.float32))
    np.testing.assert_array_equal(observe([wall_only]).up, [0, -1, 0])


@pytest.mark.parametrize(
    ("roi", "said"),
    [
        ([0, 0, 0, 1, 1], "expected six numbers x0 y0 z0 x1 y1 z1"),
        ([0, 0, 0, 1, 1, np.nan], "expected six numbers x0 y0 z0 x1 y1 z1"),
        ([0, 0, 1, 1, 1, 1], "is empty; expected x0 < x1, y0 < y1 and z0 < z1"),
        ([5, 5, 5, 6, 6, 6], "no measured point lies in the region [5.0, 5.0, 5.0, 6.0, 6.0, 6.0]; the scan spans ["),
    ],
)
def test_what_is_said_of_a_roi_that_cannot_be_used(roi: list[float], said: str) -> None:
    with pytest.raises(ScanError) as caught:
        observe([SCAN], np.array(roi, dtype=float))
    assert said in str(caught.value)


def test_what_is_said_of_scans_that_do_not_belong_together() -> None:
    with pytest.raises(ScanError, match="no scan was given"):
        observe([])
    with pytest.raises(ScanError, match="in different world frames, map, world; expected one frame for all"):
        observe([SCAN, replace(SCAN, frame_id="map")])
    with pytest.raises(ScanError, match=r"up is \[0\.0, 0\.0, 0\.0\]; expected three numbers"):
        observe([SCAN], up=np.zeros(3))
    with pytest.raises(ScanError, match="the work image's width is 20; expected at least 40 pixels"):
        observe([SCAN], width=20)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (700, 3), (3, 700), (161, 1)])
def test_a_scan_of_a_few_pixels_is_observed(width: int, height: int) -> None:
    scan = Scan(Camera(width, height, 300.0, 300.0, 0.0, 0.0), np.ones((height, width), dtype=np.float32))
    for roi in (None, np.array([-9.0, -9.0, 0.0, 9.0, 9.0, 2.0])):
        observation = observe([scan], roi)
        assert (observation.views[0].category == OBJECT).all()
        assert observation.planes.shape == (0, 4)
