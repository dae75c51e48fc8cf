"""Every call of the interface once, for what is named: by the server's own description, so that none is forgotten."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from typing import Any

import httpx

from tests.app.attacks import entries

# Bodies of calls that take JSON, by the end of their path.
_BODIES: Mapping[str, Any] = {
    "/run": {"iterations": 2},
    "/step": {"iterations": 1},
    "/scans": None,  # of the second scan, where one is named
    "/decision": {"links": ["drawer1"]},
    "/sample": {"scene": "open", "run": False},
    "{view_id}": {"part": "drawer1"},
    "{session_id}": {"config": {"joint_draws": 3}},
    "{recording_id}": {"name": "a name"},
}
# Queries that a GET cannot do without, by the end of its path.
_QUERIES: Mapping[str, str] = {"{model_id}/regions": "?scan_id={scan_id}"}
# Of one call, seconds: none of them has more to do than a few iterations of a small session.
PATIENCE = 60.0
NAMES = {"link": "drawer1", "sender": "frame", "receiver": "drawer1", "index": "0", "view_id": "attacked"}


def reads(client: httpx.Client, names: Mapping[str, str]) -> Iterator[tuple[str, httpx.Response]]:
    """Every GET whose path `names` can fill, but the streams: what was asked, and the answer."""
    for method, path, operation in operations(client):
        if method == "GET" and "text/event-stream" not in json.dumps(operation.get("responses", {})):
            query = next((query for end, query in _QUERIES.items() if path.endswith(end)), "")
            place = filled(path + query, names)
            if place is not None:
                yield f"GET {path}", asked(client, "GET", place)


def writes(
    client: httpx.Client, names: Mapping[str, str], deleting: bool = False
) -> Iterator[tuple[str, httpx.Response]]:
    """Every call that changes something, valid: uploads, then what is done to the named session, deletions last."""
    model, scan = names.get("model_id", ""), names.get("scan_id", "")
    yield "POST /models", entries.upload_model(client)
    yield "POST /scans", entries.upload_scan(client)
    if "recording" in names:
        yield "POST /recordings", entries.upload_recording(client, names["recording"].encode("latin-1"))
    if model and scan:
        yield "POST /sessions", client.post("/api/v1/sessions", json=entries.session_body(model, scan))
    last = []
    for method, path, _ in operations(client):
        place = filled(path, names)
        if method == "GET" or place is None or path in ("/api/v1/models", "/api/v1/scans", "/api/v1/recordings"):
            continue
        if method == "DELETE":
            last.append((path, place))
            continue
        if path == "/api/v1/sessions":
            continue
        body = next((body for end, body in _BODIES.items() if path.endswith(end)), None)
        if path.endswith("{session_id}/scans"):
            body = {"scan_id": names.get("further_scan_id", scan)}
        yield f"{method} {path}", asked(client, method, place, json=body)
    for path, place in last if deleting else ():
        yield f"DELETE {path}", asked(client, "DELETE", place)


def asked(client: httpx.Client, method: str, path: str, **content: Any) -> httpx.Response:
    """The answer, or what stands for none: a status that no server gives."""
    try:
        return client.request(method, path, timeout=PATIENCE, **content)
    except httpx.TimeoutException:
        return httpx.Response(599, json={"detail": f"there was no answer within {PATIENCE:.0f} s"})


def operations(client: httpx.Client) -> Iterator[tuple[str, str, Mapping[str, Any]]]:
    """Method, path and description of every call."""
    for path, found in client.get("/openapi.json").raise_for_status().json()["paths"].items():
        for method, operation in found.items():
            yield method.upper(), path, operation


def filled(path: str, names: Mapping[str, str]) -> str | None:
    """The path with its names; None where one is missing."""
    known = NAMES | dict(names)
    needed = re.findall(r"{(\w+)}", path)
    return None if any(name not in known for name in needed) else path.format(**known)
