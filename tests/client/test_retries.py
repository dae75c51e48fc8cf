"""Is a call made again where that is right, and only there? And what does a call say that came to nothing?"""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import traceback
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from email.utils import format_datetime
from pathlib import Path
from typing import Any

import pytest

from pmpnbp.client import calls
from pmpnbp.client.calls import LONGEST_RETRY_AFTER
from pmpnbp.client.client import Client
from pmpnbp.client.session import RemoteSession
from pmpnbp.errors import ServerError
from tests.app import small_sessions as small
from tests.client.failing_servers import LOST, Answer, Relay, Scripted, refused, told
from tests.servers import Served

Servers = Callable[..., Scripted]
SESSION = {"id": "0123456789abcdef", "name": "kitchen", "view_url": "/sessions/0123456789abcdef/", "state": "paused"}


def opened(client: Client) -> RemoteSession:
    return client.open_session(SESSION["id"])


@pytest.mark.parametrize(
    "refusal",
    [
        *(refused(503, retry_after="0"), refused(429, retry_after="0"), refused(429)),
        *(Answer(502, b"<html>"), Answer(503, b"<html>"), Answer(504, b"<html>"), LOST),
    ],
)
def test_what_is_read_is_asked_for_again(scripted: Servers, at_once: None, refusal: Answer) -> None:
    server = scripted(refusal, refusal, told([]))
    with Client(server.url) as client:
        assert client.models() == []
    assert [request.path for request in server.requests] == ["/api/v1/models"] * 3


def test_a_server_that_stays_busy_is_left_with_its_own_words(scripted: Servers) -> None:
    server = scripted(*[refused(429, f"refused {k}", "0") for k in range(3)])
    with Client(server.url, retries=2) as client, pytest.raises(ServerError, match=r"^refused 2$") as caught:
        client.scans()
    assert caught.value.status == 429 and len(server.requests) == 3


@pytest.mark.parametrize("status", [400, 401, 404, 409, 422, 500, 503, 507])
def test_a_refusal_for_good_is_not_asked_again(scripted: Servers, status: int) -> None:
    """Among them the 503 of a machine that cannot draw, which names no time."""
    server = scripted(refused(status, "no"))
    with Client(server.url) as client, pytest.raises(ServerError, match=r"^no$") as caught:
        client.models()
    assert caught.value.status == status and len(server.requests) == 1


COMMANDS: list[Callable[[RemoteSession], object]] = [
    RemoteSession.run,
    RemoteSession.step,
    RemoteSession.pause,
    RemoteSession.reset,
    lambda session: session.change(triangles=50),
    lambda session: session.add_scan("1" * 16),
]


def test_a_command_whose_answer_is_lost_is_told_again_with_its_key(scripted: Servers, at_once: None) -> None:
    for command in COMMANDS:
        server = scripted(told(SESSION), LOST, Answer(502, b"<html>"), told(SESSION))
        with Client(server.url) as client:
            assert command(opened(client)) == SESSION
        first, *others = server.requests[1:]
        assert [(one.method, one.path, one.body) for one in others] == [(first.method, first.path, first.body)] * 2
        assert {one.headers["Idempotency-Key"] for one in server.requests[1:]} == {first.headers["Idempotency-Key"]}


def test_a_command_that_nobody_answers_may_have_been_done(scripted: Servers, at_once: None) -> None:
    server = scripted(told(SESSION), LOST, LOST)
    with (
        Client(server.url, retries=1) as client,
        pytest.raises(ServerError, match=r"broke off the call \(.*\); whether it was done is not known$") as caught,
    ):
        opened(client).step()
    assert server.url in str(caught.value) and caught.value.status is None and len(server.requests) == 3


def test_a_step_whose_answer_is_lost_is_one_step(
    served: Served, relay: Callable[..., Relay], client: Client, at_once: None
) -> None:
    session = client.open_session(small.create(served.client).rsplit("/", 1)[1])
    with Client(relay(0).url) as far:
        assert RemoteSession(far._calls, session.status()).step(2)["iteration"] == 2
    assert session.status()["iteration"] == 2


def test_what_was_refused_was_not_done_and_is_asked_again(scripted: Servers) -> None:
    server = scripted(told(SESSION), refused(429, retry_after="0"), refused(503, retry_after="0"), told(SESSION))
    with Client(server.url) as client:
        assert opened(client).step(3) == SESSION
    assert [json.loads(request.body) for request in server.requests[1:]] == [{"iterations": 3}] * 3


def test_what_makes_something_carries_the_same_key_each_time(scripted: Servers, at_once: None) -> None:
    server = scripted(LOST, refused(503, retry_after="0"), told(SESSION, 201), told(SESSION, 201))
    with Client(server.url) as client:
        client.session("0" * 16, ["1" * 16])
        client.session("0" * 16, ["1" * 16])
    keys = [request.headers["Idempotency-Key"] for request in server.requests]
    assert keys[0] == keys[1] == keys[2] != keys[3] and len(keys[0]) == 36
    assert len({request.body for request in server.requests}) == 1


def test_a_call_that_is_still_at_work_is_waited_for(scripted: Servers, at_once: None) -> None:
    """However often that is said: a step may take minutes."""
    at_work = [refused(409, "still at work", "0")] * 3
    server = scripted(LOST, *at_work, told(SESSION, 201), refused(409, "conflict"))
    with Client(server.url, retries=1) as client:
        assert client.session("0" * 16, "1" * 16).id == SESSION["id"]
        with pytest.raises(ServerError, match=r"^conflict$"):
            client.session("0" * 16, "1" * 16)


def test_what_a_lost_call_has_deleted_is_deleted(scripted: Servers, at_once: None) -> None:
    server = scripted(LOST, refused(404), refused(404, "it is not here"))
    with Client(server.url) as client:
        client.delete_model("0" * 16)
        with pytest.raises(ServerError, match="it is not here"):
            client.delete_model("0" * 16)
    assert [request.method for request in server.requests] == ["DELETE"] * 3


def test_how_long_is_waited(scripted: Servers, monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[float] = []
    monkeypatch.setattr(calls.time, "sleep", waits.append)
    at = format_datetime(datetime.now(UTC) + timedelta(seconds=3000), usegmt=True)
    past = format_datetime(datetime.now(UTC) - timedelta(seconds=3000), usegmt=True)
    said = ["7", past, f"{LONGEST_RETRY_AFTER:g}", None, "soon", None, None, None, None]
    server = scripted(*[refused(429, retry_after=one) for one in said], told([]))
    with Client(server.url, retries=len(said)) as client:
        client.models()
    assert waits == [7.0, 0.0, LONGEST_RETRY_AFTER, 4.0, 8.0, 8.0, 8.0, 8.0, 8.0]
    del waits[:]
    server = scripted(*[refused(429)] * 6, told([]))
    with Client(server.url) as client:
        client.models()
    assert waits == [0.5, 1.0, 2.0, 4.0, 8.0, 8.0]
    del waits[:]
    for longer in ("31", "1000000", at):
        with (
            Client(scripted(refused(429, "delete a session first", longer)).url) as client,
            pytest.raises(ServerError, match=r"^delete a session first$"),
        ):
            client.models()
    assert waits == []


def test_an_upload_whose_answer_is_lost_makes_one_model(
    served: Served, relay: Callable[..., Relay], at_once: None
) -> None:
    before = {entry["id"] for entry in served.client.get("/api/v1/models").json()}
    broken = relay(0, 0)
    with Client(broken.url) as client:
        model = client.upload_model(small.CABINET / "cabinet.urdf")
    assert {entry["id"] for entry in served.client.get("/api/v1/models").json()} - before == {model.id}
    assert broken.connections == 3


def test_a_session_whose_answer_is_lost_is_made_once(
    served: Served, relay: Callable[..., Relay], client: Client, at_once: None
) -> None:
    model = client.upload_model(small.CABINET / "cabinet.urdf")
    scan = small.upload_scan(served.client)
    before = {one.id for one in client.sessions()}
    with Client(relay(0).url) as far:
        session = far.session(model, scan, roi=small.ROI, particles=40, **small.QUICK)
    assert {one.id for one in client.sessions()} - before == {session.id}


def test_a_recording_whose_answer_breaks_is_fetched_anew(
    served: Served, relay: Callable[..., Relay], client: Client, tmp_path: Path, at_once: None
) -> None:
    path = small.after(served.client, 2)
    whole = client.open_session(path.rsplit("/", 1)[1]).recording(tmp_path / "whole.sqlite")
    broken = relay(20_000)
    with Client(broken.url) as far:
        session = RemoteSession(far._calls, served.client.get(path).json())
        assert session.recording(tmp_path / "again.sqlite").read_bytes()[:16] == whole.read_bytes()[:16]
        assert (tmp_path / "again.sqlite").stat().st_size == whole.stat().st_size > 20_000
    assert broken.connections == 2


def test_no_server_is_told_with_its_address(scripted: Servers, monkeypatch: pytest.MonkeyPatch) -> None:
    """After half as many attempts where there never was one."""
    waits: list[float] = []
    monkeypatch.setattr(calls.time, "sleep", waits.append)
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = f"http://127.0.0.1:{free.getsockname()[1]}"
    with Client(address) as client, pytest.raises(ServerError, match=f"^no server answers at {address} \\(") as caught:
        client.models()
    assert caught.value.status is None and waits == [0.5, 1.0, 2.0]


def test_a_server_that_is_silent_is_asked_once_more(monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[float] = []
    monkeypatch.setattr(calls.time, "sleep", waits.append)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        address = f"http://127.0.0.1:{listener.getsockname()[1]}"
        with Client(address, timeout=0.25) as client, pytest.raises(ServerError) as caught:
            client.models()
    assert str(caught.value) == f"the server at {address} says nothing for 0.25 s" and waits == [0.5]


def test_a_server_that_was_there_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[float] = []
    monkeypatch.setattr(calls.time, "sleep", waits.append)
    answer = Answer(200, b"[]", {"Connection": "close"})
    with Scripted([answer]) as server:
        client = Client(server.url)
        assert client.models() == []
    with client, pytest.raises(ServerError, match="no server answers at"):
        client.models()
    assert waits == [0.5, 1.0, 2.0, 4.0, 8.0, 8.0]


def test_the_loopback_is_asked_past_every_proxy(scripted: Servers, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("HTTP_PROXY", "http_proxy", "ALL_PROXY"):
        monkeypatch.setenv(name, "http://127.0.0.1:9")
    for name in ("NO_PROXY", "no_proxy"):
        monkeypatch.delenv(name, raising=False)
    with Client(scripted(told([])).url, retries=0) as client:
        assert client.models() == []


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        (Answer(200, b"<html>"), "is not a list of models"),
        (told([{"id": "x"}]), "is not a list of models as this version of pmpnbp knows it"),
        (told({"detail": "no"}, 418), "answers 418 I'm a Teapot, as no pmpnbp server does"),
        (Answer(404, b"[]", {"Content-Type": calls.PROBLEM}), "answers 404 Not Found"),
        (
            Answer(301, b"", {"Location": "https://elsewhere/"}),
            "answers 301 Moved Permanently, pointing to https://els",
        ),
    ],
)
def test_another_program_is_told_from_a_server_of_ours(scripted: Servers, answer: Answer, text: str) -> None:
    with Client(scripted(answer).url) as client, pytest.raises(ServerError) as caught:
        client.models()
    assert text in str(caught.value)


@pytest.mark.parametrize(
    ("url", "text"),
    [
        (
            "127.0.0.1:8080",
            "'127.0.0.1:8080' is not the address of a server; expected one such as http://127.0.0.1:8080",
        ),
        ("ftp://host/", "'ftp://host/' is not"),
        ("http://", "'http://' is not"),
        ("http://host:port/", "'http://host:port/' is not"),
        ("http://[::1/?token=t0ps3cret", "'http://[::1/' is not"),
        ("http://user:t0ps3cret@host/", "names a user"),
    ],
)
def test_an_address_that_is_none(url: str, text: str) -> None:
    with pytest.raises(ServerError) as caught:
        Client(url)
    assert text in str(caught.value) and "t0ps3cret" not in str(caught.value)


def test_an_address_below_that_of_another_server(scripted: Servers) -> None:
    server = scripted(told([]))
    with Client(f"{server.url}/behind/") as client:
        assert client.models() == [] and client.url == f"{server.url}/behind"
    assert server.requests[0].path == "/behind/api/v1/models"


def test_a_token_lets_in(serve: Callable[..., Served]) -> None:
    served = serve(token="t0ps3cret")
    for client in (Client(served.url, "t0ps3cret"), Client(f"{served.url}/?token=t0ps3cret")):
        with client:
            assert client.models() == []
            assert client.url == served.url


def test_without_a_token_or_with_a_wrong_one(serve: Callable[..., Served]) -> None:
    served = serve(token="t0ps3cret")
    for token, text in ((None, "a token is needed: send it as"), ("another", "the token is wrong: send it as")):
        with Client(served.url, token) as client, pytest.raises(ServerError, match=text) as caught:
            client.models()
        assert caught.value.status == 401


@pytest.mark.parametrize("token", ["t0ps3cret\n", "t0ps3cret é", ""])
def test_a_token_that_no_header_carries(token: str) -> None:
    with pytest.raises(ServerError, match="one word of printable ASCII") as caught:
        Client("http://127.0.0.1:1", token)
    assert "t0ps3cret" not in "".join(traceback.format_exception(caught.value))


def test_the_token_is_never_shown(scripted: Servers, at_once: None) -> None:
    server = scripted(told(SESSION), LOST, refused(401, "the token is wrong"), Answer(302, b"", {"Location": "/"}))
    with Client(server.url, "t0ps3cret", retries=0) as client:
        session = opened(client)
        shown = [repr(client), repr(session), repr(client._calls), str(vars(session)), session.url]
        for command in (session.step, session.status, client.models):
            with pytest.raises(ServerError) as caught:
                command()
            shown.append("".join(traceback.format_exception(caught.value)))
    assert [request.headers["Authorization"] for request in server.requests] == ["Bearer t0ps3cret"] * 4
    assert "t0ps3cret" not in "".join(shown)


def test_importing_it_takes_nothing_along(repository: Path) -> None:
    script = "import sys, pmpnbp.client.client; print(*sys.modules)"
    run = subprocess.run([sys.executable, "-c", script], cwd=repository, text=True, capture_output=True, check=True)
    loaded: set[Any] = {name.split(".")[0] for name in run.stdout.split()}
    assert not loaded & {"numba", "scipy", "open3d", "trimesh", "jaxtyping", "app", "fastapi", "pydantic"}
