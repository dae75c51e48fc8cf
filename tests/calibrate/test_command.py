"""`pmpnbp calibrate` from its arguments to the report, made once and gone on with. What short runs find is of no
interest here."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest
from PIL import Image

from app.cli import main
from benchmarks.calibrate import runs as runs_module
from benchmarks.calibrate.command import ABSENT_EVERY
from benchmarks.reproduce import experiment, figures
from pmpnbp.readout import object_posterior
from pmpnbp.runs.run_log import NAME
from tests.app.command_line import CABINET, Capture, refused
from tests.calibrate import objects
from tests.reproduce.example_runs import rows_of, run_here

RUNS = 6
SHORT = ["--particles", "40", "--iterations", "2"]
COLUMNS = {
    "runs": (["seed", "absent", "fit", "at_rest", "effective_draws"], RUNS),
    "coverage": (["fit", "of", "nominal", "within", "cases", "runs", "low", "high"], 2 * 4 * 2),
    "ranks": (["coordinate", "runs", "p", "p_holm", "bar_1", "bar_2"], 2 * 3 + 1),
    "links": (
        [
            "seed",
            "part",
            "visible_share",
            "add_m",
            "expected_add_m",
            "turned_rad",
            "ellipsoid_rank",
            "certain",
            "wrong",
        ],
        (RUNS - 1) * 2,
    ),
}


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(experiment, "spread", run_here)
    monkeypatch.setattr(object_posterior, "ROUNDS", 2)


def calibrate(folder: Path, *more: str) -> int:
    return main(["calibrate", str(objects.slider(folder)), *SHORT, "--out", str(folder / "found"), *more])


def test_a_calibration_is_made_and_written_down(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert calibrate(tmp_path, "--runs", str(RUNS)) == 0
    out = tmp_path / "found"
    assert capsys.readouterr().out == f"{out / 'report.md'}\n"
    for table, (header, count) in COLUMNS.items():
        rows = rows_of(out / f"{table}.csv")
        assert list(rows[0]) == header and len(rows) == count
        for row in rows:
            for column in ("p", "p_holm", "low", "high", "ellipsoid_rank", "visible_share"):
                assert 0 <= float(row.get(column, 0)) <= 1
            assert all(math.isfinite(float(row.get(column, 0))) for column in ("add_m", "turned_rad"))
    runs = rows_of(out / "runs.csv")
    assert [row["absent"] == "True" for row in runs] == [k % ABSENT_EVERY == ABSENT_EVERY - 1 for k in range(RUNS)]
    report = (out / "report.md").read_text()
    first = report.split("\n\n")[1]
    good = sum(row["fit"] == "good" for row in runs if row["absent"] == "False")
    assert first.startswith("Whether the belief is honest for 'slider' and this camera cannot be told: ")
    assert f"and there are {good}. " in first and f"The fit is good in {good} of 5" in first
    assert {path.stem for path in out.glob("*.png")} == ({"ranks", "coverage", "reliability"} if good else set())
    for path in out.glob("*.png"):
        with Image.open(path) as image:
            assert image.width == pytest.approx(figures.COLUMN * figures.DPI, abs=2)
        assert f"]({path.name})" in report

    # the same command, and one that asks for fewer: nothing is run again
    made = (out / NAME).read_bytes()
    monkeypatch.setattr(runs_module, "perform", lambda *_: pytest.fail("a run that has been made is made again"))
    assert calibrate(tmp_path, "--runs", str(RUNS)) == 0
    assert (out / NAME).read_bytes() == made and (out / "report.md").read_text() == report
    assert calibrate(tmp_path, "--runs", str(RUNS - 1)) == 0
    assert len(rows_of(out / "runs.csv")) == RUNS - 1


def test_it_goes_on_where_it_was_interrupted_to_the_same_numbers(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, stopped = tmp_path / "whole", tmp_path / "stopped"
    for folder in (whole, stopped):
        folder.mkdir()
    assert calibrate(whole, "--runs", "3") == 0

    def interrupted(*words: object) -> object:
        yield next(run_here(*words))
        raise KeyboardInterrupt

    monkeypatch.setattr(experiment, "spread", interrupted)
    assert calibrate(stopped, "--runs", "3") == 130
    assert (
        f"what has been run is kept in {stopped / 'found' / NAME}; the same command goes on" in capsys.readouterr().err
    )
    monkeypatch.setattr(experiment, "spread", run_here)
    assert calibrate(stopped, "--runs", "3") == 0
    kept = [(folder / "found" / NAME).read_text().splitlines()[1:] for folder in (whole, stopped)]
    assert kept[0] == kept[1] and len(kept[0]) == 3
    assert (whole / "found" / "links.csv").read_text() == (stopped / "found" / "links.csv").read_text()


def test_bad_input_is_one_sentence_and_nothing_is_written(tmp_path: Path, capsys: Capture) -> None:
    model, out = str(objects.slider(tmp_path)), ["--out", str(tmp_path / "out")]
    assert "'gone.urdf'" in refused(capsys, "calibrate", str(tmp_path / "gone.urdf"), *out)
    assert "is not six finite numbers" in refused(capsys, "calibrate", model, "--roi=1,2", *out)
    assert "is empty; expected x0 < x1" in refused(capsys, "calibrate", model, "--roi=0,0,0,1,1,0", *out)
    assert "name a larger region" in refused(capsys, "calibrate", model, "--roi=0,0,0,.1,.1,.1", *out)
    assert "camera file 'gone.json'" in refused(capsys, "calibrate", model, "--camera", "gone.json", *out)
    assert "prior file 'gone.json'" in refused(capsys, "calibrate", model, "--prior", "gone.json", *out)
    assert "'0' is not a whole number from 1" in refused(capsys, "calibrate", model, "--runs", "0", *out)
    prior = str(CABINET / "prior.json")
    assert "is not in the model; it has box, tray" in refused(capsys, "calibrate", model, "--prior", prior, *out)
    assert not (tmp_path / "out").exists()


def test_a_camera_that_sees_nothing_of_the_region_is_told(tmp_path: Path, capsys: Capture) -> None:
    camera = str(CABINET / "open" / "camera.json")
    said = refused(capsys, "calibrate", str(objects.slider(tmp_path)), "--camera", camera, "--roi=50,50,0,51,51,1")
    assert "none has half of it in the camera's picture; name another camera or region" in said


def test_runs_of_another_experiment_are_not_mixed_in(tmp_path: Path, capsys: Capture) -> None:
    (tmp_path / "found").mkdir()
    (tmp_path / "found" / NAME).write_text(json.dumps({"experiment": "push", "version": "0"}) + "\n")
    assert calibrate(tmp_path, "--runs", "1") == 2
    assert "holds runs of push" in capsys.readouterr().err
