"""Does a session's page say whether the object was found, how sure that is and where else it may be, and none of it
before the inference is at rest?"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable

import numpy as np
import pytest
from playwright.sync_api import Page, Route, expect

from tests.app import small_sessions as small
from tests.browser.conftest import DESK, PATIENCE, PHONE, pixels, scrolls_sideways
from tests.browser.session_page import at_rest, has_colour, opened, parts, tab, view, wait, written
from tests.servers import Served

expect.set_options(timeout=PATIENCE)

# Metres that no part's standard deviation keeps to, and such that every one does.
TOO_LITTLE, PLENTY = 1e-5, 0.03

# Of a text against what is behind it, as the web's accessibility guidelines measure it. A canvas turns whatever the
# browser calls a colour into its channels
CONTRAST = """([text, ground]) => {
  const pen = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  const light = (place, property) => {
    pen.fillStyle = getComputedStyle(document.querySelector(place))[property];
    pen.fillRect(0, 0, 1, 1);
    const channels = [...pen.getImageData(0, 0, 1, 1).data].slice(0, 3).map((one) => one / 255);
    const linear = channels.map((one) => (one <= 0.04045 ? one / 12.92 : ((one + 0.055) / 1.055) ** 2.4));
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2] + 0.05;
  };
  const both = [light(text, "color"), light(ground, "backgroundColor")];
  return Math.max(...both) / Math.min(...both);
}"""

# The page hears this of what a session does, in answers as in events
OTHER_WORDS = """(members) => {
  const parse = JSON.parse;
  JSON.parse = (text, reviver) => {
    const value = parse(text, reviver);
    return value?.constructor === Object && "until" in value ? Object.assign(value, members) : value;
  };
}"""


@pytest.fixture(scope="module")
def certain(served: Served) -> str:
    """The path of a session at rest that is certain of every link."""
    session = at_rest(served, max_std=PLENTY)
    assert served.client.get(session).json()["certain"]
    return session


@pytest.fixture(scope="module")
def uncertain(served: Served) -> str:
    """The path of a session at rest that has found the object, and is certain of no link."""
    session = at_rest(served, max_std=TOO_LITTLE)
    assert served.client.get(session).json()["fit"] == "good"
    return session


@pytest.fixture
def on_the_way(served: Served) -> str:
    """The path of a session that has searched in iterations 1 and 2, and is not at rest in its sixth."""
    return small.after(served.client, 6, name="a cabinet")


def test_the_verdict_says_where_the_unseen_may_be(page: Page, served: Served, uncertain: str) -> None:
    estimate = served.client.get(f"{uncertain}/estimate").json()
    for link in ("drawer2", "handle2"):
        estimate["links"][link]["visible_fraction"] = 0.0
    name = next(name for name, joint in estimate["joints"].items() if joint["child"] == "drawer2")
    estimate["joints"][name]["interval"] = [0.002, 0.231]
    page.route(re.compile(r"/estimate$"), lambda route: route.fulfill(json=estimate))
    opened(page, served, uncertain, "?iteration=1")
    told = r"Found: \d+\s% explained\. drawer2 \(0\.2 to 23\.1\scm\) unseen\. frame, drawer1 and 1 other not certain\."
    expect(page.locator("#certain")).to_have_text(re.compile(told))


@pytest.mark.parametrize("size", [DESK, {"width": 1280, "height": 800}, PHONE])
def test_the_verdict_of_what_was_found(
    new_page: Callable[..., Page], served: Served, certain: str, size: dict[str, int]
) -> None:
    page = opened(new_page(viewport=size), served, certain)
    explained = served.client.get(f"{certain}/estimate").json()["explained"]
    sentence = f"Found: {100 * explained:.0f}\u202f% explained. All parts certain."
    verdict = page.locator("#certain")
    expect(verdict).to_have_text(sentence)
    expect(verdict).to_have_attribute("data-certain", "true")
    expect(verdict).to_have_attribute("data-fit", "good")
    box = verdict.bounding_box()
    assert box is not None and box["x"] + box["width"] <= size["width"]
    assert box["height"] < (50 if size is PHONE else 25)  # one line, two where there is little room
    assert not scrolls_sideways(page)
    # it is about the newest iteration, whatever is looked at
    page.get_by_role("slider", name="Iteration").fill("2")
    expect(page.locator("#part-rows tr").first.locator("td").nth(0)).to_have_text("–")
    expect(verdict).to_have_text(sentence)


def test_the_verdict_names_what_is_not_certain(page: Page, served: Served, uncertain: str) -> None:
    # the names are those of the newest iteration, though another one is looked at from the beginning
    opened(page, served, uncertain, "?iteration=1")
    verdict = page.locator("#certain")
    expect(verdict).to_have_text(re.compile(r"Found: \d+\s% explained\. frame, drawer1 and 2 others not certain\.\s*$"))
    expect(verdict).to_have_attribute("data-certain", "false")
    expect(page.locator("#shown")).to_have_text(re.compile(r"^\s*1 / "))


def test_the_verdict_says_what_is_seen_through_or_there_twice(page: Page, served: Served, certain: str) -> None:
    share = "the scan confirms 86 % of what should be seen"
    members = {"fit": "good", "fit_reason": f"{share}; drawer2 is seen through in places, so that it may be elsewhere"}
    page.add_init_script(f"({OTHER_WORDS})({json.dumps(members)})")
    opened(page, served, certain)
    told = (
        r"Found: \d+\s% explained; drawer2 is seen through in places, so that it may be elsewhere\. All parts certain\."
    )
    expect(page.locator("#certain")).to_have_text(re.compile(told))


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize(
    ("fit", "word"),
    [("good", "Found:"), ("doubtful", "Doubtful: a curtain hides it."), ("none", "Not found: a curtain")],
)
def test_the_verdict_of_a_fit(
    new_page: Callable[..., Page], served: Served, certain: str, fit: str, word: str, scheme: str
) -> None:
    page = new_page(color_scheme=scheme)
    members = {"fit": fit, "fit_reason": "a curtain hides it", "certain": fit == "good"}
    page.add_init_script(f"({OTHER_WORDS})({json.dumps(members)})")
    opened(page, served, certain)
    verdict = page.locator("#certain")
    expect(verdict).to_contain_text(word)
    expect(verdict).to_have_attribute("data-fit", fit)
    for text in ("#verdict-word", "#verdict-rest"):
        assert page.evaluate(CONTRAST, [text, ".verdict"]) >= 4.5
    box = page.get_by_role("button", name="Draw a box")
    if fit != "none":
        expect(box).to_be_hidden()
        return
    box.click()
    setup = page.locator("#setup")
    expect(setup.get_by_role("button", name="this session’s box")).to_have_attribute("aria-pressed", "true")
    expect(box).to_be_hidden()
    wait(page, lambda: view(page, served)["show"]["region"])
    setup.get_by_role("button", name="Close without running").click()
    expect(box).to_be_visible()


def test_the_verdict_while_it_goes_on(page: Page, served: Served) -> None:
    session = small.after(served.client, 1, name="a cabinet", iterations=100, max_std=PLENTY)
    opened(page, served, session)
    expect(page.locator("#certain")).to_have_text("Not at rest yet")
    expect(page.locator("#certain")).to_have_attribute("data-fit", "")
    served.client.post(f"{session}/run", json={"until": "converged"}).raise_for_status()
    expect(page.locator("#certain")).to_have_text(re.compile(r"Found: \d+\s% explained\. All parts certain\."))
    # a change that no iteration has seen yet may lead elsewhere
    served.client.patch(session, json={"config": {"effective_share": 0.2}}).raise_for_status()
    expect(page.locator("#certain")).to_have_text("Not at rest yet")


def test_a_standard_deviation_stands_against_its_limit(
    page: Page, new_page: Callable[..., Page], served: Served, certain: str, uncertain: str
) -> None:
    for shown, session, word in ((page, certain, "certain"), (new_page(), uncertain, "not certain")):
        opened(shown, served, session)
        estimate = served.client.get(f"{session}/estimate").json()
        limit = estimate["max_std"]
        expect(shown.locator("#std-limit")).to_have_text(f"of {written(limit)}")
        for name, links in parts(estimate).items():
            row = shown.locator("#part-rows tr", has=shown.get_by_role("rowheader", name=name))
            std, add = (max(np.ravel([link[of] for link in links])) for of in ("std_xyz", "expected_add"))
            expect(row.locator("td").nth(0)).to_have_text(f"±{written(std)}")
            told = row.locator("td").nth(0).get_attribute("title") or ""
            assert f"off by {written(add)}" in told
            gauge = row.locator(".gauge")
            sure = str(all(link["certain"] for link in links)).lower()
            assert std <= limit or sure == "false"
            expect(gauge).to_have_attribute("data-certain", sure)
            share = float(gauge.evaluate("(gauge) => gauge.style.getPropertyValue('--share')"))
            assert share == pytest.approx(min(1, 0.75 * std / limit), abs=1e-6)
            expect(row.locator("td").nth(2)).to_have_text(word)
            expect(row.locator("td").nth(2)).to_have_attribute("data-certain", sure)


def test_a_joint_has_its_interval_within_its_limits(page: Page, served: Served, certain: str) -> None:
    opened(page, served, certain)
    for name, joint in served.client.get(f"{certain}/estimate").json()["joints"].items():
        row = page.locator("#joints tr", has=page.get_by_role("rowheader", name=name))
        low, high = (100 * end for end in joint["interval"])
        places = 2 if high - low < 1 else 1
        text = f"{low:.{places}f} to {high:.{places}f}\u202fcm".replace("-", "\u2212")
        expect(row.locator("td").nth(1)).to_have_text(text)
        wanted = [
            min(1.0, max(0.0, (value - joint["lower"]) / (joint["upper"] - joint["lower"])))
            for value in (*joint["interval"], joint["position"])
        ]
        bar, band = (row.locator(place) for place in (".interval", ".interval > span"))
        found = bar.evaluate("(bar) => ['--from', '--to', '--at'].map((name) => +bar.style.getPropertyValue(name))")
        assert found == pytest.approx(wanted, abs=1e-6)
        track, drawn = bar.bounding_box(), band.bounding_box()
        assert track is not None and drawn is not None
        # two pixels wider at either end: an interval that is narrow for the limits is to be seen, too
        assert drawn["x"] == pytest.approx(track["x"] + wanted[0] * track["width"] - 2, abs=1)
        assert drawn["width"] == pytest.approx((wanted[1] - wanted[0]) * track["width"] + 4, abs=1)
    # drawn again, what has not changed stays the same element
    bar = page.locator("#joints .interval").first.element_handle()
    page.locator("#part-rows button").first.click()
    expect(page.locator("#part")).to_be_visible()
    page.get_by_role("button", name="Back to all parts").click()
    expect(page.locator("#joints .interval").first).to_be_visible()
    assert bar.evaluate("(bar) => bar.isConnected")
    page.get_by_role("slider", name="Iteration").fill("2")
    expect(page.locator("#joints tr").first.locator("td").nth(1)).to_have_text("–")


def test_the_standard_deviation_has_a_gap_until_it_is_at_rest(page: Page, served: Served, certain: str) -> None:
    rows = served.client.get(f"{certain}/trace").json()["iterations"]
    assert [row["std_xyz"] is None for row in rows] == [True] * (len(rows) - 1) + [False]
    opened(page, served, certain, "?iteration=2")
    colours = [part["colour"] for part in served.client.get(f"{certain}/graph").json()["parts"]]
    std, particles = (page.locator(f"[data-plot={name}] canvas") for name in ("std", "particle-std"))
    expect(page.locator("[data-plot=std] .now")).to_have_text("–")
    # a lone value is a dot: there is no line to it, and the cursor is elsewhere
    wait(page, lambda: any(has_colour(std, colour) for colour in colours))
    seen = pixels(std).astype(int)
    coloured = np.zeros(seen.shape[:2], dtype=bool)
    for colour in colours:
        wanted = [int(colour[at : at + 2], 16) for at in (1, 3, 5)]
        coloured |= np.abs(seen - wanted).max(axis=-1) < 12
    right = seen.shape[1] - 8  # of the last iteration
    assert np.flatnonzero(coloured.any(axis=0)).min() > right - 5
    # the algorithm's spread has its line from the first iteration on
    assert has_colour(particles, colours[0])


def test_how_sure_is_told_when_it_is_asked_for(page: Page, served: Served, on_the_way: str) -> None:
    opened(page, served, on_the_way)
    button = page.get_by_role("button", name="How sure?")
    std = page.locator("#part-rows tr").first.locator("td").nth(0)
    expect(std).to_have_text("–")
    button.click()
    asked = served.client.get(f"{on_the_way}/estimate?iteration=6&posterior=true").json()
    expect(std).to_have_text(f"±{written(max(asked['links']['frame']['std_xyz']))}")
    expect(button).to_be_hidden()
    expect(page.locator("#how-sure-text")).to_have_text(
        f"Not at rest in iteration 6; read out all the same: {asked['fit_reason']}."
    )
    expect(page.get_by_role("button", name=re.compile("^frame, .*standard deviation [0-9]"))).to_be_visible()
    # what the session has come to is not told by that
    expect(page.locator("#certain")).to_have_text("Not at rest yet")
    expect(tab(page, "Share").locator("#share-curl")).to_contain_text("estimate?iteration=6&posterior=true")
    tab(page, "Belief")
    # it is kept, and the search has none to tell
    slider = page.get_by_role("slider", name="Iteration")
    slider.fill("5")
    expect(button).to_be_visible()
    slider.fill("2")
    expect(page.locator("#how-sure-text")).to_have_text("The search says nothing yet about how sure it is.")
    expect(button).to_be_hidden()
    slider.fill("6")
    expect(std).to_contain_text("±")


def test_at_rest_nobody_has_to_ask(page: Page, served: Served, certain: str) -> None:
    opened(page, served, certain)
    expect(page.locator("#part-rows tr").first.locator("td").nth(0)).to_contain_text("±")
    expect(page.locator("#how-sure")).to_be_hidden()
    expect(page.locator("#how-sure-text")).to_be_hidden()
    expect(page.get_by_role("heading", name="Alternatives")).to_be_hidden()  # there is one hypothesis only


def test_alternatives_tell_what_is_elsewhere(page: Page, served: Served, certain: str) -> None:
    estimate = served.client.get(f"{certain}/estimate").json()
    (own,) = estimate["alternatives"]
    slide = estimate["joints"]["slide2"]["position"]
    here, there = f"{100 * slide:.1f}", f"{100 * (slide + 0.1):.1f}"
    moved = {name: {"pose": dict(link["pose"])} for name, link in own["links"].items()}
    position = moved["drawer2"]["pose"]["position"]
    moved["drawer2"]["pose"]["position"] = position | {"z": position["z"] + 0.1}
    # what is told is the middle of all draws, and a hypothesis its own: 10 cm to within two millimetres
    told = estimate["links"]["drawer2"]["pose"]["position"]
    far = 100 * math.dist(told.values(), moved["drawer2"]["pose"]["position"].values())
    assert abs(far - 10) < 0.2
    turned = {
        name: {"pose": {**link["pose"], "orientation": {"x": 0, "y": 0, "z": 1, "w": 0}}}
        for name, link in own["links"].items()
    }
    others = [
        own | {"weight": 0.7},
        {"weight": 0.25, "links": moved, "joints": own["joints"] | {"slide2": slide + 0.1}},
        {"weight": 0.05, "links": turned, "joints": own["joints"]},
    ]

    def altered(route: Route) -> None:
        answer = route.fetch()
        route.fulfill(response=answer, json=answer.json() | {"alternatives": others})

    page.route(f"**{certain}/estimate?*", altered)
    opened(page, served, certain)
    expect(page.get_by_role("heading", name="Alternatives")).to_be_visible()
    entries = page.locator("#alternatives-list li")
    expect(entries).to_have_text(
        [
            "70\u202f%as estimated",
            f"25\u202f%drawer2 {far:.1f}\u202fcm away; slide2 at {there}\u202fcm, not {here}\u202fcm",
            re.compile(r"^5\.0\s%\w+ \d+\.\d\scm away, turned by \d+°$"),
        ]
    )


def test_what_the_scan_does_not_tell_is_said(page: Page, served: Served, certain: str) -> None:
    opened(page, served, certain)
    expect(page.locator("#part-rows tr")).to_have_count(4)
    expect(page.locator("#unknown")).to_be_hidden()

    def altered(route: Route) -> None:
        answer = route.fetch()
        sentences = ["joint 'slide1' may be anywhere from 1 cm to 24 cm", "'frame' is round"]
        route.fulfill(response=answer, json=answer.json() | {"unknown": sentences})

    page.route(f"**{certain}/estimate?*", altered)
    page.reload()
    expect(page.locator("#unknown")).to_have_text(
        "Not told by the scan: joint 'slide1' may be anywhere from 1 cm to 24 cm. "
        "Not told by the scan: 'frame' is round."
    )


def test_a_part_that_is_in_one_place_has_one_hypothesis_of_it(page: Page, served: Served, certain: str) -> None:
    def altered(route: Route) -> None:
        answer = route.fetch()
        found = answer.json()
        (mode,) = found["links"]["drawer2"]["modes"]
        pose = mode["pose"]
        far = {"position": pose["position"] | {"x": pose["position"]["x"] + 0.2}, "orientation": pose["orientation"]}
        modes = [(0.4, pose), (0.35, far), (0.25, pose)]
        found["links"]["drawer2"]["modes"] = [mode | {"weight": weight, "pose": at} for weight, at in modes]
        route.fulfill(response=answer, json=found)

    page.route(f"**{certain}/estimate?*", altered)
    opened(page, served, certain, "?part=drawer2")
    expect(page.locator("#modes-title")).to_have_text("2 hypotheses")
    expect(page.locator("#modes li .figure")).to_have_text(["65.0\u202f%", "35.0\u202f%"])


def test_the_hypotheses_of_a_part(page: Page, served: Served, certain: str) -> None:
    link = served.client.get(f"{certain}/estimate").json()["links"]["drawer2"]
    opened(page, served, certain, "?part=drawer2")
    expect(page.locator("#modes-title")).to_have_text("1 hypothesis")
    expect(page.locator("#modes-calm")).to_be_hidden()
    expect(page.locator("#modes li")).to_have_count(len(link["modes"]))
    expect(page.locator("#particle-modes li")).to_have_count(len(link["particle_modes"]))
    facts = page.locator("#part-facts")
    expect(facts).to_contain_text(f"±\u202f{written(max(link['std_xyz']))}")
    expect(facts).to_contain_text(f"off by {written(link['expected_add'])} (ADD)")
    expect(page.locator("#part-doubt")).to_have_text("Certain.")
    particles = page.locator("#particle-facts")
    expect(particles).to_contain_text(f"particles ±\u202f{written(max(link['particle_std_xyz']))}")


def test_comparing_with_what_is_not_at_rest(page: Page, served: Served, certain: str) -> None:
    id = certain.rsplit("/", 1)[1]
    opened(page, served, certain, f"?compare={id},2")
    panel = tab(page, "Compare")
    std = max(served.client.get(f"{certain}/estimate").json()["links"]["frame"]["std_xyz"])
    cells = panel.locator("#compare-links tr").first.locator("td")
    expect(cells.nth(2)).to_have_text(written(std).removesuffix("\u202fcm"))
    expect(cells.nth(3)).to_have_text("–")
    expect(panel.locator("#compare-fit")).to_have_text("Fit: found here, not at rest there")


@pytest.mark.parametrize(
    ("fit", "certain_of_all", "text"),
    [("good", True, "found, certain"), ("good", False, "found, not certain"), ("doubtful", False, "doubtful")]
    + [("none", False, "not found")],
)
def test_the_start_page_tells_it_too(
    page: Page, served: Served, certain: str, fit: str, certain_of_all: bool, text: str
) -> None:
    def altered(route: Route) -> None:
        answer = route.fetch()
        ours = next(one for one in answer.json() if one["id"] == certain.rsplit("/", 1)[1])
        route.fulfill(response=answer, json=[ours | {"fit": fit, "fit_reason": "why", "certain": certain_of_all}])

    page.route("**/api/v1/sessions", altered)
    page.goto(served.url)
    shown = page.locator(".card .certain")
    expect(shown).to_have_text(text)
    expect(shown).to_have_attribute("title", "why")
