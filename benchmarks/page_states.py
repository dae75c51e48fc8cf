"""Pictures of every state of the pages that matters, to be looked at: `python -m benchmarks.page_states [FOLDER]`.

By default into out/page_states: a picture of each state in each of three sizes, light and dark, and beside them one
sheet a state with all six. A real server, a real browser, the sample scenes.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx
from PIL import Image
from playwright.sync_api import Browser, Page

from benchmarks import server_process
from benchmarks.browser import launched
from benchmarks.tables import progress

OUT = Path("out/page_states")
SIZES = ((1440, 900), (1920, 1080), (390, 844))
SCHEMES = ("light", "dark")
# Of the pictures on a sheet, and pixels between them.
HEIGHT, GAP = 620, 12
# Milliseconds in which a 3D view that is drawn by the processor comes to rest.
SETTLE = 3500


@dataclass(frozen=True)
class State:
    """name; path : of its page, or the address of a file; act : what is done there, before the picture"""

    name: str
    path: str
    act: Callable[[Page], Any] = lambda page: None


def sessions(client: httpx.Client) -> dict[str, str]:
    """Ids: `rest` and `other` at rest, `doubt` at rest and not certain, `new` not begun, `early` in its search."""

    def opened(scene: str, run: bool) -> str:
        made = client.post("/sessions/sample", json={"scene": scene, "run": run}).raise_for_status().json()
        return str(made["id"])

    found = {"new": opened("blanket", False), "early": opened("robot", False)}
    found |= {
        name: opened(scene, True) for name, scene in (("rest", "open"), ("doubt", "from_above"), ("other", "door"))
    }
    client.post(f"/sessions/{found['early']}/step", json={"iterations": 3}).raise_for_status()
    for name in ("rest", "doubt", "other"):
        client.get(f"/sessions/{found[name]}/estimate", params={"wait": "idle", "timeout": 120}).raise_for_status()
    client.patch(f"/sessions/{found['rest']}", json={"tags": ["kitchen", "left"]}).raise_for_status()
    return found


def exported(client: httpx.Client, session: str, folder: Path) -> str:
    """The address of the session's 3D view as a file."""
    file = folder / "scene.html"
    file.write_bytes(client.get(f"/sessions/{session}/views/export/scene.html").raise_for_status().content)
    return file.as_uri()


def states(ids: dict[str, str], scene: str) -> Iterator[State]:
    """All, of pages whose server has those sessions. scene : address of an exported one"""
    rest, new = f"/sessions/{ids['rest']}/", f"/sessions/{ids['new']}/"
    yield State("start", "/")
    yield State("start, advanced", "/", lambda page: page.get_by_text("Advanced:").click())
    yield State("start, a wrong file", "/", wrong_file)
    yield State("side by side", f"/compare?sessions={ids['rest']},{ids['doubt']}")
    yield State("set-up", new + "?setup", lambda page: page.locator("#setup-choices li").first.wait_for())
    yield State("set-up, advanced and a prior", new + "?setup", prior)
    yield State("not begun", new)
    yield State("the search", f"/sessions/{ids['early']}/")
    yield State("at rest", rest)
    yield State("at rest, not certain", f"/sessions/{ids['doubt']}/")
    for tab in ("why", "layers", "settings", "compare", "share"):
        yield State(f"tab {tab}", f"{rest}?tab={tab}")
    yield State("a part", rest + "?part=drawer1")
    yield State("a particle", rest + "?part=drawer1&particle=7&iteration=9&tab=why")
    yield State("help", rest, lambda page: page.locator("#help-open").click())
    yield State("run menu", rest, lambda page: page.locator("#run-open").click())
    yield State("not here", "/sessions/0123456789abcdef/")
    yield State("exported scene", scene)


def wrong_file(page: Page) -> None:
    """Give it a file that is none of ours."""
    page.locator("#files").set_input_files({"name": "notes.txt", "mimeType": "text/plain", "buffer": b"hello"})


def prior(page: Page) -> None:
    """All of the set-up, unfolded."""
    page.locator("#setup-choices li").first.wait_for()
    page.locator("label[for=setup-prior]").click()
    page.locator("#setup summary").click()


def taken(browser: Browser, url: str, state: State, size: tuple[int, int], scheme: Any) -> Image.Image:
    """The page in that state."""
    width, height = size
    page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
    try:
        page.goto(state.path if state.path.startswith("file:") else url + state.path)
        page.wait_for_timeout(SETTLE)
        state.act(page)
        page.wait_for_timeout(SETTLE / 2)
        with tempfile.NamedTemporaryFile(suffix=".png") as file:
            page.screenshot(path=file.name)
            return Image.open(file.name).convert("RGB").copy()
    finally:
        page.close()


def sheet(pictures: list[Image.Image]) -> Image.Image:
    """All of them in a row, equally high."""
    scaled = [
        one.resize((round(one.width * HEIGHT / one.height), HEIGHT), Image.Resampling.LANCZOS) for one in pictures
    ]
    rows = [scaled[: len(scaled) // 2], scaled[len(scaled) // 2 :]]
    width = max(sum(one.width + GAP for one in row) for row in rows)
    whole = Image.new("RGB", (width, 2 * (HEIGHT + GAP)), "white")
    for number, row in enumerate(rows):
        left = 0
        for one in row:
            whole.paste(one, (left, number * (HEIGHT + GAP)))
            left += one.width + GAP
    return whole


def main(folder: Path, only: str | None) -> None:
    """Make all, or those of which the name begins with `only`."""
    folder.mkdir(parents=True, exist_ok=True)
    with (
        tempfile.TemporaryDirectory(prefix="states-") as made,
        server_process.running() as server,
        launched() as browser,
        httpx.Client(base_url=f"{server.url}/api/v1", timeout=120.0) as client,
    ):
        ids = sessions(client)
        for state in states(ids, exported(client, ids["rest"], Path(made))):
            if only is not None and not state.name.startswith(only):
                continue
            pictures = []
            for scheme in SCHEMES:
                for size in SIZES:
                    progress(f"{state.name}, {size[0]} x {size[1]}, {scheme}")
                    pictures.append(taken(browser, server.url, state, size, scheme))
                    pictures[-1].save(folder / f"{state.name}-{size[0]}-{scheme}.png")
            sheet(pictures).save(folder / f"{state.name}.png")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="pictures of every state of the pages")
    parser.add_argument("folder", nargs="?", type=Path, default=OUT, help="where they go (default out/page_states)")
    parser.add_argument("--only", help="states of which the name begins so")
    asked = parser.parse_args()
    main(asked.folder, asked.only)
