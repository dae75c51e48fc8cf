"""Models, scans, sessions and recordings for attacks: valid ones, which an attack then changes."""

from __future__ import annotations

import contextlib
import json
import re
import sqlite3
import tempfile
import zlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import httpx

from tests.app.attacks.target import Target
from tests.app.small_sessions import CABINET, QUICK, ROI

DEPTH = (CABINET / "open" / "depth.png").read_bytes()
CAMERA_TEXT = (CABINET / "open" / "camera.json").read_text(encoding="utf-8")
CAMERA: dict[str, Any] = json.loads(CAMERA_TEXT)
URDF = (CABINET / "cabinet.urdf").read_text(encoding="utf-8")
# Links of the cabinet, as a model of a ROS robot names its own.
WITH_SLASHES = re.sub(r'(name|link)="(frame|drawer\d|handle\d)"', r'\1="robot/\2"', URDF)
# Any text that cannot be written as UTF-8, as it comes in a JSON body.
SURROGATE = "\ud800"


def upload_model(client: httpx.Client, urdf: str | bytes = URDF, name: str = "cabinet.urdf") -> httpx.Response:
    """A URDF, uploaded."""
    return client.post("/api/v1/models", files={"file": (name, urdf)})


def upload_scan(client: httpx.Client, camera: Mapping[str, Any] | str | None = None) -> httpx.Response:
    """The scan of the open cabinet, uploaded, with another camera where one is given."""
    text = camera if isinstance(camera, str) else json.dumps(dict(CAMERA if camera is None else camera))
    return client.post("/api/v1/scans", files={"file": ("depth.png", DEPTH)}, data={"camera": text})


def upload_further_scan(client: httpx.Client) -> httpx.Response:
    """The scan of the same cabinet from a second place, uploaded."""
    folder = CABINET / "second_view"
    camera = (folder / "camera.json").read_text(encoding="utf-8")
    return client.post(
        "/api/v1/scans", files={"file": ("depth.png", (folder / "depth.png").read_bytes())}, data={"camera": camera}
    )


def upload_recording(client: httpx.Client, content: bytes, name: str = "recording.sqlite") -> httpx.Response:
    """A recording, uploaded."""
    return client.post("/api/v1/recordings", files={"file": (name, content)})


def post_json(client: httpx.Client, path: str, body: Any, method: str = "POST") -> httpx.Response:
    """A JSON body in ASCII, as what is no text can only be sent escaped."""
    return client.request(method, path, content=json.dumps(body), headers={"Content-Type": "application/json"})


def session_body(model_id: str, scan_id: str, **members: Any) -> dict[str, Any]:
    """What makes a small session."""
    body = {"model_id": model_id, "scan_ids": [scan_id], "roi": ROI, "particles": 40, "seed": 1, "config": QUICK}
    return body | members


def small_session(target: Target, client: httpx.Client, iterations: int = 0, urdf: str = URDF, **members: Any) -> str:
    """The path of a small session after so many iterations; it, its model and its scan are removed in the end."""
    model = target.made_by("models", upload_model(client, urdf))
    scan = target.made_by("scans", upload_scan(client))
    path = "/api/v1/sessions"
    id = target.made_by("sessions", client.post(path, json=session_body(model, scan, **members)))
    if iterations:
        client.post(f"{path}/{id}/step", json={"iterations": iterations}).raise_for_status()
    return f"{path}/{id}"


def recording(target: Target, client: httpx.Client, iterations: int = 5) -> bytes:
    """The recording of a small session."""
    return client.get(f"{small_session(target, client, iterations)}/recording").raise_for_status().content


def edited(content: bytes, edit: Callable[[sqlite3.Connection], object]) -> bytes:
    """A recording, changed."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "recording.sqlite"
        path.write_bytes(content)
        with contextlib.closing(sqlite3.connect(path)) as connection:
            edit(connection)
            connection.commit()
        return path.read_bytes()


def packed_zeros(count: int) -> bytes:
    """zlib's stream of `count` zeros, a multiple of 16 MiB, made without having them."""
    piece = 16 << 20
    assert count % piece == 0
    packer = zlib.compressobj(9, wbits=-15)
    # each piece ends at a byte, and does without what came before it, so it can be repeated
    packed = packer.compress(bytes(piece)) + packer.flush(zlib.Z_FULL_FLUSH)
    checksum = (count % 65521) << 16 | 1  # Adler-32 of so many zeros
    return b"\x78\xda" + packed * (count // piece) + b"\x03\x00" + checksum.to_bytes(4, "big")
