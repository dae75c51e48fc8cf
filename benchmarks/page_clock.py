"""A clock beside the page: from a click to particles in the scene, and from dropped files to the estimate.

A browser that has been nowhere before opens the start page of each server in turn and waits a moment, as a person who
reads does. Measured are: a click on a sample to its first particles drawn and to its verdict; files dropped to the
boxes that are proposed; and from *Run* to the verdict, in the first of them and anywhere in the scan. Particles are
drawn once WebGL is told to draw so many of them. Run it: `python -m benchmarks.page_clock [--url URL …]`, without an
address with a server of its own.
"""

from __future__ import annotations

import argparse
import re
import statistics
import time
from collections.abc import Callable
from contextlib import ExitStack

from playwright.sync_api import Browser, Page

from benchmarks import server_process
from benchmarks.browser import launched
from benchmarks.server_process import CABINET
from benchmarks.tables import markdown, progress
from pmpnbp.settings import SessionOptions

# Seconds that a person looks at the start page, and milliseconds that anything may take.
READ, PATIENCE = 2.0, 120_000
FILES = [CABINET / "cabinet.urdf", CABINET / "open" / "depth.png", CABINET / "open" / "camera.json"]
# Notes when a part's particles are drawn first, by the system's clock.
_NOTE = """
for (const name of ["drawElements", "drawArrays", "drawElementsInstanced", "drawArraysInstanced"]) {
  const draw = WebGL2RenderingContext.prototype[name];
  WebGL2RenderingContext.prototype[name] = function (...given) {
    if (!window.drawnAt && given.includes(PARTICLES)) window.drawnAt = performance.timeOrigin + performance.now();
    return draw.apply(this, given);
  };
}
""".replace("PARTICLES", str(SessionOptions().particles))


def sample_clicked(page: Page) -> dict[str, float]:
    """A sample, from the click."""
    began = time.time()
    page.locator("#open-sample").click()
    page.wait_for_url(re.compile("/sessions/[0-9a-f]{16}/"), timeout=PATIENCE)
    while (drawn := page.evaluate("document.querySelector('#scene')?.contentWindow.drawnAt ?? 0")) == 0:
        time.sleep(0.02)
    found = {"click to first particles": drawn / 1000 - began}
    return found | {"click to the verdict": _verdict(page) - began}


def dropped(anywhere: bool) -> Callable[[Page], dict[str, float]]:
    """Files dropped; then run in the first proposed box, or `anywhere` in the scan."""

    def measure(page: Page) -> dict[str, float]:
        began = time.time()
        page.locator("#files").set_input_files(FILES)
        page.wait_for_url(re.compile("/sessions/[0-9a-f]{16}/"), timeout=PATIENCE)
        page.locator("#setup-choices").get_by_role("button").first.wait_for(timeout=PATIENCE)
        found = {"files dropped to proposed boxes": time.time() - began}
        if anywhere:
            page.get_by_role("button", name="anywhere in the scan").click()
        began = time.time()
        page.get_by_role("button", name="Run", exact=True).last.click()
        return found | {f"run {'anywhere' if anywhere else 'in a box'} to the verdict": _verdict(page) - began}

    return measure


def _verdict(page: Page) -> float:
    page.locator("#certain:not([data-fit=''])").wait_for(timeout=PATIENCE)
    return time.time()


def timed(browser: Browser, url: str, measure: Callable[[Page], dict[str, float]]) -> dict[str, float]:
    """In a browser without a past."""
    context = browser.new_context(viewport={"width": 1440, "height": 900})
    try:
        page = context.new_page()
        page.add_init_script(_NOTE)
        page.goto(url)
        page.locator("#open-sample").wait_for()
        time.sleep(READ)
        return measure(page)
    finally:
        context.close()


def main(urls: list[str], repeats: int) -> None:
    """All of it, for each server in turn, and a table of seconds."""
    found: dict[tuple[str, str], list[float]] = {}
    with ExitStack() as stack:
        asked = urls or [stack.enter_context(server_process.running()).url]
        browser = stack.enter_context(launched())
        for number in range(repeats):
            for measure in (sample_clicked, dropped(False), dropped(True)):
                for url in asked:
                    progress(f"round {number + 1} of {repeats}")
                    for what, seconds in timed(browser, url, measure).items():
                        found.setdefault((what, url), []).append(seconds)
    rows = [
        (
            what,
            url,
            *(f"{number:.2f}" for number in (seconds[0], statistics.median(seconds), min(seconds), max(seconds))),
        )
        for (what, url), seconds in sorted(found.items())
    ]
    print(markdown(("seconds", "server", "the first", "median", "least", "most"), rows))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="a clock beside the page")
    parser.add_argument("--url", action="append", default=[], help="of a server; several are measured in turn")
    parser.add_argument("--repeats", type=int, default=6, help="of everything (default 6)")
    options = parser.parse_args()
    main(options.url, options.repeats)
