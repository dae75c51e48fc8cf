"""Can a person point at things in the 3D view, and still turn it?"""

from __future__ import annotations

import time
from typing import Any

import pytest
from playwright.sync_api import Page

from tests.app import small_sessions as small
from tests.browser.conftest import Troubles, pixels
from tests.servers import Served

pytestmark = pytest.mark.scene


@pytest.fixture(scope="module")
def path(served: Served) -> str:
    """A session that has found the object in a few iterations: it is in the middle of the view."""
    return small.after(served.client, 4, config=small.QUICK | {"search_islands": 40})


def look(page: Page, served: Served, path: str, view: str, troubles: Troubles) -> str:
    """Open the view, and wait until it is drawn; its address over REST."""
    troubles.expect("GPU stall")
    page.goto(f"{served.url}/sessions/{path.rsplit('/', 1)[1]}/view/{view}/?economy")
    while pixels(page).astype(float).std() < 5:
        page.wait_for_timeout(100)
    return f"{path}/views/{view}"


def state(served: Served, view: str) -> dict[str, Any]:
    found: dict[str, Any] = served.client.get(view).json()
    return found


def middle(page: Page) -> tuple[float, float]:
    size = page.viewport_size
    assert size is not None
    return size["width"] / 2, size["height"] / 2


def test_a_click_on_the_object_selects_a_part(page: Page, served: Served, path: str, troubles: Troubles) -> None:
    view = look(page, served, path, "clicked", troubles)
    page.mouse.click(20, 20)
    page.mouse.click(*middle(page))
    while state(served, view)["part"] is None:
        time.sleep(small.PATIENCE)
    assert state(served, view)["part"] in ("frame", "drawer1", "drawer2", "drawer3")
    assert state(served, view)["camera"] is None  # a click turns nothing


def test_a_drag_turns_the_view_and_selects_nothing(page: Page, served: Served, path: str, troubles: Troubles) -> None:
    view = look(page, served, path, "turned", troubles)
    before = pixels(page).astype(float)
    x, y = middle(page)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + 120, y + 20, steps=8)
    page.mouse.up()
    while (eye := state(served, view)["camera"]) is None:
        time.sleep(small.PATIENCE)
    assert state(served, view)["part"] is None and eye["up"] == [0, 0, 1]
    assert abs(pixels(page) - before).mean() > 2


def test_only_the_scene_is_seen_in_light_and_dark(page: Page, served: Served, path: str, troubles: Troubles) -> None:
    view = look(page, served, path, "plain", troubles)
    assert page.locator("[role=alert]:visible, [data-floating-window]:visible").count() == 0
    assert tuple(pixels(page)[5, 5]) == (243, 244, 246)
    served.client.patch(view, json={"theme": "dark"})
    while tuple(pixels(page)[5, 5]) != (20, 24, 31):
        page.wait_for_timeout(100)
