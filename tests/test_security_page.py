"""Does docs/security.md name tests that there are, and docs/deployment.md every limit that can be set?"""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

from app.server_config import ServerConfig, environment_name

ROOT = Path(__file__).resolve().parents[1]
NO_LIMITS = {"host", "port", "data_dir", "token", "demo"}


def test_every_test_that_keeps_a_promise_is_there() -> None:
    named = re.findall(r"`((?:\w+/)?test_\w+\.py)(?:::(test_\w+))?`", (ROOT / "docs" / "security.md").read_text())
    assert len(named) > 20
    for file, test in named:
        path = ROOT / "tests" / file
        assert path.is_file(), file
        assert not test or f"def {test}(" in path.read_text(), f"{file}::{test}"


def test_every_script_that_is_named_is_there() -> None:
    modules = set(re.findall(r"python -m (tests\.[\w.]+)", (ROOT / "docs" / "security.md").read_text()))
    assert {"tests.app.attacks", "tests.app.upload_attack"} <= modules
    for module in modules:
        place = ROOT / module.replace(".", "/")
        assert place.with_suffix(".py").is_file() or (place / "__main__.py").is_file(), module


def test_every_limit_is_in_the_page_for_operators() -> None:
    page = (ROOT / "docs" / "deployment.md").read_text()
    names = [environment_name(entry.name) for entry in fields(ServerConfig) if entry.name not in NO_LIMITS]
    assert [name for name in names if f"`{name}`" not in page] == []
