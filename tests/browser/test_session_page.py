"""Does a session's page show how a belief forms, go back in time, and tell why? As a person would ask: by clicking,
dragging and pressing keys."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable

import numpy as np
import pytest
from playwright.sync_api import Page, Request, expect

from tests.app import small_sessions as small
from tests.browser.conftest import PATIENCE, PHONE, Troubles, pixels, scrolls_sideways
from tests.browser.session_page import has_colour, opened, parts, tab, view, wait
from tests.servers import Served

expect.set_options(timeout=PATIENCE)

# From now on `labels` has what the button has been called, in order, however briefly
NOTE_LABELS = """(button) => {
  window.labels = [];
  new MutationObserver(() => {
    if (window.labels.at(-1) !== button.ariaLabel) window.labels.push(button.ariaLabel);
  }).observe(button, { attributeFilter: ["aria-label"] });
}"""

# Forms and controls of the page's file, not of a script, that a browser keeps for when somebody comes back
KEPT = ":is(form:not([method=dialog]), input:not(form *), select:not(form *)):not([autocomplete=off])"
KEPT += ":not(#layer-groups *, #settings-groups *, .region-numbers *)"


@pytest.fixture
def session(served: Served) -> str:
    """The path of a session that has made six iterations."""
    return small.after(served.client, 6, name="a cabinet", iterations=12)


@pytest.mark.scene
def test_the_page_shows_state_numbers_and_the_scene(page: Page, served: Served, session: str) -> None:
    opened(page, served, session)
    expect(page.get_by_role("heading", level=1)).to_have_text("a cabinet")
    expect(page.locator("#progress-number")).to_have_text("6")
    estimate = served.client.get(f"{session}/estimate").json()
    for name, (link, *_) in parts(estimate).items():
        row = page.locator("#part-rows tr", has=page.get_by_role("rowheader", name=name))
        expect(row.locator("td").nth(1)).to_have_text(re.compile(f"^{link['visible_fraction'] * 100:.0f}\\s%$"))
        expect(row.locator("td").nth(0)).to_have_text("–")  # not at rest: nothing says how sure it is
        expect(row.locator("td").nth(2)).to_have_text("not yet")
    expect(page.locator("#joints tr")).to_have_count(3)
    wait(page, lambda: (view(page, served)["drawn"] or {}).get("iteration") == 6)
    wait(page, lambda: float(pixels(page.locator("#scene")).std()) > 5)


def test_step_run_and_pause(page: Page, served: Served, session: str) -> None:
    opened(page, served, session)
    page.get_by_role("button", name="Step").click()
    expect(page.locator("#progress-number")).to_have_text("7")
    expect(page.locator("#shown")).to_have_text(re.compile("7 / 7"))
    page.get_by_role("button", name="Run…").click()
    page.get_by_role("spinbutton", name="Iterations", exact=True).fill("3")
    page.locator("#run-some").get_by_role("button", name="Run").click()
    wait(page, lambda: served.client.get(session).json()["iteration"] == 10)
    expect(page.locator("#progress-number")).to_have_text("10")
    page.get_by_role("button", name="Run…").click()
    with page.expect_response("**/run"):  # before that the page and the server still say that it is paused
        page.get_by_role("button", name="Run until at rest").click()
    assert small.at_rest(served.client, session)["iteration"] >= 10
    expect(page.locator("#state-word")).to_have_text(re.compile("paused|at rest"))
    served.client.patch(session, json={"name": "another cabinet"}).raise_for_status()  # as from another page
    expect(page.locator("#name")).to_have_text("another cabinet")
    expect(page).to_have_title(re.compile("^another cabinet"))

    page.locator("#run-open").click()
    page.get_by_role("spinbutton", name="Iterations", exact=True).fill("5000")
    page.get_by_role("spinbutton", name="Iterations", exact=True).press("Enter")
    expect(page.locator("#state-word")).to_have_text(re.compile("searching|settling|at rest, going on"))
    page.get_by_role("button", name="Pause").click()
    expect(page.locator("#state-word")).to_have_text(re.compile("paused|at rest"))
    assert small.at_rest(served.client, session)["state"] == "paused"


def test_reset_asks_first(page: Page, served: Served, session: str) -> None:
    opened(page, served, session)
    page.get_by_role("button", name="Reset").click()
    page.get_by_role("button", name="Keep it").click()
    assert served.client.get(session).json()["iteration"] == 6
    page.get_by_role("button", name="Reset").click()
    page.locator("#really-reset").get_by_role("button", name="Reset").click()
    expect(page.locator("#progress-number")).to_have_text("0")
    expect(page.locator("#shown")).to_have_text(re.compile("0 / 0"))


@pytest.mark.scene
def test_the_timeline_goes_back_while_it_goes_on(page: Page, served: Served, session: str) -> None:
    opened(page, served, session)
    page.get_by_role("slider", name="Iteration").fill("2")
    expect(page.locator("#shown")).to_have_text(re.compile("2 / 6"))
    expect(page.get_by_role("button", name="Live")).to_have_attribute("aria-pressed", "false")
    wait(page, lambda: (view(page, served)["drawn"] or {}).get("iteration") == 2)
    seen = served.client.get(f"{session}/estimate?iteration=2").json()["links"]["frame"]["visible_fraction"]
    expect(page.locator("#part-rows tr").first.locator("td").nth(1)).to_have_text(f"{seen * 100:.0f}\u202f%")
    small.step(served.client, session, 1)
    expect(page.locator("#shown")).to_have_text(re.compile("2 / 7"))
    page.get_by_role("button", name="Live").click()
    expect(page.locator("#shown")).to_have_text(re.compile("7 / 7"))
    wait(page, lambda: view(page, served)["drawn"]["iteration"] == 7)


def test_it_is_played_back(page: Page, served: Served, session: str) -> None:
    opened(page, served, session)
    page.get_by_label("Speed of playing back").select_option("25")
    button = page.get_by_role("button", name="Play back", exact=True)
    # Six iterations take a quarter of a second: less than may lie between two looks of this test at the page
    button.evaluate(NOTE_LABELS)
    button.click()
    wait(page, lambda: page.evaluate("window.labels.slice(-2)") == ["Stop playing back", "Play back"])
    expect(page.locator("#shown")).to_have_text(re.compile("6 / 6"))
    # the browser's Back fills no control with what stood in one, this or another
    page.goto("about:blank")
    page.go_back()
    page.locator("body[data-ready]").wait_for()
    expect(page.get_by_label("Speed of playing back")).to_have_value("5")
    assert page.locator("#compare-at").input_value() == ""
    assert page.locator(KEPT).count() == 0


def test_keys(page: Page, served: Served, session: str) -> None:
    opened(page, served, session)
    page.keyboard.press("ArrowLeft")
    expect(page.locator("#shown")).to_have_text(re.compile("5 / 6"))
    page.keyboard.press("Shift+ArrowLeft")
    expect(page.locator("#shown")).to_have_text(re.compile("0 / 6"))
    page.keyboard.press("ArrowRight")
    expect(page.locator("#shown")).to_have_text(re.compile("1 / 6"))
    page.keyboard.press("l")
    expect(page.locator("#shown")).to_have_text(re.compile("6 / 6"))
    page.keyboard.press("s")
    expect(page.locator("#shown")).to_have_text(re.compile("7 / 7"))
    page.keyboard.press("?")
    expect(page.get_by_role("dialog", name="Keyboard")).to_be_visible()
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog", name="Keyboard")).to_be_hidden()
    expect(page.locator("#state-word")).to_have_text(re.compile("paused|at rest"))
    page.keyboard.press("Space")
    wait(page, lambda: served.client.get(session).json()["iteration"] == 12)
    expect(page.locator("#shown")).to_have_text(re.compile("12 / 12"))


def test_plots_have_a_line_per_part_and_a_cursor(page: Page, served: Served) -> None:
    # a seed with which no line hides another: all spreads are a fifth apart at most iterations
    session = small.after(served.client, 6, name="a cabinet", iterations=12, seed=83)
    opened(page, served, session)
    graph = served.client.get(f"{session}/graph").json()
    plot = page.locator("[data-plot=particle-std] canvas")
    wait(page, lambda: all(has_colour(plot, part["colour"]) for part in graph["parts"]))
    expect(page.locator(".plot:visible")).to_have_count(5)
    before = pixels(plot)
    box = plot.bounding_box()
    assert box is not None
    page.mouse.click(box["x"] + 34 + (box["width"] - 42) / 2, box["y"] + 40)
    expect(page.locator("#shown")).to_have_text(re.compile("3 / 6"))
    wait(page, lambda: not np.array_equal(pixels(plot), before))


def test_a_shared_link_shows_the_same(page: Page, served: Served, session: str, new_page: Callable[..., Page]) -> None:
    opened(page, served, session, "?camera=2,2,2,0.5,0.3,0.4,0,0,1")
    page.get_by_role("slider", name="Iteration").fill("4")
    page.get_by_role("button", name=re.compile("^drawer1, ")).click()
    panel = tab(page, "Share")
    link = panel.get_by_label("Link to this session, iteration and camera")
    expect(link).to_have_value(re.compile(r"iteration=4.*part=drawer1.*camera=(1\.9|2)"))
    expect(panel.locator("#share-curl")).to_contain_text("beliefs/drawer1?iteration=4")
    for name in ("Recording", "Picture", "Estimate", "3D scene"):
        path = panel.get_by_role("link", name=name).get_attribute("href")
        assert path and served.client.get(path).status_code == 200
    theirs = new_page()
    theirs.goto(link.input_value())
    theirs.locator("body[data-ready]").wait_for()
    expect(theirs.locator("#shown")).to_have_text(re.compile("4 / 6"))
    expect(theirs.get_by_role("heading", name="drawer1", exact=True)).to_be_visible()
    # a view has a camera of its own until the page has been heard
    wait(theirs, lambda: np.allclose((view(theirs, served)["camera"] or {}).get("position", 0), [2, 2, 2], atol=0.05))
    assert theirs.locator("#scene").get_attribute("src") != page.locator("#scene").get_attribute("src")


def test_a_failed_session_shows_the_sentence(page: Page, served: Served) -> None:
    path = small.create(served.client, name="damaged")
    opened(page, served, path)
    session = served.app.state.sessions.get(path.rsplit("/", 1)[1])
    session.step().result()
    session._submit(lambda: session._fail(RuntimeError("a stone in the gears"))).result()
    expect(page.locator("#trouble")).to_contain_text("a stone in the gears")
    expect(page.locator("#state-word")).to_have_text("stopped by an error")


def test_a_session_that_is_not_there(page: Page, served: Served, troubles: Troubles) -> None:
    troubles.expect("404")
    page.goto(f"{served.url}/sessions/nothing/")
    expect(page.locator("#trouble")).to_contain_text("nothing")
    expect(page.get_by_role("link", name="All sessions")).to_be_visible()


def test_a_session_that_is_deleted_is_asked_for_no_more(
    page: Page, served: Served, session: str, troubles: Troubles
) -> None:
    opened(page, served, session)
    expect(page.get_by_role("button", name="Set up")).to_be_visible()
    troubles.expect("404")
    served.client.delete(session).raise_for_status()
    expect(page.get_by_role("alert").first).to_have_text(re.compile("This session is not here any more."))
    expect(page.locator("#verdict-rest")).to_have_text("What is shown is the last that was heard of it")
    for name in ("Run", "Step", "Reset", "Live"):
        expect(page.get_by_role("button", name=name, exact=True)).to_be_disabled()
    expect(page.get_by_role("button", name="Set up")).to_be_hidden()
    expect(tab(page, "Settings").get_by_label("tolerance end")).to_be_disabled()
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.get_by_role("slider", name="Iteration").fill("2")
    page.wait_for_timeout(3000)  # longer than it takes to try anything again
    assert [url for url in asked if "/api/" in url] == []


def test_a_lost_connection_comes_back(page: Page, served: Served, session: str, troubles: Troubles) -> None:
    opened(page, served, session, "?iteration=3&part=drawer2")
    expect(page.locator("#shown")).to_have_text(re.compile("3 / 6"))
    troubles.expect("INTERNET_DISCONNECTED")
    page.context.set_offline(True)
    page.keyboard.press("s")
    expect(page.locator("#trouble")).to_contain_text("The connection to the server is lost")
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.get_by_role("slider", name="Iteration").fill("5")
    page.wait_for_timeout(2500)
    assert 1 <= sum("/estimate?iteration=5" in url for url in asked) <= 2  # in no hurry
    page.context.set_offline(False)
    expect(page.locator("#trouble")).to_be_hidden()


# Whether somebody sees the page, as a browser says it of a tab behind others
SEEN = """(seen) => {
  Object.defineProperty(document, "hidden", { configurable: true, get: () => !seen });
  document.dispatchEvent(new Event("visibilitychange"));
}"""


def test_a_page_that_nobody_sees_leaves_its_connections_to_others(page: Page, served: Served, session: str) -> None:
    """A browser has six to a server, for all of its pages; what happened meanwhile is there when it is seen again."""
    streams: list[Request] = []
    page.on("request", lambda request: request.url.split("?")[0].endswith("/events") and streams.append(request))
    ended: list[Request] = []
    page.on("requestfailed", lambda request: request in streams and ended.append(request))
    opened(page, served, session, "?part=drawer2")
    wait(page, lambda: len(streams) == 2)
    page.evaluate(SEEN, False)
    wait(page, lambda: len(ended) == 2)
    served.client.post(f"{session}/step", json={"iterations": 2}).raise_for_status()
    layers = "/".join((page.locator("#scene").get_attribute("src") or "").split("/")[2:5:2])
    session_id, view_id = layers.split("/")
    served.client.patch(f"/api/v1/sessions/{session_id}/views/{view_id}", json={"show": {"ellipsoids": False}})
    page.evaluate(SEEN, True)
    wait(page, lambda: len(streams) == 4)
    expect(page.locator("#progress-number")).to_have_text("8")
    panel = tab(page, "Layers")
    expect(
        panel.get_by_label("covariance ellipsoids")
    ).not_to_be_checked()  # what a program has changed is not changed back
    assert view(page, served)["part"] == "drawer2" and len(ended) == 2


def test_a_long_name_is_cut_and_pushes_nothing_out_of_sight(page: Page, served: Served) -> None:
    session = small.after(served.client, 1, name="a fridge with two doors " * 8)
    opened(page, served, session)
    width = page.evaluate("innerWidth")
    for place in (page.get_by_role("button", name="Run", exact=True), page.get_by_role("tab", name="Belief")):
        box = place.bounding_box()
        assert box and box["x"] + box["width"] <= width
    assert page.get_by_role("heading", level=1).evaluate("(name) => name.scrollWidth > name.clientWidth")


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_phone_shows_it_all_in_one_column(
    new_page: Callable[..., Page], served: Served, session: str, scheme: str
) -> None:
    page = opened(new_page(viewport=PHONE, color_scheme=scheme), served, session)
    assert not scrolls_sideways(page)
    boxes = [page.locator(place).bounding_box() for place in (".bar", "#scene", ".timeline", ".side", "#plots")]
    found = [box for box in boxes if box]
    assert len(found) == 5
    for above, below in itertools.pairwise(found):
        assert above["y"] + above["height"] <= below["y"] + 1
    split, run, more = (page.locator(place).bounding_box() for place in (".split", "#play", "#run-open"))
    assert split and run and more and run["width"] + more["width"] == pytest.approx(split["width"], abs=2)
    assert more["width"] < run["width"] / 2
    assert found[1]["height"] == pytest.approx(0.48 * PHONE["height"], abs=2)
    for name in ("Why", "Layers", "Settings", "Compare", "Share"):
        tab(page, name)
        assert not scrolls_sideways(page)
    ground = pixels(page.locator(".side"))[-5, 5].mean()
    assert ground > 200 if scheme == "light" else ground < 60


def test_every_control_has_a_name(page: Page, served: Served, session: str) -> None:
    opened(page, served, session)
    nameless = page.evaluate(
        """() => [...document.querySelectorAll("button, input, select, a[href], iframe, canvas, [role=button]")]
          .filter((one) => !(one.textContent.trim() || one.getAttribute("aria-label") || one.title
            || one.getAttribute("aria-labelledby") || one.labels?.length)).map((one) => one.outerHTML)"""
    )
    assert nameless == []


@pytest.mark.scene
def test_a_recording_is_looked_at_on_the_same_page(page: Page, served: Served, session: str) -> None:
    content = served.client.get(f"{session}/recording").content
    made = served.client.post("/api/v1/recordings", files={"file": ("kept.sqlite", content)}).json()
    page.goto(f"{served.url}/sessions/{made['id']}/")
    page.locator("body[data-ready]").wait_for()
    expect(page.locator("#state-word")).to_have_text("recording")
    expect(page.get_by_role("group", name="Inference")).to_be_hidden()
    expect(page.locator("#part-rows tr")).to_have_count(4)
    page.get_by_role("slider", name="Iteration").fill("1")
    wait(page, lambda: (view(page, served)["drawn"] or {}).get("iteration") == 1)
