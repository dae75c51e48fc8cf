"""Does the server do as HTTP has it, where no call of ours says otherwise? HEAD, Allow, entity tags."""

from __future__ import annotations

import re
import socket
from collections import defaultdict
from collections.abc import Callable
from typing import Any

import pytest

from app.routes.start_page import STATIC
from tests.app.openapi_calls import sample
from tests.app.raw_http import connect, everything, head
from tests.app.test_connections import websocket
from tests.app.upload_calls import detail


@pytest.fixture(scope="module")
def known(shared: Any) -> dict[str, str]:
    """What the paths of the document can name."""
    return sample(shared.client)()


def test_head_is_get_without_a_body(shared: Any, known: dict[str, str]) -> None:
    document = shared.client.get("/openapi.json").json()
    paths = [path for path, operations in document["paths"].items() if "get" in operations]
    paths += ["/", "/docs", "/openapi.json", "/static/style.css", "/favicon.ico", f"/sessions/{known['session_id']}/"]
    changing = {"date", "retry-after"}
    names = defaultdict(lambda: "1", known)
    for path in paths:
        place = path.format_map(names)
        head_alone = shared.client.head(place)
        assert head_alone.content == b"", path
        with shared.client.stream("GET", place) as answer:
            if not path.endswith("/events"):
                answer.read()
            assert head_alone.status_code == answer.status_code, path
            assert set(head_alone.headers) - changing == set(answer.headers) - changing, path


def test_head_of_a_stream_of_events_ends(shared: Any, known: dict[str, str]) -> None:
    with connect(shared) as connection:
        connection.sendall(head("HEAD", f"/api/v1/sessions/{known['session_id']}/events", "Connection: close"))
        assert everything(connection).endswith(b"\r\n\r\n")
    while shared.app.state.traffic.connected.all:
        pass


@pytest.mark.parametrize(
    ("method", "path", "allowed"),
    [
        ("PUT", "/api/v1/models", "GET, HEAD, POST"),
        ("PATCH", "/api/v1/models/0123456789abcdef", "DELETE, GET, HEAD"),
        ("PUT", "/api/v1/sessions/x", "DELETE, GET, HEAD, PATCH"),
        ("GET", "/api/v1/sessions/x/run", "POST"),
        ("OPTIONS", "/healthz", "GET, HEAD"),
        ("POST", "/static/style.css", "GET, HEAD"),
    ],
)
def test_a_wrong_method_is_told_all_the_right_ones(shared: Any, method: str, path: str, allowed: str) -> None:
    answer = shared.client.request(method, path)
    assert detail(answer, 405) == f"'{path}' does not take {method}; it takes {allowed}"
    assert answer.headers["Allow"] == allowed


@pytest.mark.parametrize(
    "path", ["/", "/static/style.css", "/static/start/main.js", "/static/fonts/OpenSans-Semibold.ttf"]
)
def test_a_page_file_that_a_browser_has_is_not_sent_again(shared: Any, path: str) -> None:
    first = shared.client.get(path)
    tag = first.headers["ETag"]
    for given in (tag, f"W/{tag}", f'"other", {tag}', "*"):
        again = shared.client.get(path, headers={"If-None-Match": given})
        assert (again.status_code, again.content, again.headers["ETag"]) == (304, b"", tag)
        assert again.headers["Cache-Control"] == "no-cache"
    assert shared.client.get(path, headers={"If-None-Match": '"other"'}).content == first.content


def test_failed_websockets_are_counted_and_not_logged(
    serve: Callable[..., Any], caplog: pytest.LogCaptureFixture
) -> None:
    served = serve(token="secret")
    right = "Authorization: Bearer secret"
    cookie = f"Cookie: {served.app.state.page_cookie.name}={served.app.state.page_cookie.value}"
    tries = (
        ("401", ("Authorization: Bearer wrong",)),
        ("401", ()),
        ("403", (cookie, "Origin: http://example.org")),
        ("404", (right,)),
    )
    for status, lines in tries:
        with connect(served) as connection:
            connection.sendall(websocket("/sessions/none/view/a", *lines))
            assert everything(connection).split()[1] == status.encode()
    text = served.client.get("/metrics").text
    for status, count in (("401", 2), ("403", 1), ("404", 1)):
        assert f'pmpnbp_http_requests_total{{method="WEBSOCKET",status="{status}"}} {count}.0' in text
    assert [record for record in caplog.records if record.name.startswith(("uvicorn", "pmpnbp"))] == []


def test_a_link_can_be_looked_at_first(serve: Callable[..., Any]) -> None:
    """As those do who show what is behind a link that they are sent."""
    served = serve(token="secret")
    with socket.create_connection(("127.0.0.1", served.config.port)) as connection:
        connection.sendall(head("HEAD", "/?token=secret", "Connection: close"))
        assert everything(connection).startswith(b"HTTP/1.1 303")


@pytest.mark.parametrize(
    ("ranges", "status"),
    [("bytes=0-9", 206), ("bytes=5-1", 400), ("bytes=" + "-" * 200, 400), ("bytes=99999999-", 416)],
)
@pytest.mark.parametrize("path", ["/static/style.css", "/api/v1/recordings/{recording_id}/file"])
def test_a_range_that_cannot_be_had_is_a_problem(
    shared: Any, known: dict[str, str], path: str, ranges: str, status: int
) -> None:
    answer = shared.client.get(path.format_map(known), headers={"Range": ranges})
    assert answer.status_code == status
    if status == 206:
        assert len(answer.content) == 10 and answer.headers["content-range"].startswith("bytes 0-9/")
    else:
        assert "expected bytes=FIRST-LAST" in detail(answer, status)
    if status == 416:
        assert answer.headers["content-range"].startswith("bytes */")
    assert shared.client.get(path.format_map(known)).status_code == 200


@pytest.mark.parametrize(("path", "scripts"), [("/", "start"), ("/compare", "compare"), ("/sessions/any/", "session")])
def test_a_page_says_which_scripts_it_will_ask_for(shared: Any, path: str, scripts: str) -> None:
    told = re.findall(r'<link rel="modulepreload" href="([^"]+)">', shared.client.get(path).text)
    assert {file.split("/", 3)[3] for file in told} == {
        f"{scripts}/{file.name}" for file in (STATIC / scripts).glob("*.js")
    }
    for link in told:
        assert shared.client.get(link).status_code == 200


def test_what_the_next_page_needs_is_fetched_meanwhile_except_by_those_who_save_data(shared: Any) -> None:
    def soon(**headers: str) -> set[str]:
        page = shared.client.get("/", headers=headers)
        assert page.headers["vary"] == "Save-Data"
        return {
            path.split("/", 3)[3] for path in re.findall(r'<link rel="prefetch" href="(/static/[^"]+)">', page.text)
        }

    assert soon() == {f"session/{file.name}" for file in (STATIC / "session").glob("*.js")}
    assert soon(**{"Save-Data": "on"}) == set()


def test_what_a_page_asks_for_may_be_kept_for_good_and_nothing_else(shared: Any) -> None:
    page = shared.client.get("/")
    assert page.headers["cache-control"] == "no-cache"
    assert shared.client.get("/", headers={"If-None-Match": page.headers["etag"]}).status_code == 304
    named = re.findall(r'(?:href|src)="(/(?:static|viewer)/[^"]+)"', page.text)
    assert any(path.startswith("/viewer/") for path in named)
    for path in named:
        assert "immutable" in shared.client.get(path).headers["cache-control"]
    # of another version, as a page may be that was opened before its files were edited
    for path in ("/static/style.css", "/static/0123456789ab/style.css"):
        answer = shared.client.get(path)
        assert answer.status_code == 200 and "immutable" not in answer.headers["cache-control"], path


def test_a_query_parameter_that_a_call_does_not_know_is_refused(shared: Any, known: dict[str, str]) -> None:
    document = shared.client.get("/openapi.json").json()
    names = defaultdict(lambda: "1", known)
    calls = [
        (
            method,
            path.format_map(names),
            [one["name"] for one in operation.get("parameters", ()) if one["in"] == "query"],
        )
        for path, operations in document["paths"].items()
        for method, operation in operations.items()
        if path.startswith("/api/v1/") and "requestBody" not in operation
    ]
    assert len(calls) > 30
    for method, path, its in calls:
        told = detail(shared.client.request(method, path, params={"maxstd": "0.001"}), 422)
        assert told.startswith("'maxstd' is no query parameter; "), (method, path)
        assert all(name in told for name in its), (method, path)


def test_whoever_only_looks_whether_the_server_is_there_may_ask_what_they_like(shared: Any) -> None:
    for path in ("/healthz", "/readyz", "/metrics", "/"):
        assert shared.client.get(path, params={"_": "1"}).status_code == 200, path
