"""Does the server answer as its OpenAPI document says, and does the document say enough?"""

from __future__ import annotations

from collections.abc import Iterator
from html.parser import HTMLParser
from typing import Any

import pytest

from tests.app.openapi_calls import exercise, listen, sample

EXAMPLES = 2


@pytest.fixture(scope="module")
def document(shared: Any) -> dict[str, Any]:
    found: dict[str, Any] = shared.client.get("/openapi.json").json()
    return found


def operations(document: dict[str, Any]) -> Iterator[tuple[str, dict[str, Any]]]:
    for path, entry in document["paths"].items():
        for method, operation in entry.items():
            yield f"{method.upper()} {path}", operation


def test_answers_are_as_described(shared: Any) -> None:
    """A few calls of each kind for each operation, from a fixed seed; the script makes thousands."""
    known = sample(shared.client)
    made = exercise(shared.url, known, EXAMPLES)
    assert made.total() > 100
    listen(shared.client, known()["session_id"])


def test_every_operation_is_described(document: dict[str, Any]) -> None:
    names = []
    for label, operation in operations(document):
        assert operation.get("summary"), f"{label} has no summary"
        assert operation.get("description"), f"{label} has no description"
        assert operation.get("tags"), f"{label} has no tag"
        names.append(operation["operationId"])
        for parameter in operation.get("parameters", []):
            assert parameter.get("description"), f"{label}: parameter {parameter['name']} has no description"
        for status, answer in operation["responses"].items():
            assert answer.get("description"), f"{label}: answer {status} has no description"
    assert len(names) == len(set(names))


def test_every_field_is_described(document: dict[str, Any]) -> None:
    missing = [
        f"{name}.{field}"
        for name, schema in document["components"]["schemas"].items()
        for field, entry in schema.get("properties", {}).items()
        if not entry.get("description") and "$ref" not in entry  # what it refers to has its own
    ]
    assert not missing


def test_every_failure_is_a_problem(document: dict[str, Any]) -> None:
    for label, operation in operations(document):
        for status, answer in operation["responses"].items():
            if int(status) >= 400:
                assert list(answer["content"]) == ["application/problem+json"], f"{label}: answer {status}"
        assert {"401", "429", "500"} <= set(operation["responses"]), label


def test_every_reference_leads_somewhere(document: dict[str, Any]) -> None:
    def references(node: Any) -> Iterator[str]:
        if isinstance(node, dict):
            for key, value in node.items():
                if key == "$ref":
                    yield value
                else:
                    yield from references(value)
        elif isinstance(node, list):
            for value in node:
                yield from references(value)

    for reference in set(references(document)):
        node: Any = document
        for step in reference.removeprefix("#/").split("/"):
            assert step in node, reference
            node = node[step]


def test_every_call_of_the_contract_is_there(document: dict[str, Any]) -> None:
    session = "/api/v1/sessions/{session_id}"
    wanted = {
        "GET /healthz",
        "GET /readyz",
        "GET /metrics",
        "GET /api/v1/settings",
        *(f"{method} /api/v1/{kind}" for kind in ("models", "scans", "sessions") for method in ("GET", "POST")),
        *(f"{method} /api/v1/models/{{model_id}}" for method in ("GET", "DELETE")),
        *(f"{method} /api/v1/scans/{{scan_id}}" for method in ("GET", "DELETE")),
        *(f"{method} {session}" for method in ("GET", "DELETE", "PATCH")),
        *(f"POST {session}/{verb}" for verb in ("run", "step", "pause", "reset", "scans")),
        *(f"GET {session}/{what}" for what in ("estimate", "estimate.png", "trace", "decision", "events", "recording")),
        f"GET {session}/beliefs/{{link}}",
        f"GET {session}/messages/{{sender}}/{{receiver}}",
        "POST /api/v1/recordings",
    }
    assert not wanted - {label for label, _ in operations(document)}


class Outline(HTMLParser):
    """What is linked, what can be linked to, and whether every tag is closed."""

    VOID = ("meta", "link", "br", "img")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: set[str] = set()
        self.links: set[str] = set()
        self.text: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        members = dict(attrs)
        assert tag != "script"
        self.ids |= {members["id"] or ""} & set(members.values()) if "id" in members else set()
        self.links |= {members["href"] or ""} if "href" in members else set()
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text.append(data)


def test_the_page_shows_every_operation(shared: Any, document: dict[str, Any]) -> None:
    outline = Outline()
    outline.feed(shared.client.get("/docs").text)
    assert outline.open == []
    text = " ".join("".join(outline.text).split())
    for label, operation in operations(document):
        assert label in text and operation["summary"].split("`")[0].strip() in text
    inside = {link.removeprefix("#") for link in outline.links if link.startswith("#")}
    assert inside and inside <= outline.ids
    assert not [link for link in outline.links if "://" in link]


def test_settings_are_those_of_the_library(shared: Any) -> None:
    from dataclasses import fields

    from pmpnbp.settings import Settings, preset

    answer = shared.client.get("/api/v1/settings").json()
    found = {entry["name"]: entry for entry in answer["settings"]}
    assert list(found) == [entry.name for entry in fields(Settings)]
    for name, entry in found.items():
        assert entry["default"] == getattr(preset("robust"), name)
        assert entry["paper"] == getattr(preset("paper"), name)
        assert type(entry["default"]) is type(getattr(preset("robust"), name))
        assert entry["help"] and entry["kind"] in ("boolean", "integer", "number", "string")
    assert found["renderer"]["choices"] == ["splats", "rasteriser"]
    assert found["tolerance_end"]["unit"] == "m"
