"""Do the buttons and the legend over the 3D view do and say what the view does and shows, and is a surface whole?"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from playwright.sync_api import Page, expect

from tests.app import small_sessions as small
from tests.browser.conftest import PATIENCE, PHONE, scrolls_sideways
from tests.browser.scene_pointer import BARE, change, ground, look_from_eye, settled
from tests.browser.session_page import opened, tab, view, wait
from tests.servers import Served

expect.set_options(timeout=PATIENCE)
pytestmark = pytest.mark.scene


@pytest.fixture(scope="module")
def session(served: Served) -> str:
    """The path of a session that has found the object in six iterations."""
    return small.after(served.client, 6, name="a cabinet", config=small.QUICK | {"search_islands": 40})


def test_places_by_button_and_key_and_a_legend_of_what_is_drawn(page: Page, served: Served, session: str) -> None:
    page = opened(page, served, session)
    looks, lines = page.get_by_role("group", name="Look from"), page.locator("#scene-legend-lines li")
    expect(lines.first).to_have_text("frame")
    for press, name in (
        (lambda: looks.get_by_role("button", name="Fit").click(), "fit"),
        (lambda: page.keyboard.press("c"), "sensor"),
        (lambda: page.keyboard.press("T"), "top"),
    ):
        press()
        wait(page, lambda name=name: view(page, served)["look"] == name)  # type: ignore[misc]
        expect(looks.get_by_role("button", pressed=True)).to_have_attribute("data-look", name)
    change(page, served, {"look": "sensor"})
    expect(looks.get_by_role("button", pressed=True)).to_have_text("Sensor")

    assert lines.all_inner_texts() == [line["text"] for line in view(page, served)["legend"]]
    expect(lines.filter(has_text="ruler")).to_have_count(1)
    tab(page, "Layers").get_by_role("switch", name="ruler", exact=True).uncheck()
    expect(lines.filter(has_text="ruler")).to_have_count(0)
    legend = page.locator("#scene-legend")
    legend.get_by_text("Legend").click()
    expect(lines.first).to_be_hidden()


def test_on_a_phone_the_legend_is_folded_until_it_is_asked_for(
    new_page: Callable[..., Page], served: Served, session: str
) -> None:
    page = opened(new_page(viewport=PHONE, color_scheme="dark"), served, session)
    line = page.locator("#scene-legend-lines li").first
    expect(line).to_be_attached()
    expect(line).to_be_hidden()
    page.locator("#scene-legend").get_by_text("Legend").click()
    expect(line).to_be_visible()
    box, scene = page.locator("#scene-legend").bounding_box(), page.locator("#scene").bounding_box()
    assert box is not None and scene is not None
    assert box["y"] >= scene["y"] and box["y"] + box["height"] <= scene["y"] + scene["height"]
    assert not scrolls_sideways(page)


def test_the_scan_leaves_a_surface_whole_that_fits_it(page: Page, served: Served, session: str) -> None:
    """Of the estimate's pixels nearly all keep their hue under the scan's points, which lie on it with noise."""
    page = opened(page, served, session)
    alone = look_from_eye(page, served, show=BARE | {"estimate": True})
    serial = view(page, served)["drawn"]["serial"]
    change(page, served, {"show": {"scan": True}})
    wait(page, lambda: view(page, served)["drawn"]["serial"] > serial)
    both = settled(page)
    surface = saturated(alone) & (np.abs(alone.astype(int) - ground(alone)).max(axis=-1) > 40)
    assert surface.sum() > 5000 and (saturated(both)[surface]).mean() > 0.9


def saturated(seen: NDArray[np.uint8]) -> NDArray[Any]:
    """Which pixels have a hue: parts have one, the scan hardly."""
    return np.ptp(seen.astype(int), axis=-1) > 60
