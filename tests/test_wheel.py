"""Is the wheel whole? Built, installed into an environment of its own, and called in a folder that is no checkout.

What the project needs is not installed again: the environment reads the packages of the one that the tests run in. Nor
are kernels compiled again, where that has been done: they are valid for a source file of the same time and size.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import sysconfig
import time
import venv
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx
import numba
import pytest
from numba.core.caching import _CacheLocator

import pmpnbp.potentials.kernels  # noqa: F401  says where compiled kernels are

PACKAGES = ("app", "pmpnbp", "benchmarks", "sample_data")
BUILD = "import sys; from setuptools import build_meta; build_meta.build_wheel(sys.argv[1])"

Run = Callable[..., subprocess.CompletedProcess[str]]


@pytest.fixture(scope="module")
def wheel(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Built in a copy, as building leaves folders behind."""
    source, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in ("pyproject.toml", "README.md"):
        shutil.copyfile(repository / name, source / name)
    for name in (*PACKAGES, "static"):
        shutil.copytree(repository / name, source / name, symlinks=True, ignore=shutil.ignore_patterns("__pycache__"))
    subprocess.run([sys.executable, "-c", BUILD, str(out)], cwd=source, check=True, capture_output=True)
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def programs(wheel: Path, repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder with `python` and `pmpnbp` of an environment that the wheel is installed into."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder)
    places = {name: str(folder) for name in ("base", "platbase", "installed_base", "installed_platbase")}
    site = Path(sysconfig.get_path("purelib", "venv", vars=places))
    install = [sys.executable, "-m", "pip", "--python", str(folder / "bin" / "python"), "install", "--quiet"]
    offline = ["--no-deps", "--no-index", "--no-compile", "--disable-pip-version-check", str(wheel)]
    subprocess.run([*install, *offline], check=True)
    # a line of this file is a folder to look in; what such a folder says of further ones is not read
    (site / "needed.pth").write_text(sysconfig.get_path("purelib") + "\n")
    compiled = Path(numba.config.CACHE_DIR)
    kept = site / "pmpnbp" / "potentials" / "kernels" / "__pycache__" / compiled.name
    for source in (path for package in PACKAGES for path in (repository / package).rglob("*.py")):
        installed = site / source.relative_to(repository)
        os.utime(installed, ns=(source.stat().st_atime_ns, source.stat().st_mtime_ns))
        theirs, ours = (_CacheLocator.get_suitable_cache_subpath(str(path)) for path in (source, installed))
        if (compiled / theirs).is_dir():
            shutil.copytree(compiled / theirs, kept / ours, dirs_exist_ok=True)
        for kernel in (source.parent / "__pycache__").glob(f"{source.stem}.*.nb?"):
            (installed.parent / "__pycache__").mkdir(exist_ok=True)
            shutil.copyfile(kernel, installed.parent / "__pycache__" / kernel.name)
    return folder / "bin"


@pytest.fixture
def surroundings(tmp_path: Path) -> dict[str, Any]:
    """Where programs run: a folder with names of ours in it that are not ours."""
    (tmp_path / "app.py").write_text("raise SystemExit('this is another app')\n")
    (tmp_path / "benchmarks").mkdir()
    ours = ("PYTHON", "PMPNBP_", "NUMBA_CACHE_DIR")
    environment = {name: value for name, value in os.environ.items() if not name.startswith(ours)}
    return {"cwd": tmp_path, "env": environment, "text": True}


@pytest.fixture
def run(programs: Path, surroundings: dict[str, Any]) -> Run:
    """A function that runs a program of the environment to its end."""
    return lambda name, *words: subprocess.run([str(programs / name), *words], capture_output=True, **surroundings)


def served(programs: Path, surroundings: dict[str, Any], *words: str) -> tuple[subprocess.Popen[str], str]:
    """A server that was started with `words`, and its link."""
    process = subprocess.Popen([str(programs / "pmpnbp"), *words], stdout=subprocess.PIPE, **surroundings)
    assert process.stdout is not None
    return process, process.stdout.readline().strip()


def stopped(process: subprocess.Popen[str]) -> int:
    process.send_signal(signal.SIGTERM)
    assert process.stdout is not None
    process.stdout.close()
    return process.wait()


def test_it_holds_what_is_needed_and_nothing_else(wheel: Path, repository: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    assert {name.split("/")[0] for name in names if ".dist-info/" not in name} == set(PACKAGES)
    for package in PACKAGES:
        sources = {path.relative_to(repository).as_posix() for path in (repository / package).rglob("*.py")}
        assert sources <= names
    for folder, inside in (("static", "app/static"), ("sample_data", "sample_data")):
        data = [
            path for path in (repository / folder).rglob("*.*") if path.suffix not in (".py", ".pyc", ".md", ".nbi")
        ]
        assert len(data) > 30
        assert {f"{inside}/{path.relative_to(repository / folder).as_posix()}" for path in data} <= names
    assert {"pmpnbp/py.typed", "app/py.typed"} <= names
    assert wheel.stat().st_size < 4_000_000


@pytest.mark.parametrize("words", [("pmpnbp",), ("python", "-m", "pmpnbp")])
def test_it_runs_in_a_folder_with_an_app_of_its_own(run: Run, words: tuple[str, ...]) -> None:
    done = run(*words, "--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, "pmpnbp 0.1.0\n", "")


def test_an_estimate_is_made_and_looked_at(
    run: Run, programs: Path, surroundings: dict[str, Any], repository: Path
) -> None:
    cabinet = repository / "sample_data" / "cabinet"
    words = [
        "estimate",
        cabinet / "cabinet.urdf",
        cabinet / "open" / "depth.png",
        "--camera",
        cabinet / "open" / "camera.json",
    ]
    quick = ["--particles", "40", "--iterations", "2", "--config", "search_proposals=300", "--recording", "run.sqlite"]
    done = run("pmpnbp", *map(str, words), *quick)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["iteration"] == 2
    process, link = served(programs, surroundings, "view", "run.sqlite", "--no-browser")
    try:
        page = httpx.get(link)
        assert page.status_code == 200 and "<title>" in page.text
    finally:
        assert stopped(process) == 0


USER_CODE = """\
from pathlib import Path

import pmpnbp

model: pmpnbp.Model = pmpnbp.load_model("cabinet.urdf")
scan = pmpnbp.load_scan(Path("depth.png"), "camera.json")
found: pmpnbp.Estimate = pmpnbp.estimate(model, scan, roi=[0, 0, 0, 1, 1, 1], particles=400, tolerance_end=0.01)
slide: float = found.joints["slide1"].position
place: list[float] = found.links["drawer1"].pose.tolist()
verdict: str = found.verdict
with pmpnbp.Session(model, [scan, "other.npy"], camera=["a.json", {"width": 3}], prior=Path("prior.json")) as session:
    for iteration in session:
        shape: tuple[int, ...] = iteration.particles("drawer1").shape
    session.change(tolerance_end=0.02)
    session.add_scan(scan, mode="replaces")
try:
    newest: pmpnbp.Iteration = pmpnbp.open_recording("recording.sqlite")[-1]
except pmpnbp.PmpnbpError as error:
    print(error)
wrong: int = found.verdict
"""


def test_three_lines_of_python_give_an_estimate(run: Run, repository: Path) -> None:
    cabinet = repository / "sample_data" / "cabinet"
    scan = f"{str(cabinet / 'open' / 'depth.png')!r}, camera={str(cabinet / 'open' / 'camera.json')!r}"
    lines = (
        "import pmpnbp",
        f"found = pmpnbp.estimate({str(cabinet / 'cabinet.urdf')!r}, {scan}, particles=40, search_proposals=300)",
        "print(found.verdict, list(found.joints))",
    )
    done = run("python", "-c", "\n".join(lines))
    assert done.returncode == 0, done.stderr
    assert done.stdout.endswith("['slide1', 'slide2', 'slide3']\n")


def test_types_of_the_library_hold_in_code_that_uses_it(run: Run, surroundings: dict[str, Any]) -> None:
    """Of strictly checked code the one wrong line is found, and nothing else, in its own and in ours."""
    (surroundings["cwd"] / "user_code.py").write_text(USER_CODE)
    done = run("python", "-m", "mypy", "--strict", "user_code.py")
    found = done.stdout.splitlines()
    assert len(found) == 2 and found[0].startswith(f"user_code.py:{len(USER_CODE.splitlines())}: error: "), done.stdout
    assert '(expression has type "str", variable has type "int")' in found[0]


def test_the_server_has_its_pages_its_samples_and_the_sample_session(
    programs: Path, surroundings: dict[str, Any]
) -> None:
    words = ("serve", "--demo", "--port", "0", "--data-dir", "data")
    process, link = served(programs, surroundings, *words)
    try:
        with httpx.Client(base_url=link, timeout=60.0) as client:
            files = re.findall(r'(?:src|href)="(/static/[^"]+)"', client.get("/").text)
            assert files and all(client.get(file).status_code == 200 for file in files)
            assert len(client.get("/api/v1/samples").json()) == 9
            while not (sessions := client.get("/api/v1/sessions").json()):
                assert process.poll() is None
                time.sleep(0.1)
            assert sessions[0]["name"] == "Sample: a cabinet with an open drawer"
    finally:
        assert stopped(process) == 0


def test_an_experiment_is_made_again(run: Run, surroundings: dict[str, Any]) -> None:
    words = ("reproduce", "push", "--runs", "1", "--iterations", "1", "--particles", "20", "--out", "found")
    done = run("pmpnbp", *words)
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{Path('found/report.md')}\n"
    assert (surroundings["cwd"] / "found" / "report.md").is_file()


def test_a_belief_is_calibrated(run: Run, surroundings: dict[str, Any], repository: Path) -> None:
    model = str(repository / "sample_data" / "door" / "door.urdf")
    done = run("pmpnbp", "calibrate", model, "--runs", "1", "--iterations", "1", "--particles", "20")
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{Path('out/calibrate_door/report.md')}\n"
    assert (surroundings["cwd"] / "out" / "calibrate_door" / "report.md").is_file()


def test_an_experiment_without_its_packages_is_one_sentence(run: Run) -> None:
    hidden = (
        "import sys; sys.modules['matplotlib'] = None; from app.cli import main; sys.exit(main(['reproduce', 'push']))"
    )
    done = run("python", "-P", "-c", hidden)
    assert done.returncode == 2
    assert done.stderr == "pmpnbp reproduce: figures need matplotlib: pip install 'pmpnbp[reproduce]'\n"


def test_the_benchmark_is_there(run: Run) -> None:
    """Its figures take minutes: here it is only asked to write them where it cannot."""
    done = run("pmpnbp", "benchmark", "--out", "nowhere/figures.json")
    assert done.returncode == 2
    assert done.stderr.startswith("pmpnbp benchmark: --out 'nowhere/figures.json' cannot be written")
