"""Are the things that stand in a scan found, whole, and the one that is the model's first?"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.hard import write_hard
from benchmarks.hard_scenes import FAMILIES, hard_scene
from pmpnbp.errors import ScanError
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.regions import MARGIN, MOST_REGIONS, Region, propose_regions
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.scene.sizes_over_joints import reaches, sides, sides_over_joints
from pmpnbp.scene.truth_file import load_truth
from pmpnbp.scene.urdf import load_model
from sample_data.rendering import cast, link_meshes, load

SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"
# Share of the object's pixels that its box holds.
WHOLE = 0.97


def object_points(folder: Path, urdf: Path, scan: Scan) -> Array:
    """(P, 3), metres, world: what was measured of the object, told by the truth."""
    truth = load_truth(folder / "truth.json")["links"]
    meshes = link_meshes(load(urdf.read_text(), urdf.parent), urdf.parent)
    seen = cast(
        [mesh.copy().apply_transform(poses.to_matrix(truth[name])) for name, mesh in meshes.items()], scan.camera
    )
    own = (seen.depth > 0) & (scan.depth > 0) & (np.abs(seen.depth - scan.depth) < 0.02)
    camera = scan.camera
    return poses.transform_points(camera.pose_world_camera, camera.back_project(scan.depth)[own].astype(float))


def held(points: Array, region: Region) -> float:
    """The share of points (P, 3) that lie in its box."""
    inside: NDArray[np.bool_] = np.all((points >= region.roi[:3]) & (points <= region.roi[3:]), axis=1)
    return float(inside.mean())


@pytest.mark.parametrize(
    ("model", "scene"),
    [
        ("cabinet", "open"),
        ("cabinet", "closed"),
        ("cabinet", "arm"),
        ("cabinet", "blanket"),
        ("cabinet", "from_above"),
        ("cabinet", "self_occluded"),
        ("door", "ajar"),
        ("robot", "scan_0"),
    ],
)
def test_the_sample_objects_are_proposed_first_and_whole(model: str, scene: str) -> None:
    folder, urdf = SAMPLES / model / scene, SAMPLES / model / f"{model}.urdf"
    scan = load_scan(folder / "depth.png", folder / "camera.json")
    first = propose_regions([scan], load_model(urdf))[0]
    assert held(object_points(folder, urdf, scan), first) > WHOLE


@pytest.mark.parametrize("family", ["open_laptop", "lamp", "organiser", "bias", "cut_off"])
def test_things_on_tables_and_against_walls_are_proposed(family: str, tmp_path: Path) -> None:
    write_hard(tmp_path, hard_scene(family, 0), np.random.default_rng([21, list(FAMILIES).index(family), 0]))
    scan = load_scan(tmp_path / "depth.png", tmp_path / "camera.json")
    urdf = tmp_path / "model.urdf"
    proposed = propose_regions([scan], load_model(urdf))
    own = object_points(tmp_path, urdf, scan)
    assert held(own, proposed[0]) > WHOLE
    # and little else: the table it stands on is none of it
    top = np.array([0.0, 0.0, own[:, 2].max() - own[:, 2].min() + 2 * MARGIN])
    assert (proposed[0].roi[5] - proposed[0].roi[2]) < top[2] + 0.1


def test_the_same_scan_gives_the_same_regions_and_views_are_put_together() -> None:
    cabinet = SAMPLES / "cabinet"
    model = load_model(cabinet / "cabinet.urdf")
    scans = [
        load_scan(cabinet / name / "depth.png", cabinet / name / "camera.json") for name in ("from_above", "lowered")
    ]
    once, again = propose_regions(scans, model), propose_regions(scans, model)
    assert [one.roi.tolist() for one in once] == [one.roi.tolist() for one in again]
    for scan, name in zip(scans, ("from_above", "lowered"), strict=True):
        assert held(object_points(cabinet / name, cabinet / "cabinet.urdf", scan), once[0]) > WHOLE


def test_what_is_found_does_not_depend_on_how_the_world_lies() -> None:
    folder, urdf = SAMPLES / "cabinet" / "open", SAMPLES / "cabinet" / "cabinet.urdf"
    scan = load_scan(folder / "depth.png", folder / "camera.json")
    model = load_model(urdf)
    own = object_points(folder, urdf, scan)
    first = propose_regions([scan], model)[0]
    turn = poses.from_xyz_rpy([2.0, -1.0, 0.5], [0.0, 0.0, 0.7])
    for to_other in (turn, poses.inverse(scan.camera.pose_world_camera)):  # another heading; no pose at all
        pose = poses.multiply(to_other, scan.camera.pose_world_camera)
        pose = poses.IDENTITY if to_other is not turn else pose
        other = propose_regions([replace(scan, camera=replace(scan.camera, pose_world_camera=pose))], model)[0]
        assert held(poses.transform_points(to_other, own), other) > WHOLE
        assert other.points == pytest.approx(first.points, rel=0.02)
        assert other.size == pytest.approx(first.size, abs=0.02)
        assert other.unlikeness == pytest.approx(first.unlikeness, abs=0.1)


def test_a_wall_behind_a_slim_thing_is_none(tmp_path: Path) -> None:
    write_hard(
        tmp_path, hard_scene("long_chain", 44), np.random.default_rng([21, list(FAMILIES).index("long_chain"), 44])
    )
    scan = load_scan(tmp_path / "depth.png", tmp_path / "camera.json")
    first = propose_regions([scan], load_model(tmp_path / "model.urdf"))[0]
    assert held(object_points(tmp_path, tmp_path / "model.urdf", scan), first) > WHOLE


def test_of_things_as_large_as_the_model_the_one_of_its_shape_comes_first(tmp_path: Path) -> None:
    """A box on the table is as large as the laptop might be, open; the laptop is nearly shut."""
    family, seed = "shut_laptop", 40
    write_hard(tmp_path, hard_scene(family, seed), np.random.default_rng([21, list(FAMILIES).index(family), seed]))
    scan = load_scan(tmp_path / "depth.png", tmp_path / "camera.json")
    first = propose_regions([scan], load_model(tmp_path / "model.urdf"))[0]
    assert held(object_points(tmp_path, tmp_path / "model.urdf", scan), first) > WHOLE


def test_without_a_model_what_has_most_points_comes_first() -> None:
    folder = SAMPLES / "cabinet" / "open"
    scan = load_scan(folder / "depth.png", folder / "camera.json")
    found = propose_regions([scan])
    assert 0 < len(found) <= MOST_REGIONS and all(one.unlikeness is None for one in found)
    assert [one.points for one in found] == sorted((one.points for one in found), reverse=True)
    assert held(object_points(folder, folder.parent / "cabinet.urdf", scan), found[0]) > 0.5
    for one in found:
        assert np.all(one.roi[3:] - one.roi[:3] > 2 * MARGIN)


def test_an_empty_room_has_no_things_and_nothing_is_refused(tmp_path: Path) -> None:
    folder = SAMPLES / "cabinet" / "open"
    scan = load_scan(folder / "depth.png", folder / "camera.json")
    rays = poses.rotate(scan.camera.pose_world_camera[3:], scan.camera.rays().astype(float))
    depth = -scan.camera.pose_world_camera[2] / rays[..., 2]  # the floor z = 0
    floor = np.where((depth > 0) & (depth < 6), depth, 0).astype(np.float32)
    assert propose_regions([Scan(scan.camera, floor)]) == []
    with pytest.raises(ScanError, match="no scan was given; expected at least one"):
        propose_regions([])


def test_sides_are_those_of_the_smallest_upright_box() -> None:
    box = np.array([[x, y, z] for x in (0, 0.8) for y in (0, 0.3) for z in (0, 0.5)])
    for turn in np.deg2rad([0.0, 24.0, 90.0, 150.0]):
        pose = np.array([1.0, 2.0, 3.0, np.cos(turn / 2), 0.0, 0.0, np.sin(turn / 2)])
        assert sides(reaches(poses.transform_points(pose, box))) == pytest.approx([0.5, 0.8, 0.3], abs=1e-9)
    # between two of the directions, every 6°, no more than a cosine of 3° is lost
    pose = np.array([0.0, 0.0, 0.0, np.cos(np.deg2rad(1.5)), 0.0, 0.0, np.sin(np.deg2rad(1.5))])
    assert sides(reaches(poses.transform_points(pose, box))) == pytest.approx([0.5, 0.8, 0.3], abs=0.05)


def test_a_model_is_as_large_as_its_joints_can_make_it() -> None:
    found = sides_over_joints(load_model(SAMPLES / "cabinet" / "cabinet.urdf"))
    assert found[:, 0] == pytest.approx(found[0, 0], abs=0.01)  # drawers make it deeper, not higher
    assert found[0, 2] < found[:, 1:].max() - 0.1
    assert np.array_equal(found, sides_over_joints(load_model(SAMPLES / "cabinet" / "cabinet.urdf")))
