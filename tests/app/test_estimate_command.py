"""`pmpnbp estimate` from its arguments to the result: members of result.json, recordings, interrupts, repeatability."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.cli import main
from app.commands import estimate, progress
from pmpnbp.readout.arviz_export import load_arviz
from pmpnbp.readout.checkpoint import Checkpoint
from pmpnbp.readout.verdict import verdict
from pmpnbp.recording import Recording
from tests.app.command_line import CABINET, CAMERA, DEPTH, MODEL, ROI, ROOT, SCAN, SCENE, Capture, refused

# As much of the algorithm as a test of the command line needs.
QUICK = [
    "--particles",
    "40",
    "--iterations",
    "4",
    "--config",
    "search_proposals=300",
    "--config",
    "search_iterations=2",
    "--config",
    "search_islands=1",
]


def checked_pose(pose: dict[str, Any]) -> None:
    assert list(pose) == ["position", "orientation"]
    assert list(pose["position"]) == ["x", "y", "z"]
    assert list(pose["orientation"]) == ["x", "y", "z", "w"]
    assert np.linalg.norm(list(pose["orientation"].values())) == pytest.approx(1.0)


def checked_covariance(numbers: list[float]) -> None:
    matrix = np.array(numbers).reshape(6, 6)
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-15)
    assert np.linalg.eigvalsh(matrix).min() > -1e-12


def checked(result: dict[str, Any], method: str = "pmpnbp") -> None:
    """That a result has the contract's members, no others, and values that they can have."""
    assert list(result) == [
        "schema",
        "model",
        "method",
        "seed",
        "iteration",
        "converged",
        "frame_id",
        "stamp",
        "certain",
        "max_std",
        "seconds",
        "fit",
        "fit_reason",
        "explained",
        "effective_draws",
        "posterior_iteration",
        "links",
        "joints",
        "alternatives",
        "unknown",
        "depth_noise",
        "depth_noise_area",
        "depth_distortion",
        "nuisances",
    ]
    assert (result["schema"], result["model"], result["method"]) == ("pmpnbp/estimate-2", "cabinet", method)
    assert set(result["links"]) == {"frame"} | {f"{what}{k}" for what in ("drawer", "handle") for k in (1, 2, 3)}
    told = result["fit"] is not None
    assert told == (result["posterior_iteration"] is not None) == (result["effective_draws"] is not None)
    if told:
        assert result["fit"] in ("good", "doubtful", "none") and 0 <= result["explained"] <= 1
        assert "of" in result["fit_reason"]
        assert sum(other["weight"] for other in result["alternatives"]) == pytest.approx(1.0)
    for link in result["links"].values():
        assert list(link) == [
            "pose",
            "covariance",
            "std_xyz",
            "expected_add",
            "certain",
            "doubts",
            "visible_fraction",
            "log_likelihood",
            "modes",
            "particle_std_xyz",
            "particle_modes",
        ]
        checked_pose(link["pose"])
        assert told == (link["covariance"] is not None) == (link["std_xyz"] is not None)
        if told:
            checked_covariance(link["covariance"])
            within = max(*link["std_xyz"], link["expected_add"]) <= result["max_std"]
            assert within or not link["certain"]
            assert (
                link["certain"]
                or result["fit"] != "good"
                or result["effective_draws"] < 20
                or not within
                or (len(link["modes"]) > 1)
            )
            assert link["certain"] == (link["doubts"] == [])
            assert ("fit" in link["doubts"]) == (result["fit"] != "good")
            assert ("draws" in link["doubts"]) == (result["effective_draws"] < 20)
            assert ("std_xyz" in link["doubts"]) == (max(link["std_xyz"]) > result["max_std"])
            assert ("expected_add" in link["doubts"]) == (link["expected_add"] > result["max_std"])
            assert "elsewhere" not in link["doubts"] or len(link["modes"]) > 1
            assert sum(mode["weight"] for mode in link["modes"]) == pytest.approx(1.0)
        else:
            assert not link["certain"] and link["doubts"] is None
            assert link["modes"] == [] and link["expected_add"] is None
        assert 0 <= link["visible_fraction"] <= 1
        assert 1 <= len(link["particle_modes"]) <= 5
        assert sum(mode["weight"] for mode in link["particle_modes"]) <= 1 + 1e-9
        assert len(link["particle_std_xyz"]) == 3
        for mode in link["modes"] + link["particle_modes"]:
            assert list(mode) == ["weight", "pose", "covariance"]
            checked_pose(mode["pose"])
            checked_covariance(mode["covariance"])
    assert result["certain"] == all(link["certain"] for link in result["links"].values())
    assert list(result["joints"]) == ["slide1", "slide2", "slide3"]
    for k, joint in enumerate(result["joints"].values(), 1):
        assert list(joint) == ["type", "position", "std", "interval", "lower", "upper", "parent", "child"]
        assert (joint["type"], joint["parent"], joint["child"]) == ("prismatic", "frame", f"drawer{k}")
        assert joint["lower"] <= joint["position"] <= joint["upper"]
        assert told == (joint["std"] is not None) == (joint["interval"] is not None)
        if told:
            low, high = joint["interval"]
            assert joint["std"] >= 0 and joint["lower"] - 1e-9 <= low <= high <= joint["upper"] + 1e-9


def test_the_open_cabinet_is_found(tmp_path: Path, capsys: Capture) -> None:
    out = tmp_path / "result.json"
    recording = tmp_path / "run.sqlite"
    truth = ["--truth", str(SCENE / "truth.json")]
    assert main(["estimate", *SCAN, *truth, "--out", str(out), "--recording", str(recording)]) == 0
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "converged" in printed.err
    result = json.loads(out.read_text())
    errors = result.pop("truth")
    checked(result)
    assert result["converged"] and result["iteration"] < 100
    assert (result["fit"], result["certain"], result["posterior_iteration"]) == ("good", True, result["iteration"])
    assert "Found: the scan confirms" in printed.err and "all 7 links are certain" in printed.err
    assert list(errors["parts"]) == ["frame", "drawer1", "drawer2", "drawer3"]
    assert max(error["add"] for error in errors["parts"].values()) < 0.01
    assert max(error["add_s"] for error in errors["parts"].values()) < 0.01
    assert max(abs(error) for error in errors["joints"].values()) < 0.01
    with Recording(recording) as recorded:
        assert recorded.iterations() == list(range(result["iteration"] + 1))
        posterior = recorded.posterior(result["iteration"])
    assert posterior is not None and posterior.effective_sample_size == result["effective_draws"]
    assert [mode.weight for mode in posterior.modes] == [mode["weight"] for mode in result["alternatives"]]
    assert sorted(file.name for file in tmp_path.iterdir()) == ["result.json", "run.sqlite"]


def test_the_particle_filter_infers_and_is_recorded(tmp_path: Path, capsys: Capture) -> None:
    recording = tmp_path / "run.sqlite"
    arguments = ["estimate", *SCAN, *QUICK, "--method", "particle_filter", "--recording", str(recording)]
    assert main(arguments) == 0
    printed = capsys.readouterr()
    assert "particle filter" in printed.err
    checked(json.loads(printed.out), "particle_filter")
    with Recording(recording) as recorded:
        assert recorded.inputs()["method"] == recorded.problem().method == "particle_filter"
        assert [recorded.report(k).stage for k in (2, 3, 4)] == ["search", "particle filter", "particle filter"]


@pytest.mark.parametrize("quiet", [False, True])
def test_what_the_inference_remarks_is_told(quiet: bool, capsys: Capture) -> None:
    again = ["--config", "search_explained=1", "--config", "search_restarts=1"]
    assert main(["estimate", *SCAN, *QUICK, *again, *["--quiet"] * quiet]) == 0
    printed = capsys.readouterr()
    checked(json.loads(printed.out))
    assert ("iteration 2: the search was made 2 times" in printed.err) is not quiet


def test_the_installed_way_of_calling_it_prints_the_result() -> None:
    program = [sys.executable, "-m", "app.cli", "estimate", *SCAN, *QUICK]
    done = subprocess.run(program, cwd=ROOT, capture_output=True, text=True, check=True)
    result = json.loads(done.stdout)
    checked(result)
    assert result["iteration"] == 4
    assert "belief propagation" in done.stderr


def test_the_same_seed_gives_the_same_bytes_but_for_the_seconds(capsys: Capture) -> None:
    printed = []
    for seed in ("7", "7", "8"):
        assert main(["estimate", *SCAN, *QUICK, "--seed", seed, "--quiet"]) == 0
        out, err = capsys.readouterr()
        assert err == "" or "compiling" in err
        printed.append([line for line in out.splitlines() if not line.startswith(' "seconds"')])
    assert printed[0] == printed[1]
    assert printed[0] != printed[2]


def test_prior_views_zip_and_preset_are_taken(tmp_path: Path, capsys: Capture) -> None:
    model = tmp_path / "cabinet.zip"
    with zipfile.ZipFile(model, "w") as archive:
        archive.write(MODEL, "somewhere/cabinet.urdf")
    second = CABINET / "second_view"
    arguments = [
        str(model),
        DEPTH,
        "--camera",
        CAMERA,
        str(second / "depth.png"),
        "--camera",
        str(second / "camera.json"),
    ]
    arguments += ["--roi", ROI, "--prior", str(CABINET / "prior.json"), "--config", "preset=paper", "--quiet"]
    assert main(["estimate", *arguments, "--particles", "30", "--iterations", "2", "--max-std", "0.5"]) == 0
    result = json.loads(capsys.readouterr().out)
    checked(result)
    assert (result["iteration"], result["max_std"]) == (2, 0.5)


def test_no_iterations_give_the_start(capsys: Capture) -> None:
    assert main(["estimate", *SCAN, "--iterations", "0", "--particles", "40", "--quiet"]) == 0
    result = json.loads(capsys.readouterr().out)
    checked(result)
    assert (result["iteration"], result["converged"], result["fit"]) == (0, False, None)


def test_interrupted_it_still_writes_what_it_found(tmp_path: Path) -> None:
    out = tmp_path / "result.json"
    program = [sys.executable, "-m", "app.cli", "estimate", *SCAN, *QUICK, "--iterations", "100000"]
    program += ["--config", "converged_iterations=1000", "--out", str(out), "--recording", str(tmp_path / "run.sqlite")]
    with subprocess.Popen(program, cwd=ROOT, stderr=subprocess.PIPE) as process:
        assert process.stderr is not None
        said = b""
        while b"belief propagation" not in said:
            piece = os.read(process.stderr.fileno(), 4096)
            assert piece, said.decode()
            said += piece
        process.send_signal(signal.SIGINT)
        said += process.stderr.read()
    assert process.returncode == 130
    last = said.decode().splitlines()[-1]
    result = json.loads(out.read_text())
    checked(result)
    expected = f"interrupted after iteration {result['iteration']}, what was found so far is in 'result.json'"
    assert last == f"pmpnbp estimate: {expected}"
    with Recording(tmp_path / "run.sqlite") as recording:
        # an interrupt may come between an iteration and its being recorded
        assert recording.iterations()[-1] in (result["iteration"], result["iteration"] - 1)


def test_a_long_read_out_is_told_of(capsys: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    assert main(["estimate", *SCAN, *QUICK]) == 0
    result, said = capsys.readouterr()
    assert "reading out" not in said
    monkeypatch.setattr(progress, "SOON", 0.0)
    assert main(["estimate", *SCAN, *QUICK]) == 0
    again, said = capsys.readouterr()
    *_, first, found, joints, advice = said.splitlines()
    assert (first, found) == ("reading out the posterior ...", verdict(json.loads(again)))
    assert re.fullmatch(r"(joint slide\d [\d.]+ \([\d.]+ to [\d.]+\) cm(; )?){3}", joints)
    assert advice.startswith("Next: ")
    assert main(["estimate", *SCAN, *QUICK, "--quiet"]) == 0
    quiet, said = capsys.readouterr()
    assert said == ""
    for other in (again, quiet):
        assert {**json.loads(other), "seconds": 0} == {**json.loads(result), "seconds": 0}


def test_interrupted_while_it_reads_out_it_writes_the_estimate_alone(
    tmp_path: Path, capsys: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(quiet: bool) -> Checkpoint:
        def checkpoint() -> None:
            raise KeyboardInterrupt

        return checkpoint

    monkeypatch.setattr(estimate, "reading_out", interrupt)
    out, recorded, draws = tmp_path / "result.json", tmp_path / "run.sqlite", tmp_path / "draws.nc"
    files = ["--out", str(out), "--recording", str(recorded), "--draws", str(draws)]
    assert main(["estimate", *SCAN, *QUICK, *files]) == 130
    result = json.loads(out.read_text())
    checked(result)
    assert (result["iteration"], result["fit"], draws.exists()) == (4, None, False)
    assert capsys.readouterr().err.splitlines()[-3:] == [
        "No verdict: the read-out was interrupted",
        "--draws 'draws.nc' is not written: its read-out was interrupted",
        "pmpnbp estimate: interrupted after iteration 4, what was found so far is in 'result.json'",
    ]
    with Recording(recorded) as recording:
        assert recording.posterior(4) is None


def test_the_posteriors_draws_are_written_for_arviz(tmp_path: Path, capsys: Capture) -> None:
    out, draws = tmp_path / "result.json", tmp_path / "draws.nc"
    assert main(["estimate", *SCAN, *QUICK, "--out", str(out), "--draws", str(draws)]) == 0
    result, read = json.loads(out.read_text()), load_arviz().from_netcdf(str(draws))
    assert list(read.posterior.link.values) == list(result["links"])
    for name, link in result["links"].items():
        drawn = read.posterior["link_position"].sel(link=name).values[0]
        position = np.array(list(link["pose"]["position"].values()))
        # about the estimate, as the result tells it: of 1000 resampled draws, hence not to the last digit
        np.testing.assert_allclose(np.sqrt(np.mean((drawn - position) ** 2, axis=0)), link["std_xyz"], rtol=0.05)
    assert read.attrs["fit"] == result["fit"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["draws.nc", "result.json"]


def test_draws_that_there_are_none_of_are_not_written(tmp_path: Path, capsys: Capture) -> None:
    searching = ["--particles", "40", "--iterations", "1", "--config", "search_proposals=300", "--quiet"]
    assert main(["estimate", *SCAN, *searching, "--draws", str(tmp_path / "draws.nc")]) == 0
    assert "'draws.nc' is not written: during the search there is no posterior" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_draws_without_their_package_are_refused_before_anything_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.setitem(sys.modules, "arviz", None)
    said = refused(capsys, "estimate", "gone.urdf", "gone.png", "--draws", str(tmp_path / "draws.nc"))
    assert "pip install 'pmpnbp[arviz]'" in said
