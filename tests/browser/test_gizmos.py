"""Can region, prior and particles be taken hold of in the 3D view, with the mouse, without turning it?"""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page, expect

from tests.app import small_sessions as small
from tests.browser.conftest import PATIENCE
from tests.browser.scene_pointer import BARE, differing, drag, look_from_eye, place, settled
from tests.browser.session_page import opened, tab, view, wait, weighty
from tests.servers import Served

expect.set_options(timeout=PATIENCE)
pytestmark = pytest.mark.scene
# Metres: how exactly a drag of so many pixels can be foretold.
EXACT = 0.015
# Metres from a handle's middle: on a corner's arrow, at the tip of the prior's, and on the prior's arc.
ON_ARROW, AT_TIP, ON_ARC = 0.05, 0.19, 0.65 * 0.21
UP = np.array([0.0, 0.0, 1.0])
BOX = [0.0, -0.1, -0.05, 0.8, 0.7, 0.6]
PRIOR: dict[str, Any] = {
    "kind": "gaussian",
    "link": "frame",
    "std_xyz": [0.08] * 3,
    "std_rpy": [0.15] * 3,
    "pose": {"position": {"x": 0.8, "y": 0.3, "z": 0.5}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}},
}


@pytest.fixture(scope="module")
def session(served: Served) -> str:
    """The path of a session that has made six iterations."""
    return small.after(served.client, 6, name="a cabinet")


def test_corners_of_the_region_are_dragged(page: Page, served: Served, session: str) -> None:
    page = opened(page, served, session)
    panel = tab(page, "Layers")
    panel.get_by_role("switch", name="region of interest").check()
    before = look_from_eye(page, served, region=BOX, show=BARE)
    camera = view(page, served)["camera"]

    high = np.array(BOX[3:])
    drag(page, place(page, high + ON_ARROW * UP), place(page, high + (ON_ARROW + 0.15) * UP))
    wait(page, lambda: abs(view(page, served)["region"][5] - 0.75) < EXACT)
    low, aside = np.array(BOX[:3]), np.array([0.0, 1.0, 0.0])
    drag(page, place(page, low + ON_ARROW * aside), place(page, low + (ON_ARROW - 0.1) * aside))
    wait(page, lambda: abs(view(page, served)["region"][1] + 0.2) < EXACT)

    after = settled(page)
    state = view(page, served)
    others = [number for at, number in enumerate(state["region"]) if at not in (1, 5)]
    assert others == pytest.approx([BOX[0], *BOX[2:5]], abs=1e-3)
    for at, label in ((1, "smallest y"), (5, "largest z")):
        shown = panel.get_by_label(f"{label} of the region, centimetres")
        expect(shown).to_have_value(f"{state['region'][at] * 100:.1f}")
    assert state["camera"] == camera and state["part"] is None  # neither a turn nor a click
    assert differing(before, after) > 200


def test_the_prior_is_moved_and_turned(page: Page, served: Served, session: str) -> None:
    page = opened(page, served, session)
    panel = tab(page, "Layers")
    panel.get_by_role("switch", name="prior").check()
    wait(page, lambda: view(page, served)["prior"] is not None)
    before = look_from_eye(page, served, prior=PRIOR, show=BARE)
    camera = view(page, served)["camera"]
    middle = np.array([0.8, 0.3, 0.5])
    drag(page, place(page, middle + AT_TIP * UP), place(page, middle + (AT_TIP + 0.12) * UP))
    wait(page, lambda: abs(view(page, served)["prior"]["pose"]["position"]["z"] - 0.62) < EXACT)
    moved = view(page, served)["prior"]["pose"]
    x, y, z = (moved["position"][axis] for axis in "xyz")
    assert (x, y) == pytest.approx((0.8, 0.3), abs=1e-3)
    assert moved["orientation"] == pytest.approx(PRIOR["pose"]["orientation"], abs=1e-4)
    expect(panel.locator("#prior-text")).to_contain_text(f"frame at ({x * 100:.1f}, {y * 100:.1f}, {z * 100:.1f}) cm")

    middle = np.array([x, y, z])

    def on_arc(degrees: float) -> tuple[float, float]:
        angle = math.radians(degrees)
        return place(page, middle + ON_ARC * np.array([math.cos(angle), math.sin(angle), 0]))

    drag(page, on_arc(45), on_arc(75))
    wait(
        page, lambda: abs(2 * math.degrees(math.asin(view(page, served)["prior"]["pose"]["orientation"]["z"])) - 30) < 4
    )
    turned = view(page, served)["prior"]["pose"]
    assert turned["position"] == pytest.approx(moved["position"], abs=1e-3)
    assert abs(turned["orientation"]["x"]) + abs(turned["orientation"]["y"]) < 1e-3
    after = settled(page)
    state = view(page, served)
    assert state["camera"] == camera and state["part"] is None
    assert state["prior"] == {**PRIOR, "pose": turned}
    assert differing(before, after) > 200


def test_a_click_on_a_particle_explains_it(page: Page, served: Served, session: str) -> None:
    """The one that lies most by itself on the screen; what is expected is worked out from REST."""
    page = opened(page, served, session)
    before = look_from_eye(page, served, show={**BARE, "particles": True})
    camera, scene = view(page, served)["camera"], page.locator("#scene").bounding_box()
    assert scene is not None
    found = []
    for part in served.client.get(f"{session}/graph").json()["parts"]:
        for particle in weighty(served, session, part["name"]):
            found.append((part["name"], particle["index"], place(page, particle["pose"][:3])))
    seen = np.array([at for _, _, at in found])
    apart = np.linalg.norm(seen[:, None] - seen, axis=-1) + np.diag(np.full(len(seen), np.inf))
    inside = (seen > [scene["x"] + 20, scene["y"] + 20]).all(axis=1)
    inside &= (seen < [scene["x"] + scene["width"] - 20, scene["y"] + scene["height"] - 20]).all(axis=1)
    loner = int(np.where(inside, apart.min(axis=1), 0).argmax())
    part, index, (x, y) = found[loner]
    for _ in range(12):  # a browser that draws slowly may miss a click; a person clicks again
        page.mouse.move(x + 1, y - 1)
        page.wait_for_timeout(300)
        page.mouse.click(x + 1, y - 1, delay=20)
        page.wait_for_timeout(1500)
        if view(page, served)["particle"] is not None:
            break

    state = view(page, served)
    assert (state["part"], state["particle"], state["camera"]) == (part, index, camera)
    expect(page.get_by_role("tab", name="Why")).to_have_attribute("aria-selected", "true")
    expect(page.get_by_role("heading", name=f"{part}, particle {index}")).to_be_visible()
    weight = served.client.get(f"{session}/beliefs/{part}/particles/{index}").json()["weight"]
    expect(page.locator("#why-weight")).to_contain_text(re.compile(re.escape(f"{weight * 100:.2f}") + r"\s%"))
    assert differing(before, settled(page)) > 100  # its outline stands there
