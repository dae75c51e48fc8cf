"""Does a session go on with another scan, as the page was told that it is meant?"""

from __future__ import annotations

from datetime import datetime
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.app import small_sessions as small
from tests.browser.conftest import PATIENCE, Troubles
from tests.browser.session_page import opened, tab
from tests.servers import Served

expect.set_options(timeout=PATIENCE)


def named(scans: list[dict[str, Any]], id: str) -> str:
    """A scan as the page names it, where the browser's clock is this one's."""
    names = [
        f"{one['file_name']}, {datetime.fromisoformat(one['created']).astimezone():%d/%m/%Y, %H:%M:%S}" for one in scans
    ]
    name = names[[one["id"] for one in scans].index(id)]
    return name if names.count(name) == 1 else f"{name}, {id}"


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
    kept = served.client.get("/api/v1/scans").json()
    form = tab(page, "Settings").locator("#new-scan")
    expect(form.get_by_text("In force: ")).to_have_text(f"In force: {named(kept, first)}.")
    expect(form.get_by_role("radio", name="another view of the same scene")).to_be_checked()
    scans = form.get_by_label("scan", exact=True)
    expect(scans.locator(f"option[value='{later}']")).to_have_count(1)
    expect(scans.locator(f"option[value='{first}']")).to_have_count(0)
    button = form.get_by_role("button", name="Go on with this scan")
    expect(button).to_be_disabled()  # nobody has chosen one
    scans.select_option(later)
    form.get_by_role("radio", name=choice).check()
    button.click()
    done = {"joins": "was added as another view", "replaces": "has replaced the scans before"}[mode]
    name = named(kept, later)
    expect(form.get_by_role("status")).to_have_text(f"{name}, {done}. It counts from the next iteration on.")
    expect(button).to_be_disabled()  # what was chosen has been done
    expect(scans.locator(f"option[value='{later}']")).to_have_count(0)
    expect(form.get_by_text("In force: ")).to_contain_text(name)
    expect(page.get_by_role("list", name="Marks").get_by_text(mark)).to_be_attached()
    told = served.client.get(f"{session}/trace").json()["changes"]
    assert told == [{"after_iteration": 4, "scan_id": later, "mode": mode}]
    assert served.client.get(session).json()["scan_ids"] == ([first, later] if mode == "joins" else [later])
    # what is known is of before
    expect(page.locator("#verdict-rest")).to_have_text(
        "Scans or settings have changed since iteration 4: run it to take them in."
    )
    before = tab(page, "Belief").get_by_text("This is of before the change: iteration 4 had other scans or settings.")
    expect(before).to_be_visible()
    page.get_by_role("slider", name="Iteration").fill("3")
    expect(before).to_be_hidden()
    page.get_by_role("button", name="Step", exact=True).click()
    expect(page.get_by_role("list", name="Marks").get_by_text("the search begins again")).to_be_attached()
    expect(before).to_be_hidden()
    expect(page.locator("#verdict-rest")).to_have_text("Not at rest yet")


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
    told = form.get_by_role("status")
    expect(told).to_contain_text("On the server, and not yet in this session: depth.png, ")
    (sent,) = served.client.get("/api/v1/scans").json()[-1:]
    scans = form.get_by_label("scan", exact=True)
    expect(scans).to_have_value(sent["id"])
    assert served.client.get(session).json()["scan_ids"] == first
    # of the same name and second they are told apart by their ids
    alike = [{**sent, "id": "0" * 16}, sent]
    page.route("**/api/v1/scans", lambda route: route.fulfill(json=alike))
    tab(page, "Share")
    tab(page, "Settings")
    labels = [named(alike, one["id"]) for one in reversed(alike)]
    assert labels[0].endswith(sent["id"]) and labels[1].endswith("0" * 16)
    expect(scans.locator("option")).to_have_text(["choose a scan", *labels])
    expect(scans).to_have_value(sent["id"])
    form.get_by_role("button", name="Go on with this scan").click()
    expect(told).to_contain_text("was added as another view")
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
