"""A server that is killed loses nothing that it acknowledged. `python -m tests.app.killing` kills it more often."""

from __future__ import annotations

from pathlib import Path

from tests.app.killing import kill_often


def test_what_was_acknowledged_is_there_after_a_kill(tmp_path: Path) -> None:
    assert kill_often(tmp_path, kills=1, seed=1) == []
