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
WIDE = b"[],"
PIECE = len(WIDE) << 16
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
        lines: list[tuple[float, str]] = []
        broken: dict[str, list[str]] = {}
        for method, path in calls:
            # brackets in brackets, and pairs of them beside each other, each of which becomes a list
            for chunked, piece in ((False, b"["), (False, WIDE), (True, WIDE)):
                how = ("deep" if piece != WIDE else "wide") + (" in chunks" if chunked else "")
                told = f"{method} {path.replace(session, 'SESSION')}, {how}"
                with Watch(target) as watch:
                    began = time.monotonic()
                    status, sent = _send(target, method, path, chunked, piece)
                    seconds = time.monotonic() - began
                lines.append(
                    (seconds, f"{told}: {status} after {seconds:.1f} s and {sent / 1e6:.1f} MB; {watch.told()}")
                )
                wrong = {
                    f"answered {status}, expected 413": status not in ANSWERS,
                    f"answered after more than {LONGEST:.0f} s": seconds >= LONGEST,
                    f"another caller waited for more than {HEALTH:.0f} s": watch.slowest >= HEALTH,
                    "calls of another caller were not served": watch.unserved > 0,
                    f"memory grew by more than {MOST_GROWTH // MIB} MiB": watch.growth >= MOST_GROWTH,
                }
                for what in (what for what, so in wrong.items() if so):
                    broken.setdefault(what, []).append(told)
                settled_memory(target, watch.before + 50 * MIB, 2)
        outcome.happened += [line for _, line in sorted(lines, reverse=True)[:3]]
        outcome.broken += [f"{what}: {len(of)} calls, first {of[0]}" for what, of in broken.items()]
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


def _send(target: Target, method: str, path: str, chunked: bool, brackets: bytes) -> tuple[int | None, int]:
    """The status of the answer, None where the connection broke without one, and bytes sent until then.

    Reads while it sends: who only sends is told by a broken connection that the answer was no.
    """
    length = {"Transfer_Encoding": "chunked"} if chunked else {"Content_Length": str(SIZE)}
    head = target.head(method, path, Content_Type="application/json", Connection="close", **length) + b"\r\n"
    start, piece = b"[", (brackets * PIECE)[:PIECE]
    if chunked:
        start, piece = (b"%x\r\n%s\r\n" % (len(part), part) for part in (start, piece))
    received, sent = b"", 1
    with target.socket(timeout=300) as connection:
        connection.sendall(head + start)
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
