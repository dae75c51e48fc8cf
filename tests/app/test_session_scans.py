"""Which scans does a session take together, at its beginning and later? Refusals change nothing."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

from app.sessions.document import present_scans
from app.store.store import Store
from tests.app import small_sessions as small
from tests.app.small_sessions import problem

TWICE = "scan 2 of 2 is scan 1 again, with the same depths and camera pose; expected each view once"
FRAMES = "the scans are in different world frames, map, world; expected one frame for all"


@pytest.fixture(scope="module")
def scan_id(client: httpx.Client) -> str:
    return small.upload_scan(client)


@pytest.fixture
def path(client: httpx.Client, scan_id: str) -> Iterator[str]:
    made = small.create(client, scan_id=scan_id)
    yield made
    client.delete(made)


def upload(client: httpx.Client, scene: str, **members: Any) -> str:
    """The id of a sample scan whose camera.json has other members; None leaves one out."""
    camera = json.loads((small.CABINET / scene / "camera.json").read_text()) | members
    answer = client.post(
        "/api/v1/scans",
        files={"file": ("depth.png", (small.CABINET / scene / "depth.png").read_bytes())},
        data={"camera": json.dumps({name: value for name, value in camera.items() if value is not None})},
    )
    return str(answer.raise_for_status().json()["id"])


def refused(client: httpx.Client, path: str, scan_ids: list[str], said: str) -> None:
    """Together at the beginning."""
    model = client.get(path).json()["model_id"]
    before = client.get("/api/v1/sessions").json()
    asked = small.body(model, scan_ids[0], scan_ids=scan_ids, roi=None)
    problem(client.post("/api/v1/sessions", json=asked), 422, said)
    assert client.get("/api/v1/sessions").json() == before


def test_a_view_counts_once(client: httpx.Client, path: str, scan_id: str) -> None:
    again = small.upload_scan(client)
    for second in (scan_id, again):
        refused(client, path, [scan_id, second], TWICE)
    before = client.get(path).json()
    problem(client.post(f"{path}/scans", json={"scan_id": again}), 422, TWICE)
    problem(client.post(f"{path}/scans", json={"scan_id": scan_id}), 409, "already")
    assert client.get(path).json() == before
    # a scene that has moved on may look the same
    told = client.post(f"{path}/scans", json={"scan_id": again, "mode": "replaces"})
    assert told.raise_for_status().json()["scan_ids"] == [again]
    assert small.step(client, path)["iteration"] == 1


def test_all_are_in_one_world(client: httpx.Client, path: str, scan_id: str) -> None:
    other = upload(client, "second_view", frame_id="map")
    refused(client, path, [scan_id, other], FRAMES)
    before = client.get(path).json()
    for mode in ("joins", "replaces"):
        problem(client.post(f"{path}/scans", json={"scan_id": other, "mode": mode}), 422, FRAMES)
    assert client.get(path).json() == before


def test_an_older_servers_session_counts_an_id_once_that_was_given_twice(serve: Callable[..., Any]) -> None:
    first = serve()
    path = small.after(first.client, 2)
    store: Store = first.app.state.store
    (id, document), *_ = store.sessions()
    assert document is not None
    store.write_session(id, document | {"scan_ids": document["scan_ids"] * 2})
    first.app.state.sessions.restore()
    found = first.client.get(path).json()
    assert (found["scan_ids"], found["iteration"]) == (document["scan_ids"], 2)
    assert present_scans(first.app.state.sessions.session(id)._document)[0] == document["scan_ids"]
    changed = first.client.patch(path, json={"config": {"joint_draws": 3}})
    assert changed.status_code == 200, changed.text
