"""Is every block of code in the documentation executed, or, where that cannot be, at least one that could be?

Some pages have tests of their own. Of the others the blocks of Python run here, JSON is read by what reads such files,
and of each command of a shell CHECKS says what is done with it.
"""

from __future__ import annotations

import importlib
import json
import re
import tomllib
from collections.abc import Callable
from pathlib import Path

import pytest

from app import cli
from pmpnbp.scene.prior import load_prior
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.scene.urdf import load_model
from tests.shown_code import ROOT, SAMPLES, blocks, commands, with_samples

PAGES = sorted([ROOT / "README.md", ROOT / "sample_data" / "README.md", *(ROOT / "docs").rglob("*.md")])
BLOCKS = [(page.relative_to(ROOT).as_posix(), *block) for page in PAGES for block in blocks(page)]

# All blocks of these pages are executed there.
ELSEWHERE = {
    "docs/batch.md": "tests/batch/test_batch_page.py",
    "docs/python.md": "tests/library/test_python_page.py",
    "docs/rest.md": "tests/app/test_rest_examples.py",
}
# Of these all are words to Sphinx, which test_site.py has read.
OF_THE_SITE = ("docs/site/examples.md", "docs/site/reference.md")
# Blocks without a language are nothing that could be executed. By page and beginning.
NO_CODE = {
    ("docs/benchmarks.md", "Kernels, part poses a second"): "what `pmpnbp benchmark` printed",
    ("docs/conventions.md", "x, y, z, rotation about X"): "an order of coordinates",
    ("docs/conventions.md", '{"schema": "pmpnbp/estimate-2"'): "a form with gaps; its names are looked up below",
}
# Commands of ours that take minutes, or serve until they are stopped: that they would begin is all that is looked at.
BEGUN_ELSEWHERE = {
    "serve": "tests/app/test_serve.py",
    "calibrate": "tests/calibrate",
    "reproduce": "tests/reproduce",
    "batch": "tests/batch",
}


def pmpnbp(words: list[str]) -> None:
    """Runs, where it ends within seconds."""
    if words[1] in BEGUN_ELSEWHERE:
        assert (ROOT / BEGUN_ELSEWHERE[words[1]]).exists()
        cli._parse(words[1:])
    else:
        assert cli.main(words[1:]) == 0


def make(words: list[str]) -> None:
    """The gate is `make test` itself; that there are such targets."""
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert set(words[1:]) <= set(targets)


def pip(words: list[str]) -> None:
    """Installs from afar; that there are such extras. What they are is installed by the gate."""
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    assert words[1] == "install"
    for word in words[2:]:
        assert set(re.findall(r"\w+", word.removeprefix(".").removeprefix("pmpnbp"))) <= set(extras)


def python(words: list[str]) -> None:
    """Attacks a server for minutes, which tests/app/test_attacks.py does; that there is such a module, with a help."""
    assert words[1] == "-m"
    with pytest.raises(SystemExit, match="0"):
        importlib.import_module(f"{words[2]}.__main__").main(["--help"])


def needs_what_is_not_here(words: list[str]) -> None:
    """Docker and several machines. tests/test_deployment.py reads the Dockerfile and compose.yaml, and
    tests/reproduce has a scheduler and its workers on this machine."""


CHECKS: dict[str, Callable[[list[str]], None]] = {
    "pmpnbp": pmpnbp,
    ".venv/bin/pmpnbp": pmpnbp,
    "make": make,
    "pip": pip,
    "python": python,
    "docker": needs_what_is_not_here,
    "dask": needs_what_is_not_here,
}


def of_language(language: str) -> list[tuple[str, str]]:
    """Page and text of the blocks that are executed here."""
    return [(page, text) for page, named, text in BLOCKS if named == language and page not in ELSEWHERE]


def test_every_block_is_accounted_for() -> None:
    for page, language, text in BLOCKS:
        known = page in ELSEWHERE or language in ("sh", "python", "json")
        known = known or (page in OF_THE_SITE and language.startswith("{"))
        assert known or any(page == of and text.startswith(start) for of, start in NO_CODE), f"{page}: {text[:60]}"
    for page, test in ELSEWHERE.items():
        assert f'"{Path(page).name}"' in (ROOT / test).read_text()
    assert all(any(page == of and text.startswith(start) for of, _, text in BLOCKS) for page, start in NO_CODE)


def test_commands(project: Path) -> None:
    for page, text in of_language("sh"):
        for words in commands(text):
            assert words[0] in CHECKS, f"{page}: of {words[0]} nobody says whether it runs"
            CHECKS[words[0]](words)
    result = json.loads((project / "result.json").read_text())
    (form,) = [text for _, _, text in BLOCKS if text.startswith('{"schema": "pmpnbp/estimate-2"')]
    assert result["fit"] == "good"
    missing = {name for name in re.findall(r'"(\w+)":', form) if f'"{name}":' not in json.dumps(result)}
    assert missing == {"value", "prior_std"}  # of nuisances, of which this run has none


@pytest.mark.parametrize(("page", "text"), of_language("python"))
def test_python(page: str, text: str, project: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with_samples(project)
    exec(compile(text, page, "exec"), {})
    assert "Found" in capsys.readouterr().out


@pytest.mark.parametrize(("page", "text"), of_language("json"))
def test_json(page: str, text: str) -> None:
    members = json.loads(text)
    if "kind" in members:
        load_prior(members, load_model(SAMPLES["cabinet.urdf"]))
    else:
        assert load_scan(SAMPLES["depth.png"], members).camera.width == members["width"]


@pytest.mark.parametrize("line", ["make tea", "pip install '.[tea]'", "pmpnbp serve --tea", "python -m tests.tea URL"])
def test_a_command_that_would_not_run_is_seen(line: str) -> None:
    (words,) = commands(line)
    with pytest.raises((AssertionError, SystemExit, ModuleNotFoundError)):
        CHECKS[words[0]](words)
