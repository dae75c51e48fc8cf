"""Processes that begin at once where nothing is compiled yet leave what each of them, and every later one, can use."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from pathlib import Path

import pytest

from pmpnbp.geometry import poses

USES = """
from pmpnbp.geometry import poses
assert (poses.multiply(poses.IDENTITY, poses.inverse(poses.IDENTITY)) == poses.IDENTITY).all()
"""
# Numba's count of what a process has compiled is another then.
AFTER_OTHERS = "import numba\n@numba.njit\ndef one(x): return x + 1\none(1), one(1.0)\n" + USES


def begun(code: str, cache: Path) -> subprocess.Popen[str]:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    return subprocess.Popen(
        [sys.executable, "-c", code], env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def test_two_that_begin_at_once_leave_nothing_that_ends_a_third(tmp_path: Path) -> None:
    """Without taking turns every second such pair ended itself, or all that came after it, by a segmentation fault."""
    for both in ([begun(USES, tmp_path), begun(AFTER_OTHERS, tmp_path)], [begun(AFTER_OTHERS, tmp_path)]):
        for process in both:
            _, errors = process.communicate()
            assert process.returncode == 0, errors


def test_who_comes_second_waits_for_the_first(tmp_path: Path) -> None:
    code = "print('begun', flush=True)" + USES + "print('done', flush=True)"
    with Path(poses.__file__).open("rb") as source:
        fcntl.flock(source, fcntl.LOCK_EX)
        with begun(code, tmp_path) as waiting:
            assert waiting.stdout is not None
            assert waiting.stdout.readline() == "begun\n"
            with pytest.raises(subprocess.TimeoutExpired):
                waiting.wait(3.0)
            fcntl.flock(source, fcntl.LOCK_UN)
            assert waiting.stdout.readline() == "done\n"
        assert waiting.returncode == 0
