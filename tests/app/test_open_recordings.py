"""How many uploaded recordings are open at once, and how long does one stay so?"""

from __future__ import annotations

import gc
import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from app.sessions import open_recordings
from app.sessions.open_recordings import KEPT, OpenRecordings
from app.sessions.uploaded import UploadedRecording
from tests.app.small_sessions import after, problem
from tests.app.upload_calls import upload

COUNT = KEPT + 5


@pytest.fixture(scope="module")
def served(serve_for_module: Callable[..., Any]) -> Any:
    return serve_for_module()


@pytest.fixture(scope="module")
def ids(served: Any) -> list[str]:
    """Of uploaded recordings, all alike."""
    session = after(served.client, 2)
    content = served.client.get(f"{session}/recording").content
    return [upload(served.client, "recordings", "a.sqlite", content).json()["id"] for _ in range(COUNT)]


def open_files(folder: Path) -> int:
    """Descriptors of this process for files in `folder`."""
    found = 0
    for name in os.listdir("/proc/self/fd"):
        try:
            found += os.readlink(f"/proc/self/fd/{name}").startswith(str(folder))
        except OSError:
            continue
    return found


def test_the_last_few_stay_open(served: Any, ids: list[str]) -> None:
    for id in ids:
        for path in ("", "/estimate?iteration=1", "/trace"):
            assert served.client.get(f"/api/v1/sessions/{id}{path}").status_code == 200
    gc.collect()
    sessions = served.app.state.sessions
    assert [id for id in ids if sessions.at_hand(id) is not None] == ids[-KEPT:]
    if os.path.isdir("/proc/self/fd"):
        assert open_files(served.config.data_dir / "recordings") <= KEPT * open_files_of_one(served, ids[-1])
    assert served.client.get(f"/api/v1/sessions/{ids[0]}/estimate?iteration=1").status_code == 200


def open_files_of_one(served: Any, id: str) -> int:
    return open_files(served.config.data_dir / "recordings" / id)


def test_one_that_is_looked_at_stays_the_same(served: Any, ids: list[str]) -> None:
    sessions = served.app.state.sessions
    seen = sessions.get(ids[0])
    for id in ids[1:]:
        sessions.get(id)
    assert sessions.get(ids[0]) is seen


def test_one_that_is_deleted_while_it_is_opened_is_not_there(
    served: Any, ids: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    content = served.client.get(f"/api/v1/recordings/{ids[0]}/file").content
    id = upload(served.client, "recordings", "b.sqlite", content).json()["id"]

    def too_late(id: str, path: Path, document: Any) -> UploadedRecording:
        served.app.state.store.delete("recordings", id)
        return UploadedRecording(id, path, document)

    monkeypatch.setattr(open_recordings, "UploadedRecording", too_late)
    problem(served.client.get(f"/api/v1/sessions/{id}/estimate"), 404, f"session '{id}' is not here")


def test_one_that_takes_long_to_open_keeps_no_other_waiting(
    served: Any, ids: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    recordings = OpenRecordings(served.app.state.store)
    begun, go_on = threading.Event(), threading.Event()
    original = open_recordings.UploadedRecording

    def slow(id: str, *rest: Any) -> Any:
        if id == ids[0]:
            begun.set()
            go_on.wait()
        return original(id, *rest)

    monkeypatch.setattr(open_recordings, "UploadedRecording", slow)
    found: list[Any] = []
    threads = [threading.Thread(target=lambda: found.append(recordings.get(ids[0]))) for _ in range(3)]
    for thread in threads:
        thread.start()
    begun.wait()
    assert recordings.get(ids[1]) is not None
    assert found == []
    go_on.set()
    for thread in threads:
        thread.join()
    assert len(found) == 3 and found[0] is found[1] is found[2]
    recordings.close()
    assert recordings.get(ids[2]) is None
