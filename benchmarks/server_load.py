"""How fast does the server answer while it computes and many look? Planners ask, listeners hear, views are drawn.

Starts a server of its own on a free port with an empty data directory. The clients of each kind are a process of their
own, which takes its share of the cores too; so iterations are told as a ratio to those without clients in the same run.
Run it: `python -m benchmarks.server_load [--planners 100] [--listeners 100] [--views 20] [--seconds 20]`.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import httpx
import numpy as np

from benchmarks import server_process
from benchmarks.load_clients import Clients
from benchmarks.server_process import CABINET, upload_model, upload_scan
from benchmarks.session_memory import memory
from benchmarks.tables import markdown, progress
from benchmarks.trials import load_roi

# Seconds after which the sample sessions are at rest, where an iteration always takes the same.
TO_REST = 12.0
# As many connections as are asked for, from one address.
ROOM = {"PMPNBP_MAX_CLIENTS": "2000", "PMPNBP_MAX_CLIENTS_EACH": "2000", "PMPNBP_MAX_VIEWS": "500"}


def main(words: Sequence[str] | None = None) -> int:
    """Measure and print; exit status 1 where an answer was wrong, a stream ended or a listener missed something."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.server_load", description=__doc__)
    parser.add_argument("--seconds", type=float, default=20.0, help="how long the clients are there (default 20)")
    parser.add_argument("--planners", type=int, default=100, help="clients that ask for estimates (default 100)")
    parser.add_argument("--rate", type=float, default=2.0, help="times a second that a planner asks (default 2)")
    parser.add_argument("--listeners", type=int, default=100, help="listeners to server-sent events (default 100)")
    parser.add_argument("--views", type=int, default=20, help="open 3D views (default 20)")
    parser.add_argument("--sessions", type=int, default=2, help="sessions that iterate (default 2)")
    asked = parser.parse_args(words)
    with server_process.running(ROOM) as server:
        return _measure(server.url, server.process.pid, asked)


def _measure(url: str, process: int, asked: argparse.Namespace) -> int:
    sessions = _sessions(url, asked.sessions)
    quiet = min(asked.seconds, 10.0)
    progress("nobody asks")
    time.sleep(TO_REST)
    before = _iterations_a_second(url, sessions, quiet)
    began = memory(process)
    counts = {"planners": asked.planners, "listeners": asked.listeners, "views": asked.views}
    progress(", ".join(f"{count} {kind}" for kind, count in counts.items()))
    clients = {
        kind: Clients(kind, url, sessions, count, asked.seconds + 2.0, asked.rate)
        for kind, count in counts.items()
        if count
    }
    for one in clients.values():
        one.connected()
    during = _iterations_a_second(url, sessions, asked.seconds, processor := _Processor(process))
    ended = memory(process)
    seen = {kind: one.seen() for kind, one in clients.items()}
    after = _iterations_a_second(url, sessions, quiet)
    undisturbed = (before + after) / 2
    print(f"{os.cpu_count()} cores; iterations a second: {before:.1f}, with clients {during:.1f}, then {after:.1f}:")
    print(f"**{during / undisturbed:.0%}** of the undisturbed rate. ", end="")
    print(f"The server's process took {processor.share:.0%} of one core with clients.")
    print(f"Its memory: {began['VmRSS']:.0f} MB before, {ended['VmRSS']:.0f} MB with them at the end.\n")
    return _tell(seen, asked)


def _tell(seen: dict[str, dict[str, Any]], asked: argparse.Namespace) -> int:
    rows, bad = [], 0
    for kind, found in seen.items():
        statuses = ", ".join(f"{count} × {status}" for status, count in sorted(found["statuses"].items()))
        right = {"planners": "200", "listeners": "200", "views": "101"}[kind]
        bad += sum(count for status, count in found["statuses"].items() if status != right) + found.get("ended", 0)
        share = f"{found['processor_seconds'] / asked.seconds:.0%}"
        told = ""
        if kind == "planners":
            taken = found["milliseconds"]
            quantiles = {f"{q} %": np.percentile(taken, q) for q in (50, 90, 99, 100)}
            told = ", ".join(f"{name}: {value:.1f} ms" for name, value in quantiles.items())
        elif kind == "listeners":
            told = f"{found['events']} events, in order at {found['in_order']}"
            bad += asked.listeners - found["in_order"]
        else:
            told = f"{found['megabytes']:.0f} MB"
        rows.append([kind, statuses, found.get("ended", 0), told, share])
    print(markdown(["clients", "answers", "ended early", "saw", "of a core"], rows))
    print(f"\n{bad} bad answers, streams and views.")
    return int(bad > 0)


class _Processor:
    """Seconds of the processor that a process takes, from when it is made until `share` is asked for."""

    def __init__(self, process: int) -> None:
        self._process = process
        self._began, self._spent = time.monotonic(), self._seconds()
        self.share = 0.0

    def stop(self) -> None:
        """Note its share of one core."""
        self.share = (self._seconds() - self._spent) / (time.monotonic() - self._began)

    def _seconds(self) -> float:
        fields = Path(f"/proc/{self._process}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _iterations_a_second(
    url: str, sessions: Sequence[str], seconds: float, processor: _Processor | None = None
) -> float:
    def iterations() -> int:
        answers = [httpx.get(f"{url}/api/v1/sessions/{session}", timeout=60.0).json() for session in sessions]
        return sum(answer["iteration"] for answer in answers)

    began, first = time.monotonic(), iterations()
    time.sleep(seconds)
    if processor is not None:
        processor.stop()
    return (iterations() - first) / (time.monotonic() - began)


def _sessions(url: str, count: int) -> list[str]:
    """Sessions on the open cabinet, which iterate."""
    with httpx.Client(base_url=f"{url}/api/v1", timeout=120.0) as client:
        model, scan = upload_model(client), upload_scan(client)
        roi = load_roi(CABINET / "open").tolist()
        found = []
        for seed in range(count):
            body = {"model_id": model.json()["id"], "scan_ids": [scan.json()["id"]], "roi": roi, "seed": seed}
            found.append(str(client.post("/sessions", json=body).json()["id"]))
            order = {"iterations": 100_000, "until": "iterations"}
            client.post(f"/sessions/{found[-1]}/run", json=order).raise_for_status()
        return found


if __name__ == "__main__":
    raise SystemExit(main())
