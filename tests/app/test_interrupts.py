"""Ctrl-C ends a command wherever it comes."""

from __future__ import annotations

import subprocess
import sys

import pytest

from app import cli
from app.commands import settings

DROPPED = """
import ctypes, time
from app.interrupts import keep_interrupts

class Finalised:
    def __del__(self):
        raise KeyboardInterrupt

@ctypes.CFUNCTYPE(None)
def called_back():
    raise KeyboardInterrupt

keep_interrupts()
try:
    {dropping}
    time.sleep(60)
except KeyboardInterrupt:
    print("heard")
"""


@pytest.mark.parametrize("dropping", ["Finalised()", "called_back()"])
def test_an_interrupt_that_python_drops_comes_again(dropping: str) -> None:
    told = subprocess.run(
        [sys.executable, "-c", DROPPED.format(dropping=dropping)], capture_output=True, text=True, timeout=50
    )
    assert (told.stdout, told.stderr, told.returncode) == ("heard\n", "", 0)


def test_other_dropped_exceptions_are_told_as_before() -> None:
    program = DROPPED.replace("KeyboardInterrupt\n\n@", "ValueError('another')\n\n@").replace("time.sleep(60)", "pass")
    told = subprocess.run(
        [sys.executable, "-c", program.format(dropping="Finalised()")], capture_output=True, text=True, timeout=50
    )
    assert "ValueError: another" in told.stderr and told.stdout == ""


def test_an_interrupt_within_a_compiled_function_is_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(arguments: object) -> int:
        raise SystemError("returned a result with an exception set") from KeyboardInterrupt()

    monkeypatch.setattr(settings, "run", interrupted)
    assert cli.main(["settings"]) == 130
    assert capsys.readouterr().err == "pmpnbp settings: interrupted\n"


def test_another_error_of_the_system_is_not(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(arguments: object) -> int:
        raise SystemError("broken")

    monkeypatch.setattr(settings, "run", broken)
    with pytest.raises(SystemError, match="broken"):
        cli.main(["settings"])
