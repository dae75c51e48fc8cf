"""Standard streams that cannot be written: one sentence and no traceback, and no result that is lost for a message."""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from tests.app.command_line import ROOT, SCAN

START = ["estimate", *SCAN, "--iterations", "0", "--particles", "40"]


def shell(words: list[str], redirected: str) -> subprocess.CompletedProcess[str]:
    """What comes of a command with its streams redirected as a shell does it."""
    command = shlex.join([sys.executable, "-m", "app.cli", *words])
    return subprocess.run(["bash", "-c", f"{command} {redirected}"], cwd=ROOT, capture_output=True, text=True)


@pytest.mark.parametrize(
    "words",
    [[*START, "--quiet"], ["settings"], ["completion", "bash"], ["--version"], ["estimate", "--help"]],
    ids=lambda words: words[0],
)
@pytest.mark.parametrize(
    ("redirected", "reason"),
    [(">/dev/full", "No space left on device"), (">&-", "it is closed")],
    ids=("full", "closed"),
)
def test_an_output_that_takes_nothing_is_one_sentence(words: list[str], redirected: str, reason: str) -> None:
    done = shell(words, redirected)
    assert (done.returncode, done.stderr) == (1, f"pmpnbp: standard output cannot be written: {reason}\n")


def test_a_closed_output_is_told_before_the_run() -> None:
    done = shell([*START[:-2], "--iterations", "100000", "--particles", "20000"], ">&-")
    assert (done.returncode, done.stderr) == (1, "pmpnbp: standard output cannot be written: it is closed\n")


def test_a_closed_output_is_not_missed_where_the_result_goes_elsewhere(tmp_path: Path) -> None:
    out, recording = tmp_path / "out.json", tmp_path / "run.sqlite"
    done = shell([*START, "--quiet", "--out", str(out), "--recording", str(recording)], "<&- >&- 2>&-")
    assert done.returncode == 0 and json.loads(out.read_text())["iteration"] == 0
    assert recording.stat().st_size > 0


@pytest.mark.parametrize("redirected", ["2>&-", "2>/dev/full"], ids=("closed", "full"))
def test_the_result_is_not_lost_for_a_message(redirected: str) -> None:
    done = shell(START, redirected)
    assert done.returncode == 0 and json.loads(done.stdout)["iteration"] == 0
    assert shell(["estimate", "gone.urdf", "gone.png"], redirected).returncode == 2


def test_a_reader_that_has_enough_is_no_error() -> None:
    done = shell(["settings"], "| head -n 1; exit ${PIPESTATUS[0]}")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("Settings for --config")


def test_the_result_goes_to_standard_output_by_another_name(tmp_path: Path) -> None:
    log = tmp_path / "log"
    log.write_text("before\n")
    for out, redirected in (("/dev/stdout", "| cat"), (">(cat)", "| cat"), ("/dev/stdout", f">> {log}; cat {log}")):
        done = shell([*START, "--quiet"], f"--out {out} {redirected}")
        assert done.stderr == "" and json.loads(done.stdout.removeprefix("before\n"))["iteration"] == 0
    assert log.read_text().startswith("before\n")
