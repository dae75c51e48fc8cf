"""Calls made up from the OpenAPI document, valid and not, and what is wrong with the answers.

The test suite makes a few for each operation; as a script it makes as many as it is told to, and holds the server's
memory and what was stored before against how they were: `python -m tests.app.openapi_calls --url
http://127.0.0.1:8080 --calls 10000`. What is stored there stays; what the calls make is removed.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Mapping, Set
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import schemathesis
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as seeded
from hypothesis.errors import Unsatisfiable
from schemathesis import Case, GenerationMode
from schemathesis.checks import not_a_server_error
from schemathesis.core.failures import FailureGroup
from schemathesis.specs.openapi.checks import (
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
    status_code_conformance,
)

from tests.app.upload_attack import memory

CHECKS = [
    not_a_server_error,
    status_code_conformance,
    content_type_conformance,
    response_headers_conformance,
    response_schema_conformance,
]
CABINET = Path(__file__).resolve().parents[2] / "sample_data" / "cabinet"
# Of a run or a step: what is asked is the answer's form, not the machine's patience.
FEW_ITERATIONS = 2
EVENTS = "text/event-stream"
# Sessions first, as they use the others.
KINDS = ("sessions", "models", "scans", "recordings")
# Calls of each kind for each operation in a round of the script; memory's growth that it allows.
EXAMPLES = 25
MIB = 1 << 20
MOST_GROWTH = 100 * MIB


def exercise(
    url: str,
    known: Callable[[], Mapping[str, str]],
    examples: int,
    seed: int = 0,
    wrong: Callable[[str], object] | None = None,
) -> Counter[str]:
    """Make up to `examples` calls of each kind for each operation; how many were made, by operation.

    known : makes what the path parameters can name, and returns their values, before each kind of call
    wrong : told of each answer that is not as the document says; without it the first raises schemathesis' FailureGroup
    """
    schema = schemathesis.openapi.from_url(f"{url}/openapi.json")
    made: Counter[str] = Counter()
    for found in schema.get_all_operations():
        operation = found.ok()
        label = f"{operation.method.upper()} {operation.path}"
        if EVENTS in json.dumps(operation.definition.raw.get("responses", {})):
            continue  # an answer without an end; `listen` asks for it
        names = [part[1:-1] for part in operation.path.split("/") if part.startswith("{")]
        for mode in (GenerationMode.POSITIVE, GenerationMode.NEGATIVE):
            for given_names in (True, False) if names else (False,):
                values = known()
                path = {name: values[name] for name in names if name in values} if given_names else {}
                if mode is GenerationMode.NEGATIVE and not _can_be_wrong(operation):
                    continue
                made[label] += _some(operation, mode, path, url, examples, seed, wrong)
    return made


def _can_be_wrong(operation: Any) -> bool:
    """Whether a call can break what the document asks for: not where it asks for nothing but any text in the path.
    Without this answer such calls are sought for, hundreds of times over for each operation."""
    parts = [*operation.query, *operation.headers, *operation.cookies, *operation.body]
    limits = {"pattern", "format", "enum", "const", "minLength", "maxLength"}
    schemas = [parameter.definition["schema"] for parameter in operation.path_parameters]
    return bool(parts) or any(schema.get("type") != "string" or limits & set(schema) for schema in schemas)


def _some(
    operation: Any,
    mode: GenerationMode,
    path: Mapping[str, str],
    url: str,
    examples: int,
    seed: int,
    wrong: Callable[[str], object] | None,
) -> int:
    waits = any(parameter.name == "timeout" for parameter in operation.query)
    options: dict[str, Any] = {"path_parameters": dict(path)} if path else {}
    if waits:
        options["query"] = {"timeout": 0}
    count = 0

    @seeded(seed)
    @settings(
        max_examples=examples,
        deadline=None,
        database=None,
        derandomize=False,
        phases=[Phase.explicit, Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(operation.as_strategy(generation_mode=mode, **options))
    def call(case: Case) -> None:
        nonlocal count
        _be_brief(case)
        response = case.call(base_url=url, timeout=120)
        count += 1
        try:
            case.validate_response(response, checks=CHECKS)
        except FailureGroup as failures:
            if wrong is None:
                raise
            told = "; ".join(str(failure).splitlines()[0] for failure in failures.exceptions)
            wrong(f"{case.method} {case.formatted_path[:120]}: {response.status_code}: {told}; {str(case.body)[:200]}")

    with suppress(Unsatisfiable):  # nothing about this operation can be wrong
        call()
    return count


def _be_brief(case: Case) -> None:
    body = case.body
    if case.operation.path.endswith(("/run", "/step")) and isinstance(body, dict):
        iterations = body.get("iterations")
        if isinstance(iterations, int) and not isinstance(iterations, bool) and iterations > FEW_ITERATIONS:
            body["iterations"] = FEW_ITERATIONS
    if case.operation.path.endswith("/sample") and isinstance(body, dict) and isinstance(body.get("run", True), bool):
        body["run"] = False


def sample(client: httpx.Client, stay: Set[str] = frozenset()) -> Callable[[], dict[str, str]]:
    """A function that sees to it that there are a model, a scan, a recording and a fresh session of a cabinet, and
    nothing else but the entries that `stay`, by their ids."""
    kept: dict[str, str] = {}
    config = {"image_width": 80, "triangles": 60, "search_iterations": 1, "search_proposals": 100, "search_islands": 1}
    model = CABINET / "cabinet.urdf"
    scan = CABINET / "open"

    def upload(kind: str, path: Path, **fields: str) -> str:
        answer = client.post(f"/api/v1/{kind}", files={"file": (path.name, path.read_bytes())}, data=fields)
        assert answer.status_code == 201, answer.text
        return str(answer.json()["id"])

    def fresh() -> bool:
        if not kept:
            return False
        kinds = {"model_id": "models", "scan_id": "scans", "recording_id": "recordings", "session_id": "sessions"}
        answers = {name: client.get(f"/api/v1/{kind}/{kept[name]}") for name, kind in kinds.items()}
        if any(answer.status_code != 200 for answer in answers.values()):
            return False
        session = answers["session_id"].json()
        return bool(
            session["state"] == "paused"
            and session["config"] == config
            and 1 <= session["iteration"] < 50
            and session["scan_ids"] == [kept["scan_id"]]
        )

    def make() -> dict[str, str]:
        if fresh():
            return kept
        for kind in KINDS:
            for entry in client.get(f"/api/v1/{kind}").json():
                if entry["id"] not in stay:
                    client.delete(f"/api/v1/{kind}/{entry['id']}")
        known = {
            "model_id": upload("models", model),
            "scan_id": upload("scans", scan / "depth.png", camera=(scan / "camera.json").read_text(encoding="utf-8")),
        }
        body = {
            "model_id": known["model_id"],
            "scan_ids": [known["scan_id"]],
            "particles": 20,
            "roi": json.loads((scan / "roi.json").read_text(encoding="utf-8"))["roi"],
            "config": config,
        }
        answer = client.post("/api/v1/sessions", json=body)
        assert answer.status_code == 201, answer.text
        known["session_id"] = answer.json()["id"]
        step = client.post(f"/api/v1/sessions/{known['session_id']}/step", json={"iterations": 1})
        assert step.status_code == 200, step.text
        with tempfile.TemporaryDirectory() as folder:
            recording = Path(folder) / "recording.sqlite"
            recording.write_bytes(client.get(f"/api/v1/sessions/{known['session_id']}/recording").content)
            known["recording_id"] = upload("recordings", recording)
        kept.update(known | {"link": "drawer1", "sender": "frame", "receiver": "drawer1"})
        return kept

    return make


def listen(client: httpx.Client, session_id: str) -> None:
    """Ask for events as programs might; the answer begins at once, or is a problem."""
    for last in (None, b"0", b"5", b"-1", b"x", b"9" * 40, b"\xc3\xa9"):
        headers = {} if last is None else {b"Last-Event-ID": last}
        with client.stream("GET", f"/api/v1/sessions/{session_id}/events", headers=headers) as answer:
            assert answer.status_code in (200, 422), answer.status_code
            kind = answer.headers["content-type"].split(";")[0]
            assert kind == (EVENTS if answer.status_code == 200 else "application/problem+json")


def main() -> int:
    """Make at least `--calls` calls against a server that runs; print how many of each, and what was wrong."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("--calls", type=int, default=2000)
    parser.add_argument("--url", required=True, help="of a server that iterates for nobody meanwhile")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    wrong: Counter[str] = Counter()
    began = time.monotonic()
    with httpx.Client(base_url=arguments.url, timeout=None) as client:
        _store_some(client)
        before = stored(client)
        known = sample(client, before.keys())
        listen(client, known()["session_id"])
        # what the first calls make a process load is no growth
        made = exercise(arguments.url, known, 2, arguments.seed, lambda told: wrong.update([told]))
        memory_before = memory(client)
        while made.total() < arguments.calls:
            seed = arguments.seed + made.total()
            made += exercise(arguments.url, known, EXAMPLES, seed, lambda told: wrong.update([told]))
            seconds, grown = time.monotonic() - began, (memory(client) - memory_before) / MIB
            say(f"{made.total()} calls in {seconds:.0f} s, {wrong.total()} wrong; memory grew by {grown:.0f} MiB")
        known()
        _remove(client, before.keys())
        grown = memory(client) - memory_before
        if grown > MOST_GROWTH:
            wrong[f"the server's memory grew by {grown / MIB:.0f} MiB"] += 1
        after = stored(client)
        wrong.update(f"entry {id} is not as it was" for id in before if after.get(id) != before[id])
    for label, count in sorted(made.items()):
        say(f"{count:6d}  {label}")
    for told, count in wrong.most_common(50):
        say(f"{count} × {told}")
    say(f"{made.total()} calls in {time.monotonic() - began:.0f} s, {wrong.total()} things wrong")
    return int(bool(wrong))


def stored(client: httpx.Client) -> dict[str, Any]:
    """What the server says of each of its entries, and of a session's or recording's estimate, by id."""
    found: dict[str, Any] = {}
    for kind in KINDS:
        for entry in client.get(f"/api/v1/{kind}").raise_for_status().json():
            document = client.get(f"/api/v1/{kind}/{entry['id']}").json()
            if kind == "recordings":
                document.pop("name")  # which calls may change
            if kind in ("sessions", "recordings"):
                document["estimate"] = client.get(f"/api/v1/sessions/{entry['id']}/estimate?iteration=1").json()
            found[entry["id"]] = document
    return found


def _store_some(client: httpx.Client) -> None:
    """One of each kind, so that there is something that has to stay."""
    if not client.get("/api/v1/recordings").raise_for_status().json():
        sample(client, stored(client).keys())()


def _remove(client: httpx.Client, stay: Set[str]) -> None:
    for kind in KINDS:
        for entry in client.get(f"/api/v1/{kind}").raise_for_status().json():
            if entry["id"] not in stay:
                client.delete(f"/api/v1/{kind}/{entry['id']}")


def say(line: str) -> None:
    """A line, at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
