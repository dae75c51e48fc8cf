"""What is left when somebody removes an entry's folder from the data directory, while the server runs?"""

from __future__ import annotations

import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from app.problems import MEDIA_TYPE
from app.sessions import document as documents
from tests.app.small_sessions import after, create, upload_model, upload_scan

KINDS = ("models", "scans", "sessions", "recordings")
COMMANDS = ("run", "step", "pause", "reset", "scans")


@pytest.fixture(scope="module")
def one_server(serve_for_module: Callable[..., Any]) -> Any:
    return serve_for_module()


@pytest.fixture
def served(one_server: Any) -> Iterator[Any]:
    yield one_server
    for kind in ("sessions", "recordings", "models", "scans"):
        for entry in one_server.client.get(f"/api/v1/{kind}").json():
            one_server.client.delete(f"/api/v1/{kind}/{entry['id']}")


def calls(client: httpx.Client, **ids: str) -> dict[str, httpx.Response]:
    """The answers to every GET that names entries of these ids."""
    found = {}
    names = {"link": "drawer1", "sender": "frame", "receiver": "drawer1", "view_id": "a", "view": "0", **ids}
    for path, operations in client.get("/openapi.json").json()["paths"].items():
        parts = [part[1:-1] for part in path.split("/") if part.startswith("{")]
        if "get" in operations and set(parts) & set(ids) and set(parts) <= set(names) and not path.endswith("/events"):
            found[path] = client.get(path.format(**names), params={"seen": "0"} if "camera" in path else None)
    return found


def check(answers: dict[str, httpx.Response]) -> None:
    """Every answer is a good one, or says what is wrong."""
    for path, answer in answers.items():
        assert answer.status_code in (200, 404, 409, 422, 503), f"{path}: {answer.status_code} {answer.text[:200]}"
        if answer.status_code != 200:
            assert answer.headers["Content-Type"] == MEDIA_TYPE, path


def gone(served: Any, kind: str, id: str, *inside: str) -> None:
    place: Path = served.config.data_dir / kind / id / Path(*inside)
    if not place.is_dir():
        place.unlink()
    while place.is_dir():  # a session that runs may write into it meanwhile
        shutil.rmtree(place, ignore_errors=True)


def settled(client: httpx.Client, path: str) -> dict[str, Any]:
    while (status := client.get(path).json())["state"] in ("running", "waiting"):
        time.sleep(0.02)
    return dict(status)


@pytest.mark.parametrize("inside", [(), ("recording.sqlite",)])
def test_a_session_does_not_go_on_into_a_removed_file(served: Any, inside: tuple[str, ...]) -> None:
    client = served.client
    path = after(client, 2)
    assert client.post(f"{path}/run", json={"iterations": 10_000}).status_code == 202
    gone(served, "sessions", path.rpartition("/")[2], *inside)
    status = settled(client, path)
    assert status["state"] == "failed" and "removed" in status["error"]
    assert "is failed" not in status["error"]  # which is said of it where it is asked for something
    check(calls(client, session_id=path.rpartition("/")[2]))
    assert client.post(f"{path}/step").status_code in (404, 409)
    assert client.get("/api/v1/sessions").status_code == 200
    assert client.delete(path).status_code == 204
    assert client.get(path).status_code == 404


def test_a_session_at_rest_whose_folder_is_removed(served: Any) -> None:
    client = served.client
    path = after(client, 2)
    gone(served, "sessions", path.rpartition("/")[2])
    check(calls(client, session_id=path.rpartition("/")[2]))
    for command in COMMANDS:
        answer = client.post(f"{path}/{command}", json={"scan_id": "0" * 16} if command == "scans" else None)
        assert answer.status_code in (200, 202, 404, 409), f"{command}: {answer.status_code} {answer.text}"
    assert client.patch(path, json={"config": {"iterations_kept": 1}}).status_code in (404, 409, 422)
    assert client.patch(path, json={"config": {"anneal_iterations": 3}}).status_code in (404, 409)
    assert settled(client, path)["state"] in ("paused", "failed")
    assert client.delete(path).status_code == 204


@pytest.mark.parametrize("kind", ["models", "scans"])
@pytest.mark.parametrize("whole", [True, False])
def test_what_a_session_was_made_of_is_removed(served: Any, kind: str, whole: bool) -> None:
    client = served.client
    ids = {"models": upload_model(client), "scans": upload_scan(client)}
    path = create(client, model_id=ids["models"], scan_id=ids["scans"])
    folder: Path = served.config.data_dir / kind / ids[kind]
    files = [file.name for file in folder.iterdir() if file.suffix != ".json"]
    gone(served, kind, ids[kind], *([] if whole else files))
    check(calls(client, **{f"{kind[:-1]}_id": ids[kind]}))
    check(calls(client, session_id=path.rpartition("/")[2]))
    for known in KINDS:
        assert client.get(f"/api/v1/{known}").status_code == 200
    again = client.post(
        "/api/v1/sessions", json={"model_id": ids["models"], "scan_ids": [ids["scans"]], "particles": 20}
    )
    assert again.status_code == 404 and kind[:-1] in again.json()["detail"]
    assert client.post(f"{path}/reset").status_code == 404
    assert client.post(f"{path}/step").status_code == 200  # the recording has all that it needs
    assert client.delete(path).status_code == 204
    assert client.delete(f"/api/v1/{kind}/{ids[kind]}").status_code == 204


@pytest.mark.parametrize("inside", [(), ("recording.sqlite",)])
def test_an_uploaded_recording_is_removed(served: Any, inside: tuple[str, ...]) -> None:
    client = served.client
    path = after(client, 2)
    content = client.get(f"{path}/recording").content
    answer = client.post("/api/v1/recordings", files={"file": ("a.sqlite", content)})
    assert answer.status_code == 201, answer.text
    id = answer.json()["id"]
    assert client.get(f"/api/v1/sessions/{id}/estimate").status_code == 200
    gone(served, "recordings", id, *inside)
    check(calls(client, recording_id=id))
    check(calls(client, session_id=id))
    assert client.delete(f"/api/v1/recordings/{id}").status_code == 204


def test_what_a_session_is_being_made_of_cannot_be_deleted(served: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not even between the moment that it is looked up and the one that it is read."""
    answers: list[httpx.Response] = []

    def prepare(store: Any, document: Any) -> Any:
        for path in (f"models/{document['model_id']}", f"scans/{document['scan_ids'][0]}"):
            answers.append(httpx.delete(f"{served.url}/api/v1/{path}"))
        return documents.prepare(store, document)

    monkeypatch.setattr("app.sessions.sessions.prepare", prepare)
    create(served.client)
    assert [answer.status_code for answer in answers] == [409, 409]
    assert all("is used by session" in answer.json()["detail"] for answer in answers)
