"""Does every failure become one sentence of problem+json?"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import httpx
import pytest
from fastapi import FastAPI, HTTPException
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, Field

from app import problems
from app.problems import HttpProblem, responses
from pmpnbp.errors import ModelError


class Thing(BaseModel):
    """A body."""

    count: int = Field(ge=1)
    names: list[str] = []


def application() -> FastAPI:
    app = FastAPI()
    problems.install(app)

    @app.get("/problem")
    def problem() -> None:
        raise HttpProblem(507, "the disk is full", headers={"Retry-After": "7"})

    @app.get("/model")
    def model() -> None:
        raise ModelError("joint 'a' of model 'b' has no limits; expected them")

    @app.get("/http")
    def http() -> None:
        raise HTTPException(418, "short and stout")

    @app.get("/fault")
    def fault() -> None:
        raise RuntimeError("the secret is 1234")

    @app.get("/surrogate")
    def surrogate() -> None:
        raise HttpProblem(422, "\ud800 is half a character")

    @app.get("/half")
    def half() -> StreamingResponse:
        async def pieces() -> AsyncIterator[bytes]:
            yield b"half"
            raise RuntimeError("broken off")

        return StreamingResponse(pieces())

    @app.post("/things")
    def things(thing: Thing, limit: int = 3) -> Thing:
        return thing

    return app


def call(method: str, path: str, **options: Any) -> httpx.Response:
    async def do() -> httpx.Response:
        transport = httpx.ASGITransport(application(), raise_app_exceptions=True)
        async with httpx.AsyncClient(transport=transport, base_url="http://test") as client:
            return await client.request(method, path, **options)

    return asyncio.run(do())


def failed(method: str, path: str, expected: int, **options: Any) -> tuple[str, httpx.Response]:
    answer = call(method, path, **options)
    assert answer.status_code == expected
    assert answer.headers["content-type"] == "application/problem+json"
    members = answer.json()
    assert set(members) == {"type", "title", "status", "detail"}
    assert (members["type"], members["status"]) == ("about:blank", expected)
    return members["detail"], answer


def test_a_problem_keeps_its_headers() -> None:
    detail, answer = failed("GET", "/problem", 507)
    assert detail == "the disk is full" and answer.json()["title"] == "Insufficient Storage"
    assert answer.headers["retry-after"] == "7"


def test_bad_input_is_422() -> None:
    assert failed("GET", "/model", 422)[0] == "joint 'a' of model 'b' has no limits; expected them"


def test_other_http_exceptions_are_problems_too() -> None:
    assert failed("GET", "/http", 418)[0] == "short and stout"


def test_a_fault_tells_the_log_and_not_the_client(caplog: pytest.LogCaptureFixture) -> None:
    detail, answer = failed("GET", "/fault", 500)
    assert detail == "internal error" and "1234" not in answer.text
    assert "the secret is 1234" in caplog.text and "GET /fault failed" in caplog.text


def test_a_fault_in_the_middle_breaks_the_answer_off(caplog: pytest.LogCaptureFixture) -> None:
    with pytest.raises(RuntimeError, match="broken off"):
        call("GET", "/half")
    assert "GET /half failed" in caplog.text


def test_half_a_character_can_be_quoted() -> None:
    assert failed("GET", "/surrogate", 422)[0] == "? is half a character"


def test_an_unknown_path_is_named() -> None:
    assert failed("GET", "/nowhere", 404)[0] == "nothing is at '/nowhere'; the calls are described at /docs"


def test_a_wrong_method_says_which_are_right() -> None:
    detail, answer = failed("PUT", "/things", 405)
    assert detail == "'/things' does not take PUT; it takes POST" and answer.headers["allow"] == "POST"


@pytest.mark.parametrize("body", [b"{", b"{'count': 1}", b"", b'{"count": 1,}'])
def test_a_malformed_body_is_400_or_422(body: bytes) -> None:
    expected = 400 if body else 422
    failed("POST", "/things", expected, content=body, headers={"Content-Type": "application/json"})


@pytest.mark.parametrize(
    ("body", "query", "detail"),
    [
        ({"count": 0}, "", "count in the body: input should be greater than or equal to 1, not 0"),
        ({}, "", "count in the body: field required"),
        ({"count": 1, "names": ["a", 2]}, "", "names[1] in the body: input should be a valid string, not 2"),
        (
            {"count": "x", "names": 1},
            "",
            "count in the body: input should be a valid integer, unable to parse string "
            "as an integer, not 'x'; names in the body: input should be a valid list, not 1",
        ),
        (
            {"count": 1, "names": [1, 2, 3, 4, 5]},
            "",
            "names[0] in the body: input should be a valid string, not 1; names[1] in the body: input should be a "
            "valid string, not 2; names[2] in the body: input should be a valid string, not 3; and 2 more like this",
        ),
        (
            {"count": 1},
            "?limit=x",
            "limit in the query: input should be a valid integer, unable to parse string as an integer, not 'x'",
        ),
        ([], "", "the body: input should be a valid dictionary or object to extract fields from"),
    ],
)
def test_a_wrong_body_is_named_by_its_place(body: Any, query: str, detail: str) -> None:
    assert failed("POST", f"/things{query}", 422, json=body)[0] == detail


def test_statuses_are_documented() -> None:
    found = responses(404, 409, status_503="not yet")
    assert list(found) == [404, 409, 503]
    assert found[503]["description"] == "not yet"
    assert all("application/problem+json" in entry["content"] for entry in found.values())
