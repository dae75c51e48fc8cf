"""Do uploads become what the contract says, over a real port? And what becomes of those that cannot be read?"""

from __future__ import annotations

import hashlib
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import numpy as np
import pytest

from app.store.store import safe_name
from pmpnbp.scene.scan_files import load_scan
from tests.app import mutations, upload_attack
from tests.app.upload_calls import CABINET, detail, emptied, nothing_kept, upload
from tests.servers import NO_AUTHORITIES

CAMERA = (CABINET / "open" / "camera.json").read_text(encoding="utf-8")
DEPTH = (CABINET / "open" / "depth.png").read_bytes()
BOUNDARY = "----b"
FORM = {"Content-Type": f"multipart/form-data; boundary={BOUNDARY}"}


@pytest.fixture(scope="module")
def one_server(serve_for_module: Callable[..., Any]) -> Any:
    """One for all tests here: a server that has just started spends its first second on its readers' imports."""
    return serve_for_module()


@pytest.fixture
def served(one_server: Any) -> Any:
    """The server with nothing in its store."""
    return emptied(one_server)


# What is taken in


def test_a_model(served: Any) -> None:
    content = (CABINET / "cabinet.urdf").read_bytes()
    answer = upload(served.client, "models", "cabinet.urdf", content)
    model = answer.json()
    assert answer.status_code == 201
    assert model["name"] == "cabinet"
    assert model["links"][:2] == ["frame", "drawer1"]
    assert [part["name"] for part in model["parts"]] == ["frame", "drawer1", "drawer2", "drawer3"]
    assert model["joints"][0] == {
        "name": "slide1",
        "type": "prismatic",
        "parent": "frame",
        "child": "drawer1",
        "lower": 0.0,
        "upper": 0.32,
        "mimic": None,
    }
    assert model["sha256"] == hashlib.sha256(content).hexdigest()
    assert answer.headers["Location"] == f"/api/v1/models/{model['id']}"
    assert served.client.get(answer.headers["Location"]).json() == model
    assert served.client.get("/api/v1/models").json() == [model]
    assert served.client.delete(answer.headers["Location"]).status_code == 204
    assert served.client.get("/api/v1/models").json() == []
    assert "there are 0 models" in detail(served.client.get(answer.headers["Location"]), 404)


def test_a_scan_is_kept_as_the_library_reads_it(served: Any) -> None:
    answer = upload(served.client, "scans", "depth.png", DEPTH, camera=CAMERA)
    scan = answer.json()
    expected = load_scan(CABINET / "open" / "depth.png", CABINET / "open" / "camera.json")
    kept = served.app.state.store.load_scan(scan["id"])
    assert kept.depth.tobytes() == expected.depth.tobytes()
    assert kept.camera.pose_world_camera.tobytes() == expected.camera.pose_world_camera.tobytes()
    assert scan["points"] == int((expected.depth > 0).sum())
    assert scan["valid_fraction"] == pytest.approx((expected.depth > 0).mean())
    given = json.loads(CAMERA)
    assert scan["camera"]["fx"] == given["fx"] and scan["camera"]["width"] == 640
    assert scan["camera"]["T_world_camera"] == pytest.approx(given["T_world_camera"], abs=1e-9)
    matrix = np.reshape(scan["camera"]["T_world_camera"], (4, 4))
    points = expected.camera.back_project(expected.depth)[expected.depth > 0].astype(np.float64)
    world = points @ matrix[:3, :3].T + matrix[:3, 3]
    assert scan["bounds"] == pytest.approx([*world.min(axis=0), *world.max(axis=0)], abs=1e-6)
    assert served.client.get("/api/v1/scans").json() == [scan]


def test_every_format(served: Any) -> None:
    for sample in mutations.samples():
        document = upload_attack.send(served.client, sample).json()
        if sample.kind == "models":
            assert document["name"] == "box_and_tray"
            assert [joint["mimic"] for joint in document["joints"]] == [None, "slide"]
        elif sample.kind == "recordings":
            assert document["iterations"] > 1
        else:
            assert document["points"] > 0
            assert document["bounds"][2] == pytest.approx(1.0, abs=0.02)
            assert 1.1 < document["bounds"][5] < 1.2


def test_the_camera_may_be_a_file_too(served: Any) -> None:
    files = {"file": ("depth.png", DEPTH), "camera": ("camera.json", CAMERA.encode())}
    assert served.client.post("/api/v1/scans", files=files).status_code == 201


def test_what_does_not_change_is_not_sent_twice(served: Any) -> None:
    made = upload(served.client, "models", "cabinet.urdf", (CABINET / "cabinet.urdf").read_bytes())
    path, tag = made.headers["Location"], made.headers["ETag"]
    assert served.client.get(path).headers["ETag"] == tag
    for given in (tag, f"W/{tag}", f'"other", {tag}', "*"):
        answer = served.client.get(path, headers={"If-None-Match": given})
        assert (answer.status_code, answer.content, answer.headers["ETag"]) == (304, b"", tag)
    assert served.client.get(path, headers={"If-None-Match": '"other"'}).status_code == 200


def test_a_call_with_a_key_is_done_once(served: Any) -> None:
    key = {"Idempotency-Key": "b7c4"}
    first = upload(served.client, "scans", "depth.png", DEPTH, key, camera=CAMERA)
    again = upload(served.client, "scans", "depth.png", DEPTH, key, camera=CAMERA)
    assert (again.status_code, again.json(), again.headers["Location"]) == (
        201,
        first.json(),
        first.headers["Location"],
    )
    assert len(served.client.get("/api/v1/scans").json()) == 1
    other = CAMERA.replace("525.0", "526.0")
    assert other != CAMERA
    assert "other content" in detail(upload(served.client, "scans", "depth.png", DEPTH, key, camera=other), 422)
    model = (CABINET / "cabinet.urdf").read_bytes()
    assert upload(served.client, "models", "cabinet.urdf", model, key).status_code == 201
    assert "1 to 255" in detail(upload(served.client, "models", "a.urdf", model, {"Idempotency-Key": "x" * 256}), 422)


def test_the_same_key_from_many_at_once_makes_one(served: Any) -> None:
    answers: list[httpx.Response] = []

    def send() -> None:
        with httpx.Client(base_url=served.url, timeout=None, verify=NO_AUTHORITIES) as client:
            answers.append(upload(client, "scans", "depth.png", DEPTH, {"Idempotency-Key": "at once"}, camera=CAMERA))

    threads = [threading.Thread(target=send) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {answer.status_code for answer in answers} <= {201, 409}
    assert len({answer.json()["id"] for answer in answers if answer.status_code == 201}) == 1
    assert len(served.client.get("/api/v1/scans").json()) == 1


# What is not


UNREADABLE = [
    ("models", "a.urdf", b"<robot", "is not well-formed XML"),
    ("models", "a.zip", b"PK\x03\x04nonsense", "zip 'a.zip' is damaged"),
    ("models", "a.urdf", b'<!DOCTYPE a [<!ENTITY b "c">]><robot/>', "DOCTYPE"),
    ("scans", "a.pcd", b"nonsense", "scan 'a.pcd'"),
    ("scans", "a.png", DEPTH, "needs a camera file; none was given"),
    ("scans", "a.stl", b"solid", "has the suffix '.stl'; expected one of .png"),
    ("scans", "", b"solid", "expected one of .png"),
    ("recordings", "a.sqlite", b"SQLite format 3\0 but not really", "is not a recording"),
    ("scans", "a.npy", b"", "the file 'a.npy' is empty"),
]


def test_what_cannot_be_read_is_refused_in_a_sentence(served: Any) -> None:
    for kind, name, content, says in UNREADABLE:
        assert says in detail(upload(served.client, kind, name, content), 422)
        assert nothing_kept(served)


def test_a_wrong_camera_is_named(served: Any) -> None:
    assert "camera file 'camera.json' is not JSON" in detail(
        upload(served.client, "scans", "depth.png", DEPTH, camera="{"), 422
    )
    small = CAMERA.replace("640", "320")
    assert "320x480" in detail(upload(served.client, "scans", "depth.png", DEPTH, camera=small), 422)


def part(name: str, content: str, more: str = "") -> str:
    return f'--{BOUNDARY}\r\nContent-Disposition: form-data; name="{name}"{more}\r\n\r\n{content}\r\n'


NO_FORMS = [
    ("", 400, "ends before its last boundary"),
    ("nonsense", 400, "the form is malformed"),
    (part("file", "x", '; filename="a.pcd"'), 400, "ends before its last boundary"),
    (part("x", "y") + f"--{BOUNDARY}--\r\n", 422, "a part 'x'; expected file and camera"),
    (part("camera", "{}") + f"--{BOUNDARY}--\r\n", 422, "has no part 'file'"),
    (part("file", "x") + part("file", "y") + f"--{BOUNDARY}--\r\n", 422, "the part 'file' twice"),
    (part("camera", "x" * (1 << 20) + "y"), 413, "part 'camera' is larger than 1048576 bytes"),
    (f"--{BOUNDARY}\r\nContent-Type: text/plain\r\n\r\nx\r\n--{BOUNDARY}--\r\n", 400, "has no name"),
    (f"--{BOUNDARY}\r\n" + "X: y\r\n" * 9000, 400, "the form is malformed: Maximum header count"),
]


def test_a_form_that_is_none(served: Any) -> None:
    for body, status, says in NO_FORMS:
        assert says in detail(served.client.post("/api/v1/scans", content=body.encode(), headers=FORM), status)
        assert nothing_kept(served)


def test_a_body_that_is_no_form(served: Any) -> None:
    assert "expected multipart/form-data" in detail(served.client.post("/api/v1/scans", json={}), 415)
    bare = {"Content-Type": "multipart/form-data"}
    assert "names no boundary" in detail(served.client.post("/api/v1/scans", content=b"x", headers=bare), 400)


def stream(total: int) -> Iterator[bytes]:
    yield part("file", "", '; filename="a.pcd"').removesuffix("\r\n").encode()
    for _ in range(total >> 16):
        yield b"\xaa" * (1 << 16)
    yield f"\r\n--{BOUNDARY}--\r\n".encode()


def test_too_large_is_said_whether_announced_or_not(serve: Callable[..., Any]) -> None:
    served = serve(max_upload_bytes=1 << 20)
    says = "larger than 1 MiB, the most that this server takes"
    assert says in detail(upload(served.client, "scans", "a.pcd", b"x" * (9 << 20)), 413)
    assert says in detail(served.client.post("/api/v1/scans", content=stream(3 << 20), headers=FORM), 413)
    assert nothing_kept(served)
    assert "suffix" in detail(upload(served.client, "scans", "a.stl", b"x" * (1 << 20)), 422)


def test_a_full_data_directory_is_said(serve: Callable[..., Any]) -> None:
    served = serve(max_disk_bytes=1_000_000)
    answer = upload(served.client, "scans", "depth.png", DEPTH, camera=CAMERA)
    assert "the data directory may hold 1 MiB and is full" in detail(answer, 507)
    assert nothing_kept(served)
    assert served.app.state.store.used_bytes() == 0
    assert upload(served.client, "models", "a.urdf", (CABINET / "cabinet.urdf").read_bytes()).status_code == 201


def test_a_client_that_goes_away_leaves_nothing(served: Any) -> None:
    host, port = served.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port))) as connection:
        head = f"POST /api/v1/scans HTTP/1.1\r\nHost: {host}:{port}\r\nContent-Type: {FORM['Content-Type']}\r\n"
        connection.sendall(f"{head}Content-Length: 9000000\r\n\r\n".encode())
        for chunk in list(stream(3 << 20))[:-1]:
            connection.sendall(chunk)
        incoming = served.config.data_dir / "incoming"
        while not list(incoming.rglob("a.pcd")):
            time.sleep(0.01)
    # its files go first, then what they had claimed of the disk
    while list(incoming.iterdir()) or served.app.state.store.used_bytes():
        time.sleep(0.01)
    assert nothing_kept(served) and served.app.state.store.used_bytes() == 0


def test_where_too_many_wait_one_is_told_when_to_come_back(
    serve: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("app.uploads.uploads.AT_ONCE", 0)
    served = serve(parse_seconds=2.0)
    answer = upload(served.client, "scans", "depth.png", DEPTH, camera=CAMERA)
    assert "uploads are being read and more wait" in detail(answer, 429)
    assert answer.headers["Retry-After"] == "1"
    assert nothing_kept(served)


def test_an_upload_streams_through_the_server(served_process: Callable[..., Any]) -> None:
    """64 MiB may cost the server a few of them, not all."""
    process = served_process()
    process.ready()
    upload(process.client, "scans", "a.pcd", b"x" * (4 << 20))
    before = upload_attack.memory(process.client)
    peak = [before]
    done = threading.Event()

    def watch() -> None:
        with httpx.Client(base_url=process.url, timeout=None) as client:
            while not done.is_set():
                peak.append(upload_attack.memory(client))

    watcher = threading.Thread(target=watch)
    watcher.start()
    answer = process.client.post("/api/v1/scans", content=stream(64 << 20), headers=FORM)
    done.set()
    watcher.join()
    assert "scan 'a.pcd'" in detail(answer, 422)
    assert max(peak) - before < 24 << 20


@pytest.mark.parametrize(
    ("name", "safe"),
    [
        ("depth.png", "depth.png"),
        ("../../etc/passwd", "passwd"),
        ("C:\\scans\\a b.PCD", "a_b.PCD"),
        ("", "upload"),
        ("..", "upload"),
        (".hidden", "upload.hidden"),
        ("a\0b\n.ply", "a_b_.ply"),
        ("é" * 200 + ".npz", "_" * 80 + ".npz"),
    ],
)
def test_a_name_from_outside_is_made_safe(name: str, safe: str) -> None:
    assert safe_name(name) == safe
