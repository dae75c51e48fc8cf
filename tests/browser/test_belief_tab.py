"""Does the page's first tab keep apart what is known and what the algorithm does, set coordinates against each other,
and say from where to look next?"""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np
import pytest
from playwright.sync_api import Page, Route, expect

from pmpnbp.geometry import poses
from tests.app import small_sessions as small
from tests.browser.conftest import PATIENCE, pixels
from tests.browser.scene_pointer import BARE, change, differing, settled
from tests.browser.session_page import at_rest, has_colour, opened, tab, view, wait, written
from tests.servers import Served

expect.set_options(timeout=PATIENCE)


@pytest.fixture(scope="module")
def uncertain(served: Served) -> str:
    """The path of a session at rest that has found the object, and is certain of no link."""
    session = at_rest(served, max_std=1e-5)
    assert served.client.get(session).json()["fit"] == "good"
    return session


@pytest.fixture(scope="module")
def hidden(served: Served) -> str:
    """The path of a session at rest that looks at the cabinet from above: the open drawer hides those below it."""
    prior = json.loads((small.CABINET / "from_above" / "prior.json").read_text())
    session = at_rest(served, scan_id=small.upload_scan(served.client, "from_above"), roi=None, prior=prior)
    assert decision(served, session)["action"] == "look"
    return session


def test_what_is_known_and_what_the_algorithm_does_are_apart(page: Page, served: Served, uncertain: str) -> None:
    opened(page, served, uncertain)
    estimate = served.client.get(f"{uncertain}/estimate").json()
    given = page.get_by_role("region", name="Given the scan")
    draws = round(estimate["effective_draws"])
    expect(given).to_contain_text(f"{draws} effective draws, iteration {estimate['posterior_iteration']}")
    expect(given.get_by_role("table", name="Parts")).to_be_visible()
    expect(given).not_to_contain_text("particles")
    particles = page.locator("#algorithm")
    table = particles.get_by_role("table", name="Particles of the parts")
    expect(table).to_be_hidden()  # until it is asked for
    particles.get_by_text("The algorithm’s particles").click()
    expect(particles).to_contain_text("nothing here says how sure the estimate is")
    row = served.client.get(f"{uncertain}/trace").json()["iterations"][-1]
    for name in ("frame", "drawer2"):
        link = estimate["links"][name]
        cells = table.get_by_role("row", name=name).get_by_role("cell")
        spread = f"±{written(max(link['particle_std_xyz']))}"
        effective = f"{row['effective_sample_size'][name]:.0f}"
        expect(cells).to_have_text([spread, effective, str(len(link["particle_modes"]))])
    # during the search nothing is known, and the particles are there all the same
    page.get_by_role("slider", name="Iteration").fill("1")
    expect(given.locator("#given-facts")).to_have_text("")
    expect(given.get_by_text("Where to look next")).to_be_hidden()
    expect(given.get_by_text("Two coordinates")).to_be_hidden()
    expect(table.get_by_role("row", name="frame").get_by_role("cell").first).to_contain_text("±")


def decision(served: Served, session: str) -> dict[str, Any]:
    found: dict[str, Any] = served.client.get(f"{session}/decision").json()
    return found


def test_where_to_look_next_is_told_and_looked_from(page: Page, served: Served, hidden: str) -> None:
    told = decision(served, hidden)
    opened(page, served, hidden)
    rows = page.locator("#views .row")
    expect(rows).to_have_count(len(told["views"]))
    for place, one in enumerate(told["views"]):
        link, std = max(((name, max(stds)) for name, stds in one["expected_std_xyz"].items()), key=lambda pair: pair[1])
        expect(rows.nth(place)).to_contain_text(f"{place + 1}")
        expect(rows.nth(place)).to_contain_text(f"{one['expected_gain_nats']:.1f}")
        expect(rows.nth(place)).to_contain_text(re.compile(rf"then \w+ ±{written(std)}$"))
        assert link in told["blocking"]
    expect(rows.first).to_have_attribute("aria-pressed", "true")
    rows.nth(1).hover()
    wait(page, lambda: view(page, served)["next_view"] == 1)
    expect(rows.nth(1)).to_have_attribute("aria-pressed", "true")
    rows.nth(2).focus()
    page.keyboard.press("Enter")
    wait(page, lambda: view(page, served)["camera"] is not None)
    camera, pose = view(page, served)["camera"], told["views"][2]["pose"]
    position, turn = (
        [pose[kind][axis] for axis in axes] for kind, axes in (("position", "xyz"), ("orientation", "wxyz"))
    )
    np.testing.assert_allclose(camera["position"], position, atol=1e-4)
    ahead = np.array(camera["look_at"]) - camera["position"]
    np.testing.assert_allclose(
        ahead / np.linalg.norm(ahead), poses.rotate(np.array(turn), np.array([0.0, 0.0, 1.0])), atol=1e-3
    )
    assert view(page, served)["next_view"] == 2


def test_what_hides_a_link_is_told(page: Page, served: Served, hidden: str) -> None:
    told = decision(served, hidden)
    opened(page, served, hidden)
    lines = page.locator("#blocked li")
    parts = [link for link in told["blocking"] if link.startswith(("frame", "drawer"))]
    expect(lines).to_have_count(len(parts))
    for part in parts:
        sight = told["sight"][part]
        line = lines.filter(has_text=f"{part} ±")
        expect(line).to_contain_text(f"{100 * sight['seen']:.0f}\u202f% in sight")
        for other, share in sight["behind"].items():
            if share > 0.06:
                expect(line).to_contain_text(f"{100 * share:.0f}\u202f% behind {other}")
    assert any(sight["behind"] for sight in told["sight"].values())


def test_a_chosen_part_is_asked_about_alone(page: Page, served: Served, hidden: str) -> None:
    opened(page, served, hidden, "?part=drawer2")
    told = served.client.get(f"{hidden}/decision?links=drawer2,handle2").json()
    rows = page.locator("#views .row")
    expect(rows).to_have_count(len(told["views"]))
    gain = f"{told['views'][0]['expected_gain_nats']:.1f}"
    assert gain != f"{decision(served, hidden)['views'][0]['expected_gain_nats']:.1f}"
    expect(rows.first).to_contain_text(gain)
    expect(page.locator("#blocked li")).to_have_count(1)
    expect(page.locator("#part-doubt")).to_have_text("Not certain: its std is above 0.25\u202fcm.")


def test_that_no_place_tells_more_is_told(page: Page, served: Served, uncertain: str) -> None:
    """What is not known as well as was asked for is so to a hair's breadth, which is worth no scan. Of links that are
    one part the first is named."""
    links = served.client.get(f"{uncertain}/estimate").json()["links"]
    known = sorted(max(*link["std_xyz"], link["expected_add"]) for link in links.values())
    asked = 0.98 * known[-1]
    hair = at_rest(served, max_std=asked)
    told = decision(served, hair)
    assert told["views"] and not any(one["worthwhile"] for one in told["views"])
    opened(page, served, hair)
    expect(page.locator("#views-none")).to_be_visible()
    expect(page.locator("#views")).to_be_hidden()
    expect(page.locator("#blocked li")).to_have_count(len({one for one in known if one > asked}))


def test_nobody_looks_for_what_is_certain(page: Page, served: Served) -> None:
    session = at_rest(served, max_std=0.03)
    opened(page, served, session)
    expect(page.locator("#part-rows tr").first.locator("td").nth(2)).to_have_text("certain")
    expect(page.get_by_text("Two coordinates")).to_be_visible()
    expect(page.locator("#next-views")).to_be_hidden()


@pytest.mark.scene
@pytest.mark.parametrize("recorded", [False, True])
def test_the_cameras_are_drawn_where_they_are_to_be(page: Page, served: Served, hidden: str, recorded: bool) -> None:
    if recorded:
        content = served.client.get(f"{hidden}/recording").content
        made = served.client.post("/api/v1/recordings", files={"file": ("kept.sqlite", content)}).json()
        page.goto(f"{served.url}/sessions/{made['id']}/")
        page.locator("body[data-ready]").wait_for()
        assert decision(served, f"/api/v1/sessions/{made['id']}")["action"] == "look"
    else:
        opened(page, served, hidden)
    page.frame_locator("#scene").locator("canvas").first.wait_for()
    rows = page.locator("#views .row")
    expect(rows.first).to_be_visible()
    change(page, served, {"show": BARE})
    page.get_by_role("button", name="see all cameras").click()
    wait(page, lambda: view(page, served)["show"]["next_views"])
    scene, panel = page.locator("#scene"), tab(page, "Layers")
    switch = panel.get_by_role("switch", name="where to look next")
    switch.uncheck()
    empty = settled(page)
    switch.check()
    wait(page, lambda: differing(empty, pixels(scene)) > 100)
    best = settled(page)
    tab(page, "Belief")
    rows.nth(1).focus()
    wait(page, lambda: differing(best, pixels(scene)) > 30)
    tab(page, "Layers")
    switch.uncheck()
    wait(page, lambda: differing(empty, pixels(scene)) == 0)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_two_coordinates_of_the_draws(new_page: Any, served: Served, uncertain: str, scheme: str) -> None:
    page = opened(new_page(color_scheme=scheme), served, uncertain)
    expect(page.locator("#pair summary")).to_be_visible()
    page.locator("#pair summary").focus()
    page.keyboard.press("Enter")
    across, up = page.get_by_label("across", exact=True), page.get_by_label("up", exact=True)
    canvas = page.locator("#pair-canvas")
    expect(canvas).to_have_attribute("aria-label", re.compile(r"^\d+ draws of the posterior; slide\d, .*; slide\d, .*"))
    across.select_option(label="slide2")
    up.locator("optgroup[label=drawer2] option").nth(1).wait_for(state="attached")
    up.select_option(value='["drawer2","x"]')
    found = served.client.get(f"{uncertain}/posterior?links=drawer2").json()
    named = {(one["link"], one["name"]): np.array(one["values"]) for one in found["coordinates"]}
    weights = np.exp(np.array(found["log_weights"], dtype=float))
    covariance = np.cov(named[None, "joint slide2"], named["drawer2", "x"], aweights=np.nan_to_num(weights))
    correlation = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
    wanted = f"correlation {correlation:.2f}".replace("-", "\u2212")
    expect(canvas).to_have_attribute("aria-label", re.compile(f"{len(weights)} draws .*slide2.*drawer2 x.*{wanted}$"))
    # dots and bars in the mode's colour, the estimate's cross in ink
    accent, ink = ("#345bb5", "#1f2630") if scheme == "light" else ("#8fb0ff", "#e8ebef")
    canvas.scroll_into_view_if_needed()
    wait(page, lambda: has_colour(canvas, accent) and has_colour(canvas, ink))
    expect(page.locator("#pair-modes")).to_contain_text("the estimate")


def test_each_alternative_has_a_colour_of_its_own(page: Page, served: Served, uncertain: str) -> None:
    """As if every second draw were of another mode."""

    def told(route: Route) -> None:
        answer = route.fetch()
        (own,) = answer.json()["alternatives"]
        route.fulfill(
            response=answer, json=answer.json() | {"alternatives": [own | {"weight": 0.6}, own | {"weight": 0.4}]}
        )

    def drawn(route: Route) -> None:
        answer = route.fetch()
        modes = [number % 2 for number in range(len(answer.json()["mode"]))]
        route.fulfill(response=answer, json=answer.json() | {"mode": modes})

    page.route(f"**{uncertain}/estimate?*", told)
    page.route(f"**{uncertain}/posterior?*", drawn)
    opened(page, served, uncertain)
    summary = page.get_by_text("Two coordinates")
    expect(summary).to_be_visible()
    summary.click()
    entries = page.locator("#pair-modes li")
    expect(entries).to_have_text(["+the estimate", "60\u202f% alternative 1", "40\u202f% alternative 2"])
    canvas = page.locator("#pair-canvas")
    canvas.scroll_into_view_if_needed()
    wait(page, lambda: has_colour(canvas, "#345bb5") and has_colour(canvas, "#a36410"))


def test_what_was_asked_for_goes_with_a_reset(page: Page, served: Served) -> None:
    """Nothing of the belief that is gone is told, and it comes again with the next one."""
    session = at_rest(served, max_std=1e-5)
    opened(page, served, session)
    expect(page.locator("#blocked li")).to_have_count(4)
    page.locator("#pair summary").click()
    expect(page.locator("#pair-canvas")).to_have_attribute("aria-label", re.compile(r"^\d+ draws of the posterior"))
    # more of the same would not make it certain, and where to turn to is told
    page.get_by_role("button", name="Run…").click()
    page.get_by_role("button", name="Run until certain").click()
    notice = page.get_by_role("alert").filter(has_text="It is at rest and not certain")
    expect(notice).to_contain_text("“Where to look next” under Belief")
    notice.get_by_role("button", name="Close").click()
    expect(notice).to_be_hidden()
    served.client.post(f"{session}/reset").raise_for_status()
    expect(page.locator("#next-views")).to_be_hidden()
    expect(page.locator("#pair")).to_be_hidden()
    served.client.post(f"{session}/run", json={"until": "converged"}).raise_for_status()
    expect(page.locator("#blocked li")).to_have_count(4)
