"""Can region, prior and particles be taken hold of in the 3D view, with the mouse, without turning it?"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from playwright.sync_api import Page, expect

from app.viewer.gizmos import _CORNER
from tests.app import small_sessions as small
from tests.browser.conftest import PATIENCE
from tests.browser.scene_pointer import change, differing, drag, look_from_eye, place, settled
from tests.browser.session_page import opened, tab, view, wait
from tests.servers import Served

expect.set_options(timeout=PATIENCE)
# Metres: how exactly a drag of so many pixels can be foretold.
EXACT = 0.02
# Along a handle's arrow, a share of its length.
GRIP = 0.6


@pytest.fixture(scope="module")
def session(served: Served) -> str:
    """The path of a session that has made six iterations."""
    path = small.create(served.client, name="a cabinet")
    small.step(served.client, path, 6)
    return path


def test_a_corner_of_the_region_is_dragged(page: Page, served: Served, session: str) -> None:
    opened(page, served, session)
    panel = tab(page, "Layers")
    panel.get_by_role("switch", name="region of interest").check()
    box = [0.0, -0.1, -0.05, 0.8, 0.7, 0.6]
    before = look_from_eye(page, served, region=box)
    camera = view(page, served)["camera"]
    corner = np.array(box[3:])
    up = np.array([0, 0, 1.0])
    grip = corner + up * GRIP * _CORNER * 1.0
    drag(page, place(page, grip), place(page, grip + 0.15 * up))
    wait(page, lambda: view(page, served)["region"] != box)
    settled(page)
    print(view(page, served)["region"])
