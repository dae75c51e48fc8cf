"""The command line as its users meet it: help, exit status, and one sentence for each mistake."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from PIL import Image

from app.cli import main
from pmpnbp.settings import Settings
from tests.app.command_line import CABINET, CAMERA, DEPTH, MODEL, ROOT, SCAN, Capture, refused


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


def test_the_first_file_that_is_not_there_is_told(tmp_path: Path, capsys: Capture) -> None:
    """In the order of the words, and before what is wrong with those that are there: a PNG without a camera, say."""
    there = [MODEL, DEPTH, CAMERA, str(CABINET / "prior.json"), str(CABINET / "open" / "truth.json")]
    gone = [str(tmp_path / f"gone{number}{Path(path).suffix}") for number, path in enumerate(there)]
    for number, what in enumerate(("model", "scan", "camera file", "prior file", "truth file")):
        model, scan, camera, prior, truth = [*there[:number], *gone[number:]]
        said = refused(capsys, "estimate", model, scan, "--camera", camera, "--prior", prior, "--truth", truth)
        assert said == f"pmpnbp estimate: {what} '{Path(gone[number]).name}' is not there\n"
    assert "model 'gone0.urdf' is not there" in refused(capsys, "estimate", gone[0], DEPTH)


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


@pytest.mark.parametrize("elsewhere", [False, True])
def test_help_shows_an_example_whose_files_are_there(
    elsewhere: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    monkeypatch.chdir(tmp_path if elsewhere else ROOT)
    for arguments in (["--help"], ["estimate", "--help"]):
        assert main(arguments) == 0
        text = capsys.readouterr().out
        named = [Path(word) for word in text.split() if "sample_data/" in word]
        assert len(named) == 3
        assert all(name.is_file() for name in named)


def test_help_imports_nothing_heavy() -> None:
    """What makes it answer at once; a limit on the seconds would fail on a busy machine."""
    program = "import sys; from app.cli import main; main(['--help']); print(sorted(sys.modules), file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = set(ast.literal_eval(done.stderr))
    assert not loaded & {"numpy", "numba", "scipy", "open3d", "trimesh", "yourdfpy", "tqdm", "sqlite3"}


def test_it_can_be_called_as_a_module_in_a_folder_with_an_app_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "app.py").write_text("raise SystemExit('the wrong app')\n")
    command = [sys.executable, "-m", "pmpnbp", "--version"]
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stdout[:7], done.stderr) == (0, "pmpnbp ", "")


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


@pytest.mark.parametrize("command", [("benchmark",), ("reproduce", "push")])
def test_another_package_of_the_name_benchmarks_is_told(
    command: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, capsys: Capture
) -> None:
    for name in [name for name in sys.modules if name.split(".")[0] == "benchmarks"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "benchmarks", ModuleType("benchmarks"))
    said = refused(capsys, *command)
    assert re.search(r"benchmarks\.\w+ is not here: another package of the name hides it", said)
