"""3: JSON bodies that are large and deep, whole and in chunks, at every call that takes JSON."""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Iterator

import httpx

from tests.app.attacks import entries
from tests.app.attacks.outcome import Outcome
from tests.app.attacks.target import Target
from tests.app.attacks.watch import MIB, Watch, settled_memory

SIZE = 48_000_000
PIECE = 1 << 16
# The answer to what is too large need not wait for its end; a second is for a machine that does other things.
LONGEST = 5.0
HEALTH = 1.0
MOST_GROWTH = 300 * MIB
ANSWERS = (413,)


def attack(target: Target, outcome: Outcome) -> None:
    """48 MB of brackets to each."""
    with target.client() as client:
        session = entries.small_session(target, client, 1)
        calls = list(json_calls(client, session))
        outcome.did.append(f"sent {SIZE / 1e6:.0f} MB of brackets to {len(calls)} calls, with its length and in chunks")
        slowest = 0.0
        for method, path in calls:
            for chunked in (False, True):
                told = f"{method} {path.replace(session, 'SESSION')}{' in chunks' if chunked else ''}"
                with Watch(target) as watch:
                    began = time.monotonic()
                    status, sent = _send(target, method, path, chunked)
                    seconds = time.monotonic() - began
                slowest = max(slowest, watch.slowest)
                outcome.happened.append(
                    f"{told}: {status} after {seconds:.1f} s and {sent / 1e6:.1f} MB; {watch.told()}"
                )
                outcome.expect(status in ANSWERS, f"{told}: answered {status}, expected 413")
                outcome.expect(seconds < LONGEST, f"{told}: answered after {seconds:.1f} s")
                outcome.expect(watch.slowest < HEALTH, f"{told}: another caller waited {watch.slowest:.1f} s")
                outcome.expect(not watch.unserved, f"{told}: {watch.unserved} calls of another caller were not served")
                outcome.expect(watch.growth < MOST_GROWTH, f"{told}: memory grew by {watch.growth // MIB} MiB")
                settled_memory(target, watch.before + 50 * MIB, 2)
        for method, path in calls:
            body = b"[" * 1_000_000
            answer = client.request(method, path, content=body, headers={"Content-Type": "application/json"})
            outcome.answered(f"{method} {path.replace(session, 'SESSION')} with 1 MB of brackets", answer)
        outcome.answered("GET of the session afterwards", client.get(session), {200})


def json_calls(client: httpx.Client, session: str) -> Iterator[tuple[str, str]]:
    """Method and path of every call that takes JSON, by the server's own description."""
    id = session.rpartition("/")[2]
    for path, operations in client.get("/openapi.json").raise_for_status().json()["paths"].items():
        for method, operation in operations.items():
            if "application/json" in operation.get("requestBody", {}).get("content", {}):
                yield method.upper(), path.replace("{session_id}", id).replace("{view_id}", "attacked")


def _send(target: Target, method: str, path: str, chunked: bool) -> tuple[int | None, int]:
    """The status of the answer, None where the connection broke without one, and bytes sent until then.

    Reads while it sends: who only sends is told by a broken connection that the answer was no.
    """
    length = {"Transfer_Encoding": "chunked"} if chunked else {"Content_Length": str(SIZE)}
    head = target.head(method, path, Content_Type="application/json", Connection="close", **length) + b"\r\n"
    piece = b"[" * PIECE
    piece = b"%x\r\n%s\r\n" % (PIECE, piece) if chunked else piece
    received, sent = b"", 0
    with target.socket(timeout=300) as connection:
        connection.sendall(head)
        pending = b""
        try:
            while sent < SIZE:
                readable, writable, _ = select.select([connection], [connection], [], 300)
                if readable:
                    break
                if writable:
                    pending = pending or (piece if chunked else piece[: SIZE - sent])
                    # without waiting: the rest goes when there is room again
                    count = connection.send(pending, socket.MSG_DONTWAIT)
                    pending = pending[count:]
                    sent += count
            else:
                connection.sendall(pending + (b"0\r\n\r\n" if chunked else b""))
            while b"\r\n" not in received and (data := connection.recv(1 << 16)):
                received += data
        except (ConnectionError, TimeoutError):
            pass
    first = received.split(b"\r\n")[0].split()
    return (int(first[1]) if len(first) > 1 else None), sent
