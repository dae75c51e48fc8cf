"""Does the second pass of `make test` run under other instructions, and is a red one told where it comes from?"""

from __future__ import annotations

import os
import platform
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests import instruction_sets, machine_facts
from tests.instruction_sets import BASELINE, OWN

X86 = platform.machine().lower() in ("x86_64", "amd64")
# What each library says that it uses, and whether the code that numba made of a sum has wide or fused instructions.
FACTS = """
import numba, numpy as np
from tests import instruction_sets as sets
@numba.njit(fastmath=True)
def kernel(a, b):
    total = 0.0
    for number in range(a.size):
        total += a[number] * b[number]
    return total
kernel(np.ones(64), np.ones(64))
(code,) = kernel.inspect_asm().values()
fused = "vmul" in code or "vfmadd" in code
print(sets.current(), sets.numpy_features(), sets.numba_processor(), sets.blas_core(), fused, sep="|")
"""


def run_under(name: str, *command: str) -> str:
    environment = instruction_sets.environment(name)
    done = subprocess.run([sys.executable, *command], env=environment, capture_output=True, text=True, check=True)
    return done.stdout


def test_the_baseline_sets_every_dispatch_back(repository: Path) -> None:
    program = [sys.executable, "-m", "tests.instruction_sets", sys.executable, "-c", FACTS]
    done = subprocess.run(program, cwd=repository, capture_output=True, text=True, check=True)
    said = done.stdout.splitlines()
    if X86:
        assert said[-1] == f"{BASELINE}|[]|x86-64-v2|Nehalem|False"
    else:
        assert said == [f"{platform.machine()} has no older instruction set to go back to: no second pass"]


def test_this_pass_is_under_the_set_that_it_names() -> None:
    if instruction_sets.current() == BASELINE:
        assert (instruction_sets.numpy_features(), instruction_sets.blas_core()) == ([], "Nehalem")
        assert instruction_sets.numba_processor() == "x86-64-v2"
        assert os.environ["NUMBA_CACHE_DIR"].endswith("baseline_kernels")
    else:
        assert instruction_sets.current() == OWN
        assert "NPY_DISABLE_CPU_FEATURES" not in os.environ


@pytest.mark.skipif(not X86, reason="only there is the set of numbers that are told apart here")
def test_the_c_library_goes_back_too() -> None:
    """Of 200 000 values of six functions some differ in the last bit, on a processor that can multiply and add at
    once; on one that cannot they are the same."""
    from llvmlite import binding

    program = "import math, zlib\ntotal = 0\n"
    program += "for number in range(1, 200_000):\n    x = number / 7e3\n"
    program += (
        "    total = zlib.crc32(repr([math.exp(x), math.sin(x), math.log(x), math.pow(x, 0.3)]).encode(), total)\n"
    )
    program += "print(total)"
    same = run_under(OWN, "-c", program) == run_under(BASELINE, "-c", program)
    assert same == (not binding.get_host_cpu_features()["fma"] or platform.libc_ver()[0] != "glibc")


def test_what_the_second_pass_leaves_out_is_there(repository: Path) -> None:
    assert [path for path in instruction_sets.WITHOUT_NUMBERS if not (repository / path).exists()] == []


def test_long_files_are_there_and_come_first(repository: Path, request: pytest.FixtureRequest) -> None:
    from tests.conftest import LONG_FILES

    assert [path for path in LONG_FILES if not (repository / path).exists()] == []
    collected = [item.path.relative_to(repository).as_posix() for item in request.session.items]
    long = [path.startswith(LONG_FILES) for path in collected]
    assert long == sorted(long, reverse=True)


def test_another_architecture_has_no_second_pass(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    monkeypatch.setattr(platform, "machine", lambda: "arm64")
    monkeypatch.delenv(instruction_sets.NAME, raising=False)
    assert instruction_sets.main(["false"]) == 0
    assert capsys.readouterr().out == "arm64 has no older instruction set to go back to: no second pass\n"


@pytest.fixture
def failing(tmp_path: Path) -> Path:
    """A project of four tests: one always fails, one under the processor's own set, one beside others, one never."""
    (tmp_path / "conftest.py").write_text('pytest_plugins = ["tests.machine_facts"]\n')
    (tmp_path / "test_some.py").write_text(
        "import pathlib\nfrom tests import instruction_sets as sets\n"
        "def test_never(): assert False\n"
        "def test_elsewhere(): assert sets.current() == sets.BASELINE\n"
        "def test_later():\n"
        "    if not pathlib.Path('seen').exists():\n        pathlib.Path('seen').touch()\n        assert False\n"
        "def test_always(): pass\n"
    )
    return tmp_path


def run_project(
    project: Path, repository: Path, *options: str, ignored: frozenset[signal.Signals] = frozenset()
) -> str:
    """What pytest says of the project, started by a parent that ignores these signals and no others: the parent of this
    process may have ignored some, as `nohup` and a script's shell do."""

    def ignore() -> None:
        for number in signal.valid_signals() - {signal.SIGKILL, signal.SIGSTOP}:
            signal.signal(number, signal.SIG_IGN if number in ignored else signal.SIG_DFL)

    environment = instruction_sets.environment(OWN)
    assert environment is not None
    # no other plugins: their import takes seconds
    environment |= {
        "PYTHONPATH": str(repository),
        "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1",
        "PYTEST_PLUGINS": "xdist.plugin",
    }
    command = [sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *options]
    done = subprocess.run(command, cwd=project, env=environment, capture_output=True, text=True, preexec_fn=ignore)
    return done.stdout


def test_a_red_run_says_what_machine_it_was_and_what_decides(failing: Path, repository: Path) -> None:
    said = run_project(failing, repository, "--explain-failures")
    summary = said[said.index("the machine that these failures come from") :]
    assert "cores may be used; load " in summary
    assert f"instruction set: {OWN}; NumPy uses " in summary
    assert "signals that the parent process ignored: none" in summary
    fails, passes = f"fails under {OWN}", f"passes under {OWN}"
    beyond = {word: f", {word} under {BASELINE}" if X86 else "" for word in ("fails", "passes")}
    assert f"test_some.py::test_never: {fails}{beyond['fails']}: the instruction set does not decide" in summary
    assert f"test_some.py::test_later: {passes}{beyond['passes']}: other tests, the load or chance decide" in summary
    if X86:
        assert f"test_some.py::test_elsewhere: {fails}{beyond['passes']}: the instruction set decides" in summary
    assert "test_always" not in summary


def test_without_being_asked_nothing_is_run_again_and_a_green_run_says_nothing(failing: Path, repository: Path) -> None:
    assert "run again" not in run_project(failing, repository)
    assert "failures come from" not in run_project(failing, repository, "-k", "always", "--explain-failures")


def test_the_second_pass_is_of_numbers(failing: Path, repository: Path) -> None:
    for name in ("test_deployment.py", "test_settings.py"):
        (failing / "tests").mkdir(exist_ok=True)
        (failing / "tests" / name).write_text("def test_nothing(): pass\n")
    said = run_project(failing, repository, "--of-numbers", "--collect-only", "-q")
    assert "tests/test_settings.py" in said and "test_deployment" not in said
    assert "tests/test_deployment.py" in run_project(failing, repository, "--collect-only", "-q")


def test_what_a_parent_ignores_is_told_and_not_handed_on(failing: Path, repository: Path) -> None:
    (failing / "test_some.py").write_text(
        "import signal, subprocess, sys\n"
        "def test_interrupt():\n"
        "    with subprocess.Popen([sys.executable, '-c', 'import time; print(1, flush=True); time.sleep(60)'],"
        " stdout=-1, stderr=-1) as process:\n"
        "        process.stdout.read(1)\n        process.send_signal(signal.SIGINT)\n"
        "    assert process.returncode == -signal.SIGINT\n"
    )
    said = run_project(failing, repository, ignored=frozenset({signal.SIGINT}))
    assert "1 passed" in said
    assert "signals that the parent process ignored: SIGINT" in said


def test_the_facts_are_those_of_this_process() -> None:
    processor, numbers, signals = machine_facts.facts()
    assert processor.startswith("processor: ") and processor[11] != ";"
    assert f"{os.cpu_count()} cores" in processor
    assert instruction_sets.current() in numbers
    assert "None" not in numbers and signals.startswith("signals ")
