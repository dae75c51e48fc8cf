"""Do the experiments write what they promise, and make each run once? Short runs: what they find is of no
interest here."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest
from PIL import Image

from app.cli import main
from benchmarks.reproduce import experiment, figures, scene_runs
from benchmarks.reproduce.reports import HOLDS, IN_PART, NOT
from pmpnbp.readout import object_posterior
from pmpnbp.runs.run_log import NAME
from pmpnbp.runs.workers import spread
from tests.reproduce.example_runs import rows_of, run_here

RUNS, ITERATIONS = 2, 2
SHORT = ["--runs", str(RUNS), "--iterations", str(ITERATIONS), "--particles", "60"]
DOOR = "sample_data/door/door.urdf"
PART_COLUMNS = ["seed", "part", "visible_share", "hidden", "add_m", "std_m"]
CABINET_PARTS, ROBOT_PARTS, DOOR_PARTS = 4, 12, 2
RUN_COLUMNS = ["seed", "seconds", "at_rest", "mean_add_m", "worst_part_m"]
ERROR_COLUMNS = ["iteration", "part", "median_add_m", "least_add_m", "largest_add_m"]
# The search of these runs: as many iterations as ever, each of few hypotheses.
SEARCHED = {"search_proposals": 200, "search_islands": 4}
# Columns that are words, or may be empty.
WORDS = {"scene", "variant", "case", "part", "hidden", "method", "stage", "decision", "certain", "at_rest"}

# Of every experiment: its own arguments; columns and rows of its tables; its figures; how many claims it judges.
EXPERIMENTS = {
    "convergence": (
        [],
        {
            "errors": (
                ["scene", "variant", "iteration", "seconds", "add_m", "low_m", "high_m"],
                2 * 3 * (ITERATIONS + 1),
            ),
            "runs": (
                ["scene", "variant", "run", "seconds", "add_m", "worst_part_m", "worst_part_at_equal_time_m"],
                2 * 3 * RUNS,
            ),
        },
        [
            f"cabinet_{scene}_{kind}"
            for scene in ("open", "self_occluded")
            for kind in ("error", "robust", "paper", "filter")
        ],
        5,
    ),
    "occlusion": (
        [],
        {name: (["case", *PART_COLUMNS], 3 * RUNS * CABINET_PARTS) for name in ("parts", "posterior")},
        [f"cabinet_{scene}" for scene in ("self_occluded", "arm", "blanket")],
        5,
    ),
    "planning": (
        [],
        {
            "parts": (["method", "stage", *PART_COLUMNS, "certain"], 3 * 3 * RUNS * CABINET_PARTS),
            "decisions": (
                ["method", "stage", "seed", "task_std_m", "decision", "task_add_m", "certain_parts", "seconds"],
                3 * 3 * RUNS,
            ),
        },
        ["posterior", "particles", "paper"],
        12,
    ),
    "robot": (
        [],
        {
            "parts": (["case", *PART_COLUMNS], RUNS * ROBOT_PARTS),
            "runs": (RUN_COLUMNS, RUNS),
            "errors": (ERROR_COLUMNS, (ITERATIONS + 1) * ROBOT_PARTS),
        },
        ["belief", "error"],
        1,
    ),
    "push": (
        [],
        {
            "components": (
                [
                    "method",
                    "components",
                    "runs",
                    "error_px",
                    "low_px",
                    "high_px",
                    "nodes_found",
                    "successes",
                    "iteration_ms",
                    "unary_evaluations",
                    "pair_evaluations",
                ],
                2 * 2,
            ),
            "iterations": (["method", "components", "iteration", "seconds", "error_px"], 2 * 2 * ITERATIONS),
        },
        ["figure", "error_over_time", "components"],
        3,
    ),
    "another robot": (
        ["--urdf", DOOR],
        {
            "parts": (["case", *PART_COLUMNS], RUNS * DOOR_PARTS),
            "runs": (RUN_COLUMNS, RUNS),
            "errors": (ERROR_COLUMNS, (ITERATIONS + 1) * DOOR_PARTS),
        },
        ["belief", "error"],
        1,
    ),
}


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_an_experiment_is_made_and_written_down(
    tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(experiment, "spread", spread if name == "push" else run_here)
    for key, variant in scene_runs.VARIANTS.items():
        monkeypatch.setitem(scene_runs.VARIANTS, key, replace(variant, config=SEARCHED | dict(variant.config)))
    monkeypatch.setattr(object_posterior, "ROUNDS", 2)
    own, tables, pictures, claims = EXPERIMENTS[name]
    command = ["reproduce", "robot" if own else name, *SHORT, *own, "--out", str(tmp_path / "found")]
    out = tmp_path / "found"
    assert main(command) == 0
    assert capsys.readouterr().out == f"{out / 'report.md'}\n"

    assert {path.stem for path in out.glob("*.csv")} == set(tables)
    for table, (header, count) in tables.items():
        rows = rows_of(out / f"{table}.csv")
        assert list(rows[0]) == header and len(rows) == count
        numbers = [float(value) for row in rows for column, value in row.items() if column not in WORDS]
        assert all(math.isfinite(number) for number in numbers)

    assert {path.stem for path in out.glob("*.png")} == set(pictures)
    report = (out / "report.md").read_text()
    for picture in pictures:
        with Image.open(out / f"{picture}.png") as image:
            assert image.width == pytest.approx(figures.COLUMN * figures.DPI, abs=2) and image.height > 300
        assert f"]({picture}.png)" in report
    assert (
        sum(f"| **{verdict}** |" in line for line in report.splitlines() for verdict in (HOLDS, IN_PART, NOT)) == claims
    )


def test_what_has_been_run_is_not_run_again(tmp_path: Path) -> None:
    command = ["reproduce", "push", *SHORT, "--out", str(tmp_path)]
    assert main(command) == 0
    made, report = (tmp_path / NAME).read_bytes(), (tmp_path / "report.md").read_text()
    assert main(command) == 0
    assert (tmp_path / NAME).read_bytes() == made
    assert (tmp_path / "report.md").read_text() == report


def test_another_robots_scan_is_the_same_again_and_its_runs_are_its_own(tmp_path: Path) -> None:
    from benchmarks.reproduce import robot_scan

    urdf = tmp_path / "door.urdf"
    urdf.write_bytes(Path(DOOR).read_bytes())
    digests = []
    for folder in ("one", "two"):
        robot_scan.write(tmp_path / folder, urdf)
        digests.append(robot_scan.digest(tmp_path / folder, urdf))
    urdf.write_text(urdf.read_text() + "<!-- changed -->")
    assert digests[0] == digests[1] != robot_scan.digest(tmp_path / "two", urdf)


def test_a_robot_that_cannot_be_read_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = ["reproduce", "robot", *SHORT, "--urdf", str(tmp_path / "none.urdf"), "--out", str(tmp_path / "out")]
    assert main(command) != 0
    assert "none.urdf" in capsys.readouterr().err
