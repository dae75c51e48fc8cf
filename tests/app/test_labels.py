"""What a session is called, and the tags it is found by: said at once, kept over restarts, refused in a sentence."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

from app.sessions.names import LONGEST, named
from app.sessions.sessions import Sessions
from app.store import atomic_files
from pmpnbp.errors import StorageError
from pmpnbp.inference import run as engine
from tests.app import small_sessions as small
from tests.app.small_sessions import problem


@pytest.fixture(scope="module")
def ids(client: httpx.Client) -> dict[str, str]:
    return {"model_id": small.upload_model(client), "scan_id": small.upload_scan(client)}


@pytest.fixture
def path(client: httpx.Client, ids: dict[str, str]) -> Iterator[str]:
    made = small.create(client, **ids)
    yield made
    client.delete(made)


def kept(shared: Any, path: str) -> dict[str, Any]:
    """The session as a server has it that starts now."""
    again = Sessions(shared.app.state.store, shared.config)
    again.restore()
    found = again.get(path.rpartition("/")[2])
    status = found.status()
    found.close()
    return status


def test_a_name_and_tags_are_said_at_once_and_kept(shared: Any, client: httpx.Client, path: str) -> None:
    before = client.get(path).json()
    assert before["tags"] == []
    told = client.patch(path, json={"name": "  the kitchen's  ", "tags": ["by hand", " good ", "by hand"]}).json()
    assert told == before | {"name": "the kitchen's", "tags": ["by hand", "good"]}
    assert client.get(path).json() == told and told in client.get("/api/v1/sessions").json()
    # what is not named stays; tags are all that there are
    assert client.patch(path, json={"tags": []}).json() == told | {"tags": []}
    assert client.patch(path, json={"tags": ["late"]}).json()["name"] == "the kitchen's"
    small.step(client, path, 2)
    again = kept(shared, path)
    assert (again["name"], again["tags"], again["iteration"]) == ("the kitchen's", ["late"], 2)


def test_a_session_without_a_name_is_called_by_its_files(client: httpx.Client, ids: dict[str, str], path: str) -> None:
    assert client.get(path).json()["name"] == "cabinet in depth.png"
    second = client.post("/api/v1/scans", files={"file": ("left view.xyz", b"0 0 1\n0 1 1\n1 0 1\n" * 40)}).json()["id"]
    blank = small.create(client, name=" ", **ids)
    assert client.get(blank).json()["name"] == "cabinet in depth.png"
    body = small.body(ids["model_id"], ids["scan_id"], scan_ids=[ids["scan_id"], second], tags=["two views"])
    both = client.post("/api/v1/sessions", json=body).json()
    assert (both["name"], both["tags"]) == ("cabinet in depth.png and 1 other", ["two views"])


def test_a_session_of_an_older_server_is_called_by_its_files_too(shared: Any, path: str) -> None:
    place = shared.config.data_dir / "sessions" / path.rpartition("/")[2] / "session.json"
    document = json.loads(place.read_text())
    older = {name: value for name, value in document.items() if name not in ("tags", "sample")} | {"name": None}
    assert named(older, shared.app.state.store)["name"] == "cabinet in depth.png"


def test_a_long_name_is_cut_in_the_middle_of_nothing_else() -> None:
    class Long:
        def document(self, kind: str, id: str) -> dict[str, str]:
            return {"name": "m" * 300, "file_name": "s" * 90 + "\n.png"}

    name = named({"model_id": "a", "scan_ids": ["b", "c", "d"]}, Long())["name"]  # type: ignore[arg-type]
    assert len(name) == LONGEST
    assert name.endswith(f"… in {'s' * 90} .png and 2 others")


@pytest.mark.parametrize(
    ("members", "text"),
    [
        ({"name": ""}, "name in the body"),
        ({"name": "  "}, "name in the body"),
        ({"name": "x" * 201}, "name in the body"),
        ({"name": None}, "name in the body"),
        ({"name": 5}, "name in the body"),
        ({"tags": ["x" * 41]}, "tags"),
        ({"tags": ["ok", " "]}, "tags"),
        ({"tags": ["two\r\nlines"]}, "tags[0] in the body: it has the character U+000D; expected no control"),
        ({"name": "two\nlines"}, "name in the body: it has the character U+000A; expected no control characters"),
        ({"tags": [f"tag {number}" for number in range(21)]}, "tags in the body"),
        ({"tags": "kitchen"}, "tags in the body"),
        ({"tags": None, "name": "never"}, "tags in the body"),
        ({"name": "never", "config": {"sharpness": 3}}, "setting 'sharpness' does not exist"),
        ({"tags": ["never"], "config": {"image_width": 20}}, "work image's width is 20"),
        ({}, "it names nothing to change; expected config, name or tags"),
        ({"colour": "red"}, "colour in the body"),
    ],
)
def test_what_is_refused_changes_nothing(
    shared: Any, client: httpx.Client, path: str, members: dict[str, Any], text: str
) -> None:
    before = client.get(path).json()
    problem(client.patch(path, json=members), 422, text)
    assert client.get(path).json() == before == kept(shared, path)


def test_a_name_that_cannot_be_written_is_not_taken(
    shared: Any, client: httpx.Client, path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = client.get(path).json()

    def full(*_: Any) -> None:
        raise StorageError("the disk is full")

    with monkeypatch.context() as patch:
        patch.setattr(atomic_files, "replace_json", full)
        problem(client.patch(path, json={"name": "never", "tags": ["never"]}), 507, "the disk is full")
    assert client.get(path).json() == before == kept(shared, path)


def test_settings_and_a_name_come_in_one_call(shared: Any, client: httpx.Client, path: str) -> None:
    told = client.patch(path, json={"config": {"joint_draws": 3}, "name": "both", "tags": ["t"]}).json()
    assert (told["config"]["joint_draws"], told["name"], told["tags"]) == (3, "both", ["t"])
    again = kept(shared, path)
    assert (again["config"]["joint_draws"], again["name"], again["tags"]) == (3, "both", ["t"])


def test_a_rename_waits_for_no_iteration_and_loses_no_change(
    shared: Any, client: httpx.Client, path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, go_on, following = threading.Event(), threading.Event(), engine.following

    def held(*given: Any, **named: Any) -> Any:
        begun.set()
        go_on.wait()
        return following(*given, **named)

    monkeypatch.setattr(engine, "following", held)
    client.post(f"{path}/run", json={"iterations": 2}).raise_for_status()
    begun.wait()
    changing = threading.Thread(target=client.patch, args=(path,), kwargs={"json": {"config": {"joint_draws": 3}}})
    changing.start()  # waits for the iteration
    try:
        told = client.patch(path, json={"name": "while it runs", "tags": ["kept"]}).json()
        assert (told["state"], told["iteration"], told["name"]) == ("running", 0, "while it runs")
    finally:
        go_on.set()
    changing.join()
    small.at_rest(client, path)
    for found in (client.get(path).json(), kept(shared, path)):
        assert (found["name"], found["tags"]) == ("while it runs", ["kept"])
        assert found["config"]["joint_draws"] == 3
    client.post(f"{path}/reset").raise_for_status()
    assert client.get(path).json()["name"] == kept(shared, path)["name"] == "while it runs"


def test_sessions_are_found_by_their_tags(client: httpx.Client, ids: dict[str, str], path: str) -> None:
    other = small.create(client, **ids, tags=["kitchen", "dark & cold"])
    client.patch(path, json={"tags": ["kitchen"]}).raise_for_status()

    def found(*tags: str) -> list[str]:
        return [f"/api/v1/sessions/{one['id']}" for one in client.get("/api/v1/sessions", params={"tag": tags}).json()]

    assert {path, other} <= set(found())
    assert (found("kitchen"), found("kitchen", "dark & cold"), found("Kitchen")) == ([path, other], [other], [])

    # and a few at a time, which say how many there are
    def some(**asked: Any) -> tuple[list[str], str]:
        answer = client.get("/api/v1/sessions", params={"tag": "kitchen"} | asked)
        return [f"/api/v1/sessions/{one['id']}" for one in answer.json()], answer.headers["X-Total-Count"]

    assert some() == ([path, other], "2") and some(limit=1) == ([path], "2")
    assert some(offset=1, limit=9) == ([other], "2") and some(offset=2) == ([], "2")
    for asked, text in ({"limit": 0}, "limit"), ({"limit": "x"}, "limit"), ({"offset": -1}, "offset"):
        problem(client.get("/api/v1/sessions", params=asked), 422, f"{text} in the query")
    client.delete(other)


def test_a_damaged_session_and_a_recording_keep_their_names(client: httpx.Client, path: str, shared: Any) -> None:
    file = client.get(f"{path}/recording").content
    recording = client.post("/api/v1/recordings", files={"file": ("of the kitchen.sqlite", file)}).json()["id"]
    problem(client.patch(f"/api/v1/sessions/{recording}", json={"name": "never"}), 409, "is a recording")
    assert client.get(f"/api/v1/sessions/{recording}").json()["tags"] == []
    session = shared.app.state.sessions.get(path.rpartition("/")[2])
    session._document.pop("model_id")  # as at a start with a damaged document
    problem(client.patch(path, json={"name": "never"}), 409, "document is damaged")


def test_the_sample_is_found_again_whatever_it_is_called(serve: Callable[..., Any]) -> None:
    served = serve()
    state = served.ready().app.state
    session = state.sessions.demo()
    session.pause().result()
    session.label({"name": "mine"})
    assert state.sessions.demo() is session
    session.pause().result()
