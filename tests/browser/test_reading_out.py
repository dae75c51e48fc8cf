"""What the page says while a posterior is read out, and what it does not wait for."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Page, expect

from app.sessions import long_read_out
from tests.app import small_sessions as small
from tests.app.held_read_outs import Held, holding
from tests.browser.conftest import PATIENCE
from tests.browser.session_page import opened
from tests.servers import Served

expect.set_options(timeout=PATIENCE)


@pytest.fixture
def held() -> Iterator[Held]:
    with holding() as found:
        yield found


def test_a_long_read_out_is_told_of_and_a_pause_does_not_wait_for_it(
    page: Page, served: Served, held: Held, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(long_read_out, "SOON", 0.0)
    session = small.create(served.client, name="a cabinet")
    opened(page, served, session)
    served.client.post(f"{session}/run", json={"iterations": 1000, "until": "converged"}).raise_for_status()
    state = page.locator("#state-word")
    expect(state).to_have_text("reading out the posterior…")
    page.get_by_role("button", name="Pause").click()
    expect(state).to_have_text("paused")
    held.release()
    page.get_by_role("button", name="Step").click()
    expect(state).to_have_text("at rest")
    assert len(held.begun) == 2 and held.begun[0] == held.begun[1]


def test_what_a_page_asked_for_ends_with_the_page(page: Page, served: Served, held: Held) -> None:
    session = small.after(served.client, 6, name="a cabinet")
    opened(page, served, session)
    page.get_by_role("button", name="How sure?").click()
    held.until(lambda: held.begun == [6])
    page.close()
    held.until(lambda: held.ended == 1)
