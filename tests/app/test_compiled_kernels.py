"""An image's kernels are found by processors that it was not built on, and nothing is compiled again."""

from __future__ import annotations

import ctypes
import os
import platform
import subprocess
import sys
from pathlib import Path

import pytest

from app import compiled_kernels
from pmpnbp.errors import SettingError
from tests import instruction_sets

IMAGE = "x86-64-v3 x86-64-v2 generic"
OLD = "fpu sse sse2 cx16 lahf_lm pni popcnt sse4_1 sse4_2 ssse3"
WIDE = f"{OLD} avx avx2 bmi1 bmi2 f16c fma abm movbe avx512f"
# As a server starts, and what is compiled meanwhile, whether numba keeps it or not.
SECOND_START = """
import os
from app import compiled_kernels
compiled_kernels.choose()
from numba.core import event
with event.install_recorder("numba:compile") as recorded:
    from app import warm_up
    warm_up.run()
print(os.environ["NUMBA_CPU_NAME"], os.environ["NUMBA_CACHE_DIR"], len(recorded.buffer), sep="|")
"""
PR_CAPBSET_DROP, CAP_DAC_OVERRIDE = 24, 1


@pytest.fixture
def processor(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The file that tells what the processor can do, for a test to write."""
    path = tmp_path / "cpuinfo"
    monkeypatch.setattr(compiled_kernels, "CPUINFO", path)
    return path


@pytest.mark.parametrize(
    ("told", "chosen"),
    [
        (f"processor : 0\nflags\t\t: {WIDE}\nbugs : none\n", ["x86-64-v3", "x86-64-v2"]),
        (f"flags : {WIDE.replace(' avx2', '')}\n", ["x86-64-v2"]),
        (f"flags : {WIDE.replace(' fma', '')}\n", ["x86-64-v2"]),
        (f"flags : {OLD}\n", ["x86-64-v2"]),
        ("flags : fpu sse sse2\n", []),
        ("processor : 0\nFeatures : fp asimd evtstrm aes\n", ["generic"]),
        ("", []),
        (None, []),
    ],
)
def test_the_best_target_that_fits_is_chosen(processor: Path, told: str | None, chosen: list[str]) -> None:
    if told is not None:
        processor.write_text(told)
    environment = {"KERNEL_TARGETS": IMAGE}
    assert compiled_kernels.targets(environment) == chosen
    compiled_kernels.choose(environment)
    assert environment.get("NUMBA_CPU_NAME") == (chosen[0] if chosen else None)
    assert environment.get("NUMBA_CPU_FEATURES") == ("" if chosen else None)


def test_without_an_image_and_against_an_operator_nothing_is_chosen(processor: Path) -> None:
    processor.write_text(f"flags : {WIDE}\n")
    for environment in ({}, {"KERNEL_TARGETS": ""}, {"KERNEL_TARGETS": IMAGE, "NUMBA_CPU_NAME": "znver4"}):
        before = dict(environment)
        compiled_kernels.choose(environment)
        assert environment == before


def test_an_unknown_target_is_named(processor: Path) -> None:
    with pytest.raises(SettingError, match="KERNEL_TARGETS names 'avx2', which is no target; there are x86-64-v3, "):
        compiled_kernels.choose({"KERNEL_TARGETS": "avx2"})


def test_a_folder_that_can_be_written_is_used_as_it_is(processor: Path, tmp_path: Path) -> None:
    environment = {"KERNEL_TARGETS": IMAGE, "NUMBA_CACHE_DIR": str(tmp_path)}
    compiled_kernels.choose(environment)
    assert environment["NUMBA_CACHE_DIR"] == str(tmp_path)


def unprivileged() -> None:
    """Have root, too, heed that a folder may not be written."""
    ctypes.CDLL(None).prctl(PR_CAPBSET_DROP, CAP_DAC_OVERRIDE)


@pytest.mark.skipif(
    platform.machine().lower() not in ("x86_64", "amd64") or sys.platform != "linux",
    reason="the kernels that the second pass of `make test` is made with are of an x86-64 target",
)
def test_a_second_start_compiles_nothing_even_where_kernels_cannot_be_written(tmp_path: Path, repository: Path) -> None:
    baseline = instruction_sets.baseline()
    assert baseline is not None
    target = baseline["NUMBA_CPU_NAME"]
    # compiled once by `make test`, or here
    subprocess.run([sys.executable, "-m", "app.warm_up"], cwd=repository, env=os.environ | baseline, check=True)
    shut = tmp_path / "kernels"
    subprocess.run(["cp", "-R", baseline["NUMBA_CACHE_DIR"], str(shut)], check=True)
    folders = [shut, *(path for path in shut.rglob("*") if path.is_dir())]
    for folder in folders:
        folder.chmod(0o555)
    environment = {name: value for name, value in os.environ.items() if not name.startswith("NUMBA_")}
    environment |= {"KERNEL_TARGETS": target, "NUMBA_CACHE_DIR": str(shut), "TMPDIR": str(tmp_path)}
    try:
        started = subprocess.run(
            [sys.executable, "-c", SECOND_START],
            cwd=repository,
            env=environment,
            capture_output=True,
            text=True,
            preexec_fn=unprivileged,
        )
    finally:
        for folder in folders:
            folder.chmod(0o755)
    assert started.returncode == 0, started.stderr
    chosen, read_from, compiled = started.stdout.strip().split("|")
    assert chosen == target
    assert read_from != str(shut)
    assert compiled == "0"
    assert not Path(read_from).exists()  # the copy went with the process
