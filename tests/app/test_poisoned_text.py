"""Does text that cannot be written back stay outside, wherever it is sent, and do lists survive what got in before?

Half of a surrogate pair, `\\ud800`, is read from JSON without a word, and failed every list that told it.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.store import atomic_files
from pmpnbp.errors import PmpnbpError
from tests.app import recording_mutations
from tests.app import small_sessions as small

HALF = "\ud800"
DEPTH, CAMERA = (small.CABINET / "open" / name for name in ("depth.png", "camera.json"))


@pytest.fixture(scope="module")
def path(client: httpx.Client) -> str:
    return small.after(client, 1)


def poisoned(value: Any) -> Iterator[Any]:
    """The JSON value with each of its strings, names of members too, made half of a pair in turn; and one beside."""
    if isinstance(value, str):
        yield HALF
    elif isinstance(value, list):
        for place, inner in enumerate(value):
            yield from ([*value[:place], other, *value[place + 1 :]] for other in poisoned(inner))
    elif isinstance(value, dict):
        yield value | {HALF: 1}
        for name, inner in value.items():
            yield {HALF if key == name else key: member for key, member in value.items()}
            yield from (value | {name: other} for other in poisoned(inner))


def send(client: httpx.Client, method: str, path: str, body: Any, *, escaped: bool = True) -> httpx.Response:
    text = json.dumps(body, ensure_ascii=escaped).encode("utf-8", "surrogatepass")
    return client.request(method, path, content=text, headers={"Content-Type": "application/json"})


POSE = {"position": {"x": 0, "y": 0, "z": 0}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}}
PRIOR = {"kind": "gaussian", "link": "frame", "pose": POSE, "std_xyz": [1, 1, 1], "std_rpy": [1, 1, 1]}


def test_no_body_may_hold_it(client: httpx.Client, path: str) -> None:
    """Every string of every body; escaped, and as the bytes that UTF-8 has no use for."""
    model_id, scan_id = small.ids_of(client, path)
    session = small.body(model_id, scan_id, name="kitchen", config={"renderer": "splats"})
    session |= {"prior": PRIOR | {"joints": {"slide1": {"position": 0, "std": 1}}}}
    session |= {"truth": {"links": {"frame": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}, "joints": {}}}
    calls = [
        ("POST", "/api/v1/sessions", session),
        ("POST", "/api/v1/sessions/sample", {"scene": "open", "run": False}),
        ("PATCH", path, {"config": {"renderer": "splats"}}),
        ("POST", f"{path}/run", {"until": "idle"}),
        ("POST", f"{path}/scans", {"scan_id": scan_id, "mode": "joins"}),
        ("POST", f"{path}/decision", {"links": ["frame"], "views": [{"pose": POSE}]}),
        ("PATCH", f"{path}/views/v1", {"part": "frame", "edge": ["frame", "drawer1"], "prior": PRIOR}),
        ("PATCH", f"{path}/views/v1", {"compare": {"session_id": "x"}, "theme": "dark", "show": {"scan": True}}),
    ]
    sessions = client.get("/api/v1/sessions").json()
    for method, place, body in calls:
        for number, other in enumerate(poisoned(body)):
            answer = send(client, method, place, other, escaped=number % 2 == 0)
            small.problem(answer, 422, "half of a surrogate pair")
    assert client.get("/api/v1/sessions").json() == sessions


def test_no_camera_may_hold_it(client: httpx.Client) -> None:
    before = client.get("/api/v1/scans").json()
    camera = json.loads(CAMERA.read_text())
    for other in poisoned(camera | {"frame_id": "map", "more": ["x", {"y": "z"}]}):
        answer = client.post(
            "/api/v1/scans", files={"file": ("depth.png", DEPTH.read_bytes())}, data={"camera": json.dumps(other)}
        )
        small.problem(answer, 422, "half of a surrogate pair")
    for frame, says in (("a\0b", "has the character U+0000"), ("f" * 256, "has 256 characters; expected at most 255")):
        answer = client.post(
            "/api/v1/scans",
            files={"file": ("depth.png", DEPTH.read_bytes())},
            data={"camera": json.dumps(camera | {"frame_id": frame})},
        )
        small.problem(answer, 422, says)
    assert client.get("/api/v1/scans").json() == before


@pytest.mark.parametrize(
    ("script", "text"),
    [
        ("UPDATE inputs SET value = ? WHERE name = 'model'", json.dumps(HALF)),
        ("UPDATE inputs SET value = ? WHERE name = 'version'", json.dumps(HALF)),
        ("UPDATE inputs SET value = ? WHERE name = 'parts'", json.dumps([{"name": HALF, "links": [HALF]}])),
        ("UPDATE inputs SET value = ? WHERE name = 'prior'", json.dumps({"kind": "uniform", "orientation": HALF})),
        ("UPDATE inputs SET value = ? WHERE name = 'settings'", json.dumps({"renderer": HALF})),
        ("UPDATE scans SET frame_id = ?", b"\xed\xa0\x80"),
        ("UPDATE scans SET frame_id = ?", "a\nb"),
        ("UPDATE scans SET camera = ?", json.dumps({HALF: 1})),
        ("UPDATE iterations SET notes = ?", json.dumps([HALF])),
        ("UPDATE iterations SET stage = ?", b"\xff"),
        ("INSERT INTO notes VALUES (1, ?)", b"\xff"),
        ("UPDATE summaries SET text = ?", json.dumps({"notes": [HALF]})),
        ("UPDATE changes SET note = ?", json.dumps(HALF)),
        ("UPDATE model SET file_name = ?", "a\nb"),
    ],
)
def test_no_recording_takes_the_lists_away(client: httpx.Client, tmp_path: Path, script: str, text: Any) -> None:
    path = tmp_path / "poisoned.sqlite"
    path.write_bytes(recording_mutations.recording())
    connection = sqlite3.connect(path)
    connection.execute(script, (text,))
    connection.commit()
    connection.close()
    answer = client.post("/api/v1/recordings", files={"file": (path.name, path.read_bytes())})
    assert answer.status_code in (201, 422), answer.text
    assert client.get("/api/v1/recordings").status_code == 200
    if answer.status_code == 201:
        id = answer.json()["id"]
        for call in ("", "/estimate", "/estimate?iteration=2", "/trace", "/graph", "/beliefs/frame"):
            assert client.get(f"/api/v1/sessions/{id}{call}").status_code in (200, 404, 409), call
        assert client.delete(f"/api/v1/recordings/{id}").status_code == 204


def test_the_store_adds_no_document_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(PmpnbpError, match="half of a surrogate pair"):
        atomic_files.create_folder(tmp_path / "partial", tmp_path / "place", {}, {"scan.json": {"frame_id": HALF}})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("damage", [HALF, 5, None, "missing"])
def test_lists_survive_what_an_older_server_took_in(serve: Callable[..., Any], damage: Any) -> None:
    first = serve()
    kept, poisoned = (small.upload_scan(first.client) for _ in range(2))
    first.stop()
    place = first.config.data_dir / "scans" / poisoned / "scan.json"
    document = json.loads(place.read_text())
    document["camera"]["frame_id"] = damage
    if damage == "missing":
        del document["camera"]
    place.write_text(json.dumps(document))
    served = serve()
    assert [scan["id"] for scan in served.client.get("/api/v1/scans").json()] == [kept]
    small.problem(served.client.get(f"/api/v1/scans/{poisoned}"), 404, f"scan '{poisoned}' is damaged")
    assert served.client.delete(f"/api/v1/scans/{poisoned}").status_code == 204
    assert not place.exists()
