"""Does every script of docs/examples run as it stands, and find what is true of the scene?"""

from __future__ import annotations

import ast
import json
import math
import re
import runpy
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest

import pmpnbp
from tests.servers import serving

EXAMPLES = Path(__file__).resolve().parents[2] / "docs" / "examples"
TRIED = {"first_estimate", "planner", "stepping", "known_base", "two_views", "draws_in_arviz", "robot_arm"}
Example = Callable[..., str]


@pytest.fixture
def example(project: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Example:
    """A function that runs an example of a name, with arguments; what it prints."""

    def run(name: str, *arguments: object) -> str:
        monkeypatch.setattr(sys, "argv", [f"{name}.py", *map(str, arguments)])
        runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
        return capsys.readouterr().out

    return run


def truth(scene: Path) -> dict[str, float]:
    """Where a scene's joints stand."""
    joints: dict[str, float] = json.loads((scene / "truth.json").read_text())["joints"]
    return joints


def number(pattern: str, printed: str) -> float:
    """What is printed in place of the pattern's group."""
    found = re.search(pattern, printed)
    assert found is not None, printed
    return float(found[1])


def test_every_example_is_tried_here_and_told_of_in_the_documentation(repository: Path) -> None:
    there = {path.stem for path in EXAMPLES.glob("*.py")}
    pages = [(repository / "docs" / page).read_text(encoding="utf-8") for page in ("python.md", "rest.md")]
    assert there == TRIED
    assert {name for page in pages for name in re.findall(r"\(examples/(\w+)\.py\)", page)} == TRIED


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_it_is_read_at_once(path: Path) -> None:
    """Of ours it imports the one name, and it says how it is called."""
    text = path.read_text(encoding="utf-8")
    imported = {
        alias.name for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Import) for alias in node.names
    }
    imported |= {str(node.module) for node in ast.walk(ast.parse(text)) if isinstance(node, ast.ImportFrom)}
    assert imported - set(sys.stdlib_module_names) - {"arviz"} == {"pmpnbp"}
    assert f"\npython docs/examples/{path.name}" in text
    assert len(text.splitlines()) <= 40


def test_first_estimate(example: Example, project: Path) -> None:
    printed = example("first_estimate")
    assert "all 7 links are certain" in printed
    for name, position in truth(Path("sample_data/cabinet/open")).items():
        assert number(rf"{name} is open by (\S+) m", printed) == pytest.approx(position, abs=0.004)
    assert (project / "estimate.png").read_bytes().startswith(b"\x89PNG")


def test_planner(example: Example, tmp_path: Path) -> None:
    with serving(tmp_path / "data") as serve:
        printed = example("planner", serve().ready().url)
    assert printed.count("looking lowered") == 1
    assert re.search(r"^act: every asked link is known to 4 mm.*\npull the drawer at", printed, re.MULTILINE)


def test_stepping(example: Example, project: Path) -> None:
    printed = example("stepping")
    counts = [float(count) for count in re.findall(r"belief propagation: .* where (\d+) particles", printed)]
    assert min(counts[-3:]) > 2 * max(counts[:-3])  # as the setting was changed
    assert number(r".*slide1 at (\S+) m", printed.splitlines()[-2]) == pytest.approx(0.24, abs=0.004)
    with pmpnbp.open_recording(project / "steps.sqlite") as recording:
        assert len(recording) == len(printed.splitlines())  # iteration 0 is not told, and the verdict is


def test_known_base(example: Example) -> None:
    printed = example("known_base")
    assert "Found" in printed
    assert number(r"slide1 is open by (\S+) m", printed) == pytest.approx(0.24, abs=0.004)


def test_two_views(example: Example) -> None:
    printed = example("two_views")
    widths = [float(high) - float(low) for low, high in re.findall(r"open by (\S+) to (\S+) m", printed)]
    assert len(widths) == 2 and widths[1] < 0.01 < widths[0]


def test_draws_in_arviz(example: Example, project: Path) -> None:
    pytest.importorskip("arviz")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # it announces its next version
        printed = example("draws_in_arviz")
    assert number(r"slide2\]\s+(\S+)", printed) == pytest.approx(0.05, abs=0.008)
    assert number(r"stands out by (\S+) m more", printed) == pytest.approx(0.25, abs=0.008)
    assert (project / "draws.nc").stat().st_size > 10_000


def test_robot_arm(example: Example, shared_data: Path) -> None:
    arm = shared_data / "real_xarm7"
    printed = example("robot_arm", arm / "model.urdf", arm / "frame_0" / "depth.png", arm / "frame_0" / "camera.json")
    # the joints near the base, which the scan shows well; where the wrist stands it leaves open
    for name in ("joint1", "joint2", "joint3", "joint4"):
        position = truth(arm / "frame_0")[name] * 180 / math.pi
        assert number(rf"{name} stands at (\S+)°", printed) == pytest.approx(position, abs=10)


def test_robot_arm_says_what_it_wants(example: Example) -> None:
    with pytest.raises(SystemExit, match="expected MODEL SCAN CAMERA"):
        example("robot_arm")
