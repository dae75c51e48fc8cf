"""The command line as a test calls it: the arguments of the sample cabinet, and the sentence with which it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from app.cli import main

ROOT = Path(__file__).resolve().parent.parent.parent
CABINET = ROOT / "sample_data" / "cabinet"
SCENE = CABINET / "open"
MODEL, DEPTH, CAMERA = (str(path) for path in (CABINET / "cabinet.urdf", SCENE / "depth.png", SCENE / "camera.json"))
ROI = ",".join(str(number) for number in json.loads((SCENE / "roi.json").read_text())["roi"])
SCAN = [MODEL, DEPTH, "--camera", CAMERA, f"--roi={ROI}"]
Capture = pytest.CaptureFixture[str]


def refused(capsys: Capture, *arguments: str) -> str:
    """The sentence with which the command line refuses."""
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.endswith("\n") and err.count("\n") == 1, err
    assert "Traceback" not in err
    return err
