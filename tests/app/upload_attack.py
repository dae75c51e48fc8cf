"""Send damaged uploads to a running server, three thousand of them, and see how it takes them.

    python -m tests.app.upload_attack http://127.0.0.1:8080 --count 3000 [--token TOKEN]

Each answer has to be 201 or a problem+json below 500, in under 15 s, and what was taken in, and every list, has to read
as its schema says, of a recording its estimates, trace and beliefs, too; the server has to live on, to grow by less
than 100 MB, and to keep what was stored before as it was.
"""

from __future__ import annotations

import argparse
import random
import re
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import httpx
from pydantic import BaseModel, ValidationError

from app.schemas import Session
from app.schemas_particles import Graph, ParticleReasons
from app.schemas_results import BeliefParticles, Estimate, MessageParticles, Trace
from tests.app.mutations import Sample, cut, flip_early, mutations, put_in, repeat, samples, take_out, trick

LONGEST_ANSWER = 15.0
MOST_GROWTH = 100 << 20


@dataclass
class Outcome:
    """What a server did. statuses : answers by status; failures : a sentence each; growth : of its memory, bytes;
    slowest : answer, seconds."""

    statuses: Counter[int] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)
    growth: int = 0
    slowest: float = 0.0


def send(client: httpx.Client, sample: Sample) -> httpx.Response:
    """Upload `sample`."""
    data = {} if sample.camera is None else {"camera": sample.camera}
    return client.post(f"/api/v1/{sample.kind}", files={"file": (sample.file_name, sample.content)}, data=data)


def send_form(client: httpx.Client, rng: random.Random, sample: Sample) -> httpx.Response:
    """Upload `sample` as a form that is itself damaged."""
    request = client.build_request("POST", f"/api/v1/{sample.kind}", files={"file": (sample.file_name, sample.content)})
    body = replace(sample, content=request.read(), camera=None)
    damaged = rng.choice((flip_early, cut, put_in, take_out, repeat, trick))(rng, body).content
    return client.post(
        f"/api/v1/{sample.kind}", content=damaged, headers={"Content-Type": request.headers["Content-Type"]}
    )


def objection(answer: httpx.Response) -> str | None:
    """What is wrong with an answer; None where it is as it has to be."""
    seconds = answer.elapsed.total_seconds()
    if seconds >= LONGEST_ANSWER:
        return f"answered after {seconds:.1f} s"
    if answer.status_code == 201:
        return None if answer.json()["id"] else "201 without an id"
    if not 400 <= answer.status_code < 500:
        return f"answered {answer.status_code}: {answer.text[:200]}"
    if answer.headers["Content-Type"] != "application/problem+json":
        return f"answered {answer.status_code} as {answer.headers['Content-Type']}"
    detail = answer.json()["detail"]
    unnamed = re.sub("'[^']*'", "", detail)  # an upload may be called anything.py
    if not detail or "Traceback" in detail or re.search(r"/(tmp|home|root|work|var)/|site-packages", detail):
        return f"says {detail!r}"
    if re.search(r"\.py\b", unnamed):
        return f"says {detail!r}"
    return None


# What is asked of a recording that was taken in, and what the answer has to be.
_READS: tuple[tuple[str, type[BaseModel] | None], ...] = (
    ("", Session),
    ("/estimate", Estimate),
    ("/estimate?iteration=0", Estimate),
    ("/estimate?iteration=3", Estimate),
    ("/trace", Trace),
    ("/graph", Graph),
    ("/beliefs/frame", BeliefParticles),
    ("/beliefs/drawer1?iteration=5", BeliefParticles),
    ("/beliefs/frame/particles/3", ParticleReasons),
    ("/messages/frame/drawer1", MessageParticles),
)


def objections_to_reads(client: httpx.Client, kind: str, id: str) -> list[str]:
    """What is wrong with the answers about an entry that was taken in, and about all of its kind."""
    calls: list[tuple[str, type[BaseModel] | None]] = [(f"/api/v1/{kind}", None), (f"/api/v1/{kind}/{id}", None)]
    if kind == "recordings":
        calls += [(f"/api/v1/sessions/{id}{call}", schema) for call, schema in _READS]
    found = []
    for call, schema in calls:
        answer = client.get(call)
        wrong = None
        if answer.status_code == 200 and schema is not None:
            try:
                schema.model_validate_json(answer.content)
            except ValidationError as error:
                wrong = f"is no {schema.__name__}: {error.errors()[0]}"
        elif answer.status_code not in (200, 503):
            wrong = objection(answer)
        if wrong is not None:
            found.append(f"GET {call.replace(id, 'ID')} {wrong}")
    return found


def memory(client: httpx.Client) -> int:
    """Bytes that the server's process holds, by its own metrics."""
    found = re.search(r"^pmpnbp_resident_memory_bytes (\S+)$", client.get("/metrics").text, re.MULTILINE)
    assert found is not None, "the metrics do not tell the memory"
    return int(float(found[1]))


def attack(client: httpx.Client, count: int, seed: int, say: Callable[[str], None] = lambda line: None) -> Outcome:
    """Send `count` damaged uploads, some as damaged forms; those that were taken in are deleted again."""
    rng = random.Random(seed)
    outcome = Outcome()
    before = {}
    for sample in samples():
        answer = send(client, sample)
        if answer.status_code != 201:
            outcome.failures.append(f"valid {sample.file_name} was answered {answer.status_code}: {answer.text}")
            return outcome
        before[f"/api/v1/{sample.kind}/{answer.json()['id']}"] = answer.json()
        outcome.failures += objections_to_reads(client, sample.kind, answer.json()["id"])
    source = mutations(rng)
    for _ in range(20):  # what the first calls make a process load is no growth
        send(client, next(source))
    began = memory(client)
    for number in range(count):
        sample = next(source)
        as_form = rng.random() < 0.1
        try:
            answer = send_form(client, rng, sample) if as_form else send(client, sample)
            wrong = objection(answer)
        except (httpx.HTTPError, ValueError, KeyError) as error:
            wrong = f"{type(error).__name__}: {error}"
            answer = None
        if wrong is not None:
            outcome.failures.append(f"upload {number} ({sample.file_name[:40]}, {', '.join(sample.done)}) {wrong}")
        if answer is not None:
            outcome.statuses[answer.status_code] += 1
            outcome.slowest = max(outcome.slowest, answer.elapsed.total_seconds())
            if answer.status_code == 201:
                wrongs = objections_to_reads(client, sample.kind, answer.json()["id"])
                outcome.failures += [f"upload {number} ({', '.join(sample.done)}): {wrong}" for wrong in wrongs]
                client.delete(f"/api/v1/{sample.kind}/{answer.json()['id']}")
        if number % 200 == 199:
            grown = (memory(client) - began) >> 20
            say(f"{number + 1}: {dict(outcome.statuses)}, {len(outcome.failures)} failures, {grown} MiB more")
    outcome.growth = memory(client) - began
    if outcome.growth >= MOST_GROWTH:
        outcome.failures.append(f"the server grew by {outcome.growth >> 20} MiB")
    if client.get("/healthz").status_code != 200:
        outcome.failures.append("the server is not alive")
    for path, document in before.items():
        if client.get(path).json() != document:
            outcome.failures.append(f"{path} is not what it was")
    return outcome


def main(words: Sequence[str] | None = None) -> int:
    """Attack the server that the command line names; 0 where it did well."""
    parser = argparse.ArgumentParser(description="Send damaged uploads to a server.")
    parser.add_argument("url")
    parser.add_argument("--count", type=int, default=3000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--token")
    arguments = parser.parse_args(words)
    headers = {} if arguments.token is None else {"Authorization": f"Bearer {arguments.token}"}
    began = time.monotonic()
    with httpx.Client(base_url=arguments.url, headers=headers, timeout=60) as client:
        outcome = attack(client, arguments.count, arguments.seed, lambda line: print(line, flush=True))
    for failure in outcome.failures[:50]:
        print(failure)
    print(
        f"{sum(outcome.statuses.values())} answers {dict(outcome.statuses)} in {time.monotonic() - began:.0f} s; "
        f"slowest {outcome.slowest:.2f} s; the server grew by {outcome.growth / (1 << 20):.1f} MiB; "
        f"{len(outcome.failures)} failures"
    )
    return 1 if outcome.failures else 0


if __name__ == "__main__":
    sys.exit(main())
