"""How does a call fail? As `application/problem+json` (RFC 9457), one sentence in `detail`, never a traceback.

Routes raise HttpProblem, or let the library's PmpnbpError pass (422); `install` sees to the rest. `responses` documents
the statuses of a route.
"""

from __future__ import annotations

import http
import json
import logging
from collections.abc import Mapping, Sequence
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException
from starlette.responses import Response
from starlette.routing import Match
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from pmpnbp.errors import DamageError, IterationError, PmpnbpError, RecordingError, StorageError

MEDIA_TYPE = "application/problem+json"

# Of what is wrong in a request, so many are told one by one.
MOST_TOLD = 3
NESTED_TOO_DEEPLY = "the body is not JSON that this server reads: its brackets are nested too deeply"

_log = logging.getLogger("pmpnbp.server")

# What a status means here, in the words of the document at /docs.
MEANINGS: Mapping[int, str] = {
    400: "The request is malformed.",
    401: "The token is missing or wrong.",
    403: "The request comes from a page of another origin, or names another host.",
    404: "It is not here; the detail says what there is.",
    405: "The path is here, but not for this method.",
    408: "The body came too slowly.",
    409: "The present state does not allow it; the detail names the state.",
    413: "Larger than this server takes.",
    415: "The body is of another media type than the call takes, or has a Content-Encoding.",
    416: "The range is beyond the file's end.",
    422: "Well-formed, but not acceptable; the detail says what came and what was expected.",
    429: "Too many requests, sessions or clients; try again after `Retry-After` seconds.",
    500: "A fault of the server.",
    503: "Not ready yet.",
    507: "The data directory is full or cannot be written, or memory does not suffice; nothing was changed.",
}

# Errors of the library that are not the caller's input, which all others are: 422. The first that fits counts.
_STATUSES: Mapping[type[PmpnbpError], int] = {
    IterationError: 404,
    DamageError: 409,
    StorageError: 507,
    RecordingError: 409,
}


class Problem(BaseModel):
    """The body of every failed call, RFC 9457."""

    type: str = Field("about:blank", description="URI of the kind of problem; about:blank: the status says it all")
    title: str = Field(description="the kind of problem, in a few words", examples=["Not Found"])
    status: int = Field(description="the HTTP status once more", examples=[404], ge=400, le=599)
    detail: str = Field(
        description="one sentence: what came, what was expected, what is available",
        examples=["session 'x' is not here; there are 2 sessions"],
    )


class HttpProblem(Exception):
    """A call that cannot be done. `detail` is one sentence, fit to be shown to a user as it stands."""

    def __init__(self, status: int, detail: str, *, headers: Mapping[str, str] | None = None) -> None:
        super().__init__(detail)
        self.status = status
        self.detail = detail
        self.headers = dict(headers or {})


def problem_response(problem: HttpProblem) -> Response:
    """`problem` as a response."""
    title = http.HTTPStatus(problem.status).phrase
    body = {"type": "about:blank", "title": title, "status": problem.status, "detail": problem.detail}
    text = json.dumps(body, ensure_ascii=False, allow_nan=False)
    # "replace": half a surrogate pair in what came must not break the answer that quotes it
    return Response(text.encode("utf-8", "replace"), problem.status, problem.headers, MEDIA_TYPE)


def responses(*statuses: int, **details: str) -> dict[int | str, dict[str, Any]]:
    """Documentation of failures for a route: `responses=responses(404, 409)`.

    Statuses that every call can have (`documentation.COMMON`) are added by the server. A meaning of a route's own goes
    into `details`: `responses(404, status_409="the session is running")`.
    """
    texts = {status: MEANINGS.get(status, http.HTTPStatus(status).phrase) for status in statuses}
    texts |= {int(name.removeprefix("status_")): text for name, text in details.items()}
    content = {MEDIA_TYPE: {"schema": {"$ref": "#/components/schemas/Problem"}}}
    return {status: {"description": text, "content": content} for status, text in sorted(texts.items())}


def install(app: FastAPI) -> None:
    """Make every failure of `app` a problem."""
    app.add_exception_handler(HttpProblem, _of_problem)
    app.add_exception_handler(PmpnbpError, _of_bad_input)
    app.add_exception_handler(RequestValidationError, _of_validation)
    app.add_exception_handler(HTTPException, _of_http_exception)
    app.add_middleware(Unexpected)


class Unexpected:
    """Turns what nobody expected into a 500 and a line in the log; the client learns nothing of the inside."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on; answer 500 where the response had not begun."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        begun = False

        async def watched(message: Message) -> None:
            nonlocal begun
            begun = True
            await send(message)

        try:
            await self._app(scope, receive, watched)
        except Exception:
            _log.exception("%s %s failed", scope["method"], scope["path"])
            if begun:
                raise  # half an answer is out: the server can only break the connection
            await problem_response(HttpProblem(500, "internal error"))(scope, receive, send)


def _of_problem(request: Request, error: Exception) -> Response:
    assert isinstance(error, HttpProblem)
    return problem_response(error)


def _of_bad_input(request: Request, error: Exception) -> Response:
    status = next((status for kind, status in _STATUSES.items() if isinstance(error, kind)), 422)
    return problem_response(HttpProblem(status, str(error)))


def _of_http_exception(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    detail = str(error.detail)
    if error.status_code == 404 and detail == "Not Found":
        detail = f"nothing is at '{request.url.path}'; the calls are described at /docs"
    elif error.status_code == 405:
        allowed = ", ".join(_methods(request))
        detail = f"'{request.url.path}' does not take {request.method}; it takes {allowed}"
        return problem_response(HttpProblem(405, detail, headers={"Allow": allowed}))
    elif isinstance(error.__cause__, RecursionError):
        detail = NESTED_TOO_DEEPLY
    elif isinstance(error.__cause__, UnicodeDecodeError):
        detail = "the body is not JSON that this server reads: it is not text in UTF-8"
    elif isinstance(error.__cause__, ValueError) and "digits" in str(error.__cause__):
        detail = "the body is not JSON that this server reads: a number in it has thousands of digits"
    return problem_response(HttpProblem(error.status_code, detail, headers=error.headers))


def _methods(request: Request) -> list[str]:
    """Those that the path takes: its routes are separate, and each knows its own."""
    taken = [
        method
        for method in ("DELETE", "GET", "PATCH", "POST", "PUT")
        if any(route.matches({**request.scope, "method": method})[0] is Match.FULL for route in request.app.routes)
    ]
    return sorted([*taken, *(["HEAD"] if "GET" in taken else [])])


def _of_validation(request: Request, error: Exception) -> Response:
    assert isinstance(error, RequestValidationError)
    if isinstance(error.body, bytes):  # not parsed, as its media type is another
        kind = request.headers.get("content-type") or "of no type"
        return problem_response(HttpProblem(415, f"the body is {kind:.60}; expected application/json"))
    errors = error.errors()
    first = errors[0]
    if first["type"] == "json_invalid":
        reason = first.get("ctx", {}).get("error", "it does not parse")
        return problem_response(HttpProblem(400, f"the body is not JSON: {reason}"))
    told = "; ".join(f"{_place(one['loc'])}: {_reason(one)}" for one in errors[:MOST_TOLD])
    more = len(errors) - MOST_TOLD
    also = f"; and {more} more like this" if more > 0 else ""
    return problem_response(HttpProblem(422, f"{told}{also}"))


def _place(location: Sequence[int | str]) -> str:
    """("body", "roi", 2) as `roi[2] in the body`."""
    where, *path = location
    name = "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path).lstrip(".")
    return f"{name} in the {where}" if name else f"the {where}"


def _reason(error: Mapping[str, Any]) -> str:
    text = str(error["msg"]).removeprefix("Value error, ")
    text = text[:1].lower() + text[1:]
    given = error.get("input")
    return f"{text}, not {given!r}" if isinstance(given, int | float | str) and len(str(given)) <= 80 else text
