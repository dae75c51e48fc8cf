"""A real browser for tests: the system's Chromium, driven by Playwright, and pages that tolerate no error: no member of
an answer either that the OpenAPI document does not declare (`strict_answers.js`).

Playwright's synchronous interface belongs to the thread that started it, and keeps an event loop running there: the
browser is a file's, so that tests of other files may run loops of their own. Every test has a context of its own, with
storage and cookies of its own.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from playwright.sync_api import Browser, BrowserContext, Error, Locator, Page

from app.server_config import ServerConfig
from benchmarks.browser import NAMES, executable, launched
from tests.servers import Served, serving

DESK, PHONE = {"width": 1440, "height": 900}, {"width": 390, "height": 844}
# A window whose 3D scene is drawn soon without a GPU, and not yet in one column.
SMALL = {"width": 1000, "height": 640}
# A test that waits for what does not come ends by this, in milliseconds; it is no measure of speed.
PATIENCE = 180_000
# Pictures that are asked for until one is given.
CAPTURES = 20
# No process is kept ready for a next page, and none is there to draw: an eighth of these tests' time.
FRUGAL = ("--renderer-process-limit=1", "--in-process-gpu")
# With it the start page does not have the files of a session's page fetched, which few tests go on to.
SAVING = {"extra_http_headers": {"Save-Data": "on"}}
# Leaves a session's page an empty document for its 3D scene, before the scene's program is read. Were it answered from
# here instead, each of a page's seventy requests would wait for word from here: a seventh of its time.
WITHOUT_SCENE = r"""if (/\/sessions\/[^/]+\/view\/[^/]+\/$/.test(location.pathname)) {
  document.open();
  document.close();
}"""


@dataclass
class Troubles:
    """What went wrong in a page that a person might not have seen. expected : texts that a test brought about itself"""

    found: list[str] = field(default_factory=list)
    expected: list[str] = field(default_factory=list)

    def expect(self, text: str) -> None:
        """Tolerate what holds `text`."""
        self.expected.append(text)

    def watch(self, page: Page) -> None:
        """Note console errors, among which Chromium tells of every request that failed or was refused, and exceptions
        of scripts. To be told of each request itself takes a fifteenth of these tests' processor time."""

        def told(message: Any) -> None:
            if message.type == "error":
                self.found.append(f"console: {message.text} ({message.location.get('url', '')})")

        page.on("console", told)
        page.on("pageerror", lambda error: self.found.append(f"script: {error}"))

    def unexpected(self) -> list[str]:
        """What no test expected."""
        return [one for one in self.found if not any(text in one for text in self.expected)]


@cache
def document() -> dict[str, Any]:
    """The server's OpenAPI document."""
    from app.server import create_app

    with TemporaryDirectory() as folder:
        found: dict[str, Any] = create_app(ServerConfig(data_dir=Path(folder))).openapi()
    return found


def strict_answers(document: dict[str, Any]) -> str:
    """A script under which a page fails that reads a member of an answer which `document` does not declare."""
    text = (Path(__file__).parent / "strict_answers.js").read_text(encoding="utf-8")
    return f"{text}\nstrictAnswers({json.dumps(document)});"


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Chromium. Without one the tests skip on a desk, and fail where the environment has CI set."""
    if executable() is None:
        sentence = f"no browser is there: none of {', '.join(NAMES)} is on the path; .ci/browser installs one"
        if os.environ.get("CI"):
            pytest.fail(sentence)
        pytest.skip(sentence)
    with launched(*FRUGAL) as started:
        yield started


@pytest.fixture
def troubles() -> Iterator[Troubles]:
    """What went wrong in any page of the test; the test fails at its end for what it did not expect."""
    troubles = Troubles()
    yield troubles
    assert not troubles.unexpected(), "\n".join(troubles.unexpected())


@pytest.fixture
def new_page(browser: Browser, troubles: Troubles, request: pytest.FixtureRequest) -> Iterator[Callable[..., Page]]:
    """A function that opens an empty page in a context of its own, with the options of `Browser.new_context`.

    The 3D scene is left out where the test is not marked `scene`: viser's client takes half of a page's processor time.
    """
    contexts: list[BrowserContext] = []
    scene = request.node.get_closest_marker("scene") is not None

    def open_page(**options: Any) -> Page:
        # how a page moves is nothing that these tests look at
        settings = {"viewport": SMALL, "reduced_motion": "reduce", "service_workers": "block", **SAVING} | options
        context = browser.new_context(**settings)
        context.set_default_timeout(PATIENCE)
        contexts.append(context)
        context.add_init_script(strict_answers(document()))
        if not scene:
            context.add_init_script(WITHOUT_SCENE)
        page = context.new_page()
        troubles.watch(page)
        return page

    yield open_page
    for context in contexts:
        context.close()


@pytest.fixture
def page(new_page: Callable[..., Page]) -> Page:
    """An empty page in light colours."""
    return new_page(color_scheme="light")


@pytest.fixture(scope="module")
def serve_for_module(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., Served]]:
    """A function that starts a server with the settings it is given, each with a data directory of its own."""
    with ExitStack() as stack:
        yield lambda **settings: stack.enter_context(serving(tmp_path_factory.mktemp("data")))(**settings)


@pytest.fixture(scope="module")
def served(serve_for_module: Callable[..., Served]) -> Served:
    """The server of a file's tests, ready to iterate, without a token."""
    return serve_for_module().ready()


def pixels(shown: Page | Locator) -> NDArray[np.uint8]:
    """What is to be seen, (height, width, 3)."""
    return np.asarray(Image.open(io.BytesIO(_picture(shown))).convert("RGB"))


def _picture(shown: Page | Locator) -> bytes:
    """A picture of it. Chromium refuses some while it begins to draw a page with WebGL on the processor."""
    for _ in range(CAPTURES):
        try:
            return shown.screenshot()
        except Error as error:
            if "Unable to capture screenshot" not in error.message:
                raise
    return shown.screenshot()


def scrolls_sideways(page: Page) -> bool:
    """Whether something is wider than the window."""
    return bool(page.evaluate("document.documentElement.scrollWidth > document.documentElement.clientWidth"))
