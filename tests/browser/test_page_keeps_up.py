"""Does an open page keep up with what happens elsewhere: in another tab, over REST, and while its server restarts?"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from tests.app import small_sessions as small
from tests.browser.conftest import PATIENCE, Troubles
from tests.browser.session_page import opened, tab, view, wait
from tests.servers import Served, serving

expect.set_options(timeout=PATIENCE)


def test_a_setting_changed_in_one_tab_is_seen_in_the_other(
    page: Page, served: Served, new_page: Callable[..., Page]
) -> None:
    session = small.after(served.client, 2)
    mine, theirs = opened(page, served, session), opened(new_page(), served, session)
    theirs_field = tab(theirs, "Settings").get_by_label("tolerance end")
    field = tab(mine, "Settings").get_by_label("tolerance end")
    field.fill("2")
    field.press("Tab")
    wait(mine, lambda: served.client.get(session).json()["config"].get("tolerance_end") == 0.02)
    expect(theirs_field).to_have_value("2")
    small.step(served.client, session)
    expect(theirs.locator("#progress-number")).to_have_text("3")
    expect(theirs_field).to_have_value("2")


def test_a_view_added_over_rest_is_marked_on_the_timeline(page: Page, served: Served) -> None:
    session = small.after(served.client, 2)
    page = opened(page, served, session)
    expect(page.locator(".mark.change")).to_have_count(0)
    scan = small.upload_scan(served.client, "second_view")
    assert served.client.post(f"{session}/scans", json={"scan_id": scan}).status_code < 300
    expect(page.locator(".mark.change")).to_have_attribute("title", "after iteration 2 a view was added")


@pytest.mark.scene
def test_after_a_restart_the_scene_shows_what_the_timeline_does(page: Page, tmp_path: Path, troubles: Troubles) -> None:
    troubles.expect("ERR_")
    troubles.expect("status of 503")
    with serving(tmp_path) as start:
        served = start().ready()
        session = small.after(served.client, 5)
        page = opened(page, served, session)
        page.get_by_role("slider", name="Iteration").fill("3")
        wait(page, lambda: (view(page, served)["drawn"] or {}).get("iteration") == 3)
    expect(page.locator("#trouble")).to_contain_text("The connection to the server is lost")
    with serving(tmp_path) as start:
        served = start(port=served.config.port).ready()
        expect(page.locator("#trouble")).to_be_hidden()
        wait(page, lambda: view(page, served)["iteration"] == 3)
        wait(page, lambda: (view(page, served)["drawn"] or {}).get("iteration") == 3)
        expect(page.locator("#shown")).to_have_text(re.compile("3 / 5"))


def test_a_long_name_ends_in_an_ellipsis_and_is_whole_under_the_mouse(page: Page, served: Served) -> None:
    name = "a_link_whose_name_is_far_too_long_for_any_column_of_a_table"
    page.route(
        re.compile(r"/(estimate|graph)(\?|$)"),
        lambda route: route.fulfill(
            response=(answer := route.fetch()), body=answer.text().replace('"drawer2"', f'"{name}"')
        ),
    )
    page = opened(page, served, small.after(served.client, 2))
    row = page.locator("#part-rows tr", has_text=name)
    shown = row.get_by_text(name)
    expect(shown).to_have_attribute("title", name)
    cut = "one => one.scrollWidth > one.clientWidth && getComputedStyle(one).textOverflow === 'ellipsis'"
    assert shown.evaluate(cut)
