"""Is an uploaded recording kept byte for byte, and one that would harm its reader refused?"""

from __future__ import annotations

import errno
import sqlite3
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from app.store import atomic_files
from pmpnbp.inference import run as engine
from pmpnbp.recording import Inputs, RecordingWriter
from pmpnbp.recording.schema import unpack
from pmpnbp.scene.prior import load_prior
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.scene.urdf import load_model
from pmpnbp.settings import preset
from tests.app import recording_mutations
from tests.app.upload_calls import CABINET, detail, emptied, nothing_kept, upload


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> bytes:
    """A small recording, as the library writes it."""
    path = tmp_path_factory.mktemp("recording") / "run.sqlite"
    model = load_model(CABINET / "cabinet.urdf")
    scan = load_scan(CABINET / "open" / "depth.png", CABINET / "open" / "camera.json")
    prior = load_prior(CABINET / "open" / "prior.json", model)
    inputs = Inputs(CABINET / "cabinet.urdf", (scan,), None, prior, preset("robust"), 20, 3)
    problem = inputs.problem()
    with RecordingWriter(path, inputs, problem.mrf.model) as writer:
        state, report = engine.begin(problem)
        writer.write(report, state)
    return path.read_bytes()


@pytest.fixture(scope="module")
def one_server(serve_for_module: Callable[..., Any]) -> Any:
    """One for all tests here: a server that has just started spends its first second on its readers' imports."""
    return serve_for_module()


@pytest.fixture
def served(one_server: Any) -> Any:
    """The server with nothing in its store."""
    return emptied(one_server)


def test_a_recording_comes_back_byte_for_byte(served: Any, recording: bytes) -> None:
    answer = upload(served.client, "recordings", "my run.db", recording)
    document = answer.json()
    assert answer.status_code == 201, answer.text
    assert (document["model"], document["particles"], document["seed"], document["scans"]) == ("cabinet", 20, 3, 1)
    assert (document["iterations"], document["first_iteration"], document["last_iteration"]) == (1, 0, 0)
    assert document["parts"] == ["frame", "drawer1", "drawer2", "drawer3"]
    path = answer.headers["Location"]
    file = served.client.get(f"{path}/file")
    assert file.content == recording
    assert 'filename="my_run.sqlite"' in file.headers["Content-Disposition"]
    assert served.client.get(f"{path}/file", headers={"If-None-Match": file.headers["ETag"]}).status_code == 304
    assert served.client.get("/api/v1/recordings").json() == [document]
    assert served.client.delete(path).status_code == 204
    assert "there are 0 recordings" in detail(served.client.get(f"{path}/file"), 404)


def test_a_recording_is_renamed_and_nothing_else_of_it(
    served: Any, recording: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = served.app.state.store
    empty = store.used_bytes()
    made = upload(served.client, "recordings", "my run.db", recording)
    entry = made.headers["Location"]
    session = entry.replace("recordings", "sessions")
    assert made.json()["name"] is None and served.client.get(session).json()["name"] == "my run"  # which opens it
    told = served.client.patch(entry, json={"name": "  top drawer, at last "})
    assert told.json() == made.json() | {"name": "top drawer, at last"}
    assert served.client.get("/api/v1/recordings").json() == [told.json()]
    assert served.client.get(session).json()["name"] == "top drawer, at last"
    file = served.client.get(f"{entry}/file")
    assert file.content == recording and 'filename="my_run.sqlite"' in file.headers["Content-Disposition"]
    # who has it by its old name is told the new one
    tag = {"If-None-Match": made.headers["ETag"]}
    again = served.client.get(entry, headers=tag)
    assert (again.status_code, again.json()) == (200, told.json())
    assert served.client.get(entry, headers={"If-None-Match": again.headers["ETag"]}).status_code == 304
    # rubbish changes nothing, and neither does a disk that is full
    for body in ({}, {"name": " "}, {"name": "x" * 201}, {"name": None}, {"name": 5}, {"name": "never", "tags": []}):
        assert "in the body" in detail(served.client.patch(entry, json=body), 422)
    half = served.client.patch(entry, content=b'{"name": "\\ud800"}', headers={"Content-Type": "application/json"})
    assert "surrogate" in detail(half, 422)
    assert "is not here" in detail(served.client.patch("/api/v1/recordings/nothing", json={"name": "never"}), 404)
    with monkeypatch.context() as patched:
        patched.setattr("app.store.atomic_files.write_json", full)
        assert "full" in detail(served.client.patch(entry, json={"name": "never"}), 507)
    assert served.client.get(entry).json() == told.json()
    # on the disk, too; and its room is free when it is gone
    kept = atomic_files.read_json(store.root / "recordings" / told.json()["id"] / "recording.json")
    assert kept is not None and kept["name"] == told.json()["name"]
    assert served.client.delete(entry).status_code == 204
    assert store.used_bytes() == empty and nothing_kept(served)


def full(*given: Any) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_recording_that_would_run_its_senders_queries(served: Any, recording: bytes, tmp_path: Path) -> None:
    for number, script in enumerate(
        (
            "ALTER TABLE arrays RENAME TO a; CREATE VIEW arrays AS SELECT * FROM a",
            "CREATE TRIGGER t AFTER INSERT ON notes BEGIN DELETE FROM notes; END",
            "CREATE TABLE x (a INTEGER, b TEXT GENERATED ALWAYS AS (hex(zeroblob(a))))",
            "CREATE VIRTUAL TABLE v USING fts5(a)",
            "CREATE INDEX i ON arrays (hex(data))",
        )
    ):
        content = altered(recording, script, tmp_path / f"{number}.sqlite")
        says = detail(upload(served.client, "recordings", "hostile.sqlite", content), 422)
        assert "which no recording does" in says
        assert nothing_kept(served)


def test_a_recording_that_lacks_something(served: Any, recording: bytes, tmp_path: Path) -> None:
    for number, (script, says) in enumerate(
        {
            "DELETE FROM iterations": "has no iteration that can be read",
            "UPDATE model SET zip = x'504b0304'": "is damaged",
            "UPDATE inputs SET value = '1e999' WHERE name = 'particles'": "is damaged",
            "DELETE FROM inputs WHERE name = 'prior'": "is damaged",
        }.items()
    ):
        content = altered(recording, script, tmp_path / f"{number}.sqlite")
        assert says in detail(upload(served.client, "recordings", "damaged.sqlite", content), 422)


def altered(recording: bytes, script: str, path: Path) -> bytes:
    """The recording after an SQL `script`."""
    path.write_bytes(recording)
    connection = sqlite3.connect(path)
    connection.executescript(script)
    connection.close()
    return path.read_bytes()


def test_a_bomb_in_the_midst_is_damage_of_that_iteration(served: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """64 MiB of zeros, packed in 64 KiB; nothing larger than an array of this model is unpacked to tell so."""
    size = 64 << 20
    content = recording_mutations.altered(
        recording_mutations.recording(),
        lambda connection: connection.execute(
            "UPDATE arrays SET shape = ?, data = ? WHERE iteration = 3 AND name = 'belief.poses'",
            (f"[4, {size // 224}, 7]", zlib.compress(bytes(size // 224 * 224))),
        ),
    )
    assert len(content) < 2 << 20
    answer = upload(served.client, "recordings", "bomb.sqlite", content)
    assert answer.status_code == 201, answer.text
    unpacked: list[int] = []

    def noted(*given: Any) -> Any:
        unpacked.append((array := unpack(*given)).nbytes)
        return array

    monkeypatch.setattr("pmpnbp.recording.reader.unpack", noted)
    path = f"/api/v1/sessions/{answer.json()['id']}"
    says = "iteration 3 does not fit the model of its recording"
    for call in ("estimate", "beliefs/frame", "beliefs/frame/particles/0"):
        assert says in detail(served.client.get(f"{path}/{call}?iteration=3"), 404)
        assert served.client.get(f"{path}/{call}?iteration=2").status_code == 200
    rows = served.client.get(f"{path}/trace").json()["iterations"]
    assert [row["iteration"] for row in rows] == [0, 1, 2, 3, 4, 5, 6]  # its row is the session's own
    assert unpacked and max(unpacked) < 1 << 20


def test_more_scans_than_a_server_can_keep(served: Any, recording: bytes, tmp_path: Path) -> None:
    scans = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n WHERE x < 250) INSERT INTO scans "
    scans += "SELECT x, camera, frame_id, stamp, dtype, shape, depth FROM scans, n"
    content = altered(recording, scans, tmp_path / "many.sqlite")
    assert "has more than 67108864 pixels of scans" in detail(
        upload(served.client, "recordings", "many.sqlite", content), 422
    )
    assert nothing_kept(served)
