"""Make the README's pictures of the page again: `python -m benchmarks.page_pictures [FOLDER]`, by default docs/images.

A real server, a real browser and the sample cabinet: `page.png` and `page_dark.png` after the inference has come to
rest, and `belief.webp`, a belief that forms iteration by iteration.
"""

from __future__ import annotations

import argparse
import io
import re
from pathlib import Path
from typing import Any

import httpx
from PIL import Image
from playwright.sync_api import Browser, Page

from benchmarks import server_process
from benchmarks.browser import launched
from benchmarks.viewer import cabinet

OUT = Path(__file__).resolve().parent.parent / "docs" / "images"
SIZE = {"width": 1440, "height": 900}
# The animation: iterations shown, its width, milliseconds of a frame and of the last.
FRAMES, WIDTH, PACE, LAST = 22, 960, 260, 2500


def main(folder: Path) -> None:
    """Make all."""
    folder.mkdir(parents=True, exist_ok=True)
    with (
        server_process.running() as server,
        launched() as browser,
        httpx.Client(base_url=f"{server.url}/api/v1", timeout=120.0) as client,
    ):
        session = cabinet(client, name="Cabinet with an open drawer")
        animate(browser, server.url, client, session, folder / "belief.webp")
        for scheme, name in (("light", "page.png"), ("dark", "page_dark.png")):
            shown = opened(browser, f"{server.url}/sessions/{session}/?economy=0", scheme)
            shown.wait_for_timeout(5000)
            shown.screenshot(path=folder / name)
            shown.close()


def animate(browser: Browser, url: str, client: httpx.Client, session: str, path: Path) -> None:
    """Step through the first iterations, a frame each, then let it come to rest."""
    shown = opened(browser, f"{url}/sessions/{session}/?economy=0", "light")
    frames = [taken(shown, client, session, 0)]
    for iteration in range(1, FRAMES):
        client.post(f"/sessions/{session}/step", json={"iterations": 1}).raise_for_status()
        frames.append(taken(shown, client, session, iteration))
    shown.close()
    client.post(f"/sessions/{session}/run", json={"until": "converged"}).raise_for_status()
    client.get(f"/sessions/{session}/estimate", params={"wait": "idle", "timeout": 120})
    durations = [PACE] * (len(frames) - 1) + [LAST]
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=durations, loop=0, quality=70, method=6)


def taken(shown: Page, client: httpx.Client, session: str, iteration: int) -> Image.Image:
    """The page, once its 3D view has drawn the iteration."""
    for _ in range(200):
        view = re.search(r"/view/([^/]+)", shown.frames[-1].url)
        found: Any = client.get(f"/sessions/{session}/views/{view[1]}").json()["drawn"] if view else None
        if found is not None and found["iteration"] == iteration:
            break
        shown.wait_for_timeout(50)
    shown.wait_for_timeout(600)  # what has been drawn is on its way to the browser
    image = Image.open(io.BytesIO(shown.screenshot())).convert("RGB")
    return image.resize((WIDTH, round(WIDTH * image.height / image.width)), Image.Resampling.LANCZOS)


def opened(browser: Browser, url: str, scheme: Any) -> Page:
    """A session's page, in `light` or `dark`, with something in its 3D view."""
    shown = browser.new_page(viewport=SIZE, color_scheme=scheme, device_scale_factor=1)
    shown.goto(url)
    shown.frame_locator("iframe").locator("canvas").first.wait_for()
    shown.wait_for_timeout(4000)
    return shown


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="make the README's pictures of the page again")
    parser.add_argument("folder", nargs="?", type=Path, default=OUT, help="where they go (default docs/images)")
    main(parser.parse_args().folder)
