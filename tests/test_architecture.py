"""Does the house stand as drawn? Imports only go downward, kernels know nothing of ours, files stay small.

The rules are functions of plain text and run on rule-breaking text first: a rule that cannot fail guards nothing.
"""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
LINES = 350

# From the ground up; a module imports from its own floor and those before it.
FLOORS = (
    "pmpnbp.errors",
    "pmpnbp.version",
    "pmpnbp.json_text",
    "pmpnbp.names",
    "pmpnbp.files",
    "pmpnbp.importing",
    "pmpnbp.runs",
    "pmpnbp.settings",
    "pmpnbp.geometry",
    "pmpnbp.scene",
    "pmpnbp.potentials",
    "pmpnbp.inference",
    "pmpnbp.readout",
    "pmpnbp.pictures",
    "pmpnbp.recording",
    "pmpnbp.library",
    "pmpnbp.batch",
    "pmpnbp.client",
    "app",  # its single files: what all folders of the server stand on
    "app.store",
    "app.uploads",
    "app.sessions",
    "app.viewer",
    "app.routes",
    "app.server",
    "app.commands",
    "app.cli",
    "pmpnbp.__main__",
)
KERNELS = "pmpnbp.potentials.kernels"
WEB = {"app", "viser", "fastapi", "starlette", "uvicorn", "websockets"}


def within(module: str, package: str) -> bool:
    """Whether `module` is `package` or lies in it."""
    return module == package or module.startswith(package + ".")


def floor(module: str) -> int | None:
    """The floor's place in FLOORS; None for the bare package and for everything that is not ours."""
    return max((level for level, name in enumerate(FLOORS) if within(module, name)), default=None)


def imports(source: str) -> list[str]:
    """Dotted names that `source` imports anywhere in it, `from a import b` as a.b; a relative one starts with a dot."""
    found: list[str] = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            stem = "." * node.level + (node.module or "")
            found += [f"{stem}.{alias.name}" for alias in node.names]
    return found


def objections(module: str, source: str) -> list[str]:
    """What the imports of `module` break of the rules of the house."""
    found: list[str] = []
    for name in imports(source):
        ours = floor(module)
        theirs = floor(name)
        if name.startswith("."):
            found.append(f"{module} imports {name}: imports are absolute, so that floors can be read off them")
        if ours is not None and theirs is not None and theirs > ours:
            found.append(f"{module} imports {name}, which is on a floor above it")
        if within(module, KERNELS) and within(name, "pmpnbp") and not within(name, KERNELS):
            found.append(f"{module} imports {name}: kernels import nothing of ours")
        if within(module, "pmpnbp") and name.split(".")[0] in WEB:
            found.append(f"{module} imports {name}: pmpnbp knows no web and no screen")
        if within(module, "pmpnbp") and within(name, "httpx") and not within(module, "pmpnbp.client"):
            found.append(f"{module} imports {name}: of pmpnbp only pmpnbp.client does")
        if within(name, "yourdfpy") and module != "pmpnbp.scene.urdf":
            found.append(f"{module} imports {name}: only pmpnbp.scene.urdf does")
    return found


def modules() -> Iterator[tuple[str, Path]]:
    """Dotted name and file of every module of pmpnbp and app."""
    for package in ("pmpnbp", "app"):
        for path in sorted((ROOT / package).rglob("*.py")):
            parts = path.relative_to(ROOT).with_suffix("").parts
            yield ".".join(parts[:-1] if parts[-1] == "__init__" else parts), path


MODULES = dict(modules())


@pytest.mark.parametrize(
    ("module", "source", "objection"),
    [
        ("pmpnbp.geometry.poses", "import pmpnbp.scene.urdf", "floor above"),
        ("pmpnbp.scene.observe", "def f():\n    from pmpnbp.inference import belief", "floor above"),
        ("pmpnbp.scene.observe", "from pmpnbp import readout", "floor above"),
        ("pmpnbp.errors", "from pmpnbp.geometry import poses", "floor above"),
        ("pmpnbp.scene.observe", "from .articulated_object import Part", "absolute"),
        (f"{KERNELS}.rasteriser", "from pmpnbp.geometry.poses import multiply", "nothing of ours"),
        (f"{KERNELS}.rasteriser", "from pmpnbp.errors import PmpnbpError", "nothing of ours"),
        ("pmpnbp.readout.estimate", "import viser", "no web"),
        ("pmpnbp.inference.run", "from fastapi.responses import JSONResponse", "no web"),
        ("pmpnbp.recording", "import app.cli", "no web"),
        ("pmpnbp.__main__", "from app.cli import main", "no web"),
        ("pmpnbp.client.session", "from app.schemas import Until", "no web"),
        ("pmpnbp.library.estimate", "import httpx", "only pmpnbp.client"),
        ("app.problems", "from app.store.atomic_files import read_json", "floor above"),
        ("app.store.store", "from app.sessions.session import Session", "floor above"),
        ("pmpnbp.scene.meshes", "from yourdfpy import URDF", "only pmpnbp.scene.urdf"),
        ("app.cli", "import yourdfpy", "only pmpnbp.scene.urdf"),
    ],
)
def test_a_breach_is_seen(module: str, source: str, objection: str) -> None:
    assert any(objection in found for found in objections(module, source))


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("pmpnbp.inference.run", "import numpy\nfrom pmpnbp.potentials.kernels import rasteriser"),
        ("pmpnbp.scene.urdf", "from yourdfpy import URDF\nfrom pmpnbp.errors import ModelError"),
        (f"{KERNELS}.splatting", f"import numba\nfrom {KERNELS}.reference import score"),
        ("pmpnbp.client.calls", "import httpx\nfrom pmpnbp.library.estimate import Estimate"),
        ("app.server", "import fastapi\nfrom pmpnbp import recording"),
    ],
)
def test_a_proper_import_passes(module: str, source: str) -> None:
    assert objections(module, source) == []


@pytest.mark.parametrize("module", MODULES)
def test_imports_go_downward(module: str) -> None:
    assert objections(module, MODULES[module].read_text(encoding="utf-8")) == []


def test_every_module_stands_on_a_floor() -> None:
    assert [module for module in MODULES if floor(module) is None and module != "pmpnbp"] == []


@pytest.mark.parametrize("module", MODULES)
def test_a_module_says_what_it_is_for(module: str) -> None:
    source = MODULES[module].read_text(encoding="utf-8")
    assert not source.strip() or ast.get_docstring(ast.parse(source)), f"{module} has no docstring"


@pytest.mark.parametrize("module", MODULES)
def test_files_stay_small(module: str) -> None:
    count = len(MODULES[module].read_text(encoding="utf-8").splitlines())
    assert count <= LINES, f"{module} has {count} lines, more than {LINES}: it has two jobs"


def test_nothing_is_imported_that_is_not_declared() -> None:
    """A package that only comes along with another may go when that one changes."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    declared = {canonical(re.split(r"[^\w.-]", entry)[0]) for entry in project["dependencies"]}
    distributions = packages_distributions()
    undeclared = set()
    for module, path in MODULES.items():
        for name in imports(path.read_text(encoding="utf-8")):
            top = name.split(".")[0]
            if not top or top in sys.stdlib_module_names or top in ("pmpnbp", "app"):
                continue
            if not declared & {canonical(owner) for owner in distributions.get(top, [top])}:
                undeclared.add(f"{module} imports {top}")
    assert not undeclared


def canonical(distribution: str) -> str:
    """A distribution's name as the packaging rules compare it."""
    return re.sub(r"[-_.]+", "-", distribution).lower()


def test_every_declared_package_is_constrained() -> None:
    """Without its exact version a fresh environment is not the one that was tested."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    wanted = project["dependencies"] + project["optional-dependencies"]["test"]
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = {canonical(line.split("==")[0]) for line in lines if "==" in line}
    assert {canonical(re.split(r"[^\w.-]", entry)[0]) for entry in wanted} <= pinned
