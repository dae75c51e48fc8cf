"""Does the start page show what is kept, and make sessions, as a person would: by clicking, typing and dropping?"""

from __future__ import annotations

import re
from collections.abc import Callable

import httpx
import numpy as np
import pytest
from playwright.sync_api import Page, expect

from tests.app import small_sessions as small
from tests.browser.conftest import DESK, PATIENCE, PHONE, Troubles, pixels, scrolls_sideways
from tests.browser.session_page import wait
from tests.browser.start_page import card, emptied, sessions
from tests.servers import Served

SCENE = small.CABINET / "open"
URDF, DEPTH, CAMERA = small.CABINET / "cabinet.urdf", SCENE / "depth.png", SCENE / "camera.json"
__all__ = ["emptied"]  # a fixture of every test here
expect.set_options(timeout=PATIENCE)


def contrast(page: Page, selector: str) -> float:
    """Of the text against what is behind it, as the web's accessibility guidelines measure it."""
    colours = page.locator(selector).first.evaluate(
        """(element) => {
          let ground = element;
          while (getComputedStyle(ground).backgroundColor === "rgba(0, 0, 0, 0)") ground = ground.parentElement;
          return [getComputedStyle(element).color, getComputedStyle(ground).backgroundColor];
        }"""
    )
    light = []
    for colour in colours:
        channels = np.array([float(number) for number in re.findall(r"[\d.]+", colour)[:3]]) / 255
        linear = np.where(channels <= 0.04045, channels / 12.92, ((channels + 0.055) / 1.055) ** 2.4)
        light.append(float(linear @ [0.2126, 0.7152, 0.0722]))
    return (max(light) + 0.05) / (min(light) + 0.05)


def test_a_session_is_shown_with_its_picture(page: Page, served: Served) -> None:
    path = small.after(served.client, 2, name="the kitchen's cabinet")
    page.goto(served.url)
    shown = card(page, "the kitchen's cabinet")
    expect(shown.locator(".word")).to_have_text("paused")
    expect(shown.locator(".iteration")).to_have_text("2 of 2")
    expect(shown.locator(".certain")).to_have_text("not at rest yet")
    expect(shown.locator(".method")).to_have_text("belief propagation")
    expect(page.get_by_role("status").first).to_have_text("1 kept, 0 running")
    expect(shown.get_by_role("link")).to_have_attribute("href", served.client.get(path).json()["view_url"] + "?play")
    picture = shown.get_by_role("img", name="drawn over its scan")
    picture.wait_for()
    seen = pixels(picture).reshape(-1, 3).astype(float)
    # greys of the scan and the colours of four parts: far from one colour, and far from grey in places
    assert seen.std(axis=0).min() > 10
    assert ((seen.max(axis=1) - seen.min(axis=1)) > 60).mean() > 0.02


def test_the_numbers_of_a_session_that_iterates_change(page: Page, served: Served) -> None:
    path = small.create(served.client, name="busy")
    page.goto(served.url)
    shown = card(page, "busy")
    expect(shown.locator(".word")).to_have_text("paused")
    served.client.post(f"{path}/run", json={"iterations": 100_000})
    expect(shown.locator(".word")).to_have_text(re.compile("searching|settling|at rest, going on"))
    expect(page.get_by_role("status").first).to_have_text("1 kept, 1 running")
    first = shown.locator(".iteration").inner_text()
    expect(shown.locator(".iteration")).not_to_have_text(first)
    second = shown.locator(".iteration").inner_text()
    expect(shown.locator(".iteration")).not_to_have_text(second)
    third = shown.locator(".iteration").inner_text()
    numbers = [int(text.split(" of ")[0].replace("\u202f", "")) for text in (first, second, third)]
    assert numbers == sorted(set(numbers))
    served.client.post(f"{path}/pause")
    expect(shown.locator(".word")).to_have_text(re.compile("paused|at rest"))


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_colours_are_those_that_the_reader_asks_for(
    new_page: Callable[..., Page], served: Served, scheme: str
) -> None:
    small.create(served.client, name="in colour")
    page = new_page(color_scheme=scheme)
    page.goto(served.url)
    card(page, "in colour").wait_for()
    corner = pixels(page)[-1, 0].mean()
    assert corner > 220 if scheme == "light" else corner < 40
    for selector in (
        "h1",
        "#summary",
        ".card .name",
        ".card .word",
        ".card dt",
        ".hint",
        ".drop strong",
        ".button.main",
    ):
        assert contrast(page, selector) >= 4.5, selector


@pytest.mark.parametrize("size", [DESK, PHONE, {"width": 820, "height": 1180}], ids=["desk", "phone", "tablet"])
def test_nothing_is_cut_off_nor_lies_over_something_else(
    new_page: Callable[..., Page], served: Served, size: dict[str, int]
) -> None:
    model_id, scan_id = small.upload_model(served.client), small.upload_scan(served.client)
    for name in ("a", "a session with a rather long name that says where it was, when it was, and why" * 2, "x" * 150):
        path = small.create(served.client, name=name, model_id=model_id, scan_id=scan_id)
    recording = served.client.get(f"{path}/recording").content
    served.client.post("/api/v1/recordings", files={"file": (f"{'long' * 18}.sqlite", recording)})
    page = new_page(viewport=size, has_touch=size is PHONE)
    page.goto(served.url)
    card(page, "xxx").wait_for()
    for summary in page.locator("summary").all():
        summary.click()
    page.get_by_label("about where I say").check()
    assert not scrolls_sideways(page)
    boxes = [
        box.bounding_box()
        for box in page.locator(".card, .entries li, .new, .title h1, .programs").all()
        if box.is_visible()
    ]
    assert len(boxes) > 8
    for place, one in enumerate(boxes):
        assert one is not None and one["x"] >= 0 and one["x"] + one["width"] <= size["width"]
        for other in boxes[:place]:
            assert other is not None
            apart = (
                one["x"] + one["width"] <= other["x"] + 1
                or other["x"] + other["width"] <= one["x"] + 1
                or one["y"] + one["height"] <= other["y"] + 1
                or other["y"] + other["height"] <= one["y"] + 1
            )
            assert apart, (one, other)


def test_the_link_with_the_token_logs_in(
    new_page: Callable[..., Page], serve_for_module: Callable[..., Served], troubles: Troubles
) -> None:
    guarded = serve_for_module(token="a-secret-of-this-test").ready()
    small.create(guarded.client, name="guarded")
    stranger = new_page()
    troubles.expect("401")
    stranger.goto(guarded.url)
    expect(stranger.locator("body")).to_contain_text("a token is needed")
    expect(stranger.locator("body")).to_contain_text("open the link that the server printed")
    assert stranger.get_by_text("guarded").count() == 0

    page = new_page()
    page.goto(f"{guarded.url}/?token=a-secret-of-this-test")
    card(page, "guarded").wait_for()
    assert "token" not in page.url and "a-secret" not in page.content()
    page.get_by_role("img", name="drawn over its scan").wait_for()  # pictures come by the cookie, too
    again = page.context.new_page()
    again.goto(guarded.url)
    card(again, "guarded").wait_for()
    # and what changes something
    again.get_by_role("button", name="Delete the session guarded").click()
    again.get_by_role("dialog").get_by_role("button", name="Delete").click()
    expect(again.locator(".card")).to_have_count(0)
    assert sessions(guarded) == []
    # a page whose cookie is gone says what the server says
    page.context.clear_cookies()
    expect(page.get_by_role("alert").first).to_contain_text("a token is needed")


def test_a_session_is_deleted_only_when_that_was_meant(page: Page, served: Served, troubles: Troubles) -> None:
    path = small.create(served.client, name="to go")
    page.goto(served.url)
    button = page.get_by_role("button", name="Delete the session to go")
    dialog = page.get_by_role("dialog", name="Delete this session?")
    button.focus()
    page.keyboard.press("Enter")
    expect(dialog).to_contain_text("“to go” stops after its present iteration")
    expect(dialog.get_by_role("button", name="Keep")).to_be_focused()
    page.keyboard.press("Escape")
    expect(dialog).to_be_hidden()
    expect(button).to_be_focused()
    page.keyboard.press("Enter")
    page.keyboard.press("Enter")  # "Keep"
    expect(dialog).to_be_hidden()
    assert served.client.get(path).status_code == 200
    # its model is in use, and says so
    page.get_by_text("Models and scans").click()
    page.get_by_role("button", name="Delete the model cabinet.urdf").click()
    troubles.expect("409")
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    expect(page.locator("#trouble")).to_contain_text("is used by session")
    button.click()
    dialog.get_by_role("button", name="Delete").click()
    expect(page.locator(".card")).to_have_count(0)
    expect(page.get_by_text("No session yet")).to_be_visible()
    assert served.client.get(path).status_code == 404
    page.get_by_role("button", name="Delete the model cabinet.urdf").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    expect(page.get_by_role("button", name="Delete the model cabinet.urdf")).to_have_count(0)
    assert served.client.get("/api/v1/models").json() == []


def test_everything_has_a_name_and_can_be_reached_by_keyboard(page: Page, served: Served) -> None:
    small.create(served.client, name="only one")
    page.goto(served.url)
    card(page, "only one").wait_for()
    for summary in page.locator("summary").all():
        summary.click()
    page.get_by_label("about where I say").check()
    nameless = page.evaluate(
        """() => [...document.querySelectorAll("input, select, textarea, button, a[href]")]
          .filter((one) => one.checkVisibility() && !one.ariaLabel && !one.labels?.length && !one.textContent.trim())
          .map((one) => one.outerHTML)"""
    )
    assert nameless == []
    page.locator("body").click(position={"x": 1, "y": 1})
    reached: list[str] = []
    for _ in range(80):
        page.keyboard.press("Tab")
        reached.append(
            page.evaluate(
                "document.activeElement.id || document.activeElement.className || document.activeElement.value"
            )
        )
        outlined = "getComputedStyle(document.activeElement).outlineStyle !== 'none'"
        around = "['.card', '.drop'].some((s) => document.activeElement.closest(s)) || "
        assert page.evaluate(around + outlined) or page.evaluate("document.activeElement === document.body"), reached[
            -1
        ]
    wanted = {
        "open",
        "delete",
        "sample",
        "open-sample",
        "files",
        "camera-text",
        "model",
        "name",
        "prior-text",
        "prior-file",
        "bounds",
        "no-region",
        "method",
        "preset",
        "particles",
        "iterations",
        "seed",
        "button main wide",
    }
    assert wanted <= set(reached)


def test_a_lost_server_is_said_and_comes_back_by_itself(page: Page, served: Served, troubles: Troubles) -> None:
    small.create(served.client, name="still there")
    page.goto(served.url)
    card(page, "still there").wait_for()
    troubles.expect("ERR_FAILED")
    page.route("**/api/v1/sessions", lambda route: route.abort())
    expect(page.locator("#trouble")).to_have_text("The server does not answer; this page tries again.")
    expect(card(page, "still there")).to_be_visible()
    page.unroute("**/api/v1/sessions")
    expect(page.locator("#trouble")).to_be_hidden()


@pytest.mark.parametrize(
    ("ask", "found"),
    [
        ("fetch('/no-such-page')", "status of 404 (Not Found) ({url}/no-such-page)"),
        (
            "document.body.append(Object.assign(new Image(), {src: '/no.png'}))",
            "status of 404 (Not Found) ({url}/no.png)",
        ),
        ("fetch('/gone').catch(() => {})", "ERR_FAILED ({url}/gone)"),
        ("Promise.reject(new Error('not caught'))", "script: not caught"),
    ],
)
def test_a_page_has_a_trouble_where_it_asks_in_vain(
    page: Page, served: Served, troubles: Troubles, ask: str, found: str
) -> None:
    page.route("**/gone", lambda route: route.abort())
    page.goto(served.url)
    page.evaluate(f"() => {{ {ask}; }}")
    wait(page, lambda: bool(troubles.found))
    troubles.expect(found.format(url=served.url))
    assert not troubles.unexpected()


def test_samples_are_listed_and_made_over_rest(served: Served) -> None:
    listed = served.client.get("/api/v1/samples").json()
    assert [sample["scene"] for sample in listed][:2] == ["open", "self_occluded"]
    assert {"from_above", "robot_partial"} < {sample["scene"] for sample in listed}
    client: httpx.Client = served.client
    made = [client.post("/api/v1/sessions/sample", json={"scene": "door", "run": False}) for _ in range(2)]
    assert [answer.status_code for answer in made] == [201, 201]
    assert made[0].headers["location"] == f"/api/v1/sessions/{made[0].json()['id']}"
    assert made[0].json()["state"] == "paused" and made[0].json()["iteration"] == 0
    assert len(sessions(served)) == 2
    # the same model and scan, kept once
    assert len(client.get("/api/v1/models").json()) == len(client.get("/api/v1/scans").json()) == 1
    refused = client.post("/api/v1/sessions/sample", json={"scene": "kitchen"})
    assert refused.status_code == 422 and "'open'" in refused.json()["detail"]


def test_the_letters_are_the_server_s_own(page: Page, served: Served) -> None:
    answer = served.client.get("/static/fonts/OpenSans-Regular.ttf")
    assert answer.status_code == 200 and answer.headers["content-type"] == "font/ttf"
    page.goto(served.url)
    page.wait_for_function("() => document.fonts.status === 'loaded'")
    assert page.evaluate("() => document.fonts.check('15px \"Open Sans\"') && document.fonts.size") == 2
