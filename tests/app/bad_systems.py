"""A full disk, a data directory that is read-only, a clock that jumps back an hour, files that may not grow.

    python -m tests.app.bad_systems [--only full-disk …]

For each a server of its own is started, given a model, scans, a recording and sessions, and then put under the
condition: what reads goes on, what writes says in a sentence why it cannot, nothing is damaged. Once the condition is
over everything works again, and what was stored before is there, also after a restart. Mounts are made in a namespace
of the script's own (`unshare`, root or not) and go with it. The exit status is 1 where a promise is broken.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import httpx

from tests.app import bad_conditions as conditions
from tests.app.attacks import entries, every_call
from tests.app.attacks.outcome import Outcome
from tests.app.attacks.target import KINDS, OwnServer, own_server_in
from tests.app.attacks.watch import faults

# Until when a session that iterates has noticed that it cannot, and until when one goes on again, seconds.
PATIENCE = 20.0
_NAMESPACE = "PMPNBP_TEST_NAMESPACE"
# Calls that make an entry, or a session's recording longer: these need room.
GROWING = ("POST /models", "POST /scans", "POST /recordings", "POST /sessions", "POST /api/v1/sessions/sample")


@dataclass(frozen=True)
class Condition:
    """place : makes the folder for the data; under : puts a server under the condition and takes it away again
    refusals : statuses with which what writes may be refused; needed : whether GROWING has to be refused at all
    iterations : of a session that iterates meanwhile: one that nothing stops takes a core
    environment : of the server; besides : what else is looked at under the condition
    """

    title: str
    place: Callable[[Path], AbstractContextManager[Path]]
    under: Callable[[OwnServer], AbstractContextManager[None]]
    refusals: Collection[int] = ()
    needed: bool = True
    iterations: int = 100_000
    environment: Callable[[Path], Mapping[str, str]] = lambda folder: {}
    besides: Callable[[OwnServer, Outcome, httpx.Client], None] = lambda server, outcome, client: None


CONDITIONS: Mapping[str, Condition] = {
    "full-disk": Condition("a full disk", conditions.small_disk, conditions.filled, {507}),
    "read-only": Condition("a read-only data directory", conditions.plain, conditions.read_only, {503, 507}),
    "file-size": Condition("files that may not grow", conditions.plain, conditions.small_files, {413, 503, 507}),
    "clock": Condition(
        "a clock that jumps back an hour",
        conditions.plain,
        conditions.an_hour_ago,
        needed=False,
        iterations=100,
        environment=conditions.own_clock,
        besides=conditions.keys_and_waits,
    ),
}


def main(words: Sequence[str] | None = None) -> int:
    """Try each; exit status 1 where any is not stood."""
    parser = argparse.ArgumentParser(prog="python -m tests.app.bad_systems", description=__doc__)
    parser.add_argument("--only", action="append", choices=list(CONDITIONS), help="may be given more than once")
    arguments = parser.parse_args(words)
    if _NAMESPACE not in os.environ and shutil.which("unshare"):
        _in_a_namespace(list(words if words is not None else sys.argv[1:]))
    broken = []
    for name in arguments.only or CONDITIONS:
        outcome = stand(CONDITIONS[name])
        print(outcome, flush=True)
        if outcome.broken:
            broken.append(name)
    print(f"{len(broken)} of {len(arguments.only or CONDITIONS)} broken: {', '.join(broken) or 'none'}")
    return int(bool(broken))


def _in_a_namespace(words: list[str]) -> None:
    """Begin again where mounts are nobody else's; goes on here where the system does not let us."""
    how = ["unshare", "--mount"] if os.geteuid() == 0 else ["unshare", "--mount", "--map-root-user"]
    if subprocess.run([*how, "true"], capture_output=True, check=False).returncode == 0:
        os.environ[_NAMESPACE] = "1"
        os.execvp("unshare", [*how, sys.executable, "-m", "tests.app.bad_systems", *words])


def stand(condition: Condition) -> Outcome:
    """What a server makes of a condition."""
    outcome = Outcome(condition.title)
    began = time.monotonic()
    try:
        with tempfile.TemporaryDirectory(prefix="bad-system-") as name, condition.place(Path(name)) as folder:
            _under(condition, outcome, folder)
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        place = f"{Path(where.filename).name}:{where.lineno}"
        outcome.broken.append(f"it could not be tried to its end: {type(error).__name__}: {error} ({place})")
    outcome.happened.append(f"took {time.monotonic() - began:.0f} s")
    return outcome


def _under(condition: Condition, outcome: Outcome, folder: Path) -> None:
    environment = condition.environment(folder)
    with own_server_in(folder, environment=environment) as server, server.target.client() as client:
        names = _stored(server, client)
        before = _told(client, names)
        running = entries.small_session(server.target, client, 2)
        client.post(f"{running}/run", json={"iterations": condition.iterations}).raise_for_status()
        with condition.under(server):
            _reads(outcome, client, names, condition)
            _writes(outcome, client, names, condition)
            state = _come_to_rest(client, running) if condition.needed else client.get(running).json()
            outcome.happened.append(f"the session that iterated: {state['state']}, {state['error']!r}")
            if condition.needed:
                outcome.expect(state["state"] != "running", "a session is running though it cannot be recorded")
            condition.besides(server, outcome, client)
            _same(outcome, before, _told(client, names), "under the condition")
        outcome.happened += [f"its log: {count} × {told}" for told, count in faults(server.target).most_common(12)]
        _works_again(outcome, client, names, running)
        _same(outcome, before, _told(client, names), "after the condition")
    with own_server_in(folder, environment=environment) as server, server.target.client() as client:
        _same(outcome, before, _told(client, names), "after a restart")
        for entry in client.get("/api/v1/sessions").json():
            outcome.expect(
                entry["state"] != "failed", f"after a restart session {entry['name']} is failed: {entry['error']}"
            )
        _works_again(outcome, client, names, running)


def _stored(server: OwnServer, client: httpx.Client) -> dict[str, str]:
    """A session after some iterations, whatever it stands on, and another, which may be changed."""
    session = entries.small_session(server.target, client, 5)
    found = client.get(session).json()
    recording = client.get(f"{session}/recording").raise_for_status().content
    made = server.target.made_by("recordings", entries.upload_recording(client, recording))
    further = server.target.made_by("scans", entries.upload_further_scan(client))
    changed = entries.small_session(server.target, client, 5)
    return {
        "session_id": found["id"],
        "changed_id": changed.rpartition("/")[2],
        "model_id": found["model_id"],
        "scan_id": found["scan_ids"][0],
        "further_scan_id": further,
        "recording_id": made,
        "recording": recording.decode("latin-1"),
    }


def _told(client: httpx.Client, names: Mapping[str, str]) -> dict[str, Any]:
    """What the server says of what was stored, as far as it never changes."""
    found: dict[str, Any] = {}
    for kind in ("models", "scans", "recordings"):
        answer = client.get(f"/api/v1/{kind}/{names[kind[:-1] + '_id']}")
        found[kind] = answer.json() if answer.status_code == 200 else answer.text
    if isinstance(found["recordings"], dict):
        found["recordings"].pop("name")  # which people may change
    for id in (names["session_id"], names["recording_id"]):
        for iteration in (0, 3, 5):
            answer = client.get(f"/api/v1/sessions/{id}/estimate?iteration={iteration}")
            found[f"iteration {iteration} of {id}"] = (
                answer.json()["links"] if answer.status_code == 200 else answer.text
            )
    return found


def _same(outcome: Outcome, before: Mapping[str, Any], after: Mapping[str, Any], when: str) -> None:
    for name, value in before.items():
        outcome.expect(after[name] == value, f"{name} is not as it was {when}: {str(after[name])[:160]}")


def _reads(outcome: Outcome, client: httpx.Client, names: Mapping[str, str], condition: Condition) -> None:
    outcome.did.append("every call that reads")
    for told, answer in every_call.reads(client, names):
        # a download may need room for a consistent copy
        copies = told.endswith("/recording") and answer.status_code in condition.refusals
        outcome.answered(told, answer, {answer.status_code} if copies else range(200, 500))
        outcome.expect(answer.status_code < 300 or copies or _excused(told, answer), f"{told}: {answer.status_code}")


def _excused(told: str, answer: httpx.Response) -> bool:
    """The posterior of an inference that is still searching is not there, whatever the system."""
    return "/posterior" in told and answer.status_code == 409


def _writes(outcome: Outcome, client: httpx.Client, names: Mapping[str, str], condition: Condition) -> None:
    outcome.did.append("every call that writes, but deletions")
    sentences: dict[str, str] = {}
    for told, answer in every_call.writes(client, {**names, "session_id": names["changed_id"]}):
        allowed = {*range(200, 300), 409, *condition.refusals}
        if condition.needed and told in GROWING:
            allowed = set(condition.refusals)
        outcome.answered(told, answer, allowed)
        if answer.status_code >= 400:
            sentences[f"{answer.status_code} {answer.json().get('detail')}"] = told
    outcome.happened += [f"{told}: {sentence}" for sentence, told in list(sentences.items())[:12]]


def _come_to_rest(client: httpx.Client, path: str) -> dict[str, Any]:
    """A session once it neither runs nor waits, or as it is when patience is over."""
    until = time.monotonic() + PATIENCE
    found: dict[str, Any] = client.get(path).json()
    while found["state"] in ("running", "waiting") and time.monotonic() < until:
        time.sleep(0.1)
        found = client.get(path).json()
    return found


def _works_again(outcome: Outcome, client: httpx.Client, names: Mapping[str, str], running: str) -> None:
    """Lists, uploads, sessions; those that could not go on do so when they are told to."""
    for kind in KINDS:
        outcome.answered(f"GET /{kind} afterwards", client.get(f"/api/v1/{kind}"), {200})
    recording = names["recording"].encode("latin-1")
    for told, answer in (
        ("a model", entries.upload_model(client)),
        ("a scan", entries.upload_scan(client)),
        ("a recording", entries.upload_recording(client, recording)),
        ("a session", client.post("/api/v1/sessions", json=entries.session_body(names["model_id"], names["scan_id"]))),
    ):
        outcome.answered(f"{told} afterwards", answer, {201})
    for told, path in (("the session", f"/api/v1/sessions/{names['session_id']}"), ("the one that iterated", running)):
        client.post(f"{path}/pause")
        _come_to_rest(client, path)
        answer = outcome.answered(
            f"a step of {told} afterwards", client.post(f"{path}/step", json={"iterations": 1}), {200}
        )
        if answer.status_code == 200:
            reached = answer.json()["iteration"]
            answer = client.get(f"{path}/estimate", params={"iteration": reached})
            outcome.answered(f"the iteration that {told} made afterwards", answer, {200})


if __name__ == "__main__":
    sys.exit(main())
