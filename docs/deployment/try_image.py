"""Does the server work where this runs, with all it needs? For inside the image: `python try_image.py`.

Starts `pmpnbp serve --demo` with a data folder of its own, waits until it is ready, uploads a model of every form and a
scan of every format, runs a session, has it drawn, watches its events, looks at its recording, stops the server, and
makes one estimate without it. Says what it saw, and fails at the first call that does not answer as it should.
"""

from __future__ import annotations

import atexit
import io
import json
import os
import pwd
import signal
import socket
import subprocess
import sys
import tempfile
import time
import zipfile
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import trimesh
from PIL import Image

import sample_data

CABINET = Path(sample_data.__file__).parent / "cabinet"
TOKEN = "a-token-to-try-with"
SECONDS = 600.0  # for compiling on a busy machine; it is waited for, not measured
URDF = """<robot name="box"><link name="box">
<visual><geometry><mesh filename="meshes/box.{kind}"/></geometry></visual>
</link></robot>"""


def main() -> None:
    """Every call, in the order that a user makes them."""
    with tempfile.TemporaryDirectory(prefix="try-") as folder:
        place = Path(folder)
        before = kernels()
        server, client = start(place / "data")
        try:
            scans, model = uploads(client, place)
            session(client, model, scans)
        finally:
            server.send_signal(signal.SIGTERM)
            status = server.wait()
        said(f"stopped by SIGTERM with exit status {status}")
        assert status == 0
        alone(place)
        new = kernels() - before
        said(f"kernels compiled meanwhile: {len(new)}")
        if "KERNEL_TARGETS" in os.environ and "NUMBA_CPU_NAME" not in os.environ:
            assert not new, sorted(new)


def start(data: Path) -> tuple[subprocess.Popen[bytes], httpx.Client]:
    """A server that is ready, and a client with its token."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    given = {"HOST": "127.0.0.1", "PORT": str(port), "DATA_DIR": str(data), "TOKEN": TOKEN}
    began = time.monotonic()
    command = ["pmpnbp", "serve", "--demo"]
    server = subprocess.Popen(command, env=os.environ | {f"PMPNBP_{name}": value for name, value in given.items()})
    atexit.register(server.kill)  # where something fails before it is asked to stop
    client = httpx.Client(base_url=f"http://127.0.0.1:{port}", timeout=SECONDS, trust_env=False)
    while not answers(client):
        assert server.poll() is None, "the server did not start; its words are above"
        assert time.monotonic() < began + SECONDS, "the server does not get ready; its words are above"
        time.sleep(0.05)
    said(f"ready after {time.monotonic() - began:.1f} s")
    assert client.get("/api/v1/models").status_code == 401
    client.headers["Authorization"] = f"Bearer {TOKEN}"
    user = Path(f"/proc/{server.pid}").stat().st_uid
    names = {entry.pw_uid: entry.pw_name for entry in pwd.getpwall()}
    said(f"runs as user {user} ({names.get(user, 'without a name')})")
    return server, client


def answers(client: httpx.Client) -> bool:
    """Whether the server says that it is ready."""
    try:
        return client.get("/readyz").status_code == 200
    except httpx.TransportError:
        return False


def uploads(client: httpx.Client, place: Path) -> tuple[dict[str, str], str]:
    """Identifiers of a scan of every format, by its name, and of the sample cabinet."""
    camera = (CABINET / "open" / "camera.json").read_text(encoding="utf-8")
    models = [CABINET / "cabinet.urdf", *(zipped(place, kind) for kind in ("obj", "stl", "dae"))]
    made = [posted(client, "models", path)["id"] for path in models]
    scans = {
        path.name: posted(client, "scans", path, {"camera": camera} if depth else {})["id"]
        for path, depth in scan_files(place)
    }
    said(f"took {len(made)} models and scans as {', '.join(scans)}")
    return scans, made[0]


def zipped(place: Path, kind: str) -> Path:
    """A model whose one mesh is of this kind, with more triangles than are kept."""
    shape = trimesh.creation.icosphere(subdivisions=5, radius=0.2)
    mesh = trimesh.exchange.export.export_mesh(shape, io.BytesIO(), file_type=kind)
    path = place / f"box_{kind}.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("box.urdf", URDF.format(kind=kind))
        archive.writestr(f"meshes/box.{kind}", mesh)
    return path


def scan_files(place: Path) -> list[tuple[Path, bool]]:
    """The sample scan in every format, and whether that is a depth image, which comes with a camera."""
    picture = CABINET / "open" / "depth.png"
    camera = json.loads((CABINET / "open" / "camera.json").read_text(encoding="utf-8"))
    with Image.open(picture) as opened:
        depth = np.asarray(opened, dtype=np.float32) / 1000.0
    rows, columns = np.nonzero(depth)
    far = depth[rows, columns]
    right, down = (columns - camera["cx"]) * far / camera["fx"], (rows - camera["cy"]) * far / camera["fy"]
    points = np.stack([right, down, far], axis=1).astype(np.float32)[::4]
    lines = "\n".join(f"{x:.4f} {y:.4f} {z:.4f}" for x, y, z in points) + "\n"
    fields = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    size = f"WIDTH {len(points)}\nHEIGHT 1\nPOINTS {len(points)}\n"
    members = "property float x\nproperty float y\nproperty float z\n"
    texts = {
        "cloud.xyz": lines,
        "cloud.pcd": f"VERSION 0.7\n{fields}{size}DATA ascii\n{lines}",
        "cloud.ply": f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n{members}end_header\n{lines}",
    }
    for name, text in texts.items():
        (place / name).write_text(text, encoding="ascii")
    np.save(place / "depth.npy", depth)
    np.savez(place / "cloud.npz", points=points)
    clouds = [(place / name, False) for name in (*texts, "cloud.npz")]
    return [(picture, True), (place / "depth.npy", True), *clouds]


def session(client: httpx.Client, model: str, scans: dict[str, str]) -> None:
    """A session from its beginning to its recording, which is uploaded again; and the demonstration's picture."""
    roi = json.loads((CABINET / "open" / "roi.json").read_text(encoding="utf-8"))
    wanted = {"model_id": model, "scan_ids": [scans["depth.png"]], "iterations": 20, "roi": roi_of(roi)}
    made = checked(client.post("/api/v1/sessions", json=wanted), 201).json()
    path = f"/api/v1/sessions/{made['id']}"
    checked(client.post(f"{path}/run", json={"iterations": 20, "until": "iterations"}), 202)
    estimate = checked(client.get(f"{path}/estimate?wait=idle&timeout={SECONDS:g}"), 200).json()
    while estimate["state"] == "running":
        estimate = checked(client.get(f"{path}/estimate?wait=idle&timeout={SECONDS:g}"), 200).json()
    said(f"a session of {estimate['iteration']} iterations: fit {estimate['fit']}")
    assert estimate["fit"] == "good"
    for one in [made, *(one for one in listed(client, "sessions") if one["id"] != made["id"])]:
        picture = checked(client.get(f"/api/v1/sessions/{one['id']}/estimate.png"), 200)
        with Image.open(io.BytesIO(picture.content)) as drawn:
            colours = len(np.unique(np.asarray(drawn.convert("RGB")).reshape(-1, 3), axis=0))
            said(f"drawn: {drawn.width} × {drawn.height}, {colours} colours")
            assert colours > 100
    with client.stream("GET", f"{path}/events", headers={"Last-Event-ID": "0"}) as events:
        assert next(line for line in events.iter_lines() if line.startswith("event:"))
    assert "<html" in checked(client.get(made["view_url"]), 200).text
    recording = checked(client.get(f"{path}/recording"), 200).content
    uploaded = client.post("/api/v1/recordings", files={"file": ("run.sqlite", recording)})
    said(f"recording of {len(recording)} bytes, uploaded again as {checked(uploaded, 201).json()['id']}")


def roi_of(found: Any) -> Any:
    """The six numbers, whether the file has them alone or under a name."""
    return found["roi"] if isinstance(found, dict) else found


def alone(place: Path) -> None:
    """An estimate on the command line."""
    scene, out = CABINET / "open", place / "result.json"
    command = ["pmpnbp", "estimate", CABINET / "cabinet.urdf", scene / "depth.png", "--camera", scene / "camera.json"]
    subprocess.run([*command, "--iterations", "5", "--quiet", "--out", out], check=True)
    said(f"pmpnbp estimate: {json.loads(out.read_text(encoding='utf-8'))['schema']}")


def kernels() -> set[str]:
    """What is compiled and kept, where that can be written."""
    folder = Path(os.environ.get("NUMBA_CACHE_DIR", "/nowhere"))
    return {f"{path} {path.stat().st_mtime_ns}" for path in folder.rglob("*.nb?")}


def posted(client: httpx.Client, kind: str, path: Path, more: dict[str, str] | None = None) -> dict[str, Any]:
    """What the server makes of an upload."""
    answer = client.post(f"/api/v1/{kind}", files={"file": (path.name, path.read_bytes())}, data=more)
    return dict(checked(answer, 201).json())


def listed(client: httpx.Client, kind: str) -> list[dict[str, Any]]:
    """All of a kind that the server has."""
    found = checked(client.get(f"/api/v1/{kind}"), 200).json()
    return list(found if isinstance(found, list) else found[kind])


def checked(answer: httpx.Response, status: int) -> httpx.Response:
    """The answer, if it has this status."""
    said_instead = "" if answer.status_code == status else answer.read().decode(errors="replace")[:500]
    assert answer.status_code == status, f"{answer.request.method} {answer.url}: {answer.status_code} {said_instead}"
    return answer


def said(line: str) -> None:
    """A line on standard output, at once."""
    sys.stdout.write(f"  {line}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
