"""Clients that load a server: planners, event listeners and 3D views, each kind in a process of its own.

They look into as little as they must, so that they take little of the cores which they share with the server.
`start` starts them; the process prints `connected`, and as its last line what it saw, as JSON.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import resource
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Awaitable, Callable, Sequence
from contextlib import suppress
from typing import Any

import httpx
from websockets.asyncio.client import ClientConnection
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.typing import Origin

from benchmarks.trials import PROJECT
from benchmarks.view_socket import view_socket

KINDS = ("planners", "listeners", "views")


class Clients:
    """A process of clients of one kind."""

    def __init__(self, kind: str, url: str, sessions: Sequence[str], count: int, seconds: float, rate: float) -> None:
        command = [sys.executable, "-m", "benchmarks.load_clients", kind, url, *sessions]
        command += ["--count", str(count), "--seconds", str(seconds), "--rate", str(rate)]
        self._process = subprocess.Popen(command, cwd=PROJECT, stdout=subprocess.PIPE, text=True)

    def connected(self) -> None:
        """Wait until all of them are connected, or were refused."""
        assert self._process.stdout is not None
        self._process.stdout.readline()

    def seen(self) -> dict[str, Any]:
        """What they saw, once they are done."""
        words, _ = self._process.communicate()
        found: dict[str, Any] = json.loads(words.splitlines()[-1])
        return found


class Listener(asyncio.BufferedProtocol):
    """Listens to events, and looks at their numbers alone.

    status : of the answer, 0 where there was none; lost : whether the server has ended it
    newest : the last event's number; events : how many; in_order : whether none came after a later one
    """

    def __init__(self) -> None:
        self._buffer = bytearray(1 << 18)
        self._head = b""
        self._rest = b""
        self.status: asyncio.Future[int] = asyncio.get_running_loop().create_future()
        self.lost = False
        self.newest, self.events, self.in_order = -1, 0, True

    def get_buffer(self, sizehint: int) -> bytearray:
        """Where the next bytes go."""
        return self._buffer

    def buffer_updated(self, nbytes: int) -> None:
        """So many have come."""
        if self.status.done():
            self._read(self._buffer[:nbytes])
            return
        self._head += self._buffer[:nbytes]
        if b"\r\n\r\n" in self._head:
            head, _, rest = self._head.partition(b"\r\n\r\n")
            self.status.set_result(int(head.split(b" ", 2)[1]))
            self._read(rest)

    def connection_lost(self, problem: Exception | None) -> None:
        """It has ended."""
        self.lost = True
        if not self.status.done():
            self.status.set_result(0)

    def _read(self, data: bytes) -> None:
        whole, found, self._rest = (self._rest + data).rpartition(b"\n")
        for line in whole.split(b"\n") if found else ():
            if line.startswith(b"id: "):
                number = int(line[4:])
                self.in_order &= number >= self.newest  # the state at the beginning has the newest iteration's number
                self.newest, self.events = number, self.events + 1


def main() -> None:
    """Connect, do what clients of this kind do, print what was seen."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.load_clients")
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("url")
    parser.add_argument("sessions", nargs="+")
    parser.add_argument("--count", type=int, required=True)
    parser.add_argument("--seconds", type=float, required=True)
    parser.add_argument("--rate", type=float, required=True)
    asked = parser.parse_args()
    act: Callable[[argparse.Namespace], Awaitable[dict[str, Any]]] = {
        "planners": _plan,
        "listeners": _listen,
        "views": _look,
    }[asked.kind]
    found = asyncio.run(_measured(act, asked))
    spent = resource.getrusage(resource.RUSAGE_SELF)
    print(json.dumps(found | {"processor_seconds": spent.ru_utime + spent.ru_stime}))


async def _measured(
    act: Callable[[argparse.Namespace], Awaitable[dict[str, Any]]], asked: argparse.Namespace
) -> dict[str, Any]:
    return await act(asked)


async def _plan(asked: argparse.Namespace) -> dict[str, Any]:
    """Each asks `rate` times a second for an estimate, over one connection."""
    url = httpx.URL(asked.url)
    pairs = [await asyncio.open_connection(url.host, url.port) for _ in range(asked.count)]
    print("connected", flush=True)
    end = time.perf_counter() + asked.seconds
    found = await asyncio.gather(
        *(
            _ask(pair, url, asked.sessions[number % len(asked.sessions)], number / asked.count, asked.rate, end)
            for number, pair in enumerate(pairs)
        )
    )
    for _, writer in pairs:
        writer.close()
    return {
        "milliseconds": [1000 * one for taken, _ in found for one in taken],
        "statuses": sum((statuses for _, statuses in found), Counter[str]()),
    }


async def _ask(
    pair: tuple[asyncio.StreamReader, asyncio.StreamWriter], url: httpx.URL, session: str, phase: float, rate: float,
    end: float,
) -> tuple[list[float], Counter[str]]:  # fmt: skip
    reader, writer = pair
    path = f"/api/v1/sessions/{session}/estimate"
    request = f"GET {path} HTTP/1.1\r\nHost: {url.host}:{url.port}\r\nAccept: application/json\r\n\r\n".encode()
    taken, statuses = [], Counter[str]()
    due = time.perf_counter() + phase / rate
    while due < end:
        await asyncio.sleep(max(due - time.perf_counter(), 0))
        start = time.perf_counter()
        writer.write(request)
        head = (await reader.readuntil(b"\r\n\r\n")).lower()
        body = await reader.readexactly(int(head.partition(b"content-length:")[2].split(b"\r\n")[0]))
        taken.append(time.perf_counter() - start)
        whole = body.startswith(b'{"schema":') and body.endswith(b"}")
        statuses[head.split(b" ", 2)[1].decode() + ("" if whole else " without an estimate")] += 1
        due = max(due + 1 / rate, time.perf_counter())
    return taken, statuses


async def _listen(asked: argparse.Namespace) -> dict[str, Any]:
    """Each hears the events of one session."""
    url, loop, opened = httpx.URL(asked.url), asyncio.get_running_loop(), []
    for number in range(asked.count):
        path = f"/api/v1/sessions/{asked.sessions[number % len(asked.sessions)]}/events"
        transport, listener = await loop.create_connection(Listener, url.host, url.port)
        transport.write(f"GET {path} HTTP/1.1\r\nHost: {url.host}:{url.port}\r\nAccept: */*\r\n\r\n".encode())
        opened.append((transport, listener))
    listeners = [listener for _, listener in opened]
    statuses = Counter([str(await listener.status) for listener in listeners])
    print("connected", flush=True)
    await asyncio.sleep(asked.seconds)
    ended = sum(listener.lost and listener.status.result() == 200 for listener in listeners)
    for transport, _ in opened:
        transport.abort()
    return {
        "events": sum(listener.events for listener in listeners),
        "in_order": sum(listener.in_order for listener in listeners),
        "newest": {
            session: sorted({listener.newest for listener in listeners[number :: len(asked.sessions)]})[::-1][:3]
            for number, session in enumerate(asked.sessions)
        },
        "statuses": statuses,
        "ended": ended,
    }


async def _look(asked: argparse.Namespace) -> dict[str, Any]:
    """Views read what they are sent, and answer pings, as a browser does."""
    opened = await asyncio.gather(*(_view(asked, number) for number in range(asked.count)))
    views = [view for view in opened if isinstance(view, ClientConnection)]
    received = [0] * len(views)

    async def read(number: int) -> None:
        with suppress(ConnectionClosed):
            async for message in views[number]:
                received[number] += len(message)

    reading = [asyncio.create_task(read(number)) for number in range(len(views))]
    print("connected", flush=True)
    await asyncio.sleep(asked.seconds)
    ended = sum(task.done() for task in reading)
    for view in views:
        view.transport.abort()
    await asyncio.gather(*reading)
    statuses = Counter("101" if isinstance(view, ClientConnection) else view for view in opened)
    return {"statuses": statuses, "ended": ended, "megabytes": sum(received) / 1e6}


async def _view(asked: argparse.Namespace, number: int) -> ClientConnection | str:
    """An open view, or the status that it was refused with."""
    session = asked.sessions[number % len(asked.sessions)]
    options = {"origin": Origin(asked.url), "open_timeout": 60, "ping_interval": None}
    try:
        return await view_socket(asked.url, session, f"load-{number}", **options)
    except InvalidStatus as refused:
        return str(refused.response.status_code)


if __name__ == "__main__":
    main()
