"""Sessions for tests: the sample cabinet with settings so small that an iteration takes a few milliseconds, and the
last one of the search, which polishes what each island has found, half a second."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from weakref import WeakKeyDictionary

import httpx

CABINET = Path(__file__).resolve().parents[2] / "sample_data" / "cabinet"
ROI = json.loads((CABINET / "open" / "roi.json").read_text())["roi"]
QUICK = {
    "image_width": 80,
    "triangles": 60,
    "splat_points": 64,
    "search_iterations": 2,
    "search_proposals": 300,
    "search_islands": 1,
    "search_restarts": 0,
    "anneal_iterations": 2,
    "refine_iterations": 1,
}
# How often a member that changes by itself is looked at.
PATIENCE = 0.02
# Of a server's client: the model and the scan that `create` has uploaded there.
_UPLOADED: WeakKeyDictionary[httpx.Client, dict[str, str]] = WeakKeyDictionary()


def upload_model(client: httpx.Client) -> str:
    """The id of the cabinet, uploaded."""
    path = CABINET / "cabinet.urdf"
    answer = client.post("/api/v1/models", files={"file": (path.name, path.read_bytes())})
    assert answer.status_code == 201, answer.text
    return str(answer.json()["id"])


def upload_scan(client: httpx.Client, scene: str = "open") -> str:
    """The id of a scan of the cabinet, uploaded."""
    folder = CABINET / scene
    answer = client.post(
        "/api/v1/scans",
        files={"file": ("depth.png", (folder / "depth.png").read_bytes())},
        data={"camera": (folder / "camera.json").read_text()},
    )
    assert answer.status_code == 201, answer.text
    return str(answer.json()["id"])


def body(model_id: str, scan_id: str, **members: Any) -> dict[str, Any]:
    """What makes a small session."""
    asked = {"model_id": model_id, "scan_ids": [scan_id], "roi": ROI, "particles": 40, "seed": 11, "config": QUICK}
    return asked | members


def create(client: httpx.Client, **members: Any) -> str:
    """The path of a small session. Where no model or scan is named it has those of the client's other sessions: to
    read both, and to observe the scan, takes longer than the session's first iterations."""
    model_id = members.pop("model_id", None) or _uploaded(client, "models", upload_model)
    scan_id = members.pop("scan_id", None) or _uploaded(client, "scans", upload_scan)
    answer = client.post("/api/v1/sessions", json=body(model_id, scan_id, **members))
    assert answer.status_code == 201, answer.text
    return f"/api/v1/sessions/{answer.json()['id']}"


def _uploaded(client: httpx.Client, kind: str, upload: Callable[[httpx.Client], str]) -> str:
    """The id of what was uploaded before, if nobody has deleted it since."""
    known = _UPLOADED.setdefault(client, {})
    if kind not in known or client.get(f"/api/v1/{kind}/{known[kind]}").status_code != 200:
        known[kind] = upload(client)
    return known[kind]


def after(client: httpx.Client, iterations: int, /, **members: Any) -> str:
    """The path of a small session, made as `create` does, that has made so many iterations."""
    path = create(client, **members)
    step(client, path, iterations)
    return path


def step(client: httpx.Client, path: str, iterations: int = 1) -> dict[str, Any]:
    """The session after so many more iterations."""
    answer = client.post(f"{path}/step", json={"iterations": iterations})
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def at_rest(client: httpx.Client, path: str) -> dict[str, Any]:
    """The session once it does not iterate."""
    while True:
        found: dict[str, Any] = client.get(path).json()
        if found["state"] in ("paused", "failed"):
            return found
        time.sleep(PATIENCE)


def numbers(client: httpx.Client, path: str, iteration: int | None = None) -> dict[str, Any]:
    """The estimate without what differs from run to run: seconds and the session's own members."""
    query = "" if iteration is None else f"?iteration={iteration}"
    answer = client.get(f"{path}/estimate{query}")
    assert answer.status_code == 200, answer.text
    own = ("seconds", "session_id", "state", "outdated")
    return {name: value for name, value in answer.json().items() if name not in own}


def problem(answer: httpx.Response, status: int, text: str) -> None:
    assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json"), answer.text
    assert text in answer.json()["detail"]


def ids_of(client: httpx.Client, path: str) -> tuple[str, str]:
    found = client.get(path).json()
    return found["model_id"], found["scan_ids"][0]


def history(client: httpx.Client, path: str, count: int) -> list[dict[str, Any]]:
    return [numbers(client, path, iteration) for iteration in range(count + 1)]
