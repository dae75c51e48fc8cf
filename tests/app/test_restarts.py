"""What a restart of the server leaves of its sessions: all of them, and no other numbers."""

from __future__ import annotations

import sqlite3
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx

from app.sessions.sessions import Sessions
from tests.app import small_sessions as small
from tests.app.small_sessions import history, problem


def restart(served: Any) -> None:
    """As the server's stop and start do it, with sessions that know only what is on the disk."""
    served.app.state.sessions.close()
    served.app.state.sessions = Sessions(served.app.state.store, served.config)
    served.app.state.sessions.restore()


def test_a_restart_changes_no_number(serve: Callable[..., Any]) -> None:
    """Interrupted by restarts, changed, given a further view and shown another scene on the way, a session comes to
    what one comes to that was never interrupted; what it had is told in the same words."""

    def first(client: httpx.Client, path: str) -> None:
        small.step(client, path, 3)
        client.patch(path, json={"config": {"joint_draws": 3, "converged_iterations": 2}}).raise_for_status()

    def second(client: httpx.Client, path: str) -> None:
        small.step(client, path, 2)
        client.post(f"{path}/scans", json={"scan_id": further}).raise_for_status()

    def third(client: httpx.Client, path: str) -> None:
        small.step(client, path, 4)
        client.post(f"{path}/scans", json={"scan_id": changed, "mode": "replaces"}).raise_for_status()

    def fourth(client: httpx.Client, path: str) -> None:
        small.step(client, path, 3)

    served = serve()
    client = served.client
    further, changed = small.upload_scan(client, "second_view"), small.upload_scan(client, "arm")
    ids = {"model_id": small.upload_model(client), "scan_id": small.upload_scan(client)}
    whole, pieces = small.create(client, **ids), small.create(client, **ids)
    for stretch in (first, second, third, fourth):
        stretch(client, whole)
    first(client, pieces)
    for stretch in (second, third, fourth):
        restart(served)
        before = client.get(pieces).json()
        assert before["state"] == "paused"
        assert before["config"] == small.QUICK | {"joint_draws": 3, "converged_iterations": 2}
        stretch(client, pieces)
    assert history(client, whole, 12) == history(client, pieces, 12)
    told = client.get(whole).json()
    assert told["scan_ids"] == [changed]
    assert {name: told[name] for name in ("scan_ids", "config", "iteration", "converged")} == {
        name: client.get(pieces).json()[name] for name in ("scan_ids", "config", "iteration", "converged")
    }
    rows = [client.get(f"{path}/trace").json()["iterations"] for path in (whole, pieces)]
    for name in ("converged", "stage", "notes"):
        assert [row[name] for row in rows[0]] == [row[name] for row in rows[1]], name
    # the further view was of another scene, and so was the one that replaced it
    assert [len(rows[0][number]["notes"]) for number in (5, 6, 9, 10)] == [0, 1, 0, 1]


def test_after_a_restart_every_session_is_there(serve: Callable[..., Any], tmp_path: Path) -> None:
    """Paused where it was, or failed where it is damaged, which neither stops the start nor the others."""
    served = serve()
    client = served.client
    ids = {"model_id": small.upload_model(client), "scan_id": small.upload_scan(client)}
    running, damaged, lost, cut = (small.create(client, **ids) for _ in range(4))
    small.step(client, cut, 6)
    client.post(f"{running}/run", json={"iterations": 100_000})
    while client.get(running).json()["iteration"] < 5:
        time.sleep(small.PATIENCE)
    served.app.state.sessions.close()
    estimate = served.app.state.sessions.get(running.rpartition("/")[2]).archive.read().result_text
    folders = {path: served.config.data_dir / "sessions" / path.rpartition("/")[2] for path in (damaged, lost, cut)}
    (folders[damaged] / "recording.sqlite").write_bytes(b"SQLite format 3\0 and then nothing of the kind" * 100)
    (folders[lost] / "recording.sqlite").unlink()
    connection = sqlite3.connect(folders[cut] / "recording.sqlite")
    connection.execute("UPDATE arrays SET data = x'00' WHERE iteration >= 5")
    connection.commit()
    connection.close()

    restart(served)
    found = {path: client.get(path).json() for path in (running, damaged, lost, cut)}
    assert [found[path]["state"] for path in found] == ["paused", "failed", "failed", "paused"]
    assert (found[cut]["iteration"], found[damaged]["iteration"]) == (4, None)
    assert "cannot be read" in found[damaged]["error"] or "damaged" in found[damaged]["error"]
    assert found[lost]["error"] == "recording 'recording.sqlite' is not there"
    assert served.app.state.sessions.get(running.rpartition("/")[2]).archive.read().result_text == estimate
    problem(client.post(f"{damaged}/run"), 409, "is failed:")
    problem(client.get(f"{damaged}/estimate"), 409, "is failed:")
    problem(client.get(f"{damaged}/trace"), 409, "is failed:")
    for path in (damaged, lost):
        assert client.post(f"{path}/reset").json()["state"] == "paused"
        small.step(client, path, 6)
    small.step(client, cut, 2)
    assert small.numbers(client, damaged) == small.numbers(client, lost) == small.numbers(client, cut)
