"""Is a belief seen forming? A session that was just opened begins at iteration 0 and plays; so does one that runs."""

from __future__ import annotations

import itertools
import re

import pytest
from playwright.sync_api import Page, expect

from tests.app import small_sessions as small
from tests.browser.conftest import PATIENCE
from tests.browser.session_page import opened, view, wait
from tests.servers import Served

expect.set_options(timeout=PATIENCE)

# From now on `played` has the iterations that were shown, in order, however briefly, and `verdicts` what was said then
NOTE = """() => {
  [window.played, window.verdicts] = [[], []];
  const note = () => {
    window.played.push(Number(document.getElementById("slider").value));
    window.verdicts.push(document.getElementById("verdict-word").textContent);
  };
  const noted = new MutationObserver(note);
  noted.observe(document.getElementById("shown"), { childList: true, characterData: true, subtree: true });
}"""

# From now on `addressChanged` is what was shown when the address first named no iteration
NOTE_ADDRESS = """() => {
  const replace = history.replaceState;
  history.replaceState = (...given) => {
    if (!given[2].includes("iteration")) window.addressChanged ??= document.getElementById("slider").value;
    replace.apply(history, given);
  };
}"""


def live(page: Page) -> None:
    expect(page.get_by_role("button", name="Live")).to_have_attribute("aria-pressed", "true")


def at_most_one_further(played: list[int]) -> bool:
    return all(after - before in (0, 1) for before, after in itertools.pairwise(played))


@pytest.mark.scene
def test_a_new_session_shows_its_first_particles_before_another_iteration_is_made(page: Page, served: Served) -> None:
    session = small.create(served.client, name="new", iterations=12)
    opened(page, served, session, "?play=run")
    drawn: list[int] = []

    def seen() -> bool:
        now = view(page, served)["drawn"]
        drawn.extend([] if now is None else [now["iteration"]])
        return bool(drawn)

    wait(page, seen)
    assert drawn[0] == 0
    live(page)
    assert served.client.get(session).json()["converged"]
    expect(page.locator("#shown")).to_have_text(re.compile(r"(\d+) / \1"))
    assert "play" not in page.url


def test_what_was_made_before_it_was_opened_is_played(page: Page, served: Served) -> None:
    session = small.after(served.client, 6, name="made", iterations=12)
    served.client.post(f"{session}/run", json={"until": "converged"})
    made = small.at_rest(served.client, session)["iteration"]
    page.add_init_script(f"if (top === window) addEventListener('DOMContentLoaded', {NOTE})")
    opened(page, served, session, "?play")
    live(page)
    played = page.evaluate("window.played")
    assert 0 in played
    assert played[-1] == made
    assert at_most_one_further(played[played.index(0) :])
    # nobody hears the end before it
    word, verdicts = page.locator("#verdict-word").inner_text(), page.evaluate("window.verdicts")
    assert word
    assert word not in verdicts[: played.index(made)]


def test_run_is_followed_at_a_pace_that_can_be_watched(page: Page, served: Served) -> None:
    session = small.after(served.client, 2, name="followed", iterations=100)
    opened(page, served, session, "?economy=0")  # which tells of some iterations only while a session runs
    page.evaluate(NOTE)
    page.get_by_label("Speed of playing back").select_option("10")
    page.locator("#run-open").click()
    page.get_by_role("spinbutton", name="Iterations", exact=True).fill("8")
    page.locator("#run-some").get_by_role("button", name="Run").click()
    wait(page, lambda: page.evaluate("window.played.at(-1)") == 10)
    assert at_most_one_further(page.evaluate("window.played"))
    live(page)


def test_who_chose_an_iteration_stays_there(page: Page, served: Served) -> None:
    session = small.after(served.client, 6, name="held", iterations=12)
    opened(page, served, session, "?play")
    page.get_by_label("Speed of playing back").select_option("2")
    wait(page, lambda: page.get_by_role("slider", name="Iteration").input_value() != "0")
    # loaded again it goes on by itself, from where it was
    page.reload()
    page.locator("body[data-ready]").wait_for()
    expect(page.get_by_role("button", name="Stop playing back")).to_be_visible()
    live(page)
    assert "iteration" not in page.url
    page.get_by_role("slider", name="Iteration").fill("3")
    expect(page.get_by_role("button", name="Play back", exact=True)).to_be_visible()
    small.step(served.client, session, 1)
    expect(page.locator("#shown")).to_have_text(re.compile("3 / 7"))
    page.wait_for_url("**?iteration=3")
    page.reload()
    page.locator("body[data-ready]").wait_for()
    expect(page.locator("#shown")).to_have_text(re.compile("3 / 7"))
    button = page.get_by_role("button", name="Play back", exact=True)
    expect(button).to_be_visible()
    # played on from there, the address names it no longer
    page.evaluate(NOTE_ADDRESS)
    button.click()
    page.wait_for_url(lambda url: "iteration" not in url)
    assert int(page.evaluate("window.addressChanged")) < 7  # while it plays


def test_a_plain_address_is_live_whatever_the_tab_showed_before(page: Page, served: Served) -> None:
    session = small.after(served.client, 6, name="plain", iterations=12)
    opened(page, served, session, "?iteration=3")
    expect(page.locator("#shown")).to_have_text(re.compile("3 / 6"))
    opened(page, served, session)
    expect(page.locator("#shown")).to_have_text(re.compile("6 / 6"))
    wait(page, lambda: view(page, served)["iteration"] is None)
