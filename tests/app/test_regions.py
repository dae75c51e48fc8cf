"""Regions over REST: what stands in a session's scans, and a session that begins anew with one of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import httpx
import numpy as np
import pytest

from pmpnbp.client.client import Client
from tests.app import small_sessions as small
from tests.app.upload_calls import upload

GAUSSIAN = {
    "kind": "gaussian",
    "link": "frame",
    "pose": {"position": {"x": 0.3, "y": 0.2, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}},
    "std_xyz": [0.08, 0.08, 0.08],
    "std_rpy": [0.15, 0.15, 0.15],
}


@pytest.fixture(scope="module")
def shared(serve_for_module: Callable[..., Any]) -> Any:
    return serve_for_module(max_sessions=40).ready()


@pytest.fixture(scope="module")
def everywhere(client: httpx.Client) -> str:
    """The path of a session without a region."""
    return small.create(client, roi=None)


def test_what_stands_there_is_proposed_and_taken(client: httpx.Client, everywhere: str) -> None:
    proposed = client.get(f"{everywhere}/regions").json()["regions"]
    first = proposed[0]
    assert set(first) == {"roi", "size", "points", "unlikeness"}
    # the box is where the sample's own is, and smaller: that one has a margin of 10 cm about the whole object
    low, high = np.array(first["roi"][:3]), np.array(first["roi"][3:])
    assert np.all(low > np.array(small.ROI[:3]) - 0.05) and np.all(high < np.array(small.ROI[3:]) + 0.05)
    assert np.all(high - low > 0.6 * (np.array(small.ROI[3:]) - np.array(small.ROI[:3])))
    assert 0 < first["points"] < 1 and first["unlikeness"] < 0.3

    small.step(client, everywhere)
    answer = client.post(f"{everywhere}/reset", json={"roi": first["roi"], "seed": 4})
    assert answer.status_code == 200
    found = answer.json()
    assert (found["iteration"], found["state"], found["roi"], found["seed"]) == (0, "paused", first["roi"], 4)
    assert (found["particles"], found["prior"]) == (40, None)  # as they were
    # the same as a session that was made so
    like = client.get(everywhere).json()
    members = {name: like[name] for name in ("roi", "seed", "particles", "model_id")}
    other = small.create(client, scan_id=like["scan_ids"][0], **members)
    assert small.numbers(client, other) == small.numbers(client, everywhere)
    assert client.post(f"{everywhere}/reset", json={"roi": None}).json()["roi"] is None


def test_a_reset_that_fails_changes_nothing(client: httpx.Client, everywhere: str) -> None:
    small.step(client, everywhere)
    before = client.get(everywhere).json()
    empty = client.post(f"{everywhere}/reset", json={"roi": [70, 70, 70, 71, 71, 71], "seed": 9})
    small.problem(empty, 422, "no measured point lies in the region [70.0, 70.0, 70.0, 71.0, 71.0, 71.0]")
    other = client.post(f"{everywhere}/reset", json={"prior": GAUSSIAN | {"link": "wing"}})
    small.problem(other, 422, "link 'wing' of the prior is not in the model")
    small.problem(client.post(f"{everywhere}/reset", json={"roi": [1, 2, 3]}), 422, "roi")
    small.problem(client.post(f"{everywhere}/reset", json={"colour": "red"}), 422, "colour")
    assert client.get(everywhere).json() == before
    assert client.post(f"{everywhere}/reset", json={"prior": GAUSSIAN}).json()["prior"] == GAUSSIAN


def test_a_running_session_goes_on_where_a_reset_fails(client: httpx.Client, everywhere: str) -> None:
    client.post(f"{everywhere}/run", json={"iterations": 100_000})
    failed = client.post(f"{everywhere}/reset", json={"roi": [70, 70, 70, 71, 71, 71]})
    assert failed.status_code == 422
    assert client.get(everywhere).json()["state"] in ("running", "waiting")
    assert client.post(f"{everywhere}/reset").json()["state"] == "paused"


def test_the_client_asks_for_regions_and_begins_anew(shared: Any, everywhere: str) -> None:
    with Client(shared.url) as server:
        session = server.open_session(everywhere.rpartition("/")[2])
        first = session.regions()[0]
        assert first.roi.shape == (6,) and first.size.shape == (3,)
        assert session.reset(roi=first.roi, prior=GAUSSIAN)["roi"] == first.roi.tolist()
        assert session.status()["prior"] == GAUSSIAN
        assert session.reset()["roi"] == first.roi.tolist()


def test_they_are_there_before_a_session(shared: Any, client: httpx.Client, everywhere: str) -> None:
    like = client.get(everywhere).json()
    model, scan = like["model_id"], like["scan_ids"][0]
    of_session = client.get(f"{everywhere}/regions").json()
    assert client.get(f"/api/v1/models/{model}/regions", params={"scan_id": [scan, scan]}).json() == of_session
    with Client(shared.url) as server:
        found = server.regions(model, scan)
        assert [one.roi.tolist() for one in found] == [one["roi"] for one in of_session["regions"]]
        assert [one.roi.tolist() for one in server.regions(server.models()[0], [server.scans()[0]])]

    path = f"/api/v1/models/{model}/regions"
    small.problem(client.get(path), 422, "scan_id")
    small.problem(client.get(path, params={"scan_id": [scan] * 33}), 422, "scan_id")
    small.problem(client.get(path, params={"scan_id": "0123456789abcdef"}), 404, "scan '0123456789abcdef' is not here")
    other = client.get("/api/v1/models/0123456789abcdef/regions", params={"scan_id": scan})
    small.problem(other, 404, "model '0123456789abcdef' is not here")


def test_a_recording_has_those_of_its_session(client: httpx.Client, everywhere: str) -> None:
    file = client.get(f"{everywhere}/recording").content
    recording = upload(client, "recordings", "a.sqlite", file).json()["id"]
    of_session = client.get(f"{everywhere}/regions").json()
    assert client.get(f"/api/v1/sessions/{recording}/regions").json() == of_session


def test_a_scan_that_is_damaged_on_the_disk_is_said(shared: Any, client: httpx.Client) -> None:
    model, scan = small.upload_model(client), small.upload_scan(client)
    (place,) = (shared.config.data_dir / "scans" / scan).glob("*.npz")
    place.write_bytes(place.read_bytes()[:500])
    answer = client.get(f"/api/v1/models/{model}/regions", params={"scan_id": scan})
    small.problem(answer, 422, "a scan is damaged")


def test_a_session_that_is_not_here_has_none(client: httpx.Client) -> None:
    small.problem(client.get("/api/v1/sessions/0123456789abcdef/regions"), 404, "is not here")
