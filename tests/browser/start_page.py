"""What tests of the start page do again and again: empty the server, find a card, follow to a session's page."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Locator, Page, expect

from tests.app import small_sessions as small
from tests.browser.conftest import PATIENCE
from tests.servers import Served

SCENE = small.CABINET / "open"
URDF, DEPTH, CAMERA = small.CABINET / "cabinet.urdf", SCENE / "depth.png", SCENE / "camera.json"
expect.set_options(timeout=PATIENCE)


@pytest.fixture(autouse=True)
def emptied(served: Served) -> Iterator[None]:
    """Nothing is kept when a test begins."""
    yield
    for kind in ("sessions", "recordings", "models", "scans"):
        for entry in served.client.get(f"/api/v1/{kind}").json():
            served.client.delete(f"/api/v1/{kind}/{entry['id']}")


def card(page: Page, name: str) -> Locator:
    return page.get_by_role("listitem").filter(has=page.get_by_role("link", name=name))


def sessions(served: Served) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = served.client.get("/api/v1/sessions").json()
    return found


def arrived(page: Page) -> str:
    """The id of the session whose page was gone to."""
    page.wait_for_url(re.compile(r"/sessions/[0-9a-f]{16}/"))
    found = re.search(r"/sessions/([0-9a-f]{16})/", page.url)
    assert found
    return found[1]
