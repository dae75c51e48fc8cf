"""Do the tabs at the side of a session's page answer what they are asked?"""

from __future__ import annotations

import re

import numpy as np
import pytest
from playwright.sync_api import Page, Route, expect

from tests.app import small_sessions as small
from tests.browser.conftest import PATIENCE, Troubles, pixels
from tests.browser.session_page import opened, tab, view, wait, written
from tests.servers import Served

expect.set_options(timeout=PATIENCE)

# The page then has another graph: two chains, with branches to either side of the first node.
DEEP_GRAPH = """async () => {
  const loaded = performance.getEntriesByType("resource").find(({ name }) => name.endsWith("/session/state.js"));
  const { update } = await import(loaded.name);
  const names = ["a", "b", "c", "d", "e", "f", "g", "h", "i"];
  const edge = (parent, child) => ({ parent, child, joints: [{ name: child, type: "continuous" }] });
  const pairs = [["a", "b"], ["b", "c"], ["c", "d"], ["d", "e"], ["a", "f"], ["f", "g"], ["a", "h"], ["h", "i"]];
  const parts = names.map((name) => ({ name, links: [name], colour: null, colour_dark: null }));
  update({ graph: { parts, edges: pairs.map((pair) => edge(...pair)), views: 1, truth: false } });
}"""


# Of texts in the graph: left, top, right, bottom, without what is drawn around the letters
BOXES = """(texts) => texts.map((text) => {
  const { x, y, width, height } = text.getBBox();
  return [x, y, x + width, y + height];
})"""


@pytest.fixture
def session(served: Served) -> str:
    """The path of a session that has made six iterations."""
    return small.after(served.client, 6, name="a cabinet", iterations=12)


def test_the_graph_opens_a_belief(page: Page, served: Served, session: str) -> None:
    opened(page, served, session)
    node = page.get_by_role("button", name="drawer2, not certain, standard deviation unknown")
    node.focus()
    page.keyboard.press("Enter")
    expect(node).to_have_attribute("aria-pressed", "true")
    expect(page.get_by_role("heading", name="drawer2", exact=True)).to_be_visible()
    names = [one["name"] for one in served.client.get(f"{session}/beliefs/drawer2/marginals").json()["marginals"]]
    assert {"x", "y", "z", "roll", "pitch", "yaw"} < set(names)
    expect(page.locator("#marginals figure")).to_have_count(len(names))
    expect(page.locator("#particle-modes li").first).to_be_visible()
    count = len(served.client.get(f"{session}/estimate").json()["links"]["drawer2"]["particle_modes"])
    expect(page.locator("#particle-modes-title")).to_have_text(re.compile(rf"^{count} clusters? among the particles$"))
    expect(page.locator("#modes-title")).to_have_text("hypotheses")
    expect(page.locator("#modes-calm")).to_have_text("None are read out before the inference is at rest.")
    wait(page, lambda: view(page, served)["part"] == "drawer2")
    page.get_by_role("button", name="Back to all parts").click()
    expect(page.locator("#part-rows tr")).to_have_count(4)
    # in a deep tree no edge's word lies under a node's ring
    page.evaluate(DEEP_GRAPH)
    expect(page.locator(".edge-label")).to_have_count(8)
    words = page.locator(".edge-label").evaluate_all(BOXES)
    rings = page.locator(".rail").evaluate_all(BOXES)
    for one in words:
        for left, top, right, bottom in rings:
            middle, radius = ((left + right) / 2, (top + bottom) / 2), (right - left) / 2
            near = np.clip(middle, one[:2], one[2:])
            assert np.linalg.norm(near - np.array(middle)) >= radius
        assert (
            sum(one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3] for other in words)
            == 1
        )


def test_an_edge_opens_its_two_messages(page: Page, served: Served, session: str) -> None:
    opened(page, served, session)
    page.get_by_role("button", name=re.compile("between frame and drawer3")).click()
    expect(page.get_by_role("heading", name="frame says where drawer3 is")).to_be_visible()
    expect(page.get_by_role("heading", name="drawer3 says where frame is")).to_be_visible()
    expect(page.locator(".message .scatter circle").first).to_be_attached()
    wait(page, lambda: view(page, served)["edge"] == ["frame", "drawer3"])
    wait(page, lambda: view(page, served)["show"]["messages"])


def test_why_a_particle_weighs_what_it_does(page: Page, served: Served, session: str) -> None:
    opened(page, served, session)
    panel = tab(page, "Why")
    panel.get_by_role("button", name="drawer1", exact=True).click()
    best = served.client.get(f"{session}/beliefs/drawer1/particles?limit=3").json()["particles"]
    rows = panel.get_by_role("list").locator("[data-part=drawer1]")
    expect(rows.nth(2)).to_have_attribute("data-index", str(best[2]["index"]))
    rows.first.click()
    expect(panel.get_by_role("heading", name=f"drawer1, particle {best[0]['index']}")).to_be_visible()
    expect(panel.locator("#why-shares")).to_contain_text("the scan (unary)")
    expect(panel.locator("#why-shares")).to_contain_text("frame’s message")
    picture = panel.get_by_role("img", name=re.compile("Observed depth"))
    expect(picture).to_be_visible()
    assert pixels(picture).std() > 10
    wait(page, lambda: view(page, served)["particle"] == best[0]["index"])

    why = served.client.get(f"{session}/beliefs/drawer1/particles/{best[0]['index']}").json()
    panel.locator("#ancestor").click()
    expect(page.locator("#shown")).to_have_text(re.compile("5 / 6"))
    expect(panel.get_by_role("heading", level=2)).to_have_text(f"{why['ancestor_part']}, particle {why['ancestor']}")


def test_a_particle_chosen_by_a_program_is_explained(page: Page, served: Served, session: str) -> None:
    opened(page, served, session)
    name = (page.locator("#scene").get_attribute("src") or "").split("/")[4]
    changed = served.client.patch(f"{session}/views/{name}", json={"part": "drawer3", "particle": 7})
    assert changed.status_code == 200, changed.text
    expect(page.get_by_role("tab", name="Why")).to_have_attribute("aria-selected", "true")
    expect(page.get_by_role("heading", name="drawer3, particle 7")).to_be_visible()


def test_an_answer_that_an_event_overtook_changes_nothing(page: Page, served: Served, session: str) -> None:
    """The event holds, also in what the page had on its way itself: whether it is hidden."""
    opened(page, served, session)
    name = (page.locator("#scene").get_attribute("src") or "").split("/")[4]
    seen = page.get_by_role("heading", name="drawer3, particle 7")
    other = {"part": "drawer3", "particle": 7, "hidden": True}
    held: list[Route] = []

    def hold(route: Route) -> None:
        """Keep the answer to the page's own change back until the page has heard of a later one."""
        answer = route.fetch()
        if not held:
            served.client.patch(f"{session}/views/{name}", json=other).raise_for_status()
            expect(seen).to_be_visible()
            held.append(route)
        route.fulfill(response=answer)

    page.route(f"**/views/{name}", hold)
    page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")  # the page says whether it is hidden
    wait(page, lambda: bool(held))
    page.wait_for_timeout(300)
    expect(seen).to_be_visible()
    own = "performance.getEntriesByType('resource').find(({ name }) => name.endsWith('/session/state.js')).name"
    shown = page.evaluate(f"import({own}).then(({{ state }}) => state.view)")
    assert {member: shown[member] for member in other} == other
    assert view(page, served)["particle"] == 7


def test_what_sensor_and_model_have_wrong(page: Page, served: Served) -> None:
    session = small.after(served.client, 6, config=small.QUICK | {"depth_scale_std": 0.01, "sensor": "stereo"})
    found = served.client.get(f"{session}/estimate").json()
    scale = found["nuisances"]["depth_scale/0"]
    opened(page, served, session)
    rows = page.get_by_role("table", name="Sensor and model").get_by_role("row")
    expect(rows).to_have_count(3)
    expect(rows.nth(1).get_by_role("rowheader")).to_have_text("depth noise")
    expect(rows.nth(1).get_by_role("cell")).to_have_text(["–", f"± {written(found['depth_noise'][0])}", ""])
    shared = "import('/static/session/sensor_and_model.js').then((the) => the.sensorAndModel(told)[0][0])"
    told = found | {"depth_noise_area": [7.53]}
    assert page.evaluate(f"(told) => {shared}", told) == "depth noise, 7.5 pixels as one"
    second = shared.replace("[0][0]", "[1].join()")
    assert (
        page.evaluate(f"(told) => {second}", told | {"depth_distortion": [0.0015]})
        == "depth distortion,–,± 0.15\u202fcm,"
    )
    # adding zero takes the sign from a zero
    value = f"{round(100 * scale['value'], 2) + 0.0:.2f}".replace("-", "\u2212")
    expect(rows.nth(2).get_by_role("cell")).to_have_text(
        [f"{value}\u202f%", f"± {100 * scale['std']:.2f}\u202f%", "± 1.00\u202f%"]
    )


def test_layers(page: Page, served: Served, session: str) -> None:
    opened(page, served, session)
    panel = tab(page, "Layers")
    panel.get_by_role("switch", name="support planes").check()
    panel.get_by_role("switch", name="points of the scan").uncheck()
    panel.get_by_role("button", name="explained", exact=True).click()
    panel.get_by_role("button", name="by weight").click()
    panel.get_by_label("Confidence").fill("90")
    expect(panel.locator("#confidence-text")).to_contain_text("90")
    wait(page, lambda: view(page, served)["confidence"] == 0.9)
    shown = view(page, served)
    assert shown["show"]["planes"] and not shown["show"]["scan"]
    assert (shown["colour_scan"], shown["colour_particles"]) == ("explained", "weight")
    expect(panel.get_by_role("switch", name="truth")).to_be_disabled()


def test_a_session_begins_anew_with_another_region(page: Page, served: Served, session: str) -> None:
    opened(page, served, session)
    panel = tab(page, "Layers")
    panel.get_by_role("switch", name="region of interest").check()
    corner = panel.get_by_label("largest z of the region, centimetres")
    expect(corner).to_have_value(f"{small.ROI[5] * 100:.1f}")
    corner.fill("70")
    corner.press("Tab")
    wait(page, lambda: (view(page, served)["region"] or [0])[-1] == 0.7)
    before = page.url
    panel.get_by_role("button", name="Start a new session with this region").click()
    page.wait_for_url(lambda url: url.split("?")[0] != before.split("?")[0])
    page.locator("body[data-ready]").wait_for()
    made = served.client.get("/api/v1/sessions/" + page.url.split("/")[4]).json()
    assert made["roi"] == [*small.ROI[:5], 0.7]


def test_settings_count_from_the_next_iteration(page: Page, served: Served, session: str, troubles: Troubles) -> None:
    opened(page, served, session)
    panel = tab(page, "Settings")
    field = panel.get_by_label("tolerance end")
    field.fill("2")
    field.press("Tab")
    wait(page, lambda: served.client.get(session).json()["config"].get("tolerance_end") == 0.02)
    expect(page.locator(".mark.change")).to_have_count(1)
    troubles.expect("422")
    field.fill("-1")
    field.press("Tab")
    expect(panel.get_by_role("alert").filter(has_text="at least 0.0001")).to_be_visible()
    panel.get_by_role("button", name="Reset tolerance_end to 1.2 cm").click()
    wait(page, lambda: served.client.get(session).json()["config"].get("tolerance_end") == 0.012)
    panel.get_by_role("button", name="paper").click()
    wait(page, lambda: served.client.get(session).json()["config"].get("preset") == "paper")
    expect(panel.get_by_label("pixel score")).to_have_value("distance")


def test_an_emptied_setting_is_what_it_was(page: Page, served: Served, session: str, troubles: Troubles) -> None:
    opened(page, served, session)
    panel = tab(page, "Settings")
    field = panel.get_by_label("tolerance end")
    troubles.expect("422")
    field.fill("99999")
    field.press("Enter")
    wrong = panel.get_by_role("alert").filter(has_text="is 999.99; it must be at most 100.0 m")
    expect(wrong).to_be_visible()
    field.fill("")
    field.press("Enter")
    expect(wrong).to_be_hidden()
    expect(field).to_have_value("1.2")
    panel.get_by_label("particles per part").fill("")
    panel.get_by_role("button", name="Start a new session with these").click()
    page.wait_for_timeout(300)
    assert served.client.get(session).json()["view_url"] in page.url  # the browser asks for a number


def test_numbers_that_make_no_region_are_told_until_they_do(page: Page, served: Served, session: str) -> None:
    opened(page, served, session)
    page.get_by_role("button", name="Set up").click()
    page.get_by_text("Advanced").click()
    smallest, largest = (page.locator(f"#setup-numbers [data-at='{at}']") for at in (0, 3))
    expect(largest).not_to_have_value("")
    end = float(largest.input_value())
    smallest.fill(str(end + 100))
    smallest.press("Enter")
    wrong = page.locator("#trouble")
    expect(wrong).to_contain_text(f"would go from {end + 100:g} to ")
    smallest.fill(str(end - 50))
    smallest.press("Enter")
    expect(wrong).to_be_hidden()
    wait(page, lambda: abs(view(page, served)["region"][0] - (end - 50) / 100) < 1e-6)
    page.locator("#setup-particles").fill("1")
    page.locator("#setup-run").click()
    expect(page.locator("#setup-error")).to_have_text("particles is 1; expected a whole number from 2 to 20000.")
    page.locator("#setup-particles").fill("40")
    page.locator("#setup-particles").press("Tab")
    expect(page.locator("#setup-error")).to_be_hidden()


def test_an_answer_that_comes_late_hides_nothing_of_what_is_wrong_since(
    page: Page, served: Served, session: str, troubles: Troubles
) -> None:
    opened(page, served, session)
    panel = tab(page, "Settings")
    field = panel.get_by_label("tolerance end")
    held: list[Route] = []

    def hold(route: Route) -> None:
        """Keep the first change on its way."""
        if route.request.method == "PATCH" and not held:
            held.append(route)
        else:
            route.continue_()

    page.route(f"**{session}", hold)
    field.fill("2")
    field.press("Tab")
    wait(page, lambda: bool(held))
    troubles.expect("422")
    field.fill("-1")
    field.press("Tab")
    page.wait_for_timeout(300)  # in which a change that does not wait for the one before would be refused
    held[0].continue_()
    wait(page, lambda: served.client.get(session).json()["config"].get("tolerance_end") == 0.02)
    page.wait_for_timeout(300)
    expect(panel.get_by_role("alert").filter(has_text="at least 0.0001")).to_be_visible()


def test_another_method_or_particle_count_begins_a_new_session(page: Page, served: Served, session: str) -> None:
    opened(page, served, session)
    panel = tab(page, "Settings")
    panel.get_by_label("method").select_option("particle filter")
    panel.get_by_label("particles per part").fill("30")
    panel.get_by_label("particles per part").blur()
    # what else the session does leaves it as it was chosen
    served.client.patch(session, json={"config": {"joint_draws": 4}}).raise_for_status()
    expect(page.locator(".mark.change")).to_have_count(1)
    before = page.url.split("?")[0]
    panel.get_by_role("button", name="Start a new session with these").click()
    page.wait_for_url(lambda url: url.split("?")[0] != before)
    made = served.client.get("/api/v1/sessions/" + page.url.split("/")[4]).json()
    assert (made["particles"], made["method"]) == (30, "particle_filter")
    page.locator("body[data-ready]").wait_for()


def test_compare_with_another_session(page: Page, served: Served, session: str) -> None:
    other = small.after(served.client, 4, name="the other", seed=5)
    opened(page, served, session)
    panel = tab(page, "Compare")
    panel.get_by_label("Compare with").select_option(label="the other (4)")
    mine, its = (served.client.get(f"{path}/estimate").json() for path in (session, other))
    apart = [
        mine["links"]["frame"]["pose"]["position"][axis] - its["links"]["frame"]["pose"]["position"][axis]
        for axis in "xyz"
    ]
    distance = float(np.linalg.norm(apart))
    row = panel.locator("#compare-links tr").first
    expect(row.locator("td").first).to_have_text(re.compile(re.escape(written(distance))))
    wait(page, lambda: (view(page, served)["compare"] or {}).get("session_id") == other.rsplit("/", 1)[1])
    panel.get_by_role("switch", name="follow this timeline").check()
    page.get_by_role("slider", name="Iteration").fill("2")
    expect(panel.locator("#compare-what")).to_have_text("Iteration 2 here, iteration 2 there")
    panel.get_by_role("switch", name="follow this timeline").uncheck()
    # beyond the other's newest iteration that one is shown, and stands in the field
    panel.get_by_label("at iteration").fill("500")
    panel.get_by_label("at iteration").press("Enter")
    expect(panel.locator("#compare-what")).to_have_text("Iteration 2 here, iteration 4 there")
    expect(panel.get_by_label("at iteration")).to_have_value("4")
    wait(page, lambda: view(page, served)["compare"]["iteration"] == 4)
    # as of another model
    strange = its | {"iteration": 1, "links": {}, "joints": {}}
    page.route(f"**{other}/estimate?iteration=1", lambda route: route.fulfill(json=strange))
    panel.get_by_label("at iteration").fill("1")
    panel.get_by_label("at iteration").press("Enter")
    expect(panel.get_by_text("No link and no joint of the two has the same name")).to_be_visible()
    expect(panel.get_by_role("table")).to_have_count(0)
    panel.get_by_role("button", name="Stop comparing").click()
    wait(page, lambda: view(page, served)["compare"] is None)


def test_panel_and_plots_take_the_room_they_are_given(page: Page, served: Served, session: str) -> None:
    opened(page, served, session)

    def room() -> tuple[float, float]:
        side, plot = page.locator("#details").bounding_box(), page.locator("#plots canvas").first.bounding_box()
        assert side is not None
        assert plot is not None
        return side["width"], plot["height"]

    (wide, high), edge = room(), page.get_by_role("separator", name="Width of the details")
    box = edge.bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + 200
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x - 60, y, steps=4)  # over the 3D view, which must not swallow it
    page.mouse.up()
    assert room()[0] == pytest.approx(wide + 60, abs=5)
    page.get_by_role("separator", name="Height of the plots").press("ArrowUp")
    assert room()[1] == pytest.approx(high + 24, abs=1)
    page.reload()
    page.locator("body[data-ready]").wait_for()
    assert room() == pytest.approx((wide + 60, high + 24), abs=5)
    edge.dblclick()
    assert room()[0] == pytest.approx(wide, abs=1)


def test_words_are_explained_where_they_stand_and_in_the_help(page: Page, served: Served, session: str) -> None:
    opened(page, served, session)
    told = page.locator("#part-rows").locator("xpath=..").get_by_role("columnheader", name="visible")
    explained = told.get_attribute("title")
    assert explained
    page.keyboard.press("?")
    expect(page.get_by_role("dialog", name="Keyboard")).to_contain_text(explained)
