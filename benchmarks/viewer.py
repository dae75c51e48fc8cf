"""What does looking cost, and how soon is something seen? The page in a real browser, and the 3D view's server side.

Starts a server of its own on a free port. Chromium renders in software, on the same cores. Run it:
`python -m benchmarks.viewer [steps] [scrub] [slowdown] [soak] [--iterations 20000]`; without names the first three.

| name | measures |
| --- | --- |
| steps | from the click on "step" to other pixels in the page's 3D view; the cabinet, 4 parts × 400 particles |
| scrub | from the call that asks for an iteration until it is drawn, any of 1,000 of the 12-part robot |
| slowdown | seconds an iteration takes with and without somebody who looks, in turns |
| soak | memory of server and page while many iterations are made and drawn |
"""

from __future__ import annotations

import argparse
import asyncio
import io
import json
import threading
import time
import zipfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from playwright.sync_api import Page

from benchmarks import server_process
from benchmarks.browser import launched
from benchmarks.server_process import CABINET, ServerProcess, upload_model, upload_scan
from benchmarks.tables import markdown, progress
from benchmarks.trials import PROJECT, load_roi
from benchmarks.view_socket import view_socket

ROBOT = PROJECT / "sample_data" / "robot"
VIEW = "benchmark"

# In every frame of the page: after one in which WebGL was drawn, `drawn` is called. Only then has a canvas its content,
# and whoever reads it waits until it is drawn to the end.
_HEAR_DRAWING = """
{
  const soon = window.requestAnimationFrame.bind(window);
  let drawing = false;
  for (const name of ["drawElements", "drawArrays", "drawElementsInstanced", "drawArraysInstanced"]) {
    const draw = WebGL2RenderingContext.prototype[name];
    WebGL2RenderingContext.prototype[name] = function (...given) {
      drawing = true;
      return draw.apply(this, given);
    };
  }
  window.requestAnimationFrame = (act) => soon((time) => {
    drawing = false;
    act(time);
    if (drawing) window.drawn?.();
  });
}
"""

# Resolves once the 3D view's canvas shows something else than before the click on "step"; milliseconds from the click.
_UNTIL_OTHER_PIXELS = """
() => new Promise((done) => {
  const inner = document.querySelector("iframe").contentWindow;
  const all = [...inner.document.querySelectorAll("canvas")];
  const canvas = all.reduce((most, one) => (one.width * one.height > most.width * most.height ? one : most));
  const small = new OffscreenCanvas(192, 120).getContext("2d", { willReadFrequently: true });
  let before = window.before; // of the step before: nothing is drawn while nothing changes
  let start = null;
  let late = null;
  const finish = (taken) => {
    clearTimeout(late);
    inner.drawn = null;
    window.before = before;
    done(taken);
  };
  const begin = () => setTimeout(() => {
    start = performance.now();
    document.querySelector("#step").click();
    late = setTimeout(() => finish(null), 10000);
  }, WAIT);
  inner.drawn = () => {
    small.clearRect(0, 0, 192, 120);
    small.drawImage(canvas, 0, 0, 192, 120);
    const { data } = small.getImageData(0, 0, 192, 120);
    const other = start !== null && data.some((value, place) => Math.abs(value - before[place]) > 4);
    if (!before) begin();
    if (other || start === null) before = data;
    if (other) finish(performance.now() - start);
  };
  if (before) begin();
})
"""


def main(words: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.viewer", description=__doc__)
    parser.add_argument("what", nargs="*", choices=["steps", "scrub", "slowdown", "soak", []], metavar="NAME")
    parser.add_argument("--iterations", type=int, default=20_000, help="of the soak (default 20000)")
    arguments = parser.parse_args(words)
    measures: dict[str, Callable[[ServerProcess], None]] = {
        "steps": steps,
        "scrub": scrub,
        "slowdown": slowdown,
        "soak": lambda server: soak(server, arguments.iterations),
    }
    for name in arguments.what or ("steps", "scrub", "slowdown"):
        progress(name)
        with server_process.running() as server:
            measures[name](server)
    return 0


def steps(server: ServerProcess, count: int = 60) -> None:
    """From the click on "step" to new pixels."""
    with api(server) as client:
        session = cabinet(client, config={"preset": "paper"})  # whose particles move in each iteration
        client.post(f"/sessions/{session}/step", json={"iterations": 3}).raise_for_status()
        with page(server, session) as shown:
            taken = []
            for wait in np.random.default_rng(0).integers(200, 900, count).tolist():
                taken.append(shown.evaluate(_UNTIL_OTHER_PIXELS.replace("WAIT", str(wait))))
    missed = sum(time is None for time in taken)
    row = ["step to pixels", len(taken), *quantiles([time for time in taken if time is not None]), missed]
    print(markdown(["", "steps", "median (ms)", "90 %", "longest", "not seen"], [row]))


def scrub(server: ServerProcess, iterations: int = 1000, count: int = 100) -> None:
    """From asking for an iteration until it is drawn."""
    rng = np.random.default_rng(0)
    with api(server) as client:
        session = robot(client)
        run(client, session, iterations)
        with looking(server, session):
            taken = []
            for iteration in rng.integers(0, iterations + 1, count).tolist():
                began = time.perf_counter()
                client.patch(f"/sessions/{session}/views/{VIEW}", json={"iteration": iteration}).raise_for_status()
                while drawn(client, session) != iteration:
                    time.sleep(0.002)
                taken.append((time.perf_counter() - began) * 1000.0)
    print(markdown(["", "iterations", "median (ms)", "90 %", "longest"], [["scrub", count, *quantiles(taken)]]))


def slowdown(server: ServerProcess, turns: int = 6, iterations: int = 150) -> None:
    """Iterations with and without a viewer: in turns, as the machine's clock drifts."""
    rows = []
    with api(server) as client:
        session = cabinet(client)
        run(client, session, 100)
        for title, look in (("a client that takes all", looking), ("the page in Chromium", page)):
            ratios = []
            for _ in range(turns):
                alone = pace(client, session, iterations)
                with look(server, session):
                    time.sleep(2.0)
                    ratios.append(pace(client, session, iterations) / alone)
            rows.append([title, turns, f"{np.median(ratios):.3f}", f"{min(ratios):.3f}", f"{max(ratios):.3f}"])
    print(markdown(["somebody looks by", "turns", "median ratio", "least", "most"], rows))


def soak(server: ServerProcess, iterations: int, turns: int = 20) -> None:
    """Memory while iterations are made, and drawn by the page."""
    rows: list[list[str]] = []
    with api(server) as client:
        session = cabinet(client, config={"preset": "paper"})
        run(client, session, 200)
        with page(server, session) as shown:
            for turn in range(turns):
                began = time.perf_counter()
                count = round(iterations / turns)
                run(client, session, count)
                pace = count / (time.perf_counter() - began)
                now = client.get(f"/sessions/{session}").json()["iteration"]
                rows.append([str(now), f"{resident(server):.0f}", f"{page_heap(shown):.1f}", f"{pace:.1f}"])
                progress(f"{turn}: {rows[-1]}")
    print(markdown(["iteration", "server (MiB)", "page's heap (MiB)", "iterations/s"], rows))


def resident(server: ServerProcess) -> float:
    """MiB of memory that the server has."""
    status = Path(f"/proc/{server.process.pid}/status").read_text(encoding="ascii")
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS")) / 1024


def page_heap(shown: Page) -> float:
    """MiB of the page's heap after a collection."""
    browser = shown.context.new_cdp_session(shown)
    browser.send("HeapProfiler.collectGarbage")
    heap = browser.send("Runtime.getHeapUsage")["usedSize"] / 2**20
    browser.detach()
    return float(heap)


def quantiles(taken: Sequence[float]) -> list[str]:
    """Median, 90 % and longest, as text."""
    return [f"{np.percentile(taken, q):.0f}" for q in (50, 90, 100)]


def pace(client: httpx.Client, session: str, iterations: int) -> float:
    """Seconds an iteration takes."""
    began = time.perf_counter()
    run(client, session, iterations)
    return (time.perf_counter() - began) / iterations


def run(client: httpx.Client, session: str, iterations: int) -> None:
    """Make so many iterations."""
    client.post(f"/sessions/{session}/run", json={"iterations": iterations}).raise_for_status()
    while client.get(f"/sessions/{session}/estimate", params={"wait": "idle", "timeout": 600}).json()["state"] in (
        "running",
        "waiting",
    ):
        pass


def drawn(client: httpx.Client, session: str) -> int | None:
    """The iteration that the view shows."""
    found = client.get(f"/sessions/{session}/views/{VIEW}").json()["drawn"]
    return None if found is None else found["iteration"]


@contextmanager
def api(server: ServerProcess) -> Iterator[httpx.Client]:
    """Calls to the server."""
    with httpx.Client(base_url=f"{server.url}/api/v1", timeout=700.0) as client:
        yield client


def cabinet(client: httpx.Client, **more: Any) -> str:
    """A session on the open cabinet."""
    return create(client, upload_model(client), upload_scan(client), CABINET / "open", **more)


def robot(client: httpx.Client) -> str:
    """A session on the 12-part robot, with its prior."""
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as archive:
        for path in (ROBOT / "robot.urdf", *(ROBOT / "meshes").iterdir()):
            archive.write(path, path.relative_to(ROBOT))
    model = client.post("/models", files={"file": ("robot.zip", packed.getvalue())})
    scene = ROBOT / "scan_0"
    camera = (scene / "camera.json").read_text(encoding="utf-8")
    files = {"file": ("depth.png", (scene / "depth.png").read_bytes())}
    scan = client.post("/scans", files=files, data={"camera": camera})
    prior = json.loads((scene / "prior.json").read_text(encoding="utf-8"))
    return create(client, model, scan, scene, prior=prior)


def create(client: httpx.Client, model: httpx.Response, scan: httpx.Response, scene: Path, **more: Any) -> str:
    """A session on what was uploaded."""
    body = {"model_id": model.json()["id"], "scan_ids": [scan.json()["id"]], "roi": load_roi(scene).tolist()}
    answer = client.post("/sessions", json=body | more)
    answer.raise_for_status()
    return str(answer.json()["id"])


@contextmanager
def page(server: ServerProcess, session: str) -> Iterator[Page]:
    """The session's page in Chromium, with something in its 3D view."""
    with launched() as browser:
        shown = browser.new_page(viewport={"width": 1440, "height": 900})
        shown.add_init_script(_HEAR_DRAWING)
        shown.goto(f"{server.url}/sessions/{session}/")
        shown.frame_locator("iframe").locator("canvas").first.wait_for()
        shown.wait_for_timeout(4000)
        yield shown


@contextmanager
def looking(server: ServerProcess, session: str) -> Iterator[None]:
    """A client of the 3D view that takes everything and draws nothing, as one on another machine would be."""
    stop = threading.Event()
    there = threading.Event()

    async def take() -> None:
        async with view_socket(server.url, session, VIEW) as socket:
            there.set()
            while not stop.is_set():
                try:
                    await asyncio.wait_for(socket.recv(), 0.2)
                except TimeoutError:
                    continue

    thread = threading.Thread(target=lambda: asyncio.run(take()))
    thread.start()
    there.wait(10.0)
    try:
        yield
    finally:
        stop.set()
        thread.join()


if __name__ == "__main__":
    raise SystemExit(main())
