"""The floor, the walls and the table are found; the flat front of the object is not taken for one of them.

Scenes are seen with a depth sensor's noise from a fixed seed. The planes' errors are compared with ten times what the
noise of the thousands of points on them allows, so that a false alarm means a bug.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.cloud_cameras import look_at_loose_cloud
from pmpnbp.scene.observation import OBJECT, SUPPORT, Observation, Scan
from pmpnbp.scene.observe import observe
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.scene.support_planes import ALIGNED, AT_ONCE, _votes
from tests.scene.box_rooms import FLOOR, WALL, camera_at, has_plane, see, without_pose

FLOOR_PLANE, WALL_PLANE = (0.0, 0.0, 1.0, 0.0), (1.0, 0.0, 0.0, 0.0)
VIEWS = [(1.8, 0.6, 1.2), (1.6, 0.0, 0.5), (2.2, -1.0, 1.5), (1.3, 0.1, 1.1)]
Box = tuple[float, ...]


def cabinet(gap: float) -> Box:
    """A closed cabinet that stands `gap` metres in front of the wall."""
    return (gap, -0.25, 0.0, gap + 0.4, 0.25, 0.75)


def roi_of(*boxes: Box) -> Array:
    low, high = np.min([box[:3] for box in boxes], axis=0), np.max([box[3:] for box in boxes], axis=0)
    return np.concatenate([low - 0.1, high + 0.1])


def share(observation: Observation, wanted: int, box: Sequence[float], grow: float) -> float:
    """Of the view's points within `grow` of the surface of `box`'s front and top, the share of category `wanted`."""
    (view,) = observation.views
    points = poses.transform_points(
        view.camera.pose_world_camera, view.camera.back_project(view.depth).astype(np.float64)
    )
    x0, y0, z0, x1, y1, z1 = box
    x, y, z = np.moveaxis(points, -1, 0)
    front = (np.abs(x - x1) < grow) & (y > y0) & (y < y1) & (z > z0 + 0.05) & (z < z1)
    top = (np.abs(z - z1) < grow) & (y > y0) & (y < y1) & (x > x0 + 0.05) & (x < x1)
    return float((view.category[front | top] == wanted).mean())


@pytest.mark.parametrize("with_roi", [False, True])
@pytest.mark.parametrize("position", VIEWS)
@pytest.mark.parametrize("gap", [0.02, 0.05, 0.1, 0.3])
def test_floor_and_wall_but_not_the_cabinet(
    gap: float, position: Sequence[float], with_roi: bool, rng: np.random.Generator
) -> None:
    box = cabinet(gap)
    scan = see(camera_at(position, [0.2, 0.0, 0.4]), [FLOOR, WALL, box], rng)
    observation = observe([scan], roi_of(box) if with_roi else None)
    assert len(observation.planes) == 2
    assert has_plane(observation.planes, FLOOR_PLANE, angle=0.2, offset=0.003)
    assert has_plane(observation.planes, WALL_PLANE, angle=0.2, offset=0.003)
    assert share(observation, OBJECT, box, 0.02) > 0.99


@pytest.mark.parametrize("position", VIEWS)
def test_without_a_camera_pose_up_is_the_floors_normal(position: Sequence[float], rng: np.random.Generator) -> None:
    camera = camera_at(position, [0.2, 0.0, 0.4])
    observation = observe([without_pose(see(camera, [FLOOR, WALL, cabinet(0.1)], rng))])
    truth = poses.rotate(poses.inverse(camera.pose_world_camera)[3:], np.array([0.0, 0.0, 1.0]))
    assert np.degrees(np.arccos(observation.up @ truth)) < 0.3
    assert len(observation.planes) == 2


@pytest.mark.parametrize(
    "boxes",
    [
        [FLOOR, cabinet(0.1)],
        [FLOOR, WALL, *((0.1, -1.3 + 0.52 * k, 0.0, 0.5, -0.8 + 0.52 * k, 0.75) for k in range(5))],
    ],
    ids=["nothing behind it", "in a row of its kind"],
)
def test_a_front_with_the_floor_before_it_is_no_wall(boxes: list[Box], rng: np.random.Generator) -> None:
    for position in VIEWS:
        scan = see(camera_at(position, [0.2, 0.0, 0.4]), boxes, rng)
        for roi in (None, roi_of(boxes[-1] if len(boxes) == 2 else boxes[4])):
            observation = observe([scan], roi)
            # from the fourth place, the row hides all but 2 % of the floor
            assert has_plane(observation.planes, FLOOR_PLANE, angle=0.3, offset=0.005) or position == VIEWS[3]
            fronts = [plane for plane in observation.planes if abs(plane[0]) > 0.9]
            assert all(abs(plane[3]) < 0.02 for plane in fronts)


@pytest.mark.parametrize("drawer", [[], [(0.5, -0.25, 0.5, 0.7, 0.25, 0.72)]], ids=["closed", "open"])
def test_a_cloud_of_the_object_alone_has_no_support(drawer: list[Box], rng: np.random.Generator) -> None:
    """Its front reaches every border of the virtual camera's picture and has nothing behind it."""
    for position in VIEWS:
        scan = see(camera_at(position, [0.2, 0.0, 0.4]), [cabinet(0.1), *drawer], rng)
        points = scan.camera.back_project(scan.depth)[scan.depth > 0]
        camera, depth = look_at_loose_cloud(points, poses.IDENTITY, None, "cabinet.xyz")
        posed = Camera(
            camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, scan.camera.pose_world_camera
        )
        for roi in (None, roi_of(cabinet(0.1), *drawer)):
            assert len(observe([Scan(posed, depth)], roi).planes) == 0
        assert len(observe([Scan(camera, depth)]).planes) == 0


TABLE, ON_TABLE = (-0.3, -0.8, 0.68, 0.9, 0.8, 0.72), (0.2, -0.15, 0.72, 0.45, 0.15, 1.0)
ROOM = [FLOOR, (-1.5, -5.0, -1.0, -1.4, 5.0, 4.0), TABLE, ON_TABLE]


@pytest.mark.parametrize("posed", [True, False])
@pytest.mark.parametrize("position", [(1.7, 0.6, 1.3), (1.5, -0.1, 1.1), (1.9, 0.2, 1.8)])
def test_the_table_that_the_object_stands_on(position: Sequence[float], posed: bool, rng: np.random.Generator) -> None:
    scan = see(camera_at(position, [0.3, 0.0, 0.8]), ROOM, rng)
    table = np.array([0.0, 0.0, 1.0, -0.72])
    roi = roi_of(ON_TABLE)
    if not posed:
        # the same box's corners in the camera frame, and the box around them
        corners = np.stack(np.meshgrid(*roi.reshape(2, 3).T), axis=-1).reshape(-1, 3)
        to_camera = poses.inverse(scan.camera.pose_world_camera)
        corners = poses.transform_points(to_camera, corners)
        roi = np.concatenate([corners.min(axis=0), corners.max(axis=0)])
        normal = poses.rotate(to_camera[3:], table[:3])
        table = np.append(normal, -0.72 - normal @ to_camera[:3])
        scan = without_pose(scan)
    observation = observe([scan], roi)
    assert has_plane(observation.planes, table, angle=0.5, offset=0.005)
    if posed:
        assert share(observation, OBJECT, ON_TABLE, 0.02) > 0.99
    else:
        assert observation.up @ table[:3] > 0.999


def test_the_top_of_the_object_is_no_table(rng: np.random.Generator) -> None:
    """A desk of 1.4 m: level, large, nothing above it; but what the region holds lies under it."""
    desk = [(0.1, -0.7, 0.7, 0.8, 0.7, 0.74), (0.1, -0.7, 0.0, 0.15, -0.65, 0.7), (0.1, 0.3, 0.0, 0.7, 0.7, 0.7)]
    scan = see(camera_at([2.2, 0.3, 1.5], [0.3, 0.0, 0.5]), [FLOOR, WALL, *desk], rng)
    for roi in (None, roi_of(*desk)):
        observation = observe([scan], roi)
        assert len(observation.planes) == 2
        assert share(observation, OBJECT, desk[0], 0.02) > 0.99


def test_a_far_wall_is_one_plane(rng: np.random.Generator) -> None:
    """Its noise of several centimetres once made skirts that were found as further walls."""
    wall = (-2.6, -5.0, -1.0, -2.5, 5.0, 4.0)
    scan = see(camera_at([1.8, 0.6, 1.2], [-0.5, 0.0, 0.9]), [FLOOR, wall, cabinet(0.1)], rng)
    planes = observe([scan]).planes
    assert len(planes) == 2
    assert has_plane(planes, (1.0, 0.0, 0.0, 2.5), angle=0.5, offset=0.02)


def test_a_point_of_a_plane_is_support_by_the_tolerance_of_its_depth() -> None:
    """A box 3 cm thick on a floor seen from 1.5 m: support with a tolerance of 5 cm, object with one of 1 cm."""
    mat = (0.0, -0.5, 0.0, 0.6, 0.5, 0.03)
    scan = see(camera_at([1.6, 0.2, 1.0], [0.3, 0.0, 0.0]), [FLOOR, mat])
    fine, coarse = observe([scan]), observe([scan], plane_tolerance=0.05)
    assert share(fine, OBJECT, mat, 0.005) > 0.95
    assert share(coarse, SUPPORT, mat, 0.005) > 0.95


def test_each_plane_has_the_votes_of_the_points_on_it_that_face_its_way(rng: np.random.Generator) -> None:
    """As counted point by point, of more planes than are judged at once."""
    points = rng.uniform(-0.2, 0.2, (70, 3))
    normals = poses.rotate(poses.from_rotation_vector(rng.normal(0, 0.3, (70, 3))), np.array([0.0, 0.0, 1.0]))
    n, d = normals[: AT_ONCE + 7].astype(np.float32), rng.uniform(-0.1, 0.1, AT_ONCE + 7).astype(np.float32)
    reach = rng.uniform(0.01, 0.2, 70).astype(np.float32)
    expected = [
        sum(
            abs(plane @ point + offset) < near and plane @ normal > ALIGNED
            for point, normal, near in zip(points, normals, reach, strict=True)
        )
        for plane, offset in zip(n.astype(float), d.astype(float), strict=True)
    ]
    assert max(expected) > 10
    np.testing.assert_array_equal(_votes(n, d, points, normals, reach), expected)


def test_planes_repeat_bit_for_bit(rng: np.random.Generator) -> None:
    scan = see(camera_at(VIEWS[0], [0.2, 0.0, 0.4]), [FLOOR, WALL, cabinet(0.1)], rng)
    first, second = observe([scan]), observe([scan])
    np.testing.assert_array_equal(first.planes, second.planes)
    np.testing.assert_array_equal(first.points, second.points)


def test_the_real_table(shared_data: Path) -> None:
    """The arm's table in three RealSense frames: level, and within 2 cm of the arm's base at z = 0."""
    for frame in ("frame_0", "frame_4", "frame_7"):
        folder = shared_data / "real_xarm7" / frame
        scan = load_scan(folder / "depth.png", folder / "camera.json")
        planes = observe([scan], np.array([-0.8, -0.9, -0.2, 0.8, 0.6, 1.1])).planes
        assert has_plane(planes, FLOOR_PLANE, angle=3.0, offset=0.02)


def test_the_simulated_robots_floor_and_wall(shared_data: Path) -> None:
    for name in ("scan_0", "scan_1"):
        folder = shared_data / "fetch" / name
        planes = observe([load_scan(folder / "depth.png", folder / "camera.json")]).planes
        assert len(planes) == 2
        assert has_plane(planes, FLOOR_PLANE, angle=0.3, offset=0.005)
