"""Is the documentation a site that is whole: no link that leads nowhere, nothing from a network, every public name?"""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import pmpnbp
from tests.shown_code import ROOT, commands


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As `make docs` builds it, elsewhere."""
    made = tmp_path_factory.mktemp("site")
    recipe = re.search(r"^\t\$\(BIN\)/python (-m sphinx .*?[^\\])$", (ROOT / "Makefile").read_text(), re.M | re.S)
    assert recipe is not None
    (words,) = commands(recipe[1])
    places = {"build/docs": str(made / "docs"), "build/docs-read": str(made / "read")}
    command = [sys.executable, *(places.get(word, word) for word in words)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    return made / "docs"


@pytest.fixture(scope="module")
def docstrings() -> ModuleType:
    """What rewrites docstrings for Sphinx."""
    spec = importlib.util.spec_from_file_location("house_docstrings", ROOT / "docs" / "site" / "house_docstrings.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_page_is_there(site: Path) -> None:
    for page in [*(ROOT / "docs").rglob("*.md"), ROOT / "CHANGELOG.md", ROOT / "sample_data" / "README.md"]:
        assert (site / page.relative_to(ROOT)).with_suffix(".html").is_file()
    assert (site / "index.html").is_file()


def test_every_public_name_is_described(site: Path) -> None:
    page = (site / "docs" / "site" / "reference.html").read_text(encoding="utf-8")
    described = set(re.findall(r'<dt class="sig sig-object py" id="pmpnbp\.(?:errors\.)?(\w+)">', page))
    assert set(pmpnbp.__all__) <= described
    for told in ("ScanSource | Sequence[ScanSource]", "x0 y0 z0 x1 y1 z1 of a box"):  # types as written, and units
        assert told in re.sub(r"<[^>]+>", "", page)
    assert "max_std : " not in page


def test_every_example_is_shown(site: Path) -> None:
    page = (site / "docs" / "site" / "examples.html").read_text(encoding="utf-8")
    for path in (ROOT / "docs" / "examples").glob("*.py"):
        assert f'id="{path.stem.replace("_", "-")}"' in page
        assert f"docs/examples/{path.name}" in page


def test_nothing_comes_from_a_network(site: Path) -> None:
    for page in site.rglob("*.html"):
        for tag in re.findall(r"<(?:script|link|img|iframe|source)\b[^>]*>", page.read_text(encoding="utf-8")):
            assert not re.search(r"""(?:src|href|srcset)\s*=\s*["'](?:https?:)?//""", tag), f"{page.name}: {tag}"
    for style in site.rglob("*.css"):
        assert not re.search(r"""(?:@import|url\()\s*["']?(?:https?:)?//""", style.read_text(encoding="utf-8"))


def test_the_words_of_the_house_become_lists(docstrings: ModuleType) -> None:
    lines = ["Where is it?", "", "    print(1)", "", "a, b : metres; c : a name,", "    or None", "d : (7,) x y z"]
    told = docstrings.in_words_of_sphinx(lines)
    assert told[:6] == ["Where is it?", "", ".. code-block:: python", "", "    print(1)", ""]
    fields = [":param a: metres", ":param b: metres", ":param c: a name, or None", ":param d: (7,) x y z"]
    assert told[6:10] == fields
    assert docstrings.entries(["It says: where", "it is, a : b"]) is None
    values = docstrings.in_words_of_sphinx(["One.", "", "a : metres"], {"a": "float", "b": "str", "_c": "int"})
    assert [line for line in values if line.strip()] == [
        "One.", ".. attribute:: a", "   :type: float", "   metres", ".. attribute:: b", "   :type: str"
    ]  # fmt: skip
