"""1: text that cannot be written back, wherever text comes in; afterwards every list has to be there for everybody."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable

import httpx

from tests.app.attacks import entries
from tests.app.attacks.entries import CAMERA, SURROGATE, post_json
from tests.app.attacks.outcome import Outcome
from tests.app.attacks.target import KINDS, OTHER, Target

# The same as bytes, where a header or a path carries it.
RAW = SURROGATE.encode("utf-8", "surrogatepass")
IN_PATH = "%ED%A0%80"
GAUSSIAN = {
    "kind": "gaussian",
    "link": "frame",
    "pose": {"position": {"x": 0.4, "y": 0, "z": 0.4}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}},
    "std_xyz": [0.1, 0.1, 0.1],
    "std_rpy": [0.1, 0.1, 0.1],
}


def attack(target: Target, outcome: Outcome) -> None:
    """Send it in everything that takes text."""
    outcome.did.append("sent half a surrogate pair in every text: cameras, models, recordings, bodies, headers, paths")
    with target.client() as client:
        _lists(target, outcome, "before")
        _cameras(target, outcome, client)
        _models(target, outcome, client)
        _recordings(target, outcome, client)
        _bodies(target, outcome, client)
        _headers_and_paths(target, outcome, client)


def _lists(target: Target, outcome: Outcome, when: str) -> None:
    """Another caller reads every list, which has to be there. One that is gone is told of once: what poisons it has no
    id that could be removed."""
    with target.client(OTHER) as client:
        for kind in KINDS:
            if not any(told.startswith(f"GET /{kind} ") for told in outcome.broken):
                outcome.answered(f"GET /{kind} {when}", client.get(f"/api/v1/{kind}"), {200})


def _cameras(target: Target, outcome: Outcome, client: httpx.Client) -> None:
    cameras: dict[str, str] = {
        "frame_id": json.dumps(CAMERA | {"frame_id": SURROGATE}),
        "a member's name": json.dumps(CAMERA | {SURROGATE: 1}),
        "stamp": json.dumps(CAMERA | {"stamp": SURROGATE}),
        "frame_id with a character of zero": json.dumps(CAMERA | {"frame_id": "a\0b"}),
    }
    for name, text in cameras.items():
        answer = outcome.answered(f"a camera's {name}", entries.upload_scan(client, text))
        made = target.keep("scans", answer)
        if made is None and answer.status_code >= 500:
            _find_made(target, client, "scans")
        _lists(target, outcome, f"after a camera's {name}")


def _find_made(target: Target, client: httpx.Client, kind: str) -> None:
    """What was stored behind a 500: its id is in no answer, but the list, where it still works, has it."""
    answer = client.get(f"/api/v1/{kind}")
    known = {id for _, id in target.made}
    if answer.status_code == 200:
        target.made += [(kind, entry["id"]) for entry in answer.json() if entry["id"] not in known][-1:]


def _models(target: Target, outcome: Outcome, client: httpx.Client) -> None:
    urdf = entries.URDF
    models: dict[str, tuple[bytes, str]] = {
        "robot's name": (urdf.encode().replace(b'name="cabinet"', b'name="' + RAW + b'"'), "cabinet.urdf"),
        "link's name": (urdf.encode().replace(b'"drawer1"', b'"' + RAW + b'"'), "cabinet.urdf"),
        "link's name as a reference": (urdf.encode().replace(b'"drawer1"', b'"&#xD800;"'), "cabinet.urdf"),
        "link's name in UTF-16": (
            urdf.replace('<?xml version="1.0"?>', '<?xml version="1.0" encoding="UTF-16"?>')
            .replace('"drawer1"', f'"{SURROGATE}"')
            .encode("utf-16", "surrogatepass"),
            "cabinet.urdf",
        ),
    }
    for name, (content, file_name) in models.items():
        target.keep("models", outcome.answered(f"a {name}", entries.upload_model(client, content, file_name)))
        _lists(target, outcome, f"after a {name}")
    for content_disposition in (
        b'form-data; name="file"; filename="' + RAW + b'.urdf"',
        b"form-data; name=\"file\"; filename*=utf-8''" + IN_PATH.encode() + b".urdf",
        b'form-data; name="' + RAW + b'"; filename="a.urdf"',
    ):
        body = b"--x\r\nContent-Disposition: " + content_disposition + b"\r\n\r\n" + urdf.encode() + b"\r\n--x--\r\n"
        answer = client.post(
            "/api/v1/models", content=body, headers={"Content-Type": "multipart/form-data; boundary=x"}
        )
        target.keep("models", outcome.answered(f"a part {content_disposition!r}", answer))
        _lists(target, outcome, f"after a part {content_disposition!r}")


def _recordings(target: Target, outcome: Outcome, client: httpx.Client) -> None:
    whole = entries.recording(target, client, 3)
    escaped = json.dumps(SURROGATE)

    def run(statement: str, *values: object) -> Callable[[sqlite3.Connection], object]:
        return lambda connection: connection.execute(statement, values)

    def replaced(old: str, new: str, name: str) -> Callable[[sqlite3.Connection], object]:
        return run("UPDATE inputs SET value = replace(value, ?, ?) WHERE name = ?", json.dumps(old), new, name)

    edits = {
        "model's name": run("UPDATE inputs SET value = ? WHERE name = 'model'", escaped),
        "method": run("UPDATE inputs SET value = ? WHERE name = 'method'", escaped),
        "version": run("UPDATE inputs SET value = ? WHERE name = 'version'", escaped),
        "part's name": replaced("drawer1", escaped, "parts"),
        "prior": replaced("upright", escaped, "prior"),
        "settings": replaced("splats", escaped, "settings"),
        "model's file name": run("UPDATE model SET file_name = CAST(? AS TEXT)", RAW + b".zip"),
        "scan's frame_id": run("UPDATE scans SET frame_id = CAST(? AS TEXT)", RAW),
        "scan's camera": run("UPDATE scans SET camera = replace(camera, '\"fx\"', ?)", escaped),
        "stage": run("UPDATE iterations SET stage = CAST(? AS TEXT)", RAW),
        "notes of an iteration": run("UPDATE iterations SET notes = ?", json.dumps([SURROGATE])),
        "notes": run("INSERT INTO notes (text) VALUES (CAST(? AS TEXT))", RAW),
        "summaries": run("UPDATE summaries SET text = ?", json.dumps({"notes": [SURROGATE], "iteration": SURROGATE})),
        "summaries as bytes": run("UPDATE summaries SET text = CAST(? AS TEXT)", RAW),
        "an array's name": run("UPDATE arrays SET name = CAST(? AS TEXT) WHERE name = 'mle'", RAW),
        "a change's note": run("INSERT INTO changes VALUES (1, 1, NULL, NULL, ?, 'joins')", escaped),
    }
    for name, edit in edits.items():
        content = entries.edited(whole, edit)
        answer = outcome.answered(f"a recording's {name}", entries.upload_recording(client, content))
        id = target.keep("recordings", answer)
        if id is None and answer.status_code >= 500:
            _find_made(target, client, "recordings")
        if id is not None:
            for path in (f"recordings/{id}", f"sessions/{id}", *(f"sessions/{id}/{what}" for what in READ)):
                outcome.answered(f"GET {path.replace(id, 'ID')} of a recording's {name}", client.get(f"/api/v1/{path}"))
        _lists(target, outcome, f"after a recording's {name}")


# What is read of a session or a recording.
READ = ("estimate", "estimate?iteration=1", "trace", "graph", "beliefs/drawer1", "decision", "estimate.png")


def _bodies(target: Target, outcome: Outcome, client: httpx.Client) -> None:
    session = entries.small_session(target, client, 2)
    found = client.get(session).json()
    asked = entries.session_body(found["model_id"], found["scan_ids"][0])
    odd_prior = GAUSSIAN | {"joints": {SURROGATE: {"position": 0, "std": 0.1}}}
    for name, members in {
        "name": {"name": SURROGATE},
        "model_id": {"model_id": SURROGATE},
        "scan_ids": {"scan_ids": [SURROGATE]},
        "method": {"method": SURROGATE},
        "prior's kind": {"prior": {"kind": SURROGATE}},
        "prior's link": {"prior": GAUSSIAN | {"link": SURROGATE}},
        "prior's joint": {"prior": odd_prior},
        "prior's member": {"prior": GAUSSIAN | {SURROGATE: 1}},
        "truth's link": {"truth": {"links": {SURROGATE: [1.0] * 16}}},
        "truth's joint": {"truth": {"links": {}, "joints": {SURROGATE: 0.1}}},
        "setting's name": {"config": {SURROGATE: 1}},
        "setting": {"config": {"renderer": SURROGATE}},
        "member": {SURROGATE: 1},
    }.items():
        answer = post_json(client, "/api/v1/sessions", asked | members)
        id = target.keep("sessions", outcome.answered(f"a session's {name}", answer))
        if id is None and answer.status_code >= 500:
            _find_made(target, client, "sessions")
        _lists(target, outcome, f"after a session's {name}")
    view = f"{session}/views/attacked"
    for method, path, body in (
        ("PATCH", session, {"config": {SURROGATE: SURROGATE}}),
        ("POST", f"{session}/run", {"until": SURROGATE}),
        ("POST", f"{session}/step", {SURROGATE: 1}),
        ("POST", f"{session}/scans", {"scan_id": SURROGATE}),
        ("POST", f"{session}/decision", {"links": [SURROGATE]}),
        ("POST", "/api/v1/sessions/sample", {"scene": SURROGATE}),
        ("PATCH", view, {"part": SURROGATE}),
        ("PATCH", view, {"edge": [SURROGATE, "frame"]}),
        ("PATCH", view, {"prior": GAUSSIAN | {"link": SURROGATE}}),
        ("PATCH", view, {"prior": odd_prior}),
        ("PATCH", view, {"prior": GAUSSIAN | {"note": SURROGATE}}),
        ("PATCH", view, {"theme": SURROGATE}),
        ("PATCH", view, {"compare": {"session_id": SURROGATE}}),
        ("PATCH", view, {"show": {SURROGATE: True}}),
    ):
        told = f"{method} {path.removeprefix(session) or 'the session'} {json.dumps(body)[:60]}"
        outcome.answered(told, post_json(client, path, body, method))
    outcome.answered("GET of the view afterwards", client.get(view), {200})
    outcome.answered("GET of the session afterwards", client.get(session), {200})
    _lists(target, outcome, "after bodies")


def _headers_and_paths(target: Target, outcome: Outcome, client: httpx.Client) -> None:
    session = entries.small_session(target, client, 1)
    scan = client.get(session).json()["scan_ids"][0]
    body = entries.session_body(client.get(session).json()["model_id"], scan)
    key = {b"Idempotency-Key": RAW}
    answer = client.post("/api/v1/sessions", json=body, headers=key)
    target.keep("sessions", outcome.answered("POST /sessions with such a key", answer))
    files = {"file": ("cabinet.urdf", entries.URDF)}
    answer = client.post("/api/v1/models", files=files, headers=key)
    target.keep("models", outcome.answered("POST /models with such a key", answer))
    for path in (
        f"/api/v1/models/{IN_PATH}",
        f"/api/v1/scans/{IN_PATH}",
        f"/api/v1/recordings/{IN_PATH}/file",
        f"/api/v1/sessions/{IN_PATH}",
        f"{session}/beliefs/{IN_PATH}",
        f"{session}/posterior/{IN_PATH}",
        f"{session}/messages/{IN_PATH}/frame",
        f"{session}/decision?links={IN_PATH}",
        f"{session}/posterior?links={IN_PATH}",
        f"{session}/beliefs/drawer1?format={IN_PATH}",
        f"{session}/views/{IN_PATH}",
        f"/static/{IN_PATH}",
        f"/sessions/{IN_PATH}/",
        f"/{IN_PATH}",
    ):
        outcome.answered(f"GET {path.replace(session, 'SESSION')}", client.get(path))
    for header in (b"If-None-Match", b"Cookie", b"Content-Type", b"Last-Event-ID", b"Origin"):
        answer = client.get(f"/api/v1/scans/{scan}", headers={header: RAW})
        outcome.answered(f"a header {header.decode()}", answer)
    outcome.answered("DELETE by such an id", client.delete(f"/api/v1/models/{IN_PATH}"))
    _lists(target, outcome, "after headers and paths")
