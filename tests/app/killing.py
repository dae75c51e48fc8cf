"""Kill a server at random instants, start it again, and see whether everything it acknowledged is there.

While the server runs, one thread uploads models and scans and another steps a session; each notes what was
acknowledged. The process gets SIGKILL at a random instant; the next one must know everything that was noted, byte for
byte where a checksum was given, and the session no earlier than its last acknowledged iteration. Run it:
`python -m tests.app.killing [--kills 50]`.
"""

from __future__ import annotations

import argparse
import json
import random
import signal
import tempfile
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import httpx

from benchmarks.server_process import CABINET, start, upload_model, upload_scan
from benchmarks.trials import load_roi

# As quick as to have many iterations acknowledged before a kill.
QUICK = {"image_width": 80, "triangles": 60, "search_iterations": 1, "search_proposals": 300, "search_islands": 1}


@dataclass
class Acknowledged:
    """What the server has said it keeps: checksums by kind and id, and the last iteration of each session."""

    entries: dict[str, dict[str, str]] = field(default_factory=lambda: {"models": {}, "scans": {}})
    iterations: dict[str, int] = field(default_factory=dict)
    estimates: dict[tuple[str, int], str] = field(default_factory=dict)


def main(words: Sequence[str] | None = None) -> int:
    """Kill and look; exit status 1 where something was lost."""
    parser = argparse.ArgumentParser(prog="python -m tests.app.killing", description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(words)
    with tempfile.TemporaryDirectory(prefix="killing-") as folder:
        lost = kill_often(Path(folder), arguments.kills, arguments.seed, say=lambda line: print(line, flush=True))
    for line in lost:
        print(line)
    print(f"{arguments.kills} kills, {len(lost)} losses")
    return int(bool(lost))


def kill_often(folder: Path, kills: int, seed: int, say=lambda line: None) -> list[str]:  # type: ignore[no-untyped-def]
    """One sentence for each thing that was acknowledged and is not there after a restart."""
    rng = random.Random(seed)
    known = Acknowledged()
    lost: list[str] = []
    server = start(folder).ready()
    for number in range(kills):
        stop = threading.Event()
        workers = [
            threading.Thread(target=work, args=(server.url, known, stop), daemon=True) for work in (_upload, _iterate)
        ]
        for worker in workers:
            worker.start()
        time.sleep(rng.uniform(0.2, 2.5))
        server.end(signal.SIGKILL)
        stop.set()
        for worker in workers:
            worker.join(30)
        server = start(folder).ready()
        lost += look(server.url, known)
        counts = ", ".join(f"{len(there)} {kind}" for kind, there in known.entries.items())
        say(f"kill {number + 1}: {counts}, sessions at {list(known.iterations.values())}, {len(lost)} losses")
    server.end(signal.SIGTERM)
    return lost


def look(url: str, known: Acknowledged) -> list[str]:
    """What is missing or differs."""
    lost = []
    with httpx.Client(base_url=f"{url}/api/v1", timeout=600) as client:
        for kind, entries in known.entries.items():
            for entry, checksum in entries.items():
                answer = client.get(f"/{kind}/{entry}")
                if answer.status_code != 200 or answer.headers.get("etag", "") != checksum:
                    lost.append(f"{kind}/{entry}: {answer.status_code}, etag {answer.headers.get('etag')}")
        for session, iteration in known.iterations.items():
            answer = client.get(f"/sessions/{session}")
            if answer.status_code != 200 or answer.json()["iteration"] < iteration:
                lost.append(f"session {session} was at {iteration}: {answer.status_code} {answer.text[:200]}")
        for (session, iteration), links in known.estimates.items():
            answer = client.get(f"/sessions/{session}/estimate", params={"iteration": iteration})
            if answer.status_code != 200 or json.dumps(answer.json()["links"]) != links:
                lost.append(f"session {session}: the estimate of iteration {iteration} reads otherwise")
    return lost


def _upload(url: str, known: Acknowledged, stop: threading.Event) -> None:
    """Models and scans in turn, until the server is gone."""
    with httpx.Client(base_url=f"{url}/api/v1", timeout=600) as client:
        try:
            while not stop.is_set():
                for kind, upload in (("models", upload_model), ("scans", upload_scan)):
                    answer = upload(client)
                    if answer.status_code == 201:
                        entry = answer.json()["id"]
                        known.entries[kind][entry] = client.get(f"/{kind}/{entry}").headers["etag"]
                time.sleep(0.05)
        except (httpx.TransportError, KeyError):
            return


def _iterate(url: str, known: Acknowledged, stop: threading.Event) -> None:
    """The session, made when there is a model and a scan, stepped on."""
    with httpx.Client(base_url=f"{url}/api/v1", timeout=600) as client:
        try:
            while not known.iterations and not stop.is_set():
                models, scans = list(known.entries["models"]), list(known.entries["scans"])
                if models and scans:
                    roi = load_roi(CABINET / "open").tolist()
                    body = {"model_id": models[0], "scan_ids": [scans[0]], "roi": roi, "particles": 60, "config": QUICK}
                    answer = client.post("/sessions", json=body)
                    if answer.status_code == 201:
                        known.iterations[answer.json()["id"]] = 0
                time.sleep(0.05)
            while not stop.is_set():
                for session in list(known.iterations):
                    if client.post(f"/sessions/{session}/step", json={"iterations": 1}).status_code != 200:
                        return
                    found = client.get(f"/sessions/{session}/estimate").json()
                    known.iterations[session] = found["iteration"]
                    if found["iteration"] % 5 == 1:
                        known.estimates[session, found["iteration"]] = json.dumps(found["links"])
        except (httpx.TransportError, KeyError):
            return


if __name__ == "__main__":
    raise SystemExit(main())
