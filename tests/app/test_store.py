"""Does the store lose nothing? Entries across restarts, kills at every step, and full disks."""

from __future__ import annotations

import errno
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from app.problems import HttpProblem
from app.store.disk_room import folder_size
from app.store.store import Kind, Store, StoreError
from app.store.stored_scan import read_scan, write_scan
from pmpnbp.errors import StorageError
from pmpnbp.geometry.camera import Camera
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.scan_files import load_scan
from tests.app.store_steps import create_session
from tests.scene.scan_writers import pcd, ply

SCAN = Scan(
    Camera(3, 2, 1.1, 1.2, 1.0, 0.5, np.array([0.1, -0.2, 1 / 3, 0.6, 0.0, 0.8, 0.0])),
    np.arange(6, dtype=np.float32).reshape(2, 3) / np.float32(3),
    "Küche",
    1714564800.123456,
)
ROOM = 1 << 24


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    opened = Store(tmp_path / "data", ROOM)
    yield opened
    opened.close()


def reopened(store: Store, max_bytes: int = ROOM) -> Store:
    store.close()
    return Store(store.root, max_bytes)


def add_scan(store: Store, scan: Scan = SCAN) -> str:
    with store.staging() as staging:
        write_scan(staging.folder / "scan.npz", scan)
        return str(store.add("scans", staging.folder / "scan.npz", "a.pcd", {"points": 5})["id"])


def add_model(store: Store, content: bytes = b"<robot/>", file_name: str = "a.urdf") -> str:
    with store.staging() as staging:
        (staging.folder / "x").write_bytes(content)
        return str(store.add("models", staging.folder / "x", file_name, {"name": "a", "links": ["é"]})["id"])


def add_recording(store: Store) -> str:
    with store.staging() as staging:
        (staging.folder / "x").write_bytes(b"SQLite")
        return str(store.add("recordings", staging.folder / "x", "r.sqlite", {"iterations": 3})["id"])


def same(a: Scan, b: Scan) -> bool:
    """Bit for bit."""
    assert (a.depth.dtype, a.camera.pose_world_camera.dtype) == (b.depth.dtype, b.camera.pose_world_camera.dtype)
    numbers = ("width", "height", "fx", "fy", "cx", "cy")
    return (
        a.depth.tobytes() == b.depth.tobytes()
        and a.camera.pose_world_camera.tobytes() == b.camera.pose_world_camera.tobytes()
        and [getattr(a.camera, name) for name in numbers] == [getattr(b.camera, name) for name in numbers]
        and (a.frame_id, a.stamp) == (b.frame_id, b.stamp)
    )


def test_what_was_added_is_there_after_a_restart(store: Store) -> None:
    model, scan, recording = add_model(store), add_scan(store), add_recording(store)
    session = create_session(store, {"model_id": model, "scan_ids": [scan], "changes": []})
    store.write_session(session, {"id": session, "model_id": model, "scan_ids": [scan], "name": "two"})
    before = store.documents("models"), store.documents("scans"), store.documents("recordings"), store.sessions()
    store = reopened(store)
    assert (
        store.documents("models"),
        store.documents("scans"),
        store.documents("recordings"),
        store.sessions(),
    ) == before
    assert store.document("models", model) == store.documents("models")[0]
    assert store.document("models", model)["links"] == ["é"]
    assert store.file("models", model).read_bytes() == b"<robot/>"
    assert store.file("recordings", recording).read_bytes() == b"SQLite"
    assert same(store.load_scan(scan), SCAN)
    assert store.session_folder(session).is_dir()
    assert dict(store.sessions())[session] == {"id": session, "model_id": model, "scan_ids": [scan], "name": "two"}
    store.close()


@pytest.mark.parametrize("given", [None, "camera.json"])
@pytest.mark.parametrize("name", ["cloud.pcd", "cloud.ply", "map.npy", "loose.xyz", "depth.npz"])
def test_a_scan_comes_back_with_its_bits(
    name: str, given: str | None, tmp_path: Path, rng: np.random.Generator
) -> None:
    depth = (1 + rng.random((24, 32))).astype(np.float32)
    v, u = np.mgrid[0:24, 0:32]
    points = np.stack([(u - 15.5) / 30 * depth, (v - 11.5) / 30 * depth, depth], axis=-1)
    path, camera = tmp_path / name, None
    if given is not None or name == "depth.npz":
        camera = tmp_path / "camera.json"
        members = {"width": 32, "height": 24, "fx": 30, "fy": 30.0, "cx": 15.5, "cy": 11.5, "frame_id": "base"}
        turned = [0.0, -1, 0, 0.1, 1, 0, 0, 0.2, 0, 0, 1, 1 / 3, 0, 0, 0, 1]
        camera.write_text(json.dumps(members | {"stamp": 17.25, "T_world_camera": turned}))
    if name == "cloud.pcd":
        path.write_bytes(pcd(points.astype(np.float32)))
    elif name == "cloud.ply":
        path.write_bytes(ply(points.reshape(-1, 3), "binary_little_endian", kind="double"))
    elif name == "map.npy":
        np.save(path, points)
    elif name == "loose.xyz":
        np.savetxt(path, points.reshape(-1, 3))
    else:
        np.savez(path, depth=depth)
    scan = load_scan(path, camera)
    write_scan(tmp_path / "kept.npz", scan)
    assert same(read_scan(tmp_path / "kept.npz"), scan)


def test_a_kept_scan_is_a_scan_file_itself(tmp_path: Path) -> None:
    write_scan(tmp_path / "kept.npz", SCAN)
    with np.load(tmp_path / "kept.npz") as file:
        assert np.array_equal(file["depth"], SCAN.depth)


def test_a_kill_at_any_step_leaves_the_whole_entry_or_nothing(tmp_path: Path) -> None:
    """Each action in a child that dies before its n-th change of the disk, for every n; the next start finds what was
    before or what is after, everything readable, nothing left over and the bytes counted right."""
    ran = subprocess.run(
        [sys.executable, "-m", "tests.app.store_steps", str(tmp_path)], capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stderr
    found = [json.loads(line) for line in ran.stdout.splitlines()]
    assert {one["action"]: one["wrong"] for one in found} == {one["action"]: [] for one in found}
    # a rename, a folder and a file at the least: else the steps were not seen
    assert {one["action"] for one in found if one["steps"] >= 3} == {
        "add_model",
        "add_scan",
        "delete_scan",
        "create_session",
        "write_session",
        "delete_session",
        "create_session_with_key",
        "add_model_with_key",
        "delete_model_with_key",
    }


def test_an_entry_is_forced_to_the_disk_before_it_is_there(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    steps: list[str] = []
    fsync, rename = os.fsync, os.rename

    def noted_fsync(descriptor: int) -> None:
        steps.append(f"fsync {Path(os.readlink(f'/proc/self/fd/{descriptor}')).name.rpartition('.')[2]}")
        fsync(descriptor)

    def noted_rename(source: Path, place: Path) -> None:
        steps.append("rename")
        rename(source, place)

    monkeypatch.setattr(os, "fsync", noted_fsync)
    monkeypatch.setattr(os, "rename", noted_rename)
    add_scan(store)
    assert steps == ["fsync npz", "fsync json", "fsync partial", "rename", "fsync scans"]


@pytest.mark.parametrize("call", ["mkdir", "replace", "fsync", "rename"])
def test_a_full_disk_is_said_and_changes_nothing(call: str, store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = add_scan(store)
    session = create_session(store, {"name": "old"})
    before = store.documents("models"), store.documents("scans"), store.sessions(), store.used_bytes()

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with store.staging() as staging:
        write_scan(staging.folder / "scan.npz", SCAN)
        with monkeypatch.context() as patch:
            patch.setattr(*((Path, "mkdir") if call == "mkdir" else (os, call)), full)
            with pytest.raises(StorageError, match="is full; nothing was changed"):
                store.add("scans", staging.folder / "scan.npz", "b.pcd", {})
            if call in ("replace", "fsync"):
                with pytest.raises(StorageError, match="is full"):
                    store.write_session(session, {"name": "new"})
            if call != "replace":  # which moves no file of a session
                with pytest.raises(StorageError, match="is full"):
                    create_session(store, {"name": "new"})
    assert (store.documents("models"), store.documents("scans"), store.sessions(), store.used_bytes()) == before
    store = reopened(store)
    assert [scan["id"] for scan in store.documents("scans")] == [kept]
    assert dict(store.sessions())[session] is not None
    assert dict(store.sessions())[session]["name"] == "old"  # type: ignore[index]
    store.close()


@pytest.mark.parametrize("gone", ["incoming", "scans", "sessions", "."])
def test_folders_that_were_cleared_away_are_made_again(gone: str, store: Store) -> None:
    """Programs that clear old files away take empty folders."""
    shutil.rmtree(store.root / gone)
    with store.staging() as staging:
        staging.claim(10)
        write_scan(staging.folder / "scan.npz", SCAN)
        kept = str(store.add("scans", staging.folder / "scan.npz", "b.pcd", {})["id"])
    assert store.load_scan(kept).frame_id == SCAN.frame_id
    session = create_session(store, {"name": "new"})
    if gone == "incoming":
        shutil.rmtree(store.root / gone)
        store.write_session(session, {"name": "newer"})
        shutil.rmtree(store.root / gone)
        store.delete("scans", kept)
    store = reopened(store)
    assert [id for id, _ in store.sessions()] == [session]
    store.close()


def test_room_that_is_kept_for_recordings_is_told_of(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    sector, free = 4096, ROOM // 20 + 1000
    monkeypatch.setattr(os, "statvfs", lambda _: SimpleNamespace(f_bavail=free // sector, f_frsize=sector))
    with store.staging() as staging, pytest.raises(StorageError, match=r"no more than the 1 MiB that are kept free"):
        staging.claim(free)


def test_the_limit_on_disk_counts_entries_sessions_and_uploads(store: Store) -> None:
    scan = add_scan(store)
    session = create_session(store, {})
    assert store.used_bytes() > 0
    (store.session_folder(session) / "recording.sqlite").write_bytes(b"x" * 10_000)
    store = reopened(store)
    held = sum(folder_size(store.root / kind) for kind in ("models", "scans", "sessions", "recordings"))
    assert store.used_bytes() == held > 10_000
    with store.staging() as staging:
        staging.claim(ROOM - held)
        assert store.used_bytes() == ROOM
        with store.staging() as other, pytest.raises(HttpProblem, match="may hold 16 MiB and is full") as caught:
            other.claim(1)
        assert caught.value.status == 507
    assert store.used_bytes() == held
    store.delete("scans", scan)
    assert store.used_bytes() == folder_size(store.root / "sessions")
    store.delete("sessions", session)
    assert store.used_bytes() == 0
    store.close()


def test_what_is_not_here_is_said(store: Store) -> None:
    add_model(store)
    for call in (store.document, store.file, store.delete):
        with pytest.raises(HttpProblem, match=r"^model 'x' is not here; there is 1 model$") as caught:
            call("models", "x")
        assert caught.value.status == 404
    with pytest.raises(HttpProblem, match=r"^scan '\.\./models' is not here; there are 0 scans$"):
        store.load_scan("../models")
    with pytest.raises(HttpProblem, match="session 'y' is not here; there are 0 sessions"):
        store.session_folder("y")
    with pytest.raises(HttpProblem, match="recording 'z' is not here"):
        store.file("recordings", "z")
    with pytest.raises(HttpProblem, match="scan 'gone' is not here"):
        create_session(store, {"scan_ids": ["gone"]})
    assert store.sessions() == []


def test_what_a_session_uses_cannot_be_deleted(store: Store) -> None:
    model, first, second = add_model(store), add_scan(store), add_scan(store)
    session = create_session(store, {"model_id": model, "scan_ids": [first]})
    store.write_session(
        session, {"model_id": model, "scan_ids": [first], "changes": [{"after_iteration": 3, "scan_id": second}]}
    )
    store = reopened(store)
    used: list[tuple[Kind, str]] = [("models", model), ("scans", first), ("scans", second)]
    for kind, id in used:
        with pytest.raises(HttpProblem, match=f"is used by session '{session}'; delete it first") as caught:
            store.delete(kind, id)
        assert caught.value.status == 409
    store.delete("sessions", session)
    store.delete("models", model)
    store.delete("scans", first)
    store.delete("scans", second)
    assert (store.documents("models"), store.documents("scans"), store.sessions(), store.used_bytes()) == (
        [],
        [],
        [],
        0,
    )
    store.close()


def test_a_damaged_entry_does_not_stop_the_start(store: Store) -> None:
    scan, session, whole = add_scan(store), create_session(store, {}), create_session(store, {"name": "whole"})
    (store.root / "scans" / scan / "scan.json").write_text("{")
    (store.root / "sessions" / session / "session.json").write_bytes(b"\xff\0")
    (store.root / "sessions" / "not an entry").mkdir()
    store = reopened(store)
    assert store.documents("scans") == []
    with pytest.raises(HttpProblem, match="is damaged"):
        store.document("scans", scan)
    assert {id: found is None for id, found in store.sessions()} == {session: True, whole: False}
    store.delete("sessions", session)
    store.delete("scans", scan)
    assert [id for id, _ in store.sessions()] == [whole]
    store.close()


def test_uploads_that_were_cut_off_are_gone_at_the_next_start(store: Store) -> None:
    with store.staging() as staging:
        (staging.folder / "half").write_bytes(b"x")
        (store.root / "incoming" / "file").write_bytes(b"x")
        store = reopened(store)
        assert list((store.root / "incoming").iterdir()) == []
    store.close()


def test_one_server_at_a_time(store: Store) -> None:
    code = f"from pathlib import Path; from app.store.store import Store; Store(Path({str(store.root)!r}), 1 << 20)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert StoreError.__name__ in ran.stderr and "is in use by another server" in ran.stderr
    store.close()
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, check=False).returncode == 0


def test_a_folder_that_is_none_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("x")
    with pytest.raises(StoreError, match=r"data directory .* cannot be used: "):
        Store(tmp_path / "file", ROOM)


def test_many_threads_at_once(store: Store) -> None:
    def life(number: int) -> str:
        id = add_scan(store)
        assert same(store.load_scan(id), SCAN)
        if number % 2:
            store.delete("scans", id)
        return id

    with ThreadPoolExecutor(8) as threads:
        ids = list(threads.map(life, range(60)))
    assert {scan["id"] for scan in store.documents("scans")} == set(ids[::2])
    held = store.used_bytes()
    assert held == folder_size(store.root / "scans")
    store = reopened(store)
    assert {scan["id"] for scan in store.documents("scans")} == set(ids[::2])
    store.close()


def test_documents_are_the_callers_own(store: Store) -> None:
    document: dict[str, list[int]] = {"changes": []}
    session = create_session(store, document)
    document["changes"].append(1)
    dict(store.sessions())[session]["changes"].append(2)  # type: ignore[index]
    assert dict(store.sessions())[session]["changes"] == []  # type: ignore[index]


def test_a_zip_keeps_its_name_for_models_that_have_none(store: Store) -> None:
    assert store.file("models", add_model(store, b"PK\x03\x04", "kitchen.zip")).name == "kitchen.zip"
    assert store.file("models", add_model(store, b"<robot/>", "kitchen.xml")).name == "kitchen.urdf"
    assert store.file("models", add_model(store, b"<robot/>", "")).name == "upload.urdf"
