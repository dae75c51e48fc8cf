"""10: what HTTP asks of a server, and what it says when it refuses."""

from __future__ import annotations

import json
import os
import re
import signal
import threading
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

import httpx
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from tests.app.attacks import entries, every_call
from tests.app.attacks.outcome import Outcome
from tests.app.attacks.target import Target, own_server

# What HEAD and GET have to have in common, where GET has it.
COMPARED = ("content-type", "etag", "content-length", "cache-control", "content-security-policy")
# Lengths of what differs from one second to the next, or from one packing to the next.
VARYING = ("/metrics", "/recording", "/posterior", "/estimate", "/trace", "/decision", "scene.html")
METHODS = ("GET", "HEAD", "POST", "PUT", "PATCH", "DELETE")
PAGES = ("/", "/docs", "/openapi.json", "/favicon.ico")
WEBSOCKETS, MOST_LINES = 200, 20
# Seconds during which readers are killed.
KILLED = 4.0


def attack(target: Target, outcome: Outcome) -> None:
    """All of them; those that need certain settings, or the server's own processes, on a server of our own."""
    with target.client() as client:
        session = entries.small_session(target, client, 3)
        found = client.get(session).json()
        content = client.get(f"{session}/recording").content
        recording = target.made_by("recordings", entries.upload_recording(client, content))
        names = {
            "session_id": found["id"],
            "model_id": found["model_id"],
            "scan_id": found["scan_ids"][0],
            "recording_id": recording,
        }
        _heads(outcome, client, names)
        _allow(outcome, client, names)
        _media_types(outcome, client, names)
        _entity_tags(outcome, client)
    outcome.did.append("killed readers during uploads")
    with own_server() as server:
        _killed_readers(server.target, outcome)
    _too_many(outcome)
    outcome.did.append(f"{WEBSOCKETS} websockets that cannot be")
    with own_server() as server:
        _websockets(server.target, outcome)


def _heads(outcome: Outcome, client: httpx.Client, names: Mapping[str, str]) -> None:
    """HEAD says what GET says, without a body."""
    outcome.did.append("HEAD of every path that GET has")
    paths = list(PAGES) + _static(client)
    for method, path, operation in every_call.operations(client):
        place = every_call.filled(path, names)
        if method == "GET" and place is not None:
            paths.append(place if "text/event-stream" not in json.dumps(operation["responses"]) else f"{place} stream")
    refused = []
    for path in paths:
        place, _, stream = path.partition(" ")
        try:
            head = client.head(place, timeout=20)
        except httpx.HTTPError as error:
            outcome.broken.append(f"HEAD {place}: {type(error).__name__}")
            continue
        if head.status_code == 405:
            refused.append(_short(place, names))
            continue
        if stream:
            outcome.answered(f"HEAD {_short(place, names)}", head, {200})
            continue
        get = client.get(place)
        outcome.answered(f"HEAD {_short(place, names)}", head, {get.status_code})
        if head.status_code == get.status_code:
            for name in COMPARED:
                if name == "content-length" and place.endswith(VARYING):
                    continue
                has, expected = head.headers.get(name), get.headers.get(name)
                told = f"HEAD {_short(place, names)}: {name} is {has!r}, of GET {expected!r}"
                outcome.expect(has == expected, told)
    outcome.expect(not refused, f"HEAD is refused with 405 at {len(refused)} paths: {', '.join(refused)}")


def _short(path: str, names: Mapping[str, str]) -> str:
    for name, value in names.items():
        path = path.replace(value, "{" + name + "}")
    return path


def _static(client: httpx.Client) -> list[str]:
    """Paths of the page's files."""
    return sorted(set(re.findall(r'"(/static/[^"?]+)"', client.get("/").text)))


def _allow(outcome: Outcome, client: httpx.Client, names: Mapping[str, str]) -> None:
    """405 names every method that the path takes."""
    outcome.did.append("a method that is none of its own at every path")
    known: dict[str, set[str]] = {path: {"GET"} for path in (*PAGES, *_static(client)[:1])}
    operations = list(every_call.operations(client))
    for method, path, _ in operations:
        place = every_call.filled(path, names)
        if place is not None:
            known.setdefault(place, set()).add(method)
    wrong = []
    for place, methods in known.items():
        # `sample` is a session's id, too, for all that the server knows before it looks
        others = [method for method, path, _ in operations if re.fullmatch(re.sub(r"{\w+}", "[^/]+", path), place)]
        full = methods.union(others)
        full |= {"HEAD"} if "GET" in full else set()
        method = next(method for method in ("PUT", "DELETE", "PATCH", "POST") if method not in full)
        answer = client.request(method, place)
        outcome.answered(f"{method} {_short(place, names)}", answer, {405})
        told = {name.strip() for name in answer.headers.get("allow", "").split(",")} - {"OPTIONS", ""}
        if answer.status_code == 405 and told != full:
            wrong.append(f"{_short(place, names)} says {', '.join(sorted(told))} of {', '.join(sorted(full))}")
    outcome.expect(not wrong, f"Allow is wrong at {len(wrong)} paths: {'; '.join(wrong)}")


def _media_types(outcome: Outcome, client: httpx.Client, names: Mapping[str, str]) -> None:
    """415 for JSON that says it is something else, and for nothing that says it is JSON."""
    outcome.did.append("JSON as text/plain")
    others: list[str] = []
    for method, path, operation in every_call.operations(client):
        place = every_call.filled(path, names)
        if place is None or "application/json" not in operation.get("requestBody", {}).get("content", {}):
            continue
        for kind in ("text/plain", "application/x-www-form-urlencoded", "application/xml", "multipart/form-data"):
            answer = client.request(method, place, content=b'{"iterations": 1}', headers={"Content-Type": kind})
            outcome.statuses[answer.status_code] += 1
            others += [f"{answer.status_code} {method} {path} as {kind}"] if answer.status_code != 415 else []
        for kind in ("application/json; charset=utf-8", "application/merge-patch+json"):
            answer = client.request(method, place, content=b'{"no such member": 1}', headers={"Content-Type": kind})
            outcome.answered(f"{method} {path} as {kind}", answer, {422})
    outcome.expect(not others, f"415 was expected, {len(others)} times came another: {', '.join(others[:3])} …")


def _entity_tags(outcome: Outcome, client: httpx.Client) -> None:
    """304 for what the browser has."""
    outcome.did.append("ETags of /static")
    for path in ("/", *_static(client)):
        first = client.get(path)
        tag = first.headers.get("etag")
        if not outcome.expect(tag is not None, f"{path} has no ETag"):
            continue
        answer = client.get(path, headers={"If-None-Match": str(tag)})
        outcome.answered(f"{path} with its ETag", answer, {304})
        outcome.expect(not answer.content or answer.status_code != 304, f"{path}: 304 with a body")
        other = client.get(path, headers={"If-None-Match": '"another"'})
        outcome.answered(f"{path} with another ETag", other, {200})


def _killed_readers(target: Target, outcome: Outcome) -> None:
    """The upload is read once more, or 503 says that it was not its fault."""
    assert target.pid is not None
    pid, end, killed = target.pid, threading.Event(), 0

    def kill() -> None:
        nonlocal killed
        while not end.wait(0.3):
            for reader in _readers(pid):
                with suppress(OSError):
                    os.kill(reader, signal.SIGKILL)
                    killed += 1

    with target.client() as client:
        entries.upload_scan(client)  # a reader is ready
        for reader in _readers(pid):
            os.kill(reader, signal.SIGKILL)
        outcome.answered("an upload after its reader was killed", entries.upload_scan(client), {201})
        killer = threading.Thread(target=kill)
        killer.start()
        until = time.monotonic() + KILLED
        try:
            while time.monotonic() < until:
                for upload in (entries.upload_scan, entries.upload_model):
                    answer = outcome.answered("an upload while readers are killed", upload(client), {201, 503})
                    outcome.expect(
                        answer.status_code != 503 or "retry-after" in answer.headers,
                        "503 does not say when to come back",
                    )
        finally:
            end.set()
            killer.join()
        outcome.happened.append(f"{killed} readers were killed")
        outcome.answered("an upload afterwards", entries.upload_scan(client), {201})


def _readers(pid: int) -> list[int]:
    """Processes that the server has to read uploads: the one that forks them, too."""
    found = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        with suppress(OSError):
            for child in map(int, (task / "children").read_text().split()):
                if b"parse_worker" in Path(f"/proc/{child}/cmdline").read_bytes():
                    found += [child, *_readers(child)]
    return found


def _too_many(outcome: Outcome) -> None:
    """429 says which limit, and when to come back."""
    outcome.did.append("more requests, sessions and clients than were set")
    with own_server("--requests-per-second", "5", "--max-sessions", "1") as server, server.target.client() as client:
        answers = [client.get("/api/v1/models") for _ in range(30)]
        refused = [answer for answer in answers if answer.status_code == 429]
        outcome.expect(bool(refused), "30 requests at once were all served, of a server that takes 5 a second")
        for answer in refused[:1]:
            _says(outcome, answer, "5", "request")
        time.sleep(3)
        model = server.target.made_by("models", entries.upload_model(client))
        time.sleep(1)
        scan = server.target.made_by("scans", entries.upload_scan(client))
        time.sleep(1)
        body = entries.session_body(model, scan)
        outcome.answered("the first session", client.post("/api/v1/sessions", json=body), {201})
        answer = client.post("/api/v1/sessions", json=body)
        outcome.answered("one session too many", answer, {429})
        _says(outcome, answer, "1", "session")


def _says(outcome: Outcome, answer: httpx.Response, *words: str) -> None:
    detail = str(answer.json().get("detail", "")) if answer.status_code == 429 else ""
    outcome.happened.append(f"429: {detail!r}, Retry-After {answer.headers.get('retry-after')}")
    outcome.expect(all(word in detail for word in words), f"429 says {detail!r}, expected {' and '.join(words)} in it")
    outcome.expect("retry-after" in answer.headers, "429 does not say when to come back")


def _websockets(target: Target, outcome: Outcome) -> None:
    """What is refused leaves no line each."""
    assert target.log is not None
    before = target.log.read_bytes().count(b"\n")
    for number in range(WEBSOCKETS):
        origin = "http://elsewhere.example" if number % 2 else target.url
        with suppress(OSError, WebSocketException), target.socket() as sock:
            connect(
                f"ws://{target.host}:{target.port}/sessions/none/view/x{number}/", sock=sock, origin=origin, proxy=None
            ).close()
    time.sleep(1)
    lines = target.log.read_bytes().count(b"\n") - before
    outcome.happened.append(f"{WEBSOCKETS} websockets that were refused left {lines} lines in the log")
    outcome.expect(lines < MOST_LINES, f"{WEBSOCKETS} websockets that were refused left {lines} lines in the log")
