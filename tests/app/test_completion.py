"""What does a shell complete once it has read what `pmpnbp completion` prints?"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from app.cli import main

# What bash does when TAB is pressed after the words: the function that the script named is called, and says COMPREPLY.
# Without a line that is being typed there is nothing that compopt could be told, and it says so.
PRESS_TAB = """
source "$1"; shift
COMP_WORDS=("$@") COMP_CWORD=$(($# - 1)) COMP_LINE="$*" COMP_POINT=${#COMP_LINE}
complete -p pmpnbp | grep --quiet 'F _shtab_pmpnbp pmpnbp'
_shtab_pmpnbp pmpnbp "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD - 1]}"
printf '%s\\n' "${COMPREPLY[@]}"
"""


@pytest.fixture
def script(tmp_path: Path, capsys: pytest.CaptureFixture[str], request: pytest.FixtureRequest) -> Path:
    """What is printed for a shell, as a file."""
    assert main(["completion", request.param]) == 0
    path = tmp_path / "script"
    path.write_text(capsys.readouterr().out)
    return path


@pytest.mark.parametrize("script", ["bash"], indirect=True)
@pytest.mark.parametrize(
    ("typed", "completed"),
    [
        ("", {"estimate", "serve", "view", "settings", "completion"}),
        ("est", {"estimate"}),
        ("estimate --m", {"--method", "--max-std"}),
        ("estimate --method ", {"pmpnbp", "particle_filter"}),
        ("reproduce o", {"occlusion"}),
        ("completion ", {"bash", "zsh", "fish"}),
        ("view run", {"run.sqlite"}),
        ("estimate --camera cam", {"camera.json"}),
        ("serve --data-dir ", {"sessions"}),
    ],
)
def test_bash(typed: str, completed: set[str], script: Path, tmp_path: Path) -> None:
    folder = tmp_path / "folder"
    (folder / "sessions").mkdir(parents=True)
    for name in ("run.sqlite", "camera.json"):
        (folder / name).touch()
    words = ["pmpnbp", *typed.split(" ")]
    command = ["bash", "--norc", "-c", PRESS_TAB, "bash", str(script), *words]
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    found = {word.rstrip("/") for word in done.stdout.split()}
    assert completed <= found, done.stderr
    if typed:  # without a word all commands are there, whichever come with time
        assert found == completed


@pytest.mark.parametrize("script", ["zsh", "fish"], indirect=True)
def test_the_other_shells_read_theirs(script: Path, request: pytest.FixtureRequest) -> None:
    shell = request.node.callspec.params["script"]
    text = script.read_text()
    assert all(name in text for name in ("estimate", "max-std", "particle_filter", "find an object in one scene"))
    assert "The result is JSON" not in text  # a line for each command, not its whole description
    if shutil.which(shell):
        subprocess.run([shell, "-n", str(script)], check=True)


def test_a_shell_that_is_not_known(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "dosbox"]) == 2
    assert "invalid choice: 'dosbox'" in capsys.readouterr().err
