"""Does the painter take one problem's shapes for another's, and is what views have in common made once?"""

from __future__ import annotations

import gc
import threading
import time
import weakref
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from app.viewer import scenery as scenery_module
from app.viewer.painter import STAGES, Painter
from app.viewer.scan_points import scan_points
from app.viewer.scenery import Scenery, Shared
from app.viewer.view import View
from pmpnbp.geometry.camera import Camera
from pmpnbp.scene.observation import Scan
from tests.app import small_sessions as small
from tests.app.open_views import drawn, looking, painter, state


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
    own = Painter(view, source, lambda id: source, Scenery())
    try:
        for iteration, scan in ((2, first), (3, later), (0, first)):
            (drawn,) = own._stage(source, source.archive.read(iteration), 1).scans
            seen = scan_points(served.app.state.store.load_scan(scan))
            np.testing.assert_array_equal(drawn.points, seen.points)
    finally:
        view.close()
        own.close()


@pytest.mark.parametrize("nearer", [0, 1, 2000])
def test_a_wall_seen_head_on_has_points(nearer: int) -> None:
    """All of its depths are one, and what stands before it is hardly anything of the picture."""
    depth = np.full((480, 640), 2.0, dtype=np.float32)
    depth.ravel()[150_000 : 150_000 + nearer] = 1.8
    cloud = scan_points(Scan(Camera(640, 480, 525.0, 525.0, 319.5, 239.5), depth))
    assert len(cloud.points) == cloud.measured.size
    assert np.isfinite(cloud.shade).all() and np.ptp(cloud.shade) < 0.6


def test_a_problem_lives_as_long_as_its_shapes_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shapes are found by their problem's id, which another problem may have once the first is gone."""
    monkeypatch.setattr(scenery_module, "stage", lambda problem, scans: Staged(problem))
    source: Any = SimpleNamespace(
        id="session", events=SimpleNamespace(listen=lambda wake: lambda: None), scan=lambda view: ("", None)
    )
    view = View("session", "view", None)
    own = Painter(view, source, lambda id: source, Scenery())
    try:
        problems = []
        for name in "abcd":
            snapshot: Any = SimpleNamespace(problem=Named(name))
            problems.append(weakref.ref(snapshot.problem))
            stage: Any = own._stage(source, snapshot, 0)
            assert stage.problem.name == name
            del snapshot, stage
            gc.collect()
        assert [problem() is not None for problem in problems] == [False] + [True] * STAGES
    finally:
        view.close()
        own.close()


class Staged:
    """Stands for a stage."""

    def __init__(self, problem: Any) -> None:
        self.problem = problem


def test_what_views_share_is_made_once_and_goes_with_the_last_who_holds_it() -> None:
    shared: Shared[Named] = Shared()
    made = []

    def make() -> Named:
        made.append(1)
        time.sleep(0.05)  # long enough for the others to ask for it meanwhile
        return Named("a")

    held: list[Named] = []
    threads = [threading.Thread(target=lambda: held.append(shared.get("key", make))) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(made) == 1 and len(held) == 8 and len({id(one) for one in held}) == 1
    held.clear()
    gc.collect()
    shared.get("key", make)
    assert len(made) == 2


def test_a_failure_is_told_to_all_and_kept_from_none() -> None:
    shared: Shared[Named] = Shared()

    def fail() -> Named:
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        shared.get("key", fail)
    assert shared.get("key", lambda: Named("a")).name == "a"


def test_two_views_of_one_state_draw_the_same_frame(serve: Callable[..., Any]) -> None:
    served = serve()
    path = small.after(served.client, 2)
    one, other, apart = (f"{path}/views/{name}" for name in ("one", "other", "apart"))
    state(served, other, camera={"position": [1, 1, 1], "look_at": [0, 0, 0], "up": [0, 0, 1]})
    state(served, apart, confidence=0.5)
    with looking(served, one), looking(served, other), looking(served, apart):
        for view in (one, other, apart):
            drawn(served, view, 2)
        first, second, third = (painter(served, view) for view in (one, other, apart))
        assert first._scene is second._scene and first._scene is not third._scene
        assert list(first._stages.values()) == list(third._stages.values())
