"""The hard scenes: every family makes them, the same by seed, and their study names what failed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks import belief, hard, options
from benchmarks.hard_scenes import EVERY_FAMILY, hard_scene
from pmpnbp.scene.urdf import load_model
from sample_data.rendering import posed


@pytest.mark.parametrize("family", EVERY_FAMILY)
def test_a_scene_is_the_same_by_seed_and_its_model_has_the_joints_that_are_moved(family: str, tmp_path: Path) -> None:
    first, again, other = hard_scene(family, 3), hard_scene(family, 3), hard_scene(family, 5)
    np.testing.assert_array_equal(first.scene.pose_world_base, again.scene.pose_world_base)
    assert first.urdf == again.urdf and first.scene.joint_positions == again.scene.joint_positions
    assert not np.array_equal(first.scene.pose_world_base, other.scene.pose_world_base)
    (tmp_path / "model.urdf").write_text(first.urdf, encoding="utf-8")
    model = load_model(tmp_path / "model.urdf")
    limits = {joint.name: joint.limits() for joint in model.joints}
    for name, position in first.scene.joint_positions.items():
        assert limits[name][0] <= position <= limits[name][1]


@pytest.mark.parametrize("seed", [45, 113])
def test_a_shallow_chest_s_drawer_comes_out_as_far_as_it_can(seed: int, tmp_path: Path) -> None:
    made = hard_scene("hidden", seed)
    (tmp_path / "model.urdf").write_text(made.urdf, encoding="utf-8")
    slide = next(joint for joint in load_model(tmp_path / "model.urdf").joints if joint.name == "slide1")
    assert 0.2 < made.scene.joint_positions["slide1"] <= slide.limits()[1] + 1e-6 < 0.3


def test_a_tent_stands_on_its_two_outer_edges() -> None:
    scene = hard_scene("tent", 3).scene
    table = scene.clutter[1].bounds[1, 2]
    for mesh in posed(scene.urdf, scene.joint_positions, scene.pose_world_base).values():
        assert abs(mesh.bounds[0, 2] - table) < 0.015


@pytest.mark.parametrize(
    ("scores", "cause"), [((90.0, 100.0), "search"), ((110.0, 100.0), "model"), ((99.0, 100.0), "tie")]
)
def test_a_failure_has_a_name(scores: tuple[float, float], cause: str) -> None:
    assert hard._cause(*scores) == cause


def test_what_settings_are_chosen_on_is_never_reported() -> None:
    parser = options.parser("a study", seeds=3, iterations=1)
    options.add_halves(parser)

    def seeds(*words: str) -> list[int]:
        return list(options.halved(parser.parse_args(words)))

    assert seeds() == [1, 3, 5] and seeds("--tuning") == [0, 2, 4]
    assert seeds("--first", "20", "--seeds", "2") == [21, 23] and seeds("--first", "20", "--tuning") == [20, 22, 24]


def test_the_study_reports_by_family(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--families", "open_laptop", "--seeds", "1", "--config", "search_proposals=200", "--iterations", "4"]
    hard.main([*words, "--particles", "50", "--sensor", "stereo"])
    printed = capsys.readouterr().out
    assert "| open_laptop | " in printed and "| all | " in printed


def test_the_belief_of_present_wrong_and_absent_objects_is_judged(capsys: pytest.CaptureFixture[str]) -> None:
    short = ["--seeds", "1", "--no-easy", "--iterations", "1", "--particles", "40", "--config", "search_proposals=300"]
    belief.main([*short, "--families", "organiser", "pliers"])
    tables = capsys.readouterr().out.split("\n\n")
    assert [table.splitlines()[0].split(" | ")[0] for table in tables[:4]] == [
        "| parts",
        "| joints of",
        "| what",
        "| runs",
    ]
    counts = {row.split(" | ")[0]: row.split(" | ")[1] for row in tables[0].splitlines()[2:]}
    assert counts["| hard, seen"] == "5" and counts["| easy, seen"] == "0"
    fits = {row.split(" | ")[0][2:]: row for row in tables[3].splitlines()[2:]}
    assert "of 2," in fits["wrong model"] and "of 2," in fits["absent"]
    assert tables[4].startswith("Posterior over inference: ")
