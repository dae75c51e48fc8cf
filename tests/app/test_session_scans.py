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


def test_a_scan_that_shows_nothing_of_the_region_keeps_its_number(client: httpx.Client, scan_id: str) -> None:
    """And so do those after it: the estimate of view 1 was told as view 0's, and its picture was that of another."""
    away = json.loads((small.CABINET / "open" / "camera.json").read_text())["T_world_camera"]
    away[3] += 20.0
    blind = upload(client, "open", T_world_camera=away)
    path = small.create(client, scan_ids=[blind, scan_id], config=small.QUICK | {"depth_scale_std": 0.01})
    alone = small.create(client, scan_id=scan_id, config=small.QUICK | {"depth_scale_std": 0.01})
    (begun,) = client.get(f"{path}/trace").json()["iterations"]
    assert begun["notes"] == ["view 0 shows nothing of the region of interest"]
    for one in (path, alone):
        small.step(client, one, 8)
    found, own = (client.get(f"{one}/estimate?posterior=true").json() for one in (path, alone))
    for name in ("depth_noise", "depth_noise_area", "depth_distortion"):
        assert found[name] == [None, *own[name]]
    assert ([*found["nuisances"]], [*own["nuisances"]]) == (["depth_scale/1"], ["depth_scale/0"])
    picture = "beliefs/drawer1/particles/0/picture.png?view="
    assert client.get(f"{path}/{picture}1").status_code == 200
    problem(client.get(f"{path}/{picture}0"), 404, "shows nothing of the region of interest")
    problem(client.get(f"{path}/{picture}2"), 404, "it has 0 to 1")
    assert client.get(f"{path}/graph").json()["views"] == 2
    sights = client.get(f"{path}/decision?max_std=1e-6").json()["sight"]
    assert sights and {one["view"] for one in sights.values() if one} == {1}
    # one that comes later says so, too, and changes nothing else
    away[7] += 5.0
    again = upload(client, "open", T_world_camera=away)
    assert client.post(f"{path}/scans", json={"scan_id": again}).status_code == 200
    small.step(client, path)
    last = client.get(f"{path}/trace").json()["iterations"][-1]
    assert last["notes"] == ["view 2 shows nothing of the region of interest"]
    assert client.get(f"{path}/estimate").json()["depth_noise"] == [None, *own["depth_noise"], None]
