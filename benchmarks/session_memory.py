"""How much memory does a session take, beside what is estimated before it is made, and does it come back?

For each size a server of its own on a free port: a session is made, iterates, is asked for what it has found, and is
deleted. Megabytes of the server's process beyond what it took before. Run it:
`python -m benchmarks.session_memory [cabinet:4:400 chain:48:20000 …] [--seconds 60] [--config image_width=640]`.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from app.sessions.memory_room import estimated_bytes
from benchmarks import server_process
from benchmarks.generated import KINDS, generated_case
from benchmarks.server_process import CABINET, upload_model, upload_scan
from benchmarks.tables import markdown, progress
from benchmarks.trials import load_roi
from pmpnbp import recording
from pmpnbp.geometry import poses
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.settings import changed, preset

SIZES = ("cabinet:4:400", "cabinet:4:20000", "chain:12:400", "chain:12:5000", "chain:24:5000", "chain:48:400")


def memory(process: int) -> dict[str, float]:
    """Megabytes that a process takes, VmRSS, and took at most, VmHWM; `Threads`, how many it has."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    found = {line.split(":")[0]: line.split()[1] for line in lines if line.split()[1:2]}
    return {name: float(found[name]) / (1 if name == "Threads" else 1024) for name in ("VmRSS", "VmHWM", "Threads")}


def main(words: Sequence[str] | None = None) -> int:
    """Measure and print."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.session_memory", description=__doc__)
    parser.add_argument("sizes", nargs="*", default=SIZES, metavar="KIND:PARTS:PARTICLES")
    parser.add_argument("--seconds", type=float, default=60.0, help="how long a session iterates, at most (default 60)")
    parser.add_argument("--config", action="append", default=[], metavar="NAME=VALUE", help="a setting of the sessions")
    arguments = parser.parse_args(words)
    config = dict(entry.split("=", 1) for entry in arguments.config)
    rows = []
    for size in arguments.sizes:
        progress(size)
        rows.append(_measured(size, config, arguments.seconds))
        print(*rows[-1], flush=True)
    head = ["session", "iterations", "estimated", "made", "peak", "estimated / peak", "asked for", "deleted"]
    print(markdown(head, rows))
    return 0


def _measured(size: str, config: dict[str, str], seconds: float) -> list[str]:
    kind, parts, particles = size.split(":")
    with server_process.running() as server, httpx.Client(base_url=f"{server.url}/api/v1", timeout=None) as client:
        body, estimated = _asked(client, kind, int(parts), int(particles), config)
        return [size, *_figures(client, server.process.pid, body, estimated / 2**20, seconds)]


def _figures(client: httpx.Client, process: int, body: Any, estimated: float, seconds: float) -> list[str]:
    Path(f"/proc/{process}/clear_refs").write_text("5")  # the peak counts from now on
    before = memory(process)["VmRSS"]
    answer = client.post("/sessions", json=body)
    answer.raise_for_status()
    session = f"/sessions/{answer.json()['id']}"
    made = memory(process)["VmHWM"] - before
    client.post(f"{session}/run", json={"iterations": 100, "until": "converged"}).raise_for_status()
    end = time.monotonic() + seconds
    while (status := client.get(session).json())["state"] == "running" and time.monotonic() < end:
        time.sleep(0.2)
    client.post(f"{session}/pause")
    peak = memory(process)["VmHWM"] - before
    for path in ("estimate", "estimate?iteration=1", "trace"):
        client.get(f"{session}/{path}").raise_for_status()
    asked = memory(process)["VmHWM"] - before
    client.delete(session).raise_for_status()  # after which memory is given back, soon
    time.sleep(3.0)
    deleted = memory(process)["VmRSS"] - before
    figures = (estimated, made, peak, estimated / max(peak, 1.0), asked, deleted)
    return [f"{status['iteration']}", *(f"{figure:.2f}" if figure < 10 else f"{figure:.0f}" for figure in figures)]


def _asked(client: httpx.Client, kind: str, parts: int, particles: int, config: dict[str, str]) -> tuple[Any, float]:
    """The body of a session on that object, and the bytes that are estimated for it."""
    if kind == "cabinet":
        model, scan, roi = upload_model(client), upload_scan(client), load_roi(CABINET / "open").tolist()
        view = load_scan(CABINET / "open" / "depth.png", CABINET / "open" / "camera.json")
        urdf = (CABINET / "cabinet.urdf").read_text(encoding="utf-8")
    else:
        # with a working image as wide as the scan it is the scan
        case = generated_case(kind, parts, changed(preset("robust"), {"image_width": 1280}))
        urdf, seen = KINDS[kind](parts).urdf, case.observation.views[0]
        roi, view = list(case.observation.roi), Scan(seen.camera, seen.depth)
        model = client.post("/models", files={"file": ("model.urdf", urdf.encode())})
        scan = _upload(client, view)
    body = {"model_id": model.json()["id"], "scan_ids": [scan.json()["id"]], "roi": roi}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.urdf"
        path.write_text(urdf, encoding="utf-8")
        settings = changed(preset("robust"), config)
        problem, _ = recording.prepare(path, [view], roi, None, settings, particles=particles, seed=0)
    return body | {"particles": particles, "config": config}, estimated_bytes(problem)


def _upload(client: httpx.Client, scan: Scan) -> httpx.Response:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "depth.npy"
        np.save(path, scan.depth)
        camera = scan.camera
        members = {
            "width": camera.width,
            "height": camera.height,
            **{name: float(getattr(camera, name)) for name in ("fx", "fy", "cx", "cy")},
            "T_world_camera": poses.to_matrix(camera.pose_world_camera).ravel().tolist(),
        }
        return client.post(
            "/scans", files={"file": ("depth.npy", path.read_bytes())}, data={"camera": json.dumps(members)}
        )


if __name__ == "__main__":
    raise SystemExit(main())
