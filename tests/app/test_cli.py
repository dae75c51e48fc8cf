"""The command line as its users meet it: the result, the exit status, and one sentence for each mistake."""

from __future__ import annotations

import ast
import json
import os
import signal
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from app.cli import main
from app.commands.benchmark import run
from app.commands.checkout import CheckoutError
from pmpnbp.recording import Recording
from pmpnbp.settings import Settings

ROOT = Path(__file__).resolve().parent.parent.parent
CABINET = ROOT / "sample_data" / "cabinet"
SCENE = CABINET / "open"
MODEL, DEPTH, CAMERA = (str(path) for path in (CABINET / "cabinet.urdf", SCENE / "depth.png", SCENE / "camera.json"))
ROI = ",".join(str(number) for number in json.loads((SCENE / "roi.json").read_text())["roi"])
SCAN = [MODEL, DEPTH, "--camera", CAMERA, f"--roi={ROI}"]
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
]

Capture = pytest.CaptureFixture[str]


def refused(capsys: Capture, *arguments: str) -> str:
    """The sentence with which the command line refuses."""
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.endswith("\n") and err.count("\n") == 1, err
    assert "Traceback" not in err
    return err


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
        "links",
        "joints",
    ]
    assert (result["schema"], result["model"], result["method"]) == ("pmpnbp/estimate-1", "cabinet", method)
    assert set(result["links"]) == {"frame"} | {f"{what}{k}" for what in ("drawer", "handle") for k in (1, 2, 3)}
    for link in result["links"].values():
        assert list(link) == ["pose", "covariance", "std_xyz", "certain", "visible_fraction", "log_likelihood", "modes"]
        checked_pose(link["pose"])
        checked_covariance(link["covariance"])
        assert link["certain"] == (max(link["std_xyz"]) <= result["max_std"])
        assert 0 <= link["visible_fraction"] <= 1
        assert 1 <= len(link["modes"]) <= 5
        assert sum(mode["weight"] for mode in link["modes"]) <= 1 + 1e-9
        for mode in link["modes"]:
            assert list(mode) == ["weight", "pose", "covariance"]
            checked_pose(mode["pose"])
            checked_covariance(mode["covariance"])
    assert result["certain"] == all(link["certain"] for link in result["links"].values())
    assert list(result["joints"]) == ["slide1", "slide2", "slide3"]
    for k, joint in enumerate(result["joints"].values(), 1):
        assert list(joint) == ["type", "position", "std", "lower", "upper", "parent", "child"]
        assert (joint["type"], joint["parent"], joint["child"]) == ("prismatic", "frame", f"drawer{k}")
        assert joint["lower"] <= joint["position"] <= joint["upper"]
        assert joint["std"] >= 0


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
    assert list(errors["parts"]) == ["frame", "drawer1", "drawer2", "drawer3"]
    assert max(error["add"] for error in errors["parts"].values()) < 0.01
    assert max(error["add_s"] for error in errors["parts"].values()) < 0.01
    assert max(abs(error) for error in errors["joints"].values()) < 0.01
    with Recording(recording) as recorded:
        assert recorded.iterations() == list(range(result["iteration"] + 1))
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
    assert (result["iteration"], result["converged"]) == (0, False)


def test_interrupted_it_still_writes_what_it_found(tmp_path: Path) -> None:
    out = tmp_path / "result.json"
    program = [sys.executable, "-m", "app.cli", "estimate", *SCAN, *QUICK, "--iterations", "100000"]
    program += ["--config", "converged_motion=0", "--out", str(out), "--recording", str(tmp_path / "run.sqlite")]
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


@pytest.mark.parametrize(
    ("urdf", "sentence"),
    [
        ("hello", "not"),
        ("<html/>", "robot"),
        (
            '<robot name="r"><link name="a"><visual><geometry><mesh filename="gone.stl"/></geometry></visual></link>'
            "</robot>",
            "mesh 'gone.stl' of link 'a' is missing",
        ),
        (
            '<robot name="r"><link name="a"/><link name="b"/><joint name="slide" type="prismatic"><parent link="a"/>'
            '<child link="b"/></joint></robot>',
            "joint 'slide'",
        ),
        (
            '<robot name="r"><link name="a"><visual><origin xyz="nan 0 0"/><geometry><box size="1 1 1"/></geometry>'
            "</visual></link></robot>",
            "nan",
        ),
    ],
)
def test_a_model_that_cannot_be_used(urdf: str, sentence: str, tmp_path: Path, capsys: Capture) -> None:
    path = tmp_path / "model.urdf"
    path.write_text(urdf)
    assert sentence in refused(capsys, "estimate", str(path), *SCAN[1:])


def test_files_that_are_not_there(tmp_path: Path, capsys: Capture) -> None:
    gone = str(tmp_path / "gone")
    assert "model 'gone.urdf' is not there" in refused(capsys, "estimate", gone + ".urdf", *SCAN[1:])
    assert "scan 'gone.png' cannot be read" in refused(capsys, "estimate", MODEL, gone + ".png", "--camera", CAMERA)
    assert "camera file 'gone.json'" in refused(capsys, "estimate", MODEL, DEPTH, "--camera", gone + ".json")
    assert "prior file 'gone.json'" in refused(capsys, "estimate", *SCAN, "--prior", gone + ".json")
    assert "truth file 'gone.json'" in refused(capsys, "estimate", *SCAN, "--truth", gone + ".json")


def test_scans_that_cannot_be_used(tmp_path: Path, capsys: Capture) -> None:
    members = json.loads(Path(CAMERA).read_text())
    black = tmp_path / "black.png"
    Image.fromarray(np.zeros((members["height"], members["width"]), dtype=np.uint16)).save(black)
    assert "no valid point" in refused(capsys, "estimate", MODEL, str(black), "--camera", CAMERA)
    small = tmp_path / "small.png"
    Image.fromarray(np.full((20, 30), 1000, dtype=np.uint16)).save(small)
    assert "is 30x20 pixels, but its camera file says" in refused(
        capsys, "estimate", MODEL, str(small), "--camera", CAMERA
    )
    assert "needs a camera file" in refused(capsys, "estimate", MODEL, DEPTH)
    far = [MODEL, DEPTH, "--camera", CAMERA, "--roi", "-9,-9,-9,-8,-8,-8"]
    assert "no measured point lies in the region" in refused(capsys, "estimate", *far)
    assert "--camera is given 2 times for 3 scans" in refused(
        capsys, "estimate", MODEL, DEPTH, DEPTH, DEPTH, "--camera", CAMERA, "--camera", CAMERA
    )


def test_a_prior_that_names_an_unknown_link(tmp_path: Path, capsys: Capture) -> None:
    members = json.loads((CABINET / "prior.json").read_text()) | {"link": "wheel"}
    (tmp_path / "prior.json").write_text(json.dumps(members))
    assert "wheel" in refused(capsys, "estimate", *SCAN, "--prior", str(tmp_path / "prior.json"))


@pytest.mark.parametrize(
    ("option", "sentence"),
    [
        ("--roi=1,2,3", "'1,2,3' is not six finite numbers"),
        ("--roi=0,0,nan,1,1,1", "is not six finite numbers"),
        ("--roi=1,0,0,0,1,1", "is empty; expected x0 < x1"),
        ("--particles=1", "'1' is not a whole number from 2 to 20000"),
        ("--particles=many", "'many' is not a whole number"),
        ("--iterations=-1", "'-1' is not a whole number from 0 to"),
        ("--seed=1.5", "'1.5' is not a whole number"),
        ("--max-std=0", "'0' is not a finite number of metres above zero"),
        ("--method=guess", "invalid choice: 'guess'"),
        ("--config=speed", "'speed' is not NAME=VALUE"),
        ("--config=speed=9", "setting 'speed' does not exist; there are preset, "),
        ("--config=joint_draws=few", "setting 'joint_draws' is 'few'; it must be a whole number"),
        ("--config=preset=magic", "preset 'magic' does not exist"),
        ("--fast", "--fast is not an option of estimate"),
    ],
)
def test_options_that_cannot_be(option: str, sentence: str, capsys: Capture) -> None:
    assert sentence in refused(capsys, "estimate", *SCAN[:4], option)


def test_a_setting_given_twice(capsys: Capture) -> None:
    twice = ["--config", "joint_draws=2", "--config", "joint_draws=4"]
    assert "setting 'joint_draws' is given twice" in refused(capsys, "estimate", *SCAN, *twice)


def test_outputs_are_checked_before_anything_is_read(tmp_path: Path, capsys: Capture) -> None:
    """The model is not even there, and yet it is the output that is complained of."""
    gone = [str(tmp_path / "gone.urdf"), DEPTH]
    for option in ("--out", "--recording"):
        assert "is not there" in refused(capsys, "estimate", *gone, option, str(tmp_path / "no" / "file"))
        assert "is a folder" in refused(capsys, "estimate", *gone, option, str(tmp_path))
    same = str(tmp_path / "both")
    assert "are both 'both'" in refused(capsys, "estimate", *gone, "--out", same, "--recording", same)
    note = tmp_path / "note.txt"
    note.write_text("mine")
    assert "is there and is no recording" in refused(capsys, "estimate", *SCAN, "--recording", str(note))
    assert note.read_text() == "mine"


def test_a_failed_run_leaves_no_file(tmp_path: Path, capsys: Capture) -> None:
    outputs = ["--out", str(tmp_path / "out.json"), "--recording", str(tmp_path / "run.sqlite")]
    refused(capsys, "estimate", MODEL, DEPTH, "--camera", CAMERA, "--roi=8,8,8,9,9,9", *outputs)
    assert list(tmp_path.iterdir()) == []


def test_no_command_and_an_unknown_one(capsys: Capture) -> None:
    assert "the following arguments are required: COMMAND" in refused(capsys)
    assert "invalid choice: 'plot'" in refused(capsys, "plot")


def test_help_shows_an_example_whose_files_are_there(capsys: Capture) -> None:
    for arguments in (["--help"], ["estimate", "--help"]):
        assert main(arguments) == 0
        text = capsys.readouterr().out
        named = [word for word in text.split() if word.startswith("sample_data/")]
        assert len(named) == 3
        assert all((ROOT / name).is_file() for name in named)


def test_help_imports_nothing_heavy() -> None:
    """What makes it answer at once; a limit on the seconds would fail on a busy machine."""
    program = "import sys; from app.cli import main; main(['--help']); print(sorted(sys.modules), file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(ast.literal_eval(done.stderr))
    assert not loaded & {"numpy", "numba", "scipy", "open3d", "trimesh", "yourdfpy", "tqdm", "sqlite3"}


def test_version(capsys: Capture) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("pmpnbp ")


def test_every_setting_is_listed_with_default_unit_and_help(capsys: Capture) -> None:
    assert main(["settings"]) == 0
    text = capsys.readouterr().out
    for name, entry in Settings.__dataclass_fields__.items():
        assert f"\n{name} = " in text
        assert f"\n    {entry.metadata['help']}\n" in text
    assert "\ntolerance_start = 0.06 m\n" in text
    assert "\njoint_draws = 8 draws; paper: 1 draws\n" in text
    assert "\nprior_factor = true; paper: false\n" in text


def test_benchmark_runs_the_project_s_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(CheckoutError, match="not installed with the package; run this from a checkout"):
        run(None, tmp_path)
    (tmp_path / "benchmarks").mkdir()
    (tmp_path / "benchmarks" / "__init__.py").touch()
    (tmp_path / "benchmarks" / "run.py").write_text("def main(out):\n    out.write_text('measured')\n")
    monkeypatch.setattr(sys, "path", list(sys.path))
    for name in ("benchmarks", "benchmarks.run"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    assert run(tmp_path / "figures.json", tmp_path) == 0
    assert (tmp_path / "figures.json").read_text() == "measured"
    for name in ("benchmarks", "benchmarks.run"):
        monkeypatch.delitem(sys.modules, name, raising=False)
