"""Does the painter take one problem's shapes for another's?"""

from __future__ import annotations

import gc
import weakref
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from app.viewer import painter as painter_module
from app.viewer.painter import STAGES, Painter
from app.viewer.scan_points import scan_points
from app.viewer.view import View
from tests.app import small_sessions as small


class Named:
    """Stands for a problem."""

    def __init__(self, name: str) -> None:
        self.name = name


def test_an_iteration_is_drawn_with_the_scans_it_was_made_with(serve: Callable[..., Any]) -> None:
    served = serve()
    path = small.after(served.client, 2)
    first, later = served.client.get(path).json()["scan_ids"][0], small.upload_scan(served.client, "second_view")
    served.client.post(f"{path}/scans", json={"scan_id": later, "mode": "replaces"}).raise_for_status()
    small.step(served.client, path)
    source = served.app.state.sessions.get(path.rpartition("/")[2])
    view = View(source.id, "view", None)
    painter = Painter(view, source, lambda id: source)
    try:
        for iteration, scan in ((2, first), (3, later), (0, first)):
            (drawn,) = painter._stage(source, source.archive.read(iteration), 1).scans
            seen = scan_points(served.app.state.store.load_scan(scan))
            np.testing.assert_array_equal(drawn.points, seen.points)
    finally:
        view.close()
        painter.close()


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
