"""A pytest plugin: which facts of the machine may a failure come from?

They stand in the header and, where tests fail, in the summary. With `--explain-failures`, as `make test` has it, the
failing tests are run again, one after another, under either instruction set: that tells whether the processor decides.
"""

from __future__ import annotations

import os
import platform
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests import instruction_sets
from tests.instruction_sets import BASELINE, OWN

# What tests send, or wait for. A parent that ignores them, as a script's shell does with SIGINT for what it starts in
# the background, would have every process that a test starts ignore them too. SIGHUP is left: `nohup` asks for that.
_NEEDED = {signal.SIGINT: signal.default_int_handler, signal.SIGTERM: signal.SIG_DFL, signal.SIGCHLD: signal.SIG_DFL}
_IGNORED = sorted(
    number.name
    for number in signal.valid_signals() - {signal.SIGPIPE, signal.SIGXFSZ}  # which Python itself ignores
    if isinstance(number, signal.Signals) and signal.getsignal(number) is signal.SIG_IGN
)
_LOAD = os.getloadavg()[0]
_AT_MOST = 20


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--explain-failures", action="store_true", help="run failing tests again under either set")
    parser.addoption("--of-numbers", action="store_true", help="leave out the tests that compute nothing")


@pytest.hookimpl(tryfirst=True)
def pytest_configure() -> None:
    for number, disposition in _NEEDED.items():
        if signal.getsignal(number) is signal.SIG_IGN:
            signal.signal(number, disposition)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    left_out = {config.rootpath / path for path in instruction_sets.WITHOUT_NUMBERS}
    return True if config.getoption("--of-numbers") and collection_path in left_out else None


def pytest_sessionfinish(session: pytest.Session) -> None:
    # `make test` with a selection of tests may have none of numbers
    if session.config.getoption("--of-numbers") and session.exitstatus == pytest.ExitCode.NO_TESTS_COLLECTED:
        session.exitstatus = pytest.ExitCode.OK


@pytest.hookimpl(optionalhook=True)  # of xdist, which a single test can do without
def pytest_xdist_auto_num_workers(config: pytest.Config) -> int:
    """One more than there are cores, at most five: a sixth of their time tests wait for browsers and servers. Those of
    numbers wait for nothing, and another worker imports everything once more."""
    return min(usable_cores() + (not config.getoption("--of-numbers")), 5)


def pytest_report_header() -> list[str]:
    return facts()


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def facts() -> list[str]:
    """The machine, a line for each kind of fact."""
    simd = " ".join(instruction_sets.numpy_features()) or "its minimum"
    return [
        f"processor: {_processor()}; {usable_cores()} of {os.cpu_count()} cores may be used; load {_LOAD:.1f}",
        f"instruction set: {instruction_sets.current()}; NumPy uses {simd}, "
        f"numba {instruction_sets.numba_processor()}, OpenBLAS {instruction_sets.blas_core()}",
        f"signals that the parent process ignored: {' '.join(_IGNORED) or 'none'}",
    ]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    reports = [*terminalreporter.getreports("failed"), *terminalreporter.getreports("error")]
    failing = list(dict.fromkeys(report.nodeid for report in reports if "::" in report.nodeid))
    if not failing:
        return
    terminalreporter.section("the machine that these failures come from")
    for line in facts():
        terminalreporter.write_line(line)
    if config.getoption("--explain-failures"):
        for line in explained(failing, config.rootpath):
            terminalreporter.write_line(line)


def explained(failing: list[str], root: Path) -> list[str]:
    """What each of these tests does when it is run again, and what that says."""
    passing = {name: _passing(failing[:_AT_MOST], root, name) for name in (OWN, BASELINE)}
    lines = ["run again one after another, nothing beside them:"]
    for test in failing[:_AT_MOST]:
        told = [
            f"{'passes' if test in passed else 'fails'} under {name}"
            for name, passed in passing.items()
            if passed is not None
        ]
        now = passing[instruction_sets.current()]
        other = passing[BASELINE if instruction_sets.current() == OWN else OWN]
        if now is not None and test in now:
            verdict = "other tests, the load or chance decide"
        elif other is not None and test in other:
            verdict = "the instruction set decides"
        else:
            verdict = "the instruction set does not decide"
        lines.append(f"  {test}: {', '.join(told)}: {verdict}")
    return lines


def _passing(tests: list[str], root: Path, name: str) -> set[str] | None:
    """Those of these tests that pass in a process of their own under a set; None where the set is not to be had."""
    environment = instruction_sets.environment(name)
    if environment is None:
        return None
    command = [sys.executable, "-m", "pytest", "-n", "0", "-qq", "-rp", "-p", "no:cacheprovider", "--tb=no", *tests]
    done = subprocess.run(command, cwd=root, env=environment, capture_output=True, text=True)
    told = (line.removeprefix("PASSED ") for line in done.stdout.splitlines() if line.startswith("PASSED "))
    return set(told)


def _processor() -> str:
    if Path("/proc/cpuinfo").exists():
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
