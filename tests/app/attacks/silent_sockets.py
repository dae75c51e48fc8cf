"""4: connections that say nothing, or a byte a second; another caller is served throughout."""

from __future__ import annotations

import selectors
import socket
import time
from collections.abc import Callable
from contextlib import suppress

from tests.app.attacks.outcome import Outcome
from tests.app.attacks.target import Target
from tests.app.attacks.watch import MIB, Watch, descriptors, log_size

SILENT, DRIPPING, DRIPPING_BODY = 1100, 300, 50
# How long each is kept up, and until when the server should have closed what does not go on, seconds.
SILENCE, HEADERS, BODIES = 25.0, 25.0, 75.0
CLOSED_BY, BODY_CLOSED_BY = 15.0, 65.0
LONGEST = 2.0
MOST_LOG = 1_000_000


def attack(target: Target, outcome: Outcome) -> None:
    """One kind after the other, then whether everything is as before."""
    if not target.several_addresses:
        outcome.happened.append("the other caller has the attacker's address, as the server is on another machine")
    before, log = descriptors(target), log_size(target)
    multipart = {"Content_Type": "multipart/form-data; boundary=x", "Content_Length": "1000"}
    json = {"Content_Type": "application/json", "Content_Length": "1000"}

    def body(number: int) -> bytes:
        path, headers = ("/api/v1/scans", multipart) if number % 2 else ("/api/v1/sessions", json)
        return target.head("POST", path, **headers) + b"\r\n"

    for told, count, seconds, by, first, drip in (
        (f"{SILENT} connections that say nothing", SILENT, SILENCE, CLOSED_BY, lambda number: b"", b""),
        (f"{DRIPPING} that send a byte of a header a second", DRIPPING, HEADERS, CLOSED_BY, _start, b"a"),
        (f"{DRIPPING_BODY} that send a byte of a body a second", DRIPPING_BODY, BODIES, BODY_CLOSED_BY, body, b" "),
    ):
        _hold(target, outcome, told, count, seconds, by, first, drip)
    grown = log_size(target) - log
    if target.log is not None:
        outcome.expect(grown < MOST_LOG, f"the log grew by {grown / 1e6:.1f} MB")
    time.sleep(1)
    after = descriptors(target)
    if before is not None and after is not None:
        outcome.happened.append(f"descriptors: {before} before, {after} afterwards")
        outcome.expect(after < before + 50, f"{after - before} descriptors stay open")


def _start(number: int) -> bytes:
    return b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nX-Slow: "


def _hold(
    target: Target,
    outcome: Outcome,
    told: str,
    count: int,
    seconds: float,
    by: float,
    first: Callable[[int], bytes],
    drip: bytes,
) -> None:
    """Open `count` connections that begin with `first` and go on with `drip`, and see when the server closes them."""
    outcome.did.append(f"{told}, for {seconds:.0f} s")
    waiting, refused, last_closed = selectors.DefaultSelector(), 0, 0.0
    opened: list[socket.socket] = []
    statuses: dict[str, int] = {}
    try:
        with Watch(target, patience=20) as watch:
            began = time.monotonic()
            for number in range(count):
                try:
                    connection = target.socket(timeout=2)
                    connection.sendall(first(number))
                except OSError:
                    refused += 1
                    if refused > 20:  # nothing more gets in: no need to wait for each
                        break
                    continue
                connection.setblocking(False)
                opened.append(connection)
                waiting.register(connection, selectors.EVENT_READ)
            peak, next_drip = descriptors(target), time.monotonic() + 1
            while (left := began + seconds - time.monotonic()) > 0 and waiting.get_map():
                for key, _ in waiting.select(min(left, 0.5)):
                    assert isinstance(key.fileobj, socket.socket)
                    if _ended(key.fileobj, statuses):
                        waiting.unregister(key.fileobj)
                        last_closed = time.monotonic() - began
                if drip and time.monotonic() >= next_drip:
                    next_drip += 1
                    for key in list(waiting.get_map().values()):
                        assert isinstance(key.fileobj, socket.socket)
                        with suppress(OSError):
                            key.fileobj.send(drip)
        left_open = len(waiting.get_map())
    finally:
        for connection in opened:
            connection.close()
        waiting.close()
    answers = ", ".join(f"{n} × {status}" for status, n in statuses.items()) or "none"
    outcome.happened.append(
        f"{told}: {len(opened)} connected, {refused} refused; {len(opened) - left_open} closed by the server, the last "
        f"after {last_closed:.1f} s, {left_open} left open; answers: {answers}; "
        f"{peak if peak is not None else 'unknown'} descriptors; {watch.told()}"
    )
    outcome.expect(not left_open, f"{told}: {left_open} were still open after {seconds:.0f} s")
    outcome.expect(last_closed <= by, f"{told}: the last was closed after {last_closed:.1f} s, expected {by:.0f} s")
    outcome.expect(not watch.unserved, f"{told}: {watch.unserved} calls of another caller were not served")
    outcome.expect(watch.slowest < LONGEST, f"{told}: another caller waited {watch.slowest:.1f} s")
    outcome.expect(watch.growth < 300 * MIB, f"{told}: memory grew by {watch.growth // MIB} MiB")


def _ended(connection: socket.socket, statuses: dict[str, int]) -> bool:
    """Whether the server has closed it; its answer, where it sent one, is counted."""
    try:
        data = connection.recv(1 << 16)
    except BlockingIOError:
        return False
    except OSError:
        return True
    if data.startswith(b"HTTP/"):
        status = data.split()[1].decode()
        statuses[status] = statuses.get(status, 0) + 1
    return not data
