"""The study of next views: its scenes by number, and what it makes of deviations that are expected and got."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import next_view
from benchmarks.hard_scenes import hidden_drawer
from benchmarks.next_view import Ranking


def test_a_scene_is_the_same_by_number() -> None:
    first, again, other = hidden_drawer(3), hidden_drawer(3), hidden_drawer(5)
    assert first.urdf == again.urdf != other.urdf
    assert first.scene.joint_positions == again.scene.joint_positions
    np.testing.assert_array_equal(first.scene.camera.pose_world_camera, again.scene.camera.pose_world_camera)
    assert first.scene.joint_positions["slide1"] >= 0.2  # it hides the lower ones


def test_the_first_view_is_held_against_the_median_of_those_in_the_middle() -> None:
    expected = np.array([0.2, 0.4, 0.4, 0.4, 9.0]) / 1000
    better = Ranking(1, 0.03, expected, np.array([0.2, 0.5, 0.3, 0.4, 8.0]) / 1000, 0.1)
    worse = Ranking(3, 0.03, expected, np.array([0.45, 0.1, 0.8, 0.4, 8.0]) / 1000, 0.1)
    assert better.median == worse.median == pytest.approx(0.0004)
    printed = next_view.report([better, worse])
    assert "at least as much as the median one | 1 of 2" in printed
    assert "| median | 30.00 | 0.33 | 0.40 | 8.00 |" in printed


def test_the_study_runs(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("ITERATIONS", "SCANS", "SETS", "POLISH_ROUNDS"):
        monkeypatch.setattr(next_view, name, 1)
    next_view.main(["--scenes", "1", "--first", "2"])
    printed = capsys.readouterr()
    assert printed.err.splitlines()[-1].startswith("3: ") and " of 1, " in printed.out
