"""The examples of docs/rest.md do what the page says, against a real server."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image

from tests.shown_code import blocks

if TYPE_CHECKING:
    from tests.servers import Served

ADDRESS = "http://127.0.0.1:8080"


def of_language(repository: Path, language: str) -> list[str]:
    """The page's blocks of code in a language, in order."""
    return [text for named, text in blocks(repository / "docs" / "rest.md") if named == language]


@pytest.fixture
def folder(repository: Path, tmp_path: Path) -> Path:
    """A folder like the project's, for the files that the examples write."""
    made = tmp_path / "project"
    made.mkdir()
    (made / "sample_data").symlink_to(repository / "sample_data")
    return made


def executed(command: list[str], script: str, folder: Path, url: str) -> str:
    """What a script prints that was written for a server at ADDRESS. Fails where the script does."""
    assert ADDRESS in script
    environment = os.environ | {"PMPNBP_TOKEN": "none-is-needed", "NO_PROXY": "127.0.0.1"}
    found = subprocess.run(
        [*command, script.replace(ADDRESS, url)], cwd=folder, env=environment, text=True, capture_output=True
    )
    assert found.returncode == 0, found.stdout + found.stderr
    return found.stdout


def known_picture(path: Path) -> None:
    with Image.open(path) as picture:
        assert picture.format == "PNG"
        assert picture.size == (640, 480)


def test_every_block_is_of_a_kind_that_is_executed(repository: Path) -> None:
    assert {language for language, _ in blocks(repository / "docs" / "rest.md")} == {"sh", "python"}


def test_the_planner_takes_ten_lines(repository: Path) -> None:
    assert len(of_language(repository, "sh")[0].splitlines()) == 10


def test_curl(served: Served, repository: Path, folder: Path) -> None:
    served.ready()
    # of `decide | grep … && …` the second half is left out where the decision is the other one: a file is missing then
    script = "set -eu\n" + "\n".join(of_language(repository, "sh"))
    printed = executed(["sh", "-c"], script, folder, served.url)
    first, second = (json.loads((folder / f"{name}.json").read_text()) for name in ("first", "second"))
    assert (first["action"], second["action"]) == ("look", "act")
    estimate = json.loads((folder / "estimate.json").read_text())
    assert abs(estimate["joints"]["slide3"]["position"]) < 0.015  # the accuracy that was asked for
    known_picture(folder / "estimate.png")
    assert "paused" in printed
    assert "nothing" in printed
    assert len(json.loads((folder / "sessions.json").read_text())) == 3  # one of them the sample
    assert len(json.loads((folder / "replaced.json").read_text())["scan_ids"]) == 1
    assert "the search begins again" in printed
    view = json.loads((folder / "view.json").read_text())
    assert (view["iteration"], view["part"]) == (2, "drawer2")
    assert "</html>" in (folder / "scene.html").read_text()
    assert len(json.loads((folder / "samples.json").read_text())) > 1
    particles = json.loads((folder / "belief.json").read_text())
    with np.load(folder / "belief.npz") as belief:
        assert any(array.ndim == 2 and array.shape[1] == 7 for array in belief.values())
    assert particles
    assert (folder / "message.ply").read_bytes().startswith(b"ply")
    assert (folder / "recording.sqlite").read_bytes().startswith(b"SQLite format 3")
    assert re.search(r"^event: (iteration|state)$", (folder / "events.txt").read_text(), re.MULTILINE)


def test_python(served: Served, repository: Path, folder: Path) -> None:
    served.ready()
    (script,) = of_language(repository, "python")
    printed = executed([sys.executable, "-c"], script, folder, served.url)
    assert "looked again: act" in printed
    opened = re.search(r"drawer3 is open by (\S+) m", printed)
    assert opened is not None and abs(float(opened[1])) < 0.015
    known_picture(folder / "estimate.png")
