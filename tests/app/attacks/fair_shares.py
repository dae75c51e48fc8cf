"""5: one client takes all places, opens all views, or makes the largest sessions."""

from __future__ import annotations

import random
import socket
import threading
import time
from collections import Counter
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, suppress

import httpx

from tests.app.attacks import entries
from tests.app.attacks.browsers import Browsers
from tests.app.attacks.outcome import Outcome
from tests.app.attacks.target import ATTACKER, OTHER, Target
from tests.app.attacks.watch import MIB, Watch, memory, settled_memory

UPLOADS, VIEWS = 205, 195
PARTS, PARTICLES = 48, 20_000
# Seconds during which iterations are counted.
COUNTED = 10.0
# Of the undisturbed rate, beside VIEWS views whose browsers are on the same machine.
LEAST_RATE = 0.4
MOST_KEPT = 300 * MIB
# Calls of one client at once, a decision about so many places to look from, and the share of the rate that they have to
# leave to a session that iterates.
CROWD, PLACES, LEAST_BESIDE_CROWDS = 40, 100, 0.1
# {seen} is at its iteration 8, {session} iterates and is beyond {iteration}; the search has no posterior: 404.
CROWDS = {
    "decisions": "{seen}/decision",
    "recorded estimates": "{session}/estimate?iteration={{iteration}}",
    "posteriors": "{session}/estimate?iteration={{iteration}}&posterior=true",
    "draws": "{session}/posterior/frame?iteration={{iteration}}",
    "beliefs": "{session}/beliefs/drawer1?iteration={{iteration}}",
    "marginals": "{session}/beliefs/drawer1/marginals?iteration={{iteration}}",
    "pictures of a particle": "{session}/beliefs/drawer1/particles/3/picture.png?iteration={{iteration}}",
    "pictures": "{session}/estimate.png?iteration={{iteration}}",
    "traces": "{session}/trace",
    "recordings": "{session}/recording",
    "lists": "/api/v1/sessions",
    "graphs": "{session}/graph",
}
# Of one call beside the views, seconds.
PATIENCE = 60.0
# A view outlives its last browser by a minute.
LINGER = 90.0


def attack(target: Target, outcome: Outcome) -> None:
    """All four."""
    _uploads(target, outcome)
    _crowds(target, outcome)
    target.clean()
    _views(target, outcome)
    target.clean()
    _large_sessions(target, outcome)


def _uploads(target: Target, outcome: Outcome) -> None:
    """Halves of uploads; who holds them and who does not are both served."""
    outcome.did.append(f"{UPLOADS} uploads that stop in the middle")
    head = target.head(
        "POST", "/api/v1/scans", Content_Type="multipart/form-data; boundary=x", Content_Length="1000000"
    )
    begun = head + b'\r\n--x\r\nContent-Disposition: form-data; name="file"; filename="a.ply"\r\n\r\nply\n'
    with ExitStack() as stack, Watch(target, patience=20) as watch:
        connections = []
        for _ in range(UPLOADS):
            connection = stack.enter_context(target.socket(timeout=5))
            connection.sendall(begun)
            connections.append(connection)
        time.sleep(1)
        told = Counter(_status(connection) for connection in connections)
        outcome.happened.append(
            "uploads: " + ", ".join(f"{count} × {status or 'taken'}" for status, count in told.items())
        )
        for address, who in ((ATTACKER, "the same client"), (OTHER, "another client")):
            if address == OTHER and not target.several_addresses:
                continue
            with target.client(address) as client:
                for path in ("/healthz", "/api/v1/scans", "/api/v1/sessions", "/metrics"):
                    outcome.answered(f"GET {path} of {who} beside {UPLOADS} half uploads", client.get(path), {200})
                if address == OTHER:
                    answer = entries.upload_scan(client)
                    outcome.answered(f"an upload of {who} beside {UPLOADS} half uploads", answer, {201})
                    target.keep("scans", answer)
        time.sleep(2)
    outcome.happened.append(f"uploads: {watch.told()}")
    outcome.expect(not watch.unserved, f"uploads: {watch.unserved} calls of another caller were not served")


def _status(connection: socket.socket) -> str:
    """The status that has come; empty where none has."""
    connection.setblocking(False)
    try:
        data = connection.recv(1 << 16)
    except BlockingIOError:
        return ""
    except OSError as error:
        return type(error).__name__
    return data.split()[1].decode() if data.startswith(b"HTTP/") else "closed"


def _crowds(target: Target, outcome: Outcome) -> None:
    """Calls that compute, many at once and again and again, of one client; another's session iterates."""
    outcome.did.append(
        f"{CROWD} calls at once, for {COUNTED:g} s each: decisions about {PLACES} places, and every kind of read"
    )
    with target.client(OTHER, timeout=PATIENCE) as client:
        seen = entries.small_session(target, client, 8)
        session = entries.small_session(target, client, 1, particles=400)
        client.post(f"{session}/run", json={"iterations": 100_000}).raise_for_status()
        undisturbed = _rate(client, session)
        outcome.happened.append(f"crowds: {undisturbed:.1f} iterations/s before")
        for name, path in CROWDS.items():
            with Watch(target, patience=20) as watch, _Crowd(target, path.format(seen=seen, session=session)) as crowd:
                disturbed = _rate(client, session)
            outcome.happened.append(
                f"{name}: "
                + ", ".join(f"{count} × {answer}" for answer, count in crowd.told.items())
                + f"; {disturbed:.1f} iterations/s beside them; {watch.told()}"
            )
            odd = set(crowd.told) - {"200", "404", "429", "given up"}
            outcome.expect(not odd, f"{name}: answered with {dict(crowd.told)}")
            outcome.expect(
                disturbed >= LEAST_BESIDE_CROWDS * undisturbed,
                f"{name}: {disturbed:.1f} iterations/s beside {CROWD} of them, {undisturbed:.1f} without",
            )
            outcome.expect(not watch.unserved, f"{name}: {watch.unserved} calls of another caller were not served")


class _Crowd:
    """A context in which CROWD threads of one client ask for `path` without a pause.

    told : their answers, by status
    """

    def __init__(self, target: Target, path: str) -> None:
        self.told: Counter[str] = Counter()
        self._target = target
        self._path = path
        self._over = threading.Event()
        self._pool = ThreadPoolExecutor(CROWD)
        self._answers: list[Future[Counter[str]]] = []

    def __enter__(self) -> _Crowd:
        self._answers = [self._pool.submit(self._ask, number) for number in range(CROWD)]
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        with self._pool:
            for answers in self._answers:
                self.told += answers.result()

    def _ask(self, seed: int) -> Counter[str]:
        upright = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
        places = [{"position": {"x": 0.1 * at, "y": -1.0, "z": 1.0}, "orientation": upright} for at in range(PLACES)]
        asked = {"views": [{"pose": pose, "cost": 1.0} for pose in places], "max_std": 1e-5}
        numbers = random.Random(seed)
        told: Counter[str] = Counter()
        with self._target.client(timeout=COUNTED) as client:
            while not self._over.is_set():
                path = self._path.format(iteration=numbers.randrange(50))
                try:
                    answer = client.post(path, json=asked) if path.endswith("/decision") else client.get(path)
                    told[str(answer.status_code)] += 1
                except httpx.TimeoutException:
                    told["given up"] += 1
        return told


def _views(target: Target, outcome: Outcome) -> None:
    """As many as are let in, first from one address, then from ten."""
    with target.client(OTHER, timeout=PATIENCE) as client:
        session = entries.small_session(target, client, 1, particles=400)
        client.post(f"{session}/run", json={"iterations": 100_000}).raise_for_status()
        undisturbed = _rate(client, session)
        before = memory(target)
        addresses = [ATTACKER] * VIEWS
        if target.several_addresses:
            addresses += [f"127.0.0.{10 + number % 10}" for number in range(VIEWS)]
        outcome.did.append(
            f"{len(addresses)} views of a session that iterates, by their websockets, {VIEWS} of one client"
        )
        with Watch(target, patience=20) as watch, Browsers(target, session.rpartition("/")[2], addresses) as browsers:
            disturbed = _rate(client, session)
        opened, refusals = browsers.opened, browsers.refusals
        alone = opened.count(ATTACKER)
        outcome.happened.append(
            f"views: {alone} of one client and {len(opened) - alone} of others opened, refused "
            + (", ".join(f"{count} × {status}" for status, count in refusals.items()) or "none")
            + f"; {undisturbed:.1f} iterations/s before, {disturbed:.1f} beside them; {watch.told()}"
        )
        outcome.happened += [f"views: refused with {sentence!r}" for sentence in list(browsers.sentences)[:3]]
        outcome.expect(
            disturbed >= LEAST_RATE * undisturbed,
            f"views: {disturbed:.1f} iterations/s beside {len(opened)} views, {undisturbed:.1f} without",
        )
        outcome.expect(set(refusals) <= {"429"}, f"views: refused with {dict(refusals)}, expected 429")
        outcome.expect(all(browsers.sentences), "views: a refusal without a sentence")
        outcome.expect(not watch.unserved, f"views: {watch.unserved} calls of another caller were not served")
        with suppress(httpx.TimeoutException):
            client.post(f"{session}/pause")
        after = settled_memory(target, before + MOST_KEPT, LINGER)
        outcome.happened.append(f"views: memory {before // MIB} MiB before, {after // MIB} MiB after they were closed")
        outcome.expect(after < before + MOST_KEPT, f"views: {(after - before) // MIB} MiB did not come back")


def _rate(client: httpx.Client, session: str) -> float:
    """Iterations a second; none where the server does not answer."""
    try:
        began, first = time.monotonic(), client.get(session).json()["iteration"]
        time.sleep(COUNTED)
        last = client.get(session).json()["iteration"]
    except httpx.TimeoutException:
        return 0.0
    return (last - first) / (time.monotonic() - began)


def _large_sessions(target: Target, outcome: Outcome) -> None:
    """Two; refused with a sentence, or their memory comes back when they are deleted."""
    outcome.did.append(f"two sessions of {PARTS} parts × {PARTICLES} particles")
    with target.client(timeout=600) as client:
        model = target.made_by("models", entries.upload_model(client, chain(PARTS), "chain.urdf"))
        scan = target.made_by("scans", entries.upload_scan(client))
        before = memory(target)
        made = []
        with Watch(target, patience=60) as watch:
            for _ in range(2):
                body = entries.session_body(model, scan, particles=PARTICLES, prior=CHAIN_PRIOR)
                answer = client.post("/api/v1/sessions", json=body)
                outcome.answered("POST of a large session", answer, {201, 413, 422, 429, 503, 507})
                id = target.keep("sessions", answer)
                if id is None:
                    outcome.happened.append(f"large session: {answer.status_code} {answer.json().get('detail')!r}")
                    outcome.expect(bool(answer.json().get("detail")), "a large session is refused without a sentence")
                    continue
                made.append(id)
                step = client.post(f"/api/v1/sessions/{id}/step", json={"iterations": 1})
                outcome.answered("a step of a large session", step, {200, 507})
        outcome.happened.append(f"large sessions: {len(made)} made; {watch.told()}")
        for id in made:
            outcome.answered("DELETE of a large session", client.delete(f"/api/v1/sessions/{id}"), {204})
        after = settled_memory(target, before + MOST_KEPT, 20)
        outcome.happened.append(f"large sessions: memory {before // MIB} MiB before, {after // MIB} MiB after DELETE")
        outcome.expect(after < before + MOST_KEPT, f"large sessions: {(after - before) // MIB} MiB did not come back")
        outcome.expect(not watch.unserved, f"large sessions: {watch.unserved} calls of another caller were not served")


CHAIN_PRIOR = {
    "kind": "gaussian",
    "link": "part0",
    "pose": {"position": {"x": 0.4, "y": 0.2, "z": 0.2}, "orientation": {"x": 0, "y": 0, "z": 0, "w": 1}},
    "std_xyz": [0.05, 0.05, 0.05],
    "std_rpy": [0.1, 0.1, 0.1],
}


def chain(parts: int) -> str:
    """A URDF of boxes that slide on each other."""
    lines = ['<?xml version="1.0"?>', '<robot name="chain">']
    for number in range(parts):
        box = '<box size="0.05 0.1 0.02"/>'
        lines.append(f'<link name="part{number}"><visual><geometry>{box}</geometry></visual></link>')
        if number:
            lines.append(
                f'<joint name="slide{number}" type="prismatic"><parent link="part{number - 1}"/>'
                f'<child link="part{number}"/><origin xyz="0 0 0.02"/><axis xyz="1 0 0"/>'
                '<limit lower="0" upper="0.05" effort="1" velocity="1"/></joint>'
            )
    return "\n".join([*lines, "</robot>"])
