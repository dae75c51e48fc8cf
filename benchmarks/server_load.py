"""How fast does the server answer while it computes? Two sessions iterate, clients ask, listeners wait.

Starts a server of its own on a free port with an empty data directory. The clients are one process with plain sockets,
so that they take little of the two cores which they share with the server. Run it:
`python -m benchmarks.server_load [--seconds 20] [--clients 20] [--listeners 50]`.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import signal
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import httpx
import numpy as np

from benchmarks import server_process
from benchmarks.server_process import CABINET, upload_model, upload_scan
from benchmarks.tables import markdown, progress
from benchmarks.trials import load_roi

# A planner asks again after it has looked at the answer.
PAUSE = 0.05


@dataclass
class Heard:
    """What one listener has received. ids : of the iteration events, in order; newest : the last iteration's number."""

    ids: list[int] = field(default_factory=list)
    newest: int = -1

    @property
    def in_order(self) -> bool:
        """Whether no event came twice or after a later one."""
        return all(before < after for before, after in zip(self.ids, self.ids[1:], strict=False))


def main(words: Sequence[str] | None = None) -> int:
    """Measure and print; exit status 1 where an answer was wrong or a listener missed the newest iteration."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.server_load", description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="how long the clients ask (default 20)")
    parser.add_argument("--clients", type=int, default=20, help="clients that ask for estimates (default 20)")
    parser.add_argument("--listeners", type=int, default=50, help="listeners to server-sent events (default 50)")
    arguments = parser.parse_args(words)
    with tempfile.TemporaryDirectory(prefix="load-") as folder:
        server = server_process.start(Path(folder)).ready()
        try:
            return asyncio.run(_measure(server.url, arguments.seconds, arguments.clients, arguments.listeners))
        finally:
            server.end(signal.SIGTERM)


async def _measure(url: str, seconds: float, clients: int, listeners: int) -> int:
    sessions = _sessions(url)
    host, port = httpx.URL(url).host, httpx.URL(url).port or 80
    rows = []
    bad = 0
    for title, running in (("no session runs", False), ("two sessions run", True)):
        if running:
            for session in sessions:
                httpx.post(f"{url}/api/v1/sessions/{session}/run", json={"iterations": 100_000, "until": "iterations"})
        progress(title)
        paths = [f"/api/v1/sessions/{sessions[k % len(sessions)]}/estimate" for k in range(clients)]
        found = await asyncio.gather(*(_ask(host, port, path, seconds) for path in paths))
        taken = np.concatenate([times for times, _ in found]) * 1000.0
        bad += sum(wrong for _, wrong in found)
        quantiles = (f"{np.percentile(taken, q):.1f}" for q in (50, 90, 99, 100))
        rows.append([title, clients, len(taken), f"{len(taken) / seconds:.0f}", *quantiles])
    print(markdown(["", "clients", "answers", "a second", "median (ms)", "90 %", "99 %", "longest"], rows))
    heard = [Heard() for _ in range(listeners)]
    tasks = [asyncio.create_task(_listen(host, port, sessions[0], one)) for one in heard]
    await asyncio.sleep(min(seconds, 10.0))
    for session in sessions:
        httpx.post(f"{url}/api/v1/sessions/{session}/pause")
    await asyncio.sleep(1.0)
    last = httpx.get(f"{url}/api/v1/sessions/{sessions[0]}").json()["iteration"]
    for task in tasks:
        task.cancel()
    complete = sum(one.in_order and one.newest == last for one in heard)
    events = sum(len(one.ids) for one in heard)
    print(f"\n{complete} of {listeners} listeners heard iteration {last}, the newest, in order ({events} events);")
    print(f"{bad} bad answers.")
    return int(complete < listeners or bad > 0)


async def _ask(host: str, port: int, path: str, seconds: float) -> tuple[list[float], int]:
    """Seconds each answer took, over one connection, and how many were not 200 with a whole estimate."""
    reader, writer = await asyncio.open_connection(host, port)
    taken, wrong = [], 0
    end = time.perf_counter() + seconds
    while time.perf_counter() < end:
        start = time.perf_counter()
        writer.write(f"GET {path} HTTP/1.1\r\nHost: {host}:{port}\r\nAccept: application/json\r\n\r\n".encode())
        head = (await reader.readuntil(b"\r\n\r\n")).decode().lower()
        length = int(head.partition("content-length:")[2].split("\r\n")[0])
        body = await reader.readexactly(length)
        taken.append(time.perf_counter() - start)
        wrong += not (head.startswith("http/1.1 200") and json.loads(body)["schema"] == "pmpnbp/estimate-1")
        await asyncio.sleep(PAUSE)
    writer.close()
    return taken, wrong


async def _listen(host: str, port: int, session: str, heard: Heard) -> None:
    reader, writer = await asyncio.open_connection(host, port)
    path = f"/api/v1/sessions/{session}/events"
    writer.write(f"GET {path} HTTP/1.1\r\nHost: {host}:{port}\r\nAccept: text/event-stream\r\n\r\n".encode())
    number, kind = -1, ""
    while line := await reader.readline():
        text = line.decode().rstrip()
        name, _, value = text.partition(": ")
        if name == "id":
            number = int(value)
        elif name == "event":
            kind = value
        elif name == "data" and kind == "iteration":
            heard.ids.append(number)
            heard.newest = json.loads(value)["iteration"]


def _sessions(url: str) -> list[str]:
    """Two sessions on the open cabinet, each after one step so that there is an estimate."""
    with httpx.Client(base_url=f"{url}/api/v1", timeout=120.0) as client:
        model, scan = upload_model(client), upload_scan(client)
        roi = load_roi(CABINET / "open").tolist()
        found = []
        for seed in range(2):
            body = {"model_id": model.json()["id"], "scan_ids": [scan.json()["id"]], "roi": roi, "seed": seed}
            found.append(str(client.post("/sessions", json=body).json()["id"]))
            client.post(f"/sessions/{found[-1]}/step", json={"iterations": 1}).raise_for_status()
        return found


if __name__ == "__main__":
    raise SystemExit(main())
