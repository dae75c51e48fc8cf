"""What tests of a session's page do again and again: open it, wait, read what its 3D view shows."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from playwright.sync_api import Locator, Page

from tests.app import small_sessions as small
from tests.browser.conftest import PATIENCE, pixels
from tests.servers import Served


def at_rest(served: Served, **members: Any) -> str:
    """The path of a small session that has come to rest just now."""
    session = small.after(served.client, 2, name="a cabinet", **members)
    served.client.post(f"{session}/run", json={"until": "converged"}).raise_for_status()
    assert small.at_rest(served.client, session)["converged"]
    return session


def opened(page: Page, served: Served, session: str, query: str = "") -> Page:
    """The session's page, once it has heard from the server."""
    page.goto(served.url + served.client.get(session).json()["view_url"] + query)
    page.locator("body[data-ready]").wait_for()
    return page


def view(page: Page, served: Served) -> dict[str, Any]:
    """What the server says that this page's 3D view shows."""
    frame = page.locator("#scene").get_attribute("src") or ""
    _, _, id, _, name, *_ = frame.split("/")
    found: dict[str, Any] = served.client.get(f"/api/v1/sessions/{id}/views/{name}").json()
    return found


def wait(page: Page, so: Callable[[], bool]) -> None:
    """Until it is so; a test that waits in vain ends by an error."""
    for _ in range(PATIENCE // 50):
        if so():
            return
        page.wait_for_timeout(50)
    raise AssertionError("it has not become so")


def weighty(served: Served, session: str, part: str) -> list[dict[str, Any]]:
    """The particles of a part that weigh anything beside its heaviest: those that are drawn."""
    particles = served.client.get(f"{session}/beliefs/{part}/particles?limit=40").json()["particles"]
    least = max(particle["weight"] for particle in particles) * math.exp(-12)
    return [particle for particle in particles if particle["weight"] >= least]


def tab(page: Page, name: str) -> Locator:
    """A tab's panel, opened."""
    page.get_by_role("tab", name=name).click()
    return page.get_by_role("tabpanel", name=name)


def written(length: float) -> str:
    """Metres as the page has what is known finely: centimetres, from ten on with one place."""
    return f"{100 * length:.{1 if length >= 0.1 else 2}f}\u202fcm"


def parts(estimate: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """The cabinet's links of an estimate, by the part that they are of."""
    links = estimate["links"]
    of_drawers = {f"drawer{n}": [links[f"drawer{n}"], links[f"handle{n}"]] for n in (1, 2, 3)}
    return {"frame": [links["frame"]], **of_drawers}


def has_colour(place: Locator, colour: str) -> bool:
    wanted = np.array([int(colour[at : at + 2], 16) for at in (1, 3, 5)])
    return bool((np.abs(pixels(place).astype(int) - wanted).max(axis=-1) < 12).any())
