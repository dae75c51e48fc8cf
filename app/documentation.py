"""What can be asked of the server? The OpenAPI document, and the page /docs that shows it without anybody's script."""

from __future__ import annotations

import html
import json
from functools import cache, partial
from typing import Any

from fastapi import FastAPI
from fastapi.openapi.utils import get_openapi
from fastapi.responses import HTMLResponse

from app.problems import Problem, responses

ABOUT = """\
Poses of the links and positions of the joints of an articulated object, from depth scans.

Units: metres, radians, seconds. Frames are right-handed. The camera frame is optical: x right, y down, z forward.
`world` is the frame in which the camera's pose was given, and the camera frame where none was given. A failed call
changes nothing and answers `application/problem+json`. The calls that create, and commands to sessions, take an
`Idempotency-Key`.
"""
TAGS = {
    "models": "Articulated objects: a URDF, or a zip that holds one with its meshes.",
    "scans": "Depth images and point clouds, in the camera frame.",
    "sessions": "An object looked for in scans: create, run, step, pause, change.",
    "results": "What a session has found: estimates, beliefs, messages, decisions.",
    "events": "What happens in a session, as it happens.",
    "views": "3D views: what each shows, and what is clicked and dragged in it.",
    "recordings": "Sessions as files.",
    "settings": "What can be set.",
    "health": "For orchestrators and monitoring.",
}
# Path parameters, where a route does not describe its own.
PARAMETERS = {f"{kind}_id": f"id of the {kind}, 16 hexadecimal digits" for kind in ("model", "scan", "recording")}
# Statuses that every call can answer with, from the middleware in front of the routes.
COMMON = (400, 401, 403, 408, 413, 422, 429, 500)


def answer(description: str, *, status: int = 200, **members: Any) -> dict[int | str, dict[str, Any]]:
    """Documentation of what a call answers that goes well, with other `members` (`model`, `content`, `headers`); to be
    joined with `problems.responses`."""
    return {status: {"description": description, **members}}


BINARY = {"schema": {"type": "string", "format": "binary"}}
PICTURE = answer("The picture.", content={"image/png": BINARY})


def install(app: FastAPI) -> None:
    """Give `app` its OpenAPI document and the page /docs."""

    app.openapi = cache(partial(_document, app))  # type: ignore[method-assign]

    @app.get("/docs", include_in_schema=False)
    def docs() -> HTMLResponse:
        return HTMLResponse(page(app.openapi()))


def _document(app: FastAPI) -> dict[str, Any]:
    found = get_openapi(
        title=app.title,
        version=app.version,
        description=ABOUT,
        routes=app.routes,
        tags=[{"name": name, "description": text} for name, text in TAGS.items()],
    )
    schemas = found.setdefault("components", {}).setdefault("schemas", {})
    schemas["Problem"] = Problem.model_json_schema()
    # FastAPI's own form of a validation error, which `problems` replaces
    schemas.pop("HTTPValidationError", None)
    schemas.pop("ValidationError", None)
    found["components"]["securitySchemes"] = {
        "token": {"type": "http", "scheme": "bearer", "description": "needed where the server was given a token"}
    }
    for operations in found["paths"].values():
        for operation in operations.values():
            answers: dict[str, Any] = operation["responses"]
            if "HTTPValidationError" in json.dumps(answers.get("422", {})):
                del answers["422"]
            takes_json = "application/json" in operation.get("requestBody", {}).get("content", {})
            for status, answer in responses(*COMMON, *((415,) if takes_json else ())).items():
                answers.setdefault(str(status), answer)
            for parameter in operation.get("parameters", []):
                parameter.setdefault("description", PARAMETERS.get(parameter["name"], ""))
            if "description" in operation:  # a route's docstring, whose lines end where the source's do
                operation["description"] = " ".join(operation["description"].split())
            operation["security"] = [{}, {"token": []}]
    return found


def page(document: dict[str, Any]) -> str:
    """The document as one page of HTML."""
    groups: dict[str, list[str]] = {}
    for path, operations in document["paths"].items():
        for method, operation in operations.items():
            groups.setdefault(operation.get("tags", ["other"])[0], []).append(_operation(method, path, operation))
    order = sorted(groups, key=lambda tag: list(TAGS).index(tag) if tag in TAGS else len(TAGS))
    contents = "".join(f'<li><a href="#{tag}">{tag}</a></li>' for tag in order)
    parts = "".join(
        f'<section><h2 id="{tag}">{tag}</h2><p>{_text(TAGS.get(tag, ""))}</p>{"".join(groups[tag])}</section>'
        for tag in order
    )
    schemas = "".join(
        f'<details id="schema-{name}"><summary><code>{name}</code></summary>{_fields(schema)}</details>'
        for name, schema in sorted(document["components"]["schemas"].items())
    )
    about = "".join(f"<p>{_text(text)}</p>" for text in document["info"]["description"].split("\n\n"))
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><title>pmpnbp: REST</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<link rel="icon" href="/static/icon.svg" type="image/svg+xml">'
        '<link rel="stylesheet" href="/static/style.css"></head><body class="docs"><header><a class="home" href="/">'
        f'pmpnbp</a><nav aria-label="Calls"><ul>{contents}</ul></nav></header><main><h1>REST, version '
        f'{_text(document["info"]["version"])}</h1>{about}<p>The same for programs: <a href="/openapi.json">'
        f'openapi.json</a>.</p>{parts}<section><h2 id="schemas">schemas</h2>{schemas}</section></main></body></html>'
    )


def _operation(method: str, path: str, operation: dict[str, Any]) -> str:
    parameters = "".join(
        f"<tr><td><code>{_text(p['name'])}</code></td><td>{p['in']}</td><td>{_kind(p.get('schema', {}))}</td>"
        f"<td>{_text(p.get('description', ''))}</td></tr>"
        for p in operation.get("parameters", [])
    )
    body = "".join(
        f"<p>Body: <code>{_text(kind)}</code> {_kind(content.get('schema', {}))}</p>"
        for kind, content in operation.get("requestBody", {}).get("content", {}).items()
    )
    answers = "".join(
        f"<tr><td><code>{status}</code></td><td>{_text(answer['description'])}</td><td>{_contents(answer)}</td></tr>"
        for status, answer in sorted(operation["responses"].items())
    )
    return (
        f'<details class="call"><summary><code class="{method}">{method.upper()}</code> <code>{_text(path)}</code> '
        f"<span>{_text(operation.get('summary', ''))}</span></summary>"
        f"<p>{_text(operation.get('description', ''))}</p>"
        + (f"<table><caption>Parameters</caption>{parameters}</table>" if parameters else "")
        + body
        + f"<table><caption>Answers</caption>{answers}</table></details>"
    )


def _contents(answer: dict[str, Any]) -> str:
    found = (f"<code>{_text(k)}</code> {_kind(c.get('schema', {}))}" for k, c in answer.get("content", {}).items())
    return "<br>".join(found)


def _fields(schema: dict[str, Any]) -> str:
    required = schema.get("required", [])
    rows = "".join(
        f"<tr><td><code>{_text(name)}</code></td><td>{_kind(entry)}{'' if name in required else ' (optional)'}</td>"
        f"<td>{_text(entry.get('description', ''))}</td></tr>"
        for name, entry in schema.get("properties", {}).items()
    )
    return f"<p>{_text(schema.get('description', ''))}</p>" + (f"<table>{rows}</table>" if rows else _kind(schema))


def _kind(schema: dict[str, Any]) -> str:
    """A schema in a word, with a link where it has a name."""
    if "$ref" in schema:
        name = schema["$ref"].rsplit("/", 1)[-1]
        return f'<a href="#schema-{name}">{name}</a>'
    if "anyOf" in schema or "oneOf" in schema:
        return " or ".join(_kind(one) for one in schema.get("anyOf", schema.get("oneOf", [])))
    if "enum" in schema:
        return " or ".join(f"<code>{_text(json.dumps(value))}</code>" for value in schema["enum"])
    if schema.get("type") == "array":
        return f"array of {_kind(schema.get('items', {}))}"
    return _text(str(schema.get("const", schema.get("type", "any"))))


def _text(text: str) -> str:
    """`text` as HTML, `code` in backticks as such."""
    parts = html.escape(text).split("`")
    return "".join(f"<code>{part}</code>" if place % 2 else part for place, part in enumerate(parts))
