"""A folder in which what the documentation shows is executed."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture
def project(repository: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder like the project's, for the files that are written; the working folder."""
    made = tmp_path / "project"
    made.mkdir()
    (made / "sample_data").symlink_to(repository / "sample_data")
    monkeypatch.chdir(made)
    return made
