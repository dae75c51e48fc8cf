"""Does the sample data tell the truth about itself, and can it be made again?"""

from __future__ import annotations

import json
import shutil
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy import ndimage

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from sample_data import generate, sensor
from sample_data.rendering import BACKGROUND, RayCast, bounds, cast, link_meshes, load
from sample_data.scenes import KINDS, held_out_scene

SAMPLES = Path(generate.__file__).parent
SCANS = {
    **{f"cabinet/{name}": "cabinet/cabinet.urdf" for name in (*generate.CABINET_SCENES, "second_view", "lowered")},
    **{f"robot/{name}": "robot/robot.urdf" for name in generate.ROBOT_SCANS},
    "door/ajar": "door/door.urdf",
}
HELD_OUT = [(kind, seed) for kind in KINDS for seed in (0, 5)]


def read(path: Path) -> dict:
    return json.loads(path.read_text())


def read_depth(folder: Path) -> np.ndarray:
    return np.asarray(Image.open(folder / "depth.png")).astype(np.float64) / 1000


def read_camera(folder: Path) -> Camera:
    entries = read(folder / "camera.json")
    pose = poses.from_matrix(np.reshape(entries["T_world_camera"], (4, 4)))
    return Camera(*(entries[key] for key in ("width", "height", "fx", "fy", "cx", "cy")), pose)


def true_surfaces(urdf: Path, folder: Path) -> dict:
    """The links' surfaces where truth.json says that they are: not by the generator's own kinematics."""
    matrices = read(folder / "truth.json")["links"]
    meshes = link_meshes(load(urdf.read_text(), urdf.parent), urdf.parent)
    return {name: mesh.apply_transform(np.array(matrices[name])) for name, mesh in meshes.items()}


def assert_truth_explains_depth(urdf: Path, folder: Path) -> None:
    """Rendered from truth.json, nothing is seen through, and where the object is measured it is measured there.

    Away from outlines a pixel on the object is off by axial noise and quantisation alone. Pixels of occluders and
    clutter lie in front of the rendered object, so only those behind it, or within six sigma of it, are judged.
    False-alarm rate: none, since the scans and every seed are fixed; the bounds leave room for other seeds.
    """
    camera, depth = read_camera(folder), read_depth(folder)
    seen: RayCast = cast(list(true_surfaces(urdf, folder).values()), camera)
    inside = seen.index != BACKGROUND
    near = sensor.at_edge(seen.depth)
    for shift in (-2, -1, 1, 2):
        near |= np.roll(near, shift, 0) | np.roll(near, shift, 1)
    judged = inside & ~near & (depth > 0)
    assert judged.sum() > 2000
    step = sensor.DISPARITY_STEP / sensor.FOCAL_BASELINE * seen.depth**2
    sigma = np.sqrt(sensor.axial_sigma(seen.depth) ** 2 + step**2 / 12)
    error = (depth - seen.depth)[judged] / sigma[judged]
    assert np.mean(error > 6) < 1e-3  # seen through
    on = np.abs(error) < 6
    assert on.mean() > 0.3
    # An unbiased sensor of that sigma: with 600 pixels, the fewest that come this far, the median scatters by 0.05 and
    # the spread by 0.03; occluders that touch the object add to both.
    assert abs(np.median(error[on])) < 0.1
    assert 0.85 < np.std(error[on]) < 1.15
    for index in np.unique(seen.index[judged]):
        own = error[(seen.index[judged] == index) & on]
        if own.size > 300:  # the median of 300 scatters by 0.07
            assert abs(np.median(own)) < 0.35


@pytest.mark.parametrize("scan", SCANS)
def test_the_truth_explains_the_depth(scan: str) -> None:
    assert_truth_explains_depth(SAMPLES / SCANS[scan], SAMPLES / scan)


@pytest.mark.parametrize("scan", SCANS)
def test_the_roi_is_the_box_of_the_truth_ten_centimetres_wider(scan: str) -> None:
    roi = read(SAMPLES / scan / "roi.json")["roi"]
    box = bounds(true_surfaces(SAMPLES / SCANS[scan], SAMPLES / scan))
    np.testing.assert_allclose(roi, box + [-0.1, -0.1, -0.1, 0.1, 0.1, 0.1], atol=1e-3)


@pytest.mark.parametrize("scan", SCANS)
def test_truth_names_every_link_and_moving_joint_within_its_limits(scan: str) -> None:
    tree = ET.parse(SAMPLES / SCANS[scan]).getroot()
    truth = read(SAMPLES / scan / "truth.json")
    assert set(truth["links"]) == {link.get("name") for link in tree.findall("link")}
    moving = {joint.get("name"): joint for joint in tree.findall("joint") if joint.get("type") != "fixed"}
    assert set(truth["joints"]) == set(moving)
    for name, position in truth["joints"].items():
        limit = moving[name].find("limit")
        if limit is not None:
            assert float(limit.get("lower")) <= position <= float(limit.get("upper"))


def test_scenes_hide_what_they_are_meant_to_hide() -> None:
    visible = {
        name: read(SAMPLES / "cabinet" / name / "truth.json")["visible_fraction"]
        for name in (*generate.CABINET_SCENES, "second_view", "lowered")
    }
    assert visible["self_occluded"]["drawer2"] < 0.1 < visible["second_view"]["drawer2"]
    assert visible["blanket"]["drawer1"] < 0.5 < visible["open"]["drawer1"]
    assert visible["from_above"]["drawer3"] == 0.0 and visible["lowered"]["drawer3"] > 0.1
    assert visible["arm"]["handle2"] < visible["second_view"]["handle2"]
    assert all(read(SAMPLES / "cabinet/closed/truth.json")["joints"][f"slide{k}"] == 0 for k in (1, 2, 3))


def test_a_truth_that_is_a_centimetre_wrong_is_noticed(tmp_path: Path) -> None:
    for scan, link in (("cabinet/open", "drawer2"), ("robot/scan_0", "elbow"), ("door/ajar", "door1")):
        folder = tmp_path / scan
        folder.mkdir(parents=True)
        for name in ("depth.png", "camera.json"):
            (folder / name).write_bytes((SAMPLES / scan / name).read_bytes())
        truth = read(SAMPLES / scan / "truth.json")
        towards = read_camera(SAMPLES / scan).pose_world_camera[:3] - np.array(truth["links"][link])[:3, 3]
        moved = np.array(truth["links"][link])
        moved[:3, 3] += 0.01 * towards / np.linalg.norm(towards)
        truth["links"][link] = moved.tolist()
        (folder / "truth.json").write_text(json.dumps(truth))
        with pytest.raises(AssertionError):
            assert_truth_explains_depth(SAMPLES / SCANS[scan], folder)


def test_dark_surfaces_are_lost_in_patches(rng: np.random.Generator) -> None:
    """Of what is dark the share that is told, and nothing else; pixels beside each other mostly together, which
    independent ones would be in 58 %. The seed is fixed: no false alarms."""
    dark = np.zeros((200, 300), dtype=bool)
    dark[40:160, 50:250] = True
    lost = sensor.lost_in_patches(dark, rng)
    assert not lost[~dark].any()
    assert lost[dark].mean() == pytest.approx(sensor.DARK_LOSS, abs=0.001)
    inside = lost[40:160, 50:250]
    assert np.mean(inside[:, 1:] == inside[:, :-1]) > 0.9
    assert not sensor.lost_in_patches(np.zeros_like(dark), rng).any()


def test_two_views_are_of_one_scene() -> None:
    for names in (("self_occluded", "second_view"), ("from_above", "lowered")):
        first, second = (read(SAMPLES / "cabinet" / name / "truth.json") for name in names)
        assert first["links"] == second["links"]


def test_all_of_it_is_at_most_ten_megabytes() -> None:
    files = [path for path in SAMPLES.rglob("*") if path.is_file() and path.suffix != ".pyc"]
    assert 1_000_000 < sum(path.stat().st_size for path in files) <= 10_000_000


def assert_same_scan(made: Path, kept: Path) -> None:
    """Alike but for what the ray caster's instruction set decides: seen on other processors, two pixels of 307,200
    whose depth falls to the other side of a disparity step."""
    again, depth = read_depth(made), read_depth(kept)
    assert np.mean((again > 0) != (depth > 0)) <= 1e-4
    both = (again > 0) & (depth > 0)
    assert np.mean(again[both] != depth[both]) <= 1e-4
    step = sensor.DISPARITY_STEP / sensor.FOCAL_BASELINE * depth[both] ** 2
    assert np.all(np.abs(again - depth)[both] <= 1.02 * step + 0.001)  # of which 1 mm is rounding
    for name in ("camera", "truth", "roi", "prior"):
        told, expected = read(made / f"{name}.json"), read(kept / f"{name}.json")
        for counted, tolerance in (("visible_fraction", 1e-3), ("pixels_alone", 5)):
            assert told.pop(counted, {}) == pytest.approx(expected.pop(counted, {}), abs=tolerance)
        assert_same_numbers(told, expected)


def assert_same_numbers(told: Any, expected: Any) -> None:
    """Two JSON values alike, numbers to a micrometre, or as much of whatever their unit is."""
    assert type(told) is type(expected)
    if isinstance(expected, dict):
        assert list(told) == list(expected)
        told, expected = list(told.values()), list(expected.values())
    if isinstance(expected, list):
        for one, other in zip(told, expected, strict=True):
            assert_same_numbers(one, other)
    elif isinstance(expected, float):
        assert told == pytest.approx(expected, abs=1e-6)
    else:
        assert told == expected


def test_a_scene_is_made_again(tmp_path: Path) -> None:
    generate.write_cabinet(tmp_path, ("open",))
    assert_same_scan(tmp_path / "open", SAMPLES / "cabinet/open")
    assert (tmp_path / "cabinet.urdf").read_bytes() == (SAMPLES / "cabinet/cabinet.urdf").read_bytes()


def test_another_scan_of_the_scene_is_not_the_same(tmp_path: Path) -> None:
    """The comparison notices a tenth of a millimetre, and another draw of the noise."""
    shutil.copytree(SAMPLES / "cabinet/open", tmp_path / "open")
    assert_same_scan(tmp_path / "open", SAMPLES / "cabinet/open")
    camera = read_camera(tmp_path / "open")
    scene = cast(list(true_surfaces(SAMPLES / "cabinet/cabinet.urdf", tmp_path / "open").values()), camera)
    for nearer, draw in ((1e-4, 0), (0.0, 1)):
        kept, made = (tmp_path / f"{name}_{draw}" for name in ("kept", "made"))
        for folder, shift, seed in ((kept, 0.0, 0), (made, nearer, draw)):
            shutil.copytree(SAMPLES / "cabinet/open", folder)
            depth = np.where(scene.depth > 0, scene.depth - shift, 0.0)
            measured = sensor.measured(depth, scene.cosine, np.random.default_rng(seed))
            Image.fromarray(measured).save(folder / "depth.png")
        with pytest.raises(AssertionError):
            assert_same_scan(made, kept)


@pytest.mark.parametrize(("kind", "seed"), HELD_OUT)
def test_random_scenes_are_whole_in_view_and_true(kind: str, seed: int, tmp_path: Path) -> None:
    folder = held_out_scene(kind, seed, tmp_path)
    assert_truth_explains_depth(folder / "model.urdf", folder)
    camera = read_camera(folder)
    vertices = np.concatenate([mesh.vertices for mesh in true_surfaces(folder / "model.urdf", folder).values()])
    pixels = camera.project(poses.transform_points(poses.inverse(camera.pose_world_camera), vertices))
    assert pixels[:, :2].min() > 0
    assert np.all(pixels[:, :2].max(axis=0) < [camera.width, camera.height])
    assert vertices[:, 2].min() > -1e-6
    prior, truth = read(folder / "prior.json"), read(folder / "truth.json")
    position = np.array([prior["pose"]["position"][axis] for axis in "xyz"])
    assert 0 < np.linalg.norm(position - np.array(truth["links"][prior["link"]])[:3, 3]) < 5 * 0.08 * np.sqrt(3)


def test_random_scenes_depend_on_the_seed_and_on_nothing_else(tmp_path: Path) -> None:
    again = [held_out_scene("door", 3, tmp_path / place) for place in ("first", "second")]
    assert (again[0] / "depth.png").read_bytes() == (again[1] / "depth.png").read_bytes()
    assert KINDS["door"](3)[0] != KINDS["door"](4)[0]


def test_an_unknown_kind_is_named_with_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="kind 'table' is not one of cabinet, door, chain"):
        held_out_scene("table", 0, tmp_path)


def test_sensor_noise_has_the_stated_spread() -> None:
    """False-alarm rate: below 1e-6 a depth (the standard deviation of 40 000 draws scatters by 0.35 %)."""
    rng = np.random.default_rng(0)
    for z in (0.8, 1.5, 2.5):
        flat = np.full((200, 200), z)
        measured = sensor.measured(flat, np.ones_like(flat), rng)
        valid = measured[measured > 0] / 1000
        step = sensor.DISPARITY_STEP / sensor.FOCAL_BASELINE * z**2
        expected = np.sqrt(sensor.axial_sigma(np.array(z)) ** 2 + step**2 / 12 + 0.001**2 / 12)
        # Where a step is wide beside sigma the quantisation error is not uniform: allow for it.
        assert np.std(valid) == pytest.approx(expected, rel=0.15)
        assert 0.985 < valid.size / flat.size < 0.995


@pytest.mark.parametrize("window", [3, 12])
def test_stereo_s_neighbours_err_together(window: int) -> None:
    """A mean over a window narrower than matching's is off by nearly as much as a pixel is, over a wider one by less.
    False-alarm rate: below 1e-6 (of some 400 windows that tell on their own a deviation scatters by 4 %)."""
    rng, z = np.random.default_rng(0), 1.5
    measured = sensor.measured(np.full((400, 400), z), np.ones((400, 400)), rng, "stereo") / 1000
    off = np.where(measured > 0, measured - z, 0.0)
    pixel = z**2 / sensor.STEREO_FOCAL_BASELINE * np.hypot(sensor.SHARED_SIGMA, sensor.OWN_SIGMA)
    assert off[measured > 0].std() == pytest.approx(pixel, rel=0.1)
    mean = ndimage.uniform_filter(off, window)[::window, ::window].std()
    assert (0.8 * pixel < mean < pixel) if window == 3 else (1.5 / window * pixel < mean < 0.7 * pixel)


def test_time_of_flight_s_pixels_fly_between_the_sides_of_an_outline() -> None:
    rng = np.random.default_rng(0)
    depth = np.where(np.arange(100) < 50, 1.0, 2.0) * np.ones((400, 1))
    measured = sensor.measured(depth, np.ones_like(depth), rng, "time_of_flight") / 1000
    between = (measured > 1.1) & (measured < 1.9)
    assert between[:, 49:51].mean() == pytest.approx(0.8 * sensor.FLYING, abs=0.1)
    assert not between[:, :48].any() and not between[:, 52:].any()


@pytest.mark.parametrize("kind", ["stereo", "time_of_flight"])
def test_no_sensor_measures_what_no_ray_meets_or_grazes(kind: str) -> None:
    rng = np.random.default_rng(1)
    depth = np.where(np.arange(100) < 50, 1.0, 0.0) * np.ones((100, 1))
    cosine = np.where(np.arange(100) < 20, np.cos(np.deg2rad(81)), 1.0) * np.ones((100, 1))
    lost = sensor.measured(depth, cosine, rng, kind) == 0
    assert lost[:, :20].all() and lost[:, 50:].all()
    assert lost[:, 25:45].mean() < 0.2


def test_sensor_loses_edges_and_grazing_surfaces() -> None:
    rng = np.random.default_rng(1)
    depth = np.where(np.arange(100) < 50, 1.0, 1.5) * np.ones((100, 1))
    cosine = np.where(np.arange(100) < 20, np.cos(np.deg2rad(81)), 1.0) * np.ones((100, 1))
    lost = sensor.measured(depth, cosine, rng) == 0
    assert lost[:, :20].all()
    assert 0.4 < lost[:, 49:51].mean() < 0.8
    assert lost[:, 25:45].mean() < 0.05
