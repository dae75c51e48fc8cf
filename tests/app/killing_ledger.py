"""What a server has said that it keeps, and what of that is true after a kill."""

from __future__ import annotations

import json
import random
import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import httpx

KINDS = ("models", "scans", "recordings", "sessions")


@dataclass(frozen=True)
class Call:
    """A call that makes an entry, and can be sent again. name : of the entry, which no other has"""

    kind: str
    key: str
    name: str
    send: Callable[[httpx.Client], httpx.Response]


def _of_each_kind() -> dict[str, dict[str, str]]:
    return {kind: {} for kind in KINDS}


@dataclass
class Ledger:
    """known : by kind, the acknowledged entries with their checksums, those of sessions empty
    gone : by kind, entries whose deletion was acknowledged
    leaving : kind and id of what was asked to be deleted, without an answer
    sent : calls without an answer
    iterations : of sessions, the last acknowledged; estimates : links of some, by session and iteration
    broken : a sentence for each promise that was not kept; counts : of everything, for people
    """

    known: dict[str, dict[str, str]] = field(default_factory=_of_each_kind)
    gone: dict[str, set[str]] = field(default_factory=lambda: {kind: set() for kind in KINDS})
    leaving: set[tuple[str, str]] = field(default_factory=set)
    sent: dict[str, Call] = field(default_factory=dict)
    iterations: dict[str, int] = field(default_factory=dict)
    estimates: dict[tuple[str, int], str] = field(default_factory=dict)
    broken: list[str] = field(default_factory=list)
    counts: Counter[str] = field(default_factory=Counter)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def told(self) -> str:
        """Where it stands, in a line."""
        there = ", ".join(f"{len(known)} {kind}" for kind, known in self.known.items())
        counts = ", ".join(f"{count} {what}" for what, count in sorted(self.counts.items()))
        return f"{there}; so far {counts}; {len(self.broken)} promises broken"

    def any_of(self, kind: str, rng: random.Random) -> str | None:
        """An entry that is not being deleted."""
        with self.lock:
            found = [id for id in self.known[kind] if (kind, id) not in self.leaving]
        return rng.choice(found) if found else None

    def newest(self, kind: str) -> str:
        """Raises LookupError where there is none."""
        with self.lock:
            return [id for id in self.known[kind] if (kind, id) not in self.leaving][-1]

    # Calls; a broken connection is raised, and leaves the call among those without an answer

    def make(self, client: httpx.Client, call: Call) -> str | None:
        """Send a call; the id of its entry, None where it was refused."""
        with self.lock:
            self.sent[call.key] = call
        answer = call.send(client)
        id = None
        with self.lock:
            del self.sent[call.key]
            if answer.status_code == 201:
                id = answer.json()["id"]
                self.known[call.kind][id] = answer.json().get("sha256", "")
                self.counts[f"{call.kind} made"] += 1
                if call.kind == "sessions":
                    self.iterations[id] = 0
            elif answer.status_code not in (404, 409, 429):  # its model or scan was deleted meanwhile; too many at once
                self.broken.append(f"a call that makes {call.kind}: {answer.status_code} {answer.text[:200]}")
        return id

    def step(self, client: httpx.Client, session: str) -> None:
        """One iteration, and sometimes what it found."""
        path = f"/api/v1/sessions/{session}"
        answer = client.post(f"{path}/step", json={"iterations": 1})
        if answer.status_code != 200:
            with self.lock:
                if answer.status_code not in (404, 409):  # deleted meanwhile
                    self.broken.append(f"a step: {answer.status_code} {answer.text[:200]}")
            return
        with self.lock:
            self.iterations[session] = max(self.iterations.get(session, 0), answer.json()["iteration"])
            self.counts["iterations"] += 1
        found = client.get(f"{path}/estimate")
        if found.status_code == 200 and found.json()["iteration"] % 3 == 1:
            with self.lock:
                if session not in self.known["sessions"]:
                    return  # its deletion was acknowledged since
                self.estimates[session, found.json()["iteration"]] = json.dumps(found.json()["links"])

    def delete(self, client: httpx.Client, kind: str, id: str) -> None:
        """Delete an entry; refused where a session uses it."""
        with self.lock:
            self.leaving.add((kind, id))
        answer = client.delete(f"/api/v1/{kind}/{id}")
        with self.lock:
            self.leaving.discard((kind, id))
            if answer.status_code == 204:
                self._forget(kind, id)
                self.gone[kind].add(id)
                self.counts["deleted"] += 1
            elif answer.status_code != 409:
                self.broken.append(f"DELETE of {kind}/{id}: {answer.status_code} {answer.text[:200]}")

    def _forget(self, kind: str, id: str) -> None:
        self.known[kind].pop(id, None)
        if kind == "sessions":
            self.iterations.pop(id, None)
            self.estimates = {key: links for key, links in self.estimates.items() if key[0] != id}

    # After a restart, with no other thread at work

    def look(self, client: httpx.Client, when: str) -> None:
        """Hold what is there against what was said."""
        found = len(self.broken)
        listed = self._lists(client)
        self._settle_deletions(listed)
        self._everything_is_there(client)
        self._nothing_is_back(listed)
        self._no_ghosts(client, listed)
        self._once_each(client, listed)
        self.broken[found:] = [f"{when}: {line}" for line in self.broken[found:]]

    def _lists(self, client: httpx.Client) -> dict[str, dict[str, dict[str, object]]]:
        found: dict[str, dict[str, dict[str, object]]] = {}
        for kind in KINDS:
            answer = client.get(f"/api/v1/{kind}")
            if answer.status_code != 200:
                self.broken.append(f"GET /{kind}: {answer.status_code} {answer.text[:200]}")
            found[kind] = {entry["id"]: entry for entry in answer.json()} if answer.status_code == 200 else {}
        return found

    def _settle_deletions(self, listed: dict[str, dict[str, dict[str, object]]]) -> None:
        """A deletion without an answer may have happened or not; from now on it is one of them."""
        for kind, id in self.leaving:
            self.counts["deletions in flight"] += 1
            if id not in listed[kind]:
                self._forget(kind, id)
                self.gone[kind].add(id)
        self.leaving.clear()

    def _everything_is_there(self, client: httpx.Client) -> None:
        for kind in ("models", "scans", "recordings"):
            for id, checksum in self.known[kind].items():
                answer = client.get(f"/api/v1/{kind}/{id}")
                if answer.status_code != 200 or answer.json()["sha256"] != checksum:
                    self.broken.append(f"{kind}/{id} is lost or changed: {answer.status_code} {answer.text[:200]}")
        for id in self.known["sessions"]:
            answer = client.get(f"/api/v1/sessions/{id}")
            reached = self.iterations.get(id, 0)
            if answer.status_code != 200 or (answer.json()["iteration"] or 0) < reached:
                self.broken.append(f"session {id} was at {reached}: {answer.status_code} {answer.text[:200]}")
        for (id, iteration), links in self.estimates.items():
            answer = client.get(f"/api/v1/sessions/{id}/estimate", params={"iteration": iteration})
            if answer.status_code != 200 or json.dumps(answer.json()["links"]) != links:
                self.broken.append(
                    f"session {id}: the estimate of iteration {iteration} reads otherwise: {answer.status_code}, told "
                    f"were the links {links}, now {answer.text}"
                )

    def _nothing_is_back(self, listed: dict[str, dict[str, dict[str, object]]]) -> None:
        for kind, gone in self.gone.items():
            self.broken += [f"{kind}/{id} is back: its deletion was acknowledged" for id in gone & set(listed[kind])]

    def _no_ghosts(self, client: httpx.Client, listed: dict[str, dict[str, dict[str, object]]]) -> None:
        """Whatever is listed can be used, also where no answer ever named it."""
        for id, entry in listed["sessions"].items():
            answer = client.get(f"/api/v1/sessions/{id}/estimate")
            if entry["state"] == "failed" or entry["iteration"] is None or answer.status_code != 200:
                self.broken.append(
                    f"session {id} is a ghost: {entry['state']}, iteration {entry['iteration']}, {entry['error']}; its "
                    f"estimate {answer.status_code} {answer.text[:120]}"
                )
                client.delete(f"/api/v1/sessions/{id}")
                self._forget("sessions", id)
        for id in listed["recordings"]:
            answer = client.get(f"/api/v1/sessions/{id}/estimate")
            if answer.status_code != 200:
                self.broken.append(f"recording {id} is a ghost: {answer.status_code} {answer.text[:200]}")

    def _once_each(self, client: httpx.Client, listed: dict[str, dict[str, dict[str, object]]]) -> None:
        """Calls without an answer, sent again: each has made one entry, the one that the answer names."""
        for call in list(self.sent.values()):
            self.counts["makings in flight"] += 1
            before = [id for id, entry in listed[call.kind].items() if _name(entry) == call.name]
            self.counts["of them stored at the kill"] += bool(before)
            id = self.make(client, call)
            if id is None:
                continue  # what it stands on was deleted
            after = [entry["id"] for entry in client.get(f"/api/v1/{call.kind}").json() if _name(entry) == call.name]
            if after != [id]:
                self.broken.append(
                    f"one key made {len(after)} {call.kind}: {after}, of which {before} were there before the call was "
                    f"sent again and answered {id}"
                )
                for other in set(after) - {id}:
                    client.delete(f"/api/v1/{call.kind}/{other}")
        self.sent.clear()


def _name(entry: dict[str, object]) -> object:
    return entry.get("name") if "state" in entry else entry.get("file_name")
