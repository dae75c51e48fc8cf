"""9: folders of a store that go while the server has them in hand."""

from __future__ import annotations

import shutil
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import httpx

from tests.app.attacks import entries, every_call
from tests.app.attacks.outcome import Outcome
from tests.app.attacks.target import KINDS, OwnServer, Target, own_server_in
from tests.app.attacks.watch import faults

# Until when a session has to have noticed that it writes into nothing, seconds.
NOTICED = 20.0


def attack(target: Target, outcome: Outcome) -> None:
    """On a server of our own, as the folders are its own; started again afterwards."""
    del target
    with tempfile.TemporaryDirectory(prefix="removed-") as name:
        folder = Path(name)
        with own_server_in(folder) as server, server.target.client() as client:
            for what in (_idle_session, _running_session, _model, _scan, _recording, _session_with_view):
                outcome.did.append(str(what.__doc__))
                what(server, outcome, client)
                _lists(outcome, client, str(what.__doc__))
        outcome.did.append("started the server again on what is left")
        with own_server_in(folder) as server, server.target.client() as client:
            _lists(outcome, client, "after a restart")
            for entry in client.get("/api/v1/sessions").json():
                for told, answer in every_call.reads(client, {"session_id": entry["id"]}):
                    outcome.answered(f"{told} after a restart", answer)
                outcome.answered("DELETE after a restart", client.delete(f"/api/v1/sessions/{entry['id']}"))
            outcome.answered("an upload after a restart", entries.upload_scan(client), {201})
        outcome.happened += [f"its log: {count} × {told}" for told, count in faults(server.target).most_common(12)]


def _lists(outcome: Outcome, client: httpx.Client, when: str) -> None:
    for path in (*KINDS, "samples"):
        outcome.answered(f"GET /{path}: {when}", client.get(f"/api/v1/{path}"), {200})
    outcome.answered(f"GET /metrics: {when}", client.get("/metrics"), {200})


def _made(server: OwnServer, client: httpx.Client, iterations: int = 5) -> tuple[str, dict[str, str]]:
    """A session's path, and the names of all that it stands on."""
    path = entries.small_session(server.target, client, iterations)
    found = client.get(path).json()
    further = entries.upload_further_scan(client).json()["id"]
    return path, {
        "session_id": found["id"],
        "model_id": found["model_id"],
        "scan_id": found["scan_ids"][0],
        "further_scan_id": further,
    }


def _remove(server: OwnServer, kind: str, id: str) -> None:
    """At one instant, as the server may be writing there."""
    aside = server.folder / f"removed-{id}"
    (server.data_dir / kind / id).rename(aside)
    shutil.rmtree(aside, ignore_errors=True)


def _everything(outcome: Outcome, client: httpx.Client, names: dict[str, str], what: Callable[..., object]) -> None:
    """Every call for what is named, deleted in the end; none may be a fault."""
    told = what.__doc__
    for call, answer in every_call.reads(client, names):
        outcome.answered(f"{call}: {told}", answer)
    for call, answer in every_call.writes(client, names, deleting=True):
        outcome.answered(f"{call}: {told}", answer)
    for call, answer in every_call.reads(client, names):
        outcome.answered(f"{call} once deleted: {told}", answer)


def _idle_session(server: OwnServer, outcome: Outcome, client: httpx.Client) -> None:
    """the folder of a session that is at rest"""
    _, names = _made(server, client)
    _remove(server, "sessions", names["session_id"])
    _everything(outcome, client, names, _idle_session)


def _running_session(server: OwnServer, outcome: Outcome, client: httpx.Client) -> None:
    """the folder of a session that iterates"""
    path, names = _made(server, client)
    client.post(f"{path}/run", json={"iterations": 100_000}).raise_for_status()
    _remove(server, "sessions", names["session_id"])
    _ends(outcome, client, path, "its folder")
    _everything(outcome, client, names, _running_session)


def _ends(outcome: Outcome, client: httpx.Client, path: str, without: str) -> None:
    """The session does not iterate for ever into what is not there, and says why."""
    until = time.monotonic() + NOTICED
    while time.monotonic() < until:
        answer = outcome.answered("GET of a session that iterates", client.get(path))
        if answer.status_code != 200 or answer.json()["state"] not in ("running", "waiting"):
            break
        time.sleep(0.2)
    state = answer.json().get("state") or answer.status_code
    outcome.happened.append(f"a session that iterates without {without}: {state}, {answer.json().get('error')!r}")
    outcome.expect(state != "running", f"a session without {without} is running after {NOTICED:.0f} s")
    outcome.expect(state != "failed" or answer.json()["error"], f"a session without {without} failed without a word")


def _model(server: OwnServer, outcome: Outcome, client: httpx.Client) -> None:
    """the folder of a model whose session is at rest"""
    _, names = _made(server, client)
    _remove(server, "models", names["model_id"])
    _everything(outcome, client, names, _model)


def _scan(server: OwnServer, outcome: Outcome, client: httpx.Client) -> None:
    """the folder of a scan whose session iterates"""
    path, names = _made(server, client)
    client.post(f"{path}/run", json={"iterations": 100_000}).raise_for_status()
    _remove(server, "scans", names["scan_id"])
    for call, answer in every_call.reads(client, names):
        outcome.answered(f"{call}: {_scan.__doc__}", answer)
    client.post(f"{path}/pause")
    _everything(outcome, client, names, _scan)


def _recording(server: OwnServer, outcome: Outcome, client: httpx.Client) -> None:
    """the folder of a recording, read already, and of one that was not"""
    content = entries.recording(server.target, client)
    for read in (True, False):
        id = entries.upload_recording(client, content).json()["id"]
        if read:
            client.get(f"/api/v1/sessions/{id}/estimate").raise_for_status()
        _remove(server, "recordings", id)
        _everything(outcome, client, {"recording_id": id, "session_id": id}, _recording)


def _session_with_view(server: OwnServer, outcome: Outcome, client: httpx.Client) -> None:
    """the folder of a session that somebody looks at and that iterates"""
    path, names = _made(server, client)
    client.get(f"{path}/views/attacked").raise_for_status()
    client.post(f"{path}/run", json={"iterations": 100_000}).raise_for_status()
    time.sleep(1)
    _remove(server, "sessions", names["session_id"])
    _ends(outcome, client, path, "its folder, looked at")
    _everything(outcome, client, names, _session_with_view)
