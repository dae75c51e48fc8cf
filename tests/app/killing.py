"""Kill a server at random instants of whatever changes its store, start it again, and see whether it kept its word.

While the server runs, threads upload models, scans and recordings, make sessions, iterate and delete, each with an
Idempotency-Key where there is one; `killing_ledger` notes what was acknowledged. The process gets SIGKILL at a random
instant. Of the next one is asked: everything acknowledged is there, byte for byte where a checksum was given, and a
session no earlier than its last acknowledged iteration; nothing is back whose deletion was acknowledged; whatever is
listed can be used; and a call in flight, sent again with its key, has made one entry. Run it:
`python -m tests.app.killing [--kills 300]`.
"""

from __future__ import annotations

import argparse
import itertools
import random
import signal
import tempfile
import threading
import time
import uuid
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import httpx

from tests.app.attacks import entries
from tests.app.forked_servers import ForkedServers
from tests.app.killing_ledger import KINDS, Call, Ledger

# Kept of each kind: few, so that a start has little to take up, and deletions are as frequent as uploads.
KEPT = {"models": 3, "scans": 3, "recordings": 2, "sessions": 4}
# Instants of a kill, seconds after the threads begin.
EARLIEST, LATEST = 0.05, 2.0


def main(words: Sequence[str] | None = None) -> int:
    """Kill and look; exit status 1 where a promise was broken."""
    parser = argparse.ArgumentParser(prog="python -m tests.app.killing", description=__doc__)
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(words)
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="killing-") as folder:
        broken = kill_often(Path(folder), arguments.kills, arguments.seed, say=lambda line: print(line, flush=True))
    for line in broken:
        print(line)
    print(f"{arguments.kills} kills in {time.monotonic() - began:.0f} s, {len(broken)} promises broken")
    return int(bool(broken))


def kill_often(folder: Path, kills: int, seed: int, say: Callable[[str], object] = lambda line: None) -> list[str]:
    """One sentence for each promise that was not kept."""
    rng = random.Random(seed)
    ledger = Ledger()
    with ForkedServers() as servers:
        url = servers.start(folder / "data")
        with _client(url) as client:
            recording = _first(client, ledger)
        for number in range(kills):
            stop = threading.Event()
            works = (_upload, _make_sessions, _iterate, _delete)
            workers = [
                threading.Thread(
                    target=_until_gone, args=(work, url, ledger, recording, stop, rng.random()), daemon=True
                )
                for work in works
            ]
            for worker in workers:
                worker.start()
            time.sleep(rng.uniform(EARLIEST, LATEST))
            servers.end(signal.SIGKILL)
            stop.set()
            for worker in workers:
                worker.join()
            url = servers.start(folder / "data")
            with _client(url) as client:
                ledger.look(client, f"kill {number + 1}")
            say(f"kill {number + 1}: {ledger.told()}")
        servers.end(signal.SIGTERM)
    return ledger.broken


def _client(url: str) -> httpx.Client:
    return httpx.Client(base_url=url, timeout=120)


def _first(client: httpx.Client, ledger: Ledger) -> bytes:
    """A model, a scan and a session to begin with; the session's recording."""
    for call in (_model_call(), _scan_call()):
        ledger.make(client, call)
    session = ledger.make(client, _session_call(ledger))
    assert session is not None, "the first session could not be made"
    path = f"/api/v1/sessions/{session}"
    client.post(f"{path}/step", json={"iterations": 2}).raise_for_status()
    return client.get(f"{path}/recording").raise_for_status().content


Work = Callable[[httpx.Client, Ledger, bytes, random.Random], None]


def _until_gone(work: Work, url: str, ledger: Ledger, recording: bytes, stop: threading.Event, seed: float) -> None:
    """Work on until the server is gone."""
    rng = random.Random(seed)
    with _client(url) as client, suppress(httpx.TransportError):
        while not stop.is_set():
            work(client, ledger, recording, rng)
            time.sleep(0.02)


def _upload(client: httpx.Client, ledger: Ledger, recording: bytes, rng: random.Random) -> None:
    """One more of what there are too few of; or of any, for the deletions to have something."""
    call = rng.choice((_model_call, _scan_call, lambda: _recording_call(recording)))()
    if len(ledger.known[call.kind]) < 2 * KEPT[call.kind]:
        ledger.make(client, call)


def _make_sessions(client: httpx.Client, ledger: Ledger, recording: bytes, rng: random.Random) -> None:
    if len(ledger.known["sessions"]) < 2 * KEPT["sessions"]:
        with suppress(LookupError):
            ledger.make(client, _session_call(ledger))


def _iterate(client: httpx.Client, ledger: Ledger, recording: bytes, rng: random.Random) -> None:
    session = ledger.any_of("sessions", rng)
    if session is not None:
        ledger.step(client, session)


def _delete(client: httpx.Client, ledger: Ledger, recording: bytes, rng: random.Random) -> None:
    kind = rng.choice(KINDS)
    if len(ledger.known[kind]) > KEPT[kind] and (id := ledger.any_of(kind, rng)) is not None:
        ledger.delete(client, kind, id)


_numbers = itertools.count()


def _key() -> str:
    return f"{next(_numbers)}-{uuid.uuid4().hex}"


def _model_call() -> Call:
    key = _key()
    # the robot's name makes each of them another file
    content = entries.URDF.replace('name="cabinet"', f'name="{key}"')
    return Call("models", key, f"{key}.urdf", lambda client: _form(client, "models", key, f"{key}.urdf", content))


def _scan_call() -> Call:
    key = _key()
    camera = {"camera": entries.CAMERA_TEXT}
    return Call(
        "scans", key, f"{key}.png", lambda client: _form(client, "scans", key, f"{key}.png", entries.DEPTH, camera)
    )


def _recording_call(content: bytes) -> Call:
    key = _key()
    name = f"{key}.sqlite"
    return Call("recordings", key, name, lambda client: _form(client, "recordings", key, name, content))


def _form(
    client: httpx.Client, kind: str, key: str, name: str, content: str | bytes, data: dict[str, str] | None = None
) -> httpx.Response:
    headers = {"Idempotency-Key": key}
    return client.post(f"/api/v1/{kind}", files={"file": (name, content)}, data=data or {}, headers=headers)


def _session_call(ledger: Ledger) -> Call:
    """Of the newest model and scan, which are deleted last. Raises LookupError where there are none."""
    key = _key()
    model, scan = ledger.newest("models"), ledger.newest("scans")
    body = entries.session_body(model, scan, name=key)
    headers = {"Idempotency-Key": key}
    return Call("sessions", key, key, lambda client: client.post("/api/v1/sessions", json=body, headers=headers))


if __name__ == "__main__":
    raise SystemExit(main())
