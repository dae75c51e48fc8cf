"""Is the truth drawn from the prior, and does the camera see enough of it? Regions and cameras that nobody named."""

from __future__ import annotations

import json
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from benchmarks.calibrate import scenes
from benchmarks.calibrate.task import Task, unseen, vertices
from pmpnbp.errors import RunError
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from tests.calibrate import objects

INTRINSICS = {"width": 640, "height": 480, "fx": 525, "fy": 525, "cx": 319.5, "cy": 239.5}


@pytest.fixture(scope="module")
def task(tmp_path_factory: pytest.TempPathFactory) -> Task:
    return objects.task(tmp_path_factory.mktemp("model"))


def corners(task: Task, root: Array, joints: Array) -> Array:
    return vertices(task.model, task.model.part_poses(root, joints))


def test_a_truth_is_uniform_over_what_fits_into_the_region(task: Task, monkeypatch: pytest.MonkeyPatch) -> None:
    """Against plain rejection: roots thrown anywhere, kept where the object is whole within the region. Kolmogorov and
    Smirnov's test on five numbers, each with a false alarm in a thousand; the seeds are fixed."""
    monkeypatch.setattr(scenes, "_share_in_picture", lambda *_: 1.0)
    problem, rng = unseen(task.model, task.prior, task.settings, task.up), np.random.default_rng(1)
    drawn = [scenes._placement(rng, task, problem) for _ in range(300)]
    tried = 40_000
    roots = np.concatenate([rng.uniform(task.region[:3], task.region[3:], (tried, 3)), np.zeros((tried, 4))], axis=1)
    roots[:, 3:] = poses.from_rotation_vector(rng.uniform(-np.pi, np.pi, (tried, 1)) * np.array([0.0, 0.0, 1.0]))
    joints = rng.uniform(0.0, 0.2, (tried, 1))
    at = corners(task, roots, joints)
    kept = np.all((at >= task.region[:3]) & (at <= task.region[3:]), axis=(1, 2))
    assert kept.sum() > 300

    def numbers(root: Array, joints: Array) -> Array:
        return np.concatenate([root[..., :3], poses.to_rpy(root[..., 3:])[..., 2:], joints], axis=-1)

    ours = np.array([numbers(*one) for one in drawn])
    for one, other in zip(ours.T, numbers(roots[kept], joints[kept]).T, strict=True):
        assert stats.ks_2samp(one, other).pvalue > 0.001


def test_a_scene_shows_the_object_where_the_truth_has_it(task: Task) -> None:
    scene, again = (scenes.draw(task, 3) for _ in range(2))
    np.testing.assert_array_equal(scene.scan.depth, again.scan.depth)
    np.testing.assert_array_equal(scene.root, again.root)
    at = corners(task, scene.root, scene.joints)
    assert np.all(at >= task.region[:3] - 1e-9) and np.all(at <= task.region[3:] + 1e-9)
    camera = task.camera
    world = poses.transform_points(camera.pose_world_camera, camera.back_project(scene.scan.depth).reshape(-1, 3))
    inside = np.all((world > at.min(axis=0) - 0.01) & (world < at.max(axis=0) + 0.01), axis=1)
    above = inside & (world[:, 2] > at[:, 2].min() + 0.05)
    assert above.sum() > scenes.FEWEST
    assert scene.shares[0] > 0.5 and np.all(scene.shares <= 1.0)


def test_an_absent_object_leaves_its_floor_and_boxes(task: Task) -> None:
    scene, empty = scenes.draw(task, 3), scenes.draw(task, 3, absent=True)
    assert not empty.shares.any()
    assert np.abs(scene.scan.depth - empty.scan.depth).max() > 0.05


def test_another_kind_of_camera_measures_the_same_scene_otherwise(task: Task) -> None:
    scene, other = scenes.draw(task, 3), scenes.draw(replace(task, sensor="stereo"), 3)
    np.testing.assert_array_equal(other.root, scene.root)
    both = (scene.scan.depth > 0) & (other.scan.depth > 0)
    apart = np.abs(scene.scan.depth - other.scan.depth)[both]
    assert 0.0005 < np.median(apart) < 0.01


def test_without_a_camera_or_a_region_the_object_is_in_the_picture(task: Task) -> None:
    counted = [scenes.draw(task, seed).shares[0] for seed in range(5)]
    assert min(counted) > 0.5


@pytest.mark.parametrize("posed", [False, True])
def test_a_region_is_laid_out_where_the_camera_looks(tmp_path: Path, posed: bool, task: Task) -> None:
    members = dict(INTRINSICS)
    if posed:
        members["T_world_camera"] = poses.to_matrix(task.camera.pose_world_camera).ravel().tolist()
    (tmp_path / "camera.json").write_text(json.dumps(members))
    seen = objects.task(tmp_path, tmp_path / "camera.json")
    middle = poses.transform_points(
        poses.inverse(seen.camera.pose_world_camera), (seen.region[:3] + seen.region[3:]) / 2
    )
    np.testing.assert_allclose(middle[:2], 0.0, atol=1e-9)
    scene = scenes.draw(seen, 0)
    up = poses.rotate(scene.root[3:], np.array([0.0, 0.0, 1.0]))
    np.testing.assert_allclose(up, [0.0, 0.0, 1.0] if posed else [0.0, -1.0, 0.0], atol=1e-9)


def test_a_gaussian_prior_is_drawn_from(tmp_path: Path) -> None:
    """Means of 200 draws within 4.5 of their deviations, a false alarm in 10⁵ each; the seed is fixed."""
    pose = {"position": {"x": 0.3, "y": -0.2, "z": 0.1}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}
    prior = {"kind": "gaussian", "link": "tray", "pose": pose, "std_xyz": [0.02, 0.03, 0.01], "std_rpy": [0.1] * 3}
    (tmp_path / "prior.json").write_text(json.dumps(prior))
    task = replace(objects.task(tmp_path, prior=tmp_path / "prior.json"), region=np.repeat([-4.0, 4.0], 3))
    problem, rng = unseen(task.model, task.prior, task.settings, task.up), np.random.default_rng(2)
    tray = np.array([task.model.part_poses(*scenes._placement(rng, task, problem))[1, :3] for _ in range(200)])
    deviations = (tray - [0.3, -0.2, 0.1]) / [0.02, 0.03, 0.01]
    assert np.abs(deviations.mean(axis=0)).max() < 4.5 / np.sqrt(200)
    np.testing.assert_allclose(deviations.std(axis=0), 1.0, atol=4.5 / np.sqrt(400))


def test_what_cannot_be_placed_is_told(tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"'slider' is not whole within the region .* name a larger region"):
        scenes.draw(objects.task(tmp_path, region=objects.cube(0.35)), 0)
    behind = objects.task(tmp_path, region=objects.cube(2.0))
    with pytest.raises(RunError, match="none has half of it in the camera's picture"):
        scenes.draw(replace(behind, region=behind.region + np.tile([50.0, 50.0, 0.0], 2)), 0)


def test_tasks_that_differ_have_other_digests(task: Task, tmp_path: Path) -> None:
    others = [
        replace(task, particles=task.particles + 1),
        replace(task, region=task.region + 0.1),
        replace(task, camera=replace(task.camera, fx=520.0)),
        replace(task, archive=task.archive + b" "),
        replace(task, max_std=0.003),
        replace(task, sensor="stereo"),
    ]
    assert len({one.digest for one in (task, *others)}) == 7
    assert objects.task(tmp_path).digest == task.digest


def test_a_task_is_the_same_on_another_machine(task: Task) -> None:
    """Where there is nothing but what was sent."""
    sent = pickle.loads(pickle.dumps(task))
    assert sent.digest == task.digest
    np.testing.assert_array_equal(scenes.draw(sent, 4).scan.depth, scenes.draw(task, 4).scan.depth)
