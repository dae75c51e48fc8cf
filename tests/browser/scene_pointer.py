"""Where in the window is a place of the 3D scene, and when does the picture stand still?

The browser's camera is set over REST to an eye that a test chooses, so that a test can point at a place in world.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from playwright.sync_api import Page

from app.viewer.places import FIELD_OF_VIEW
from tests.browser.conftest import PATIENCE, pixels
from tests.browser.session_page import view
from tests.servers import Served

# In front of the cabinet and above it, near enough that its handles are large; metres, world.
EYE = {"position": [2.3, 0.5, 1.4], "look_at": [0.5, 0.3, 0.4], "up": [0.0, 0.0, 1.0]}
# Layers of an empty scene.
BARE = dict.fromkeys(
    ("scan", "camera", "particles", "estimate", "ellipsoids", "draws", "next_views", "ruler", "candidates"), False
)
# Neighbouring screenshots of a scene at rest differ by less than this in every pixel.
SAME = 6


def change(page: Page, served: Served, members: dict[str, Any]) -> dict[str, Any]:
    """Tell the page's view over REST what to show."""
    frame = page.locator("#scene").get_attribute("src") or ""
    _, _, id, _, name, *_ = frame.split("/")
    answer = served.client.patch(f"/api/v1/sessions/{id}/views/{name}", json=members)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def settled(page: Page) -> NDArray[np.uint8]:
    """The 3D view's pixels (height, width, 3), once it has stood still for a while."""
    canvas = page.locator("#scene")
    before, still = pixels(canvas), 0
    for _ in range(PATIENCE // 150):
        page.wait_for_timeout(150)
        now = pixels(canvas)
        still = still + 1 if differing(before, now) == 0 else 0
        if still == 2:
            return now
        before = now
    raise AssertionError("the scene does not come to rest")


def differing(one: NDArray[np.uint8], other: NDArray[np.uint8]) -> int:
    """How many pixels are not the same."""
    return int((np.abs(one.astype(int) - other).max(axis=-1) >= SAME).sum())


def ground(seen: NDArray[np.uint8]) -> tuple[int, ...]:
    """The colour of a corner where nothing is drawn."""
    return tuple(int(channel) for channel in seen[3, 3])


def look_from_eye(page: Page, served: Served, **members: Any) -> NDArray[np.uint8]:
    """The pixels from EYE, with what else the view is told, once it stands still; nothing lies over them."""
    page.evaluate("document.getElementById('over').style.visibility = 'hidden'")
    page.frame_locator("#scene").locator("canvas").first.wait_for()
    change(page, served, {"camera": EYE, **members})
    for _ in range(PATIENCE // 50):
        looked = view(page, served)
        # what was drawn before the view was told may stand still for a while
        if looked["drawn"] is not None and (looked["show"]["particles"] or not looked["drawn"]["particles"]):
            return settled(page)
        page.wait_for_timeout(50)
    raise AssertionError("nothing is drawn")


def place(page: Page, point: Sequence[float] | NDArray[np.float64]) -> tuple[float, float]:
    """Where in the window a point (3,), world, is seen from EYE, in pixels from the left and from the top."""
    box = page.locator("#scene").bounding_box()
    assert box is not None
    position, look_at, up = (np.array(EYE[name]) for name in ("position", "look_at", "up"))
    ahead = (look_at - position) / np.linalg.norm(look_at - position)
    right = np.cross(ahead, up)
    right /= np.linalg.norm(right)
    offset = np.asarray(point) - position
    depth = offset @ ahead
    focal = box["height"] / 2 / math.tan(FIELD_OF_VIEW / 2)
    x = box["width"] / 2 + focal * float(offset @ right / depth)
    y = box["height"] / 2 - focal * float(offset @ np.cross(right, ahead) / depth)
    return box["x"] + x, box["y"] + y


def drag(page: Page, start: tuple[float, float], end: tuple[float, float]) -> None:
    """Press at the one place, move slowly, let go at the other."""
    page.mouse.move(*start)
    # the handle lights up under the mouse before it can be taken
    page.wait_for_timeout(300)
    page.mouse.down()
    page.mouse.move(*end, steps=10)
    page.wait_for_timeout(100)
    page.mouse.up()
