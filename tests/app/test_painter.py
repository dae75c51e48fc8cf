"""Does the painter take one problem's shapes for another's?"""

from __future__ import annotations

import gc
import weakref
from types import SimpleNamespace
from typing import Any

import pytest

from app.viewer import painter as painter_module
from app.viewer.painter import STAGES, Painter
from app.viewer.view import View


class Named:
    """Stands for a problem."""

    def __init__(self, name: str) -> None:
        self.name = name


def test_a_problem_lives_as_long_as_its_shapes_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shapes are found by their problem's id, which another problem may have once the first is gone."""
    monkeypatch.setattr(painter_module, "stage", lambda problem, scans: SimpleNamespace(name=problem.name))
    source: Any = SimpleNamespace(
        id="session", events=SimpleNamespace(listen=lambda wake: lambda: None), scan=lambda view: ("", None)
    )
    view = View("session", "view", None)
    painter = Painter(view, source, lambda id: source)
    try:
        problems = []
        for name in "abcd":
            snapshot: Any = SimpleNamespace(problem=Named(name))
            problems.append(weakref.ref(snapshot.problem))
            stage: Any = painter._stage(source, snapshot, 0)
            assert stage.name == name
            del snapshot
            gc.collect()
        assert [problem() is not None for problem in problems] == [False] + [True] * STAGES
    finally:
        view.close()
        painter.close()
