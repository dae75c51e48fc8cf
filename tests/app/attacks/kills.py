"""7: kills in the middle of everything that changes the store; `python -m tests.app.killing` makes more of them."""

from __future__ import annotations

import tempfile
from pathlib import Path

from tests.app.attacks.outcome import Outcome
from tests.app.attacks.target import Target
from tests.app.killing import kill_often

KILLS = 20


def attack(target: Target, outcome: Outcome) -> None:
    """On servers of our own: the target is not ours to kill."""
    del target
    outcome.did.append(f"killed a server of its own {KILLS} times while it was uploaded to, iterated and deleted from")
    lines: list[str] = []
    with tempfile.TemporaryDirectory(prefix="killed-") as folder:
        outcome.broken += kill_often(Path(folder), KILLS, seed=7, say=lines.append)
    outcome.happened += lines[-1:]
