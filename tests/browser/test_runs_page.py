"""Is a list of many sessions put in order, filtered, named and tagged as a person would, and are several looked at side
by side?"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from tests.app import small_sessions as small
from tests.browser.conftest import DESK, PHONE, Troubles, scrolls_sideways
from tests.browser.start_page import card, emptied
from tests.servers import Served

__all__ = ["emptied"]  # a fixture of every test here


@pytest.fixture
def runs(served: Served) -> dict[str, str]:
    """Paths of four sessions of one model and scan, by name; made in this order."""
    ids = {"model_id": small.upload_model(served.client), "scan_id": small.upload_scan(served.client)}
    tags = {"kitchen 10": ["hard"], "Kitchen 9": ["hard", "to check"], "hall": [], "lab": ["to check"]}
    made = {name: small.create(served.client, name=name, tags=these, **ids) for name, these in tags.items()}
    small.step(served.client, made["hall"], 2)
    return made


def shows(page: Page, *names: str) -> None:
    expect(page.locator(".card .name")).to_have_text([*names])


def test_the_list_is_put_in_order_and_filtered_and_its_address_says_how(
    page: Page, served: Served, runs: dict[str, str]
) -> None:
    page.goto(served.url)
    shows(page, "lab", "hall", "Kitchen 9", "kitchen 10")
    page.get_by_label("Order").select_option("name")
    shows(page, "hall", "Kitchen 9", "kitchen 10", "lab")  # as people count, not as letters come
    page.get_by_role("group", name="Tags").get_by_role("button", name="hard 2").click()
    shows(page, "Kitchen 9", "kitchen 10")
    expect(page.locator("#summary")).to_have_text("2 of 4 shown, 0 running")
    page.get_by_label("Name, model or tag").fill("TO check")
    shows(page, "Kitchen 9")
    address = page.url
    assert "sort=name" in address and "tag=hard" in address and "q=TO+check" in address
    # who is sent it sees the same
    other = page.context.new_page()
    other.goto(address)
    shows(other, "Kitchen 9")
    expect(other.get_by_label("Order")).to_have_value("name")
    expect(other.get_by_label("Name, model or tag")).to_have_value("TO check")
    expect(other.get_by_role("button", name="hard 2")).to_have_attribute("aria-pressed", "true")
    other.close()
    # each choice is a step back, typing is none
    page.go_back()
    shows(page, "hall", "Kitchen 9", "kitchen 10", "lab")
    expect(page.get_by_role("button", name="hard 2")).to_have_attribute("aria-pressed", "false")
    page.go_back()
    shows(page, "lab", "hall", "Kitchen 9", "kitchen 10")
    page.get_by_label("Order").select_option("iterations")
    expect(page.locator(".card .name").first).to_have_text("hall")
    page.get_by_label("Name, model or tag").fill("cabinet")  # the model's name
    expect(page.locator(".card")).to_have_count(4)
    page.get_by_label("Verdict").select_option("not found")
    expect(page.locator(".card")).to_have_count(0)
    page.get_by_role("button", name="Show all").click()
    expect(page.locator(".card")).to_have_count(4)
    page.get_by_label("State").select_option("paused")
    expect(page.locator(".card")).to_have_count(4)


def test_name_and_tags_are_changed_where_they_stand(
    page: Page, served: Served, runs: dict[str, str], troubles: Troubles
) -> None:
    page.goto(served.url)
    button = page.get_by_role("button", name="Name and tags of the session hall")
    form = card(page, "hall").locator("form")
    button.focus()
    page.keyboard.press("Enter")
    expect(form.get_by_label("Name")).to_be_focused()
    page.keyboard.type("never")
    page.keyboard.press("Escape")
    expect(form).to_have_count(0)
    expect(button).to_be_focused()
    page.keyboard.press("Enter")
    form.get_by_label("Tags").fill(" to check, dark,, dark ")
    form.get_by_label("Name").fill(" ")
    troubles.expect("422")
    page.keyboard.press("Enter")
    expect(form.get_by_role("alert")).to_contain_text("name in the body")
    form.get_by_label("Name").fill("the hall's")
    page.keyboard.press("Enter")
    shown = card(page, "the hall's")
    expect(shown.locator(".card-tags button")).to_have_text(["to check", "dark"])
    told = served.client.get(runs["hall"]).json()
    assert (told["name"], told["tags"]) == ("the hall's", ["to check", "dark"])
    shown.get_by_role("button", name="Only sessions with the tag dark").click()
    shows(page, "the hall's")
    # a tag that a program gave may hold a comma, and stays whole beside others
    served.client.patch(runs["hall"], json={"tags": ["row 2, left", "dark"]}).raise_for_status()
    expect(shown.locator(".card-tags button")).to_have_text(["row 2, left", "dark"])
    page.get_by_role("button", name="Name and tags of the session the hall's").click()
    page.locator("form.edit").get_by_label("Tags").fill("row 2, left, dark, new,, row 2")
    page.keyboard.press("Enter")
    expect(shown.locator(".card-tags button")).to_have_text(["row 2, left", "dark", "new", "row 2"])
    # what somebody writes in stays while the list goes on, and though it fits no more
    page.get_by_role("button", name="Name and tags of the session the hall's").click()
    form = page.locator("form.edit")
    form.get_by_label("Tags").fill("half a w")
    served.client.patch(runs["hall"], json={"tags": []}).raise_for_status()
    expect(page.locator("#summary")).to_have_text("0 of 4 shown, 0 running")
    expect(form.get_by_label("Tags")).to_have_value("half a w")
    expect(form.get_by_label("Tags")).to_be_focused()


def test_several_are_tagged_laid_side_by_side_and_deleted(
    new_page: Callable[..., Page], served: Served, runs: dict[str, str]
) -> None:
    page = new_page(viewport=DESK)  # all four are in sight
    page.goto(served.url)
    page.get_by_label("Select the session hall").check()
    chosen = page.get_by_role("region", name="Selected sessions")
    expect(chosen.get_by_role("status")).to_have_text("1 selected")
    link = chosen.get_by_role("link", name="Side by side")
    expect(link).to_have_attribute("aria-disabled", "true")
    page.get_by_label("Select the session lab").check()
    ids = [runs[name].rpartition("/")[2] for name in ("hall", "lab")]
    expect(link).to_have_attribute("href", f"/compare?sessions={','.join(ids)}")
    chosen.get_by_label("Tag").fill("both")
    page.keyboard.press("Enter")
    expect(card(page, "lab").locator(".card-tags button")).to_have_text(["to check", "both"])
    assert [served.client.get(runs[name]).json()["tags"] for name in ("hall", "lab")] == [
        ["both"],
        ["to check", "both"],
    ]
    # one that the list does not show is selected all the same, and that is said
    page.get_by_label("Name, model or tag").fill("lab")
    expect(chosen.get_by_role("status")).to_have_text("2 selected, 1 of them not in this list")
    page.get_by_label("Name, model or tag").fill("")
    expect(page.get_by_role("img", name="drawn over its scan")).to_have_count(4)  # none is on its way
    chosen.get_by_role("button", name="Delete").click()
    dialog = page.get_by_role("dialog", name="Delete 2 sessions?")
    expect(dialog).to_contain_text("“hall” and “lab” stop after their present iteration")
    dialog.get_by_role("button", name="Delete").click()
    shows(page, "Kitchen 9", "kitchen 10")
    expect(chosen).to_be_hidden()
    page.get_by_label("Select the session Kitchen 9").check()
    chosen.get_by_role("button", name="All 2").click()
    expect(chosen.get_by_role("status")).to_have_text("2 selected")
    chosen.get_by_role("button", name="None").click()
    expect(chosen).to_be_hidden()


def test_of_very_many_the_first_are_drawn_until_all_are_asked_for(
    page: Page, served: Served, runs: dict[str, str]
) -> None:
    one = served.client.get(runs["lab"]).json() | {"iteration": None}  # no pictures: the others are not there
    many = [one | {"id": f"{number:016x}", "name": f"run {number}"} for number in range(150)]
    page.route("**/api/v1/sessions", lambda route: route.fulfill(json=many))
    page.goto(served.url)
    cards, more = page.locator(".card"), page.get_by_role("button", name="Show all 150", exact=True)
    expect(cards).to_have_count(60)
    expect(page.locator("#summary")).to_have_text("150 kept, 0 running")
    # order and filters look at all of them
    page.get_by_label("Order").select_option("name")
    expect(cards.first.locator(".name")).to_have_text("run 0")
    page.get_by_label("Name, model or tag").fill("run 149")
    shows(page, "run 149")
    expect(more).to_be_hidden()
    page.get_by_label("Name, model or tag").fill("")
    more.focus()
    page.keyboard.press("Enter")
    expect(cards).to_have_count(150)
    expect(more).to_be_hidden()
    expect(cards.nth(60).locator(".open")).to_be_focused()


def test_pictures_are_only_asked_for_where_somebody_looks(page: Page, served: Served) -> None:
    ids = {"model_id": small.upload_model(served.client), "scan_id": small.upload_scan(served.client)}
    for number in range(12):
        small.create(served.client, name=f"number {number}", **ids)
    page.goto(served.url)
    page.get_by_role("img", name="The estimate of number 11").wait_for()
    last = page.locator(".card").last
    assert last.get_attribute("data-picture") is None
    last.scroll_into_view_if_needed()
    page.get_by_role("img", name="The estimate of number 0").wait_for()


def camera_of(served: Served, frame: str) -> Any:
    """Where the view of a frame, by its address, looks from."""
    found = re.search(r"/sessions/(\w+)/view/([\w-]+)/", frame)
    assert found
    return served.client.get(f"/api/v1/sessions/{found[1]}/views/{found[2]}").json()["camera"]


def test_sessions_stand_side_by_side_and_turn_together(
    page: Page, served: Served, runs: dict[str, str], troubles: Troubles
) -> None:
    ids = [runs[name].rpartition("/")[2] for name in ("hall", "lab")]
    troubles.expect("404")
    page.goto(f"{served.url}/compare?sessions={ids[0]},{'0' * 16},{ids[1]}")
    page.locator("body[data-ready]").wait_for()
    expect(page.get_by_role("alert")).to_have_text("session '0000000000000000' is not here; there are 4 sessions.")
    table = page.get_by_role("table", name="What each session has found")
    heads = table.locator("thead th")
    expect(heads).to_have_count(2)
    for head, name, id in zip(heads.all(), ("hall", "lab"), ids, strict=True):
        expect(head.get_by_role("link", name=name)).to_have_attribute("href", f"/sessions/{id}/")
        expect(head.locator("iframe")).to_have_attribute("title", f"3D view of {name}")
    row = table.get_by_role("row", name=re.compile("^slide1"))
    position = served.client.get(f"{runs['hall']}/estimate").json()["joints"]["slide1"]["position"]
    expect(row.get_by_role("cell").first).to_have_text(f"{100 * position:.1f}\u202fcm".replace("-", "\u2212"))
    expect(table.get_by_role("row", name=re.compile("^iteration")).get_by_role("cell")).to_have_text(["2", "0"])
    # what a hand does in one view goes for the other: they look at the same scan
    frames = [head.locator("iframe") for head in heads.all()]
    addresses = [str(frame.get_attribute("src")) for frame in frames]
    eye = {"position": [1.0, 2.0, 3.0], "look_at": [0.0, 0.0, 0.5], "up": [0.0, 0.0, 1.0]}
    frames[0].content_frame.locator("body").dispatch_event("pointerdown")
    with page.expect_response(lambda answer: answer.request.method == "PATCH" and ids[1] in answer.url):
        path = addresses[0].split("?")[0].rstrip("/").replace("/view/", "/views/")
        served.client.patch(f"/api/v1{path}", json={"camera": eye}).raise_for_status()
    assert camera_of(served, addresses[1]) == {"field_of_view": None, **eye}
    # what is new of a session is seen
    small.step(served.client, runs["lab"])
    served.client.patch(runs["lab"], json={"name": "the lab's"}).raise_for_status()
    expect(table.get_by_role("row", name=re.compile("^iteration")).get_by_role("cell")).to_have_text(["2", "1"])
    expect(heads.last.get_by_role("link")).to_have_text("the lab's")


def test_side_by_side_on_a_phone_only_the_table_scrolls(
    new_page: Callable[..., Page], served: Served, runs: dict[str, str]
) -> None:
    page = new_page(viewport=PHONE, has_touch=True)
    page.goto(f"{served.url}/compare?sessions={','.join(path.rpartition('/')[2] for path in runs.values())}")
    page.locator("body[data-ready]").wait_for()
    expect(page.locator("thead th")).to_have_count(4)
    assert not scrolls_sideways(page)
    page.goto(f"{served.url}/compare")
    expect(page.get_by_role("alert")).to_contain_text("No session is named")
