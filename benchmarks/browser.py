"""Which browser shows the page to benchmarks and tests? The system's Chromium, driven by Playwright, without a GPU."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager

from playwright.sync_api import Browser, sync_playwright

# In the order of .ci/browser; the shell is Chromium without its desktop program.
NAMES = ("chromium-headless-shell", "chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
# Without a GPU: WebGL is drawn by SwiftShader, and the page as on any machine without a graphics card; with
# --use-angle=swiftshader SwiftShader would put the page together too, at five times the cost. /dev/shm is small in
# containers, and a full one crashes pages.
FLAGS = ("--no-sandbox", "--enable-unsafe-swiftshader", "--disable-dev-shm-usage")


def executable() -> str | None:
    """Path of the first of NAMES that is there; None where none is."""
    return next((found for found in map(shutil.which, NAMES) if found), None)


@contextmanager
def launched(*more: str) -> Iterator[Browser]:
    """The browser, with FLAGS and `more`; where the system has none, one that Playwright itself has installed."""
    with (
        sync_playwright() as playwright,
        playwright.chromium.launch(executable_path=executable(), args=[*FLAGS, *more]) as browser,
    ):
        yield browser
