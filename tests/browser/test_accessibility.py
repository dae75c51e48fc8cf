"""Does axe find anything serious on the pages, in light and dark, on a desk and a phone?"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, expect

from tests.app import small_sessions as small
from tests.browser.conftest import DESK, PATIENCE, PHONE
from tests.browser.session_page import at_rest, opened
from tests.servers import Served

expect.set_options(timeout=PATIENCE)
TABS = ("Belief", "Why", "Layers", "Settings", "Compare", "Share")
LOOKS: dict[str, dict[str, Any]] = {
    "light": {"viewport": DESK, "color_scheme": "light"},
    "dark": {"viewport": DESK, "color_scheme": "dark"},
    "phone": {"viewport": PHONE, "color_scheme": "light"},
}


@pytest.fixture(scope="module")
def sessions(served: Served) -> tuple[str, str]:
    """One at rest, and one that has not begun."""
    return at_rest(served), small.create(served.client, name="another")


def serious(page: Page) -> list[str]:
    """What axe calls serious or critical: its rule, and where."""
    found = Axe().run(page, context={"exclude": [["iframe"]]}).response["violations"]
    return [
        f"{one['id']}: {node['target']} {node['failureSummary']}"
        for one in found
        if one["impact"] in ("serious", "critical")
        for node in one["nodes"]
    ]


@pytest.mark.parametrize("look", LOOKS)
def test_nothing_serious_is_found(
    new_page: Callable[..., Page], served: Served, sessions: tuple[str, str], look: str
) -> None:
    page = new_page(**LOOKS[look])
    page.goto(served.url)
    page.get_by_text("another").first.wait_for()
    found = {"start": serious(page)}
    page.get_by_text("Advanced:").click()
    found["start, advanced"] = serious(page)
    opened(page, served, sessions[0])
    for name in TABS:
        page.get_by_role("tab", name=name).click()
        found[name] = serious(page)
    page.evaluate("document.getElementById('help').showModal()")
    found["help"] = serious(page)
    opened(page, served, sessions[1], "?setup")
    page.locator("#setup-choices li").first.wait_for()
    found["set up"] = serious(page)
    page.goto(f"{served.url}/compare?sessions={','.join(path.rsplit('/', 1)[1] for path in sessions)}")
    page.get_by_role("rowheader", name="tags").wait_for()
    found["side by side"] = serious(page)
    assert not any(found.values()), "\n".join(f"{where}: {what}" for where, all in found.items() for what in all)
