"""Does a session go on with another scan, as the page was told that it is meant?"""

from __future__ import annotations

import pytest
from playwright.sync_api import Page, expect

from tests.app import small_sessions as small
from tests.browser.conftest import PATIENCE, Troubles
from tests.browser.session_page import opened, tab
from tests.servers import Served

expect.set_options(timeout=PATIENCE)


@pytest.mark.parametrize(
    ("choice", "mode", "mark"),
    [
        ("another view of the same scene", "joins", "after iteration 4 a view was added"),
        ("the scene has changed", "replaces", "after iteration 4 the scene had changed"),
    ],
)
def test_a_scan_is_given_to_a_session(page: Page, served: Served, choice: str, mode: str, mark: str) -> None:
    session = small.after(served.client, 4)
    first, later = served.client.get(session).json()["scan_ids"][0], small.upload_scan(served.client, "second_view")
    opened(page, served, session)
    form = tab(page, "Settings").locator("#new-scan")
    expect(form.get_by_role("radio", name="another view of the same scene")).to_be_checked()
    scans = form.get_by_label("scan", exact=True)
    expect(scans.locator(f"option[value='{later}']")).to_have_count(1)
    expect(scans.locator(f"option[value='{first}']")).to_have_count(0)
    scans.select_option(later)
    form.get_by_role("radio", name=choice).check()
    form.get_by_role("button", name="Go on with this scan").click()
    expect(scans.locator(f"option[value='{later}']")).to_have_count(0)
    expect(page.get_by_role("list", name="Marks").get_by_text(mark)).to_be_attached()
    told = served.client.get(f"{session}/trace").json()["changes"]
    assert told == [{"after_iteration": 4, "scan_id": later, "mode": mode}]
    assert served.client.get(session).json()["scan_ids"] == ([first, later] if mode == "joins" else [later])
    page.get_by_role("button", name="Step", exact=True).click()
    expect(page.get_by_role("list", name="Marks").get_by_text("the search begins again")).to_be_attached()


def test_a_scan_comes_from_a_file_with_its_camera(page: Page, served: Served, troubles: Troubles) -> None:
    session = small.after(served.client, 1)
    first = served.client.get(session).json()["scan_ids"]
    opened(page, served, session)
    form = tab(page, "Settings").locator("#new-scan")
    files = form.get_by_label("or from a file, with its camera.json")
    folder = small.CABINET / "second_view"
    troubles.expect("422")
    files.set_input_files([folder / "depth.png"])
    expect(form.get_by_role("alert")).to_contain_text("needs a camera file")
    files.set_input_files([folder / "truth.json"])
    expect(form.get_by_role("alert")).to_contain_text("There is no scan among these files")
    files.set_input_files([folder / "depth.png", folder / "camera.json"])
    expect(page.get_by_role("list", name="Marks").get_by_text("after iteration 1 a view was added")).to_be_attached()
    assert len(served.client.get(session).json()["scan_ids"]) == len(first) + 1
    expect(form.get_by_role("alert")).to_have_count(0)


def test_what_the_server_says_is_shown(page: Page, served: Served, troubles: Troubles) -> None:
    """The scan is gone by the time that it is asked for."""
    session, later = small.after(served.client, 2), small.upload_scan(served.client, "arm")
    troubles.expect(f"status of 404 (Not Found) ({served.url}{session}/scans)")
    opened(page, served, session)
    form = tab(page, "Settings").locator("#new-scan")
    form.get_by_label("scan", exact=True).select_option(later)
    served.client.delete(f"/api/v1/scans/{later}").raise_for_status()
    form.get_by_role("button", name="Go on with this scan").click()
    expect(form.get_by_role("alert")).to_contain_text(f"scan '{later}' is not here")
    assert served.client.get(session).json()["scan_ids"] != [later]
