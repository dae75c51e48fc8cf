"""Who gets in, and who does not: tokens, cookies, hosts, origins, rates."""

from __future__ import annotations

import socket
from collections.abc import Callable
from typing import Any

import httpx
import pytest

from app.rate_limit import REMEMBERED_CLIENTS, Buckets
from tests.servers import NO_AUTHORITIES

TOKEN = "correct-horse_battery.staple"


@pytest.fixture(scope="module")
def guarded(serve_for_module: Callable[..., Any]) -> Any:
    """A server with a token; its `client` carries it."""
    return serve_for_module(token=TOKEN)


@pytest.fixture(scope="module")
def served(serve_for_module: Callable[..., Any]) -> Any:
    """A server for this machine, without a token."""
    return serve_for_module()


def anonymous(served: Any, **options: Any) -> httpx.Client:
    return httpx.Client(base_url=served.url, timeout=None, verify=NO_AUTHORITIES, **options)


def status(client: httpx.Client, path: str = "/api/v1/settings", method: str = "GET", **headers: str) -> int:
    return client.request(method, path, headers={k.replace("_", "-"): v for k, v in headers.items()}).status_code


@pytest.mark.parametrize("path", ["/", "/docs", "/openapi.json", "/metrics", "/api/v1/models", "/api/v1/settings"])
def test_nothing_is_told_without_the_token(guarded: Any, path: str) -> None:
    with anonymous(guarded) as client:
        answer = client.get(path)
        assert answer.status_code == 401
        assert answer.headers["content-type"] == "application/problem+json"
        assert "Bearer" in answer.headers["www-authenticate"]
        assert answer.json()["status"] == 401 and TOKEN not in answer.text
    assert guarded.client.get(path).status_code == 200


@pytest.mark.parametrize("path", ["/healthz", "/readyz"])
def test_probes_need_no_token(guarded: Any, path: str) -> None:
    with anonymous(guarded) as client:
        assert client.get(path).status_code in (200, 503)


@pytest.mark.parametrize(
    "value", ["Bearer", f"Bearer {TOKEN}x", f"Bearer {TOKEN[:-1]}", f"Basic {TOKEN}", TOKEN, "Bearer \xe9\xff", ""]
)
def test_a_wrong_token_is_refused(guarded: Any, value: str) -> None:
    with anonymous(guarded) as client:
        answer = client.get("/api/v1/settings", headers={"Authorization": value.encode("latin-1")})
        assert answer.status_code == 401


def test_the_pages_link_gives_a_cookie_and_loses_the_token(guarded: Any) -> None:
    with anonymous(guarded) as client:
        answer = client.get("/", params={"token": TOKEN, "at": "a b"})
        assert answer.status_code == 303
        assert answer.headers["location"] == "/?at=a+b"
        cookie = answer.headers["set-cookie"]
        assert "HttpOnly" in cookie and "SameSite=lax" in cookie and "Path=/" in cookie
        assert TOKEN not in cookie
        # from here on the client has the cookie
        assert client.get("/").status_code == 200
        assert client.get("/api/v1/settings").status_code == 200


def test_a_wrong_link_gives_nothing(guarded: Any) -> None:
    with anonymous(guarded) as client:
        answer = client.get("/", params={"token": TOKEN + "x"})
        assert answer.status_code == 401 and "set-cookie" not in answer.headers


def test_a_link_does_not_lead_elsewhere(guarded: Any) -> None:
    with anonymous(guarded) as client:
        for path in ("//example.org/", "/\\example.org/", "/%5Cexample.org"):
            answer = client.get(f"{guarded.url}{path}?token={TOKEN}")
            assert answer.status_code == 303
            assert answer.headers["location"].startswith("/example.org") or answer.headers["location"][1] not in "/\\"


def test_programs_do_not_send_the_token_in_the_address(guarded: Any) -> None:
    with anonymous(guarded) as client:
        assert client.get("/api/v1/settings", params={"token": TOKEN}).status_code == 401


def cookie(served: Any) -> str:
    """What a page sends that was opened by the server's link."""
    ours = served.app.state.page_cookie
    return f"{ours.name}={ours.value}"


def test_a_wrong_cookie_is_refused(guarded: Any) -> None:
    name, value = cookie(guarded).split("=")
    with anonymous(guarded) as client:
        for wrong in (TOKEN, "", value[:-1], value[::-1], '"'):
            assert status(client, Cookie=f"{name}={wrong}") == 401
        assert status(client, Cookie=f"pmpnbp={value}") == 401
        assert status(client, Cookie=f"{name}={value}") == 200


def test_what_changes_something_must_come_from_our_own_page(guarded: Any) -> None:
    ours = {"Cookie": cookie(guarded)}
    missing = "/api/v1/models/0123456789abcdef"
    host = guarded.url.removeprefix("http://")
    with anonymous(guarded) as client:
        assert status(client, missing, "DELETE", Origin=guarded.url, **ours) == 404
        for origin in ("http://example.org", "null", "http://127.0.0.1", f"ftp://{host}", f"http://{host}.example.org"):
            assert status(client, missing, "DELETE", Origin=origin, **ours) == 403
        assert status(client, missing, "DELETE", **ours) == 403
        assert status(client, "/api/v1/settings", **ours) == 200
    # a program with the token is no page
    assert status(guarded.client, missing, "DELETE", Origin="http://example.org") == 404


def test_behind_a_proxy_that_ends_tls_the_origin_still_fits(guarded: Any) -> None:
    ours = {"Cookie": cookie(guarded), "Host": "pose.example.org"}
    with anonymous(guarded) as client:
        assert status(client, "/api/v1/models/x", "DELETE", Origin="https://pose.example.org", **ours) == 404
        assert status(client, "/api/v1/models/x", "DELETE", Origin="https://pose.example.org:8443", **ours) == 403


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "localhost:1234", "[::1]:8080"])
def test_without_a_token_this_machine_is_let_in(served: Any, host: str) -> None:
    assert status(served.client, Host=host) == 200


@pytest.mark.parametrize("host", ["example.org", "127.0.0.1.example.org", "localhost.example.org:8080", "[", "a]:b"])
def test_without_a_token_another_host_name_is_refused(served: Any, host: str) -> None:
    answer = served.client.get("/api/v1/settings", headers={"Host": host})
    assert answer.status_code == 403 and answer.json()["title"] == "Forbidden"


def test_without_a_token_other_pages_change_nothing(served: Any) -> None:
    path = "/api/v1/models/0123456789abcdef"
    assert status(served.client, path, "DELETE") == 404
    assert status(served.client, path, "DELETE", Origin=served.url) == 404
    assert status(served.client, path, "DELETE", Origin="https://example.org") == 403
    assert status(served.client, path, "DELETE", Sec_Fetch_Site="cross-site") == 403


def test_a_request_without_a_host_is_answered(served: Any) -> None:
    host, port = served.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port))) as connection:
        connection.sendall(b"GET /api/v1/settings HTTP/1.0\r\n\r\n")
        assert connection.makefile("rb").readline().split()[1] == b"403"


@pytest.mark.parametrize("path", ["/", "/docs", "/static/start/main.js", "/api/v1/settings", "/nowhere", "/healthz"])
def test_every_answer_keeps_browsers_strict(served: Any, path: str) -> None:
    headers = served.client.get(path).headers
    assert "default-src 'none'" in headers["content-security-policy"]
    assert "frame-ancestors 'self'" in headers["content-security-policy"]
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["referrer-policy"] == "no-referrer"
    assert "server" not in headers


def test_a_refusal_carries_the_headers_too(guarded: Any) -> None:
    with anonymous(guarded) as client:
        assert client.get("/").headers["x-content-type-options"] == "nosniff"


def test_too_many_requests_are_told_when_to_come_back(serve: Callable[..., Any]) -> None:
    served = serve(requests_per_second=5)
    answers = [served.client.get("/api/v1/settings") for _ in range(60)]
    refused = [answer for answer in answers if answer.status_code == 429]
    assert answers[0].status_code == 200 and refused
    assert int(refused[0].headers["retry-after"]) >= 1
    assert "5 requests a second" in refused[0].json()["detail"]
    assert "(requests_per_second)" in refused[0].json()["detail"]
    assert served.client.get("/healthz").status_code == 200


def test_guesses_of_the_token_are_slowed_down(serve: Callable[..., Any]) -> None:
    served = serve(token=TOKEN, requests_per_second=5)
    with anonymous(served) as client:
        statuses = {status(client, Authorization=f"Bearer {guess}") for guess in range(60)}
    assert statuses == {401, 429}


def test_a_bucket_fills_again() -> None:
    buckets = Buckets(per_second=10)
    assert [buckets.take("a", 0.0) for _ in range(20)] == [0.0] * 20
    assert buckets.take("a", 0.0) == pytest.approx(0.1)
    assert buckets.take("b", 0.0) == 0.0
    assert buckets.take("a", 0.1) == 0.0
    assert buckets.take("a", 0.15) == pytest.approx(0.05)
    assert [buckets.take("a", 100.0) for _ in range(20)] == [0.0] * 20


def test_buckets_of_long_ago_are_forgotten() -> None:
    buckets = Buckets(per_second=1)
    for number in range(REMEMBERED_CLIENTS + 100):
        buckets.take(str(number), 0.0)
    assert len(buckets._levels) == REMEMBERED_CLIENTS
