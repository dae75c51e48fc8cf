"""What has been given to the server and must not be lost? Models, scans, sessions and recordings in one folder.

| folder | an entry is a folder with |
| --- | --- |
| `models/ID/` | `model.json`, the URDF or zip as it was uploaded |
| `scans/ID/` | `scan.json`, `scan.npz` (depth image and camera) |
| `sessions/ID/` | `session.json`, `recording.sqlite` |
| `recordings/ID/` | `recording.json`, `recording.sqlite` |
| `remembered/` | answers to calls that carried an `Idempotency-Key`: commands, and those whose entry is deleted |
| `incoming/` | uploads and entries that are not whole yet; emptied at every start |

An entry comes to be by one rename (`atomic_files`), so at every instant it is there, whole, or not at all; the answer
to the call that made it lies beside it (`idempotency`). But for sessions, and the names of recordings, none changes.
"""

from __future__ import annotations

import copy
import fcntl
import hashlib
import re
import secrets
import shutil
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal

from app.problems import HttpProblem
from app.store import atomic_files
from app.store.disk_room import DiskRoom, folder_size
from app.store.idempotency import ANSWER, Call, IdempotencyKeys
from app.store.stored_documents import is_sound
from app.store.stored_scan import UNREADABLE, read_scan
from pmpnbp.errors import PmpnbpError, storage_told
from pmpnbp.scene.observation import Scan

Document = dict[str, Any]

Kind = Literal["models", "scans", "sessions", "recordings"]
KINDS: Mapping[Kind, str] = {"models": "model", "scans": "scan", "sessions": "session", "recordings": "recording"}
# The file in an entry, where its name is always the same.
_FILES: Mapping[Kind, str] = {"scans": "scan.npz", "recordings": "recording.sqlite"}
_ID = re.compile(r"[0-9a-f]{16}")


class StoreError(PmpnbpError):
    """The data directory cannot be used."""


@dataclass
class Staging:
    """An upload on its way in. folder : its own, on the store's file system, removed afterwards; claimed : bytes."""

    folder: Path
    room: DiskRoom
    claimed: int = 0

    def claim(self, count: int) -> None:
        """Set `count` bytes aside before they are written. Raises HttpProblem 507, StorageError."""
        self.room.claim(count)
        self.claimed += count


class Store:
    """The data directory. Thread-safe; one process at a time. Raises StoreError where `root` cannot be used."""

    def __init__(self, root: Path, max_bytes: int) -> None:
        self.root = root
        self._lock = threading.RLock()
        self._incoming = root / "incoming"
        try:
            for name in (*KINDS, "incoming"):
                (root / name).mkdir(parents=True, exist_ok=True)
            self._lock_file = (root / ".lock").open("w")
        except OSError as error:
            raise StoreError(f"the data directory '{root}' cannot be used: {error.strerror}") from None
        try:
            # POSIX locks are a process's own and end with it, however it ends.
            fcntl.lockf(self._lock_file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._lock_file.close()
            raise StoreError(f"the data directory '{root}' is in use by another server") from None
        for left in self._incoming.iterdir():
            if left.is_dir() and not left.is_symlink():
                shutil.rmtree(left, ignore_errors=True)
            else:
                left.unlink(missing_ok=True)
        self._room = DiskRoom(root / "sessions", max_bytes)
        self._documents: dict[Kind, dict[str, Document | None]] = {}
        # sessions that are being made
        self._drafts: dict[str, Document] = {}
        answers: list[Path] = []
        for kind, noun in KINDS.items():
            places = [place for place in (root / kind).iterdir() if _ID.fullmatch(place.name) and place.is_dir()]
            read = {place.name: _whole(place / f"{noun}.json") for place in places}
            self._documents[kind] = dict(sorted(read.items(), key=lambda entry: _created(entry[1])))
            if kind != "sessions":
                self._room.entry(sum(folder_size(place) for place in places))
            answers += [place / ANSWER for place in places if (place / ANSWER).is_file()]
        self.idempotency = IdempotencyKeys(root / "remembered", answers)

    def close(self) -> None:
        """Let another process have the directory."""
        self._lock_file.close()

    def used_bytes(self) -> int:
        """Bytes that the data directory holds, and those set aside for what is on its way in."""
        return self._room.used()

    @contextmanager
    def staging(self) -> Iterator[Staging]:
        """A folder for an upload, removed at the end with whatever is still in it."""
        folder = self._unfinished("upload")
        with storage_told():
            folder.mkdir()
        staging = Staging(folder, self._room)
        try:
            yield staging
        finally:
            shutil.rmtree(folder, ignore_errors=True)
            self._room.release(staging.claimed)

    # Models, scans and recordings

    def add(
        self, kind: Kind, staged: Path, file_name: str, summary: Mapping[str, Any], call: Call | None = None
    ) -> Document:
        """Take in what its sender calls `file_name`; the entry's document, which answers `call`.

        staged : moved away: a URDF or zip, what `stored_scan.write_scan` wrote, or a recording
        """
        id, noun = _new_id(), KINDS[kind]
        name = _FILES.get(kind) or _model_file(staged, file_name)
        document = {
            "id": id,
            **summary,
            "file_name": file_name,
            "created": _now(),
            "sha256": sha256_of(staged),
            "bytes": staged.stat().st_size,
            "file": name,
        }
        place = self.root / kind / id
        documents = {f"{noun}.json": document, **_answer(call, document)}
        size = atomic_files.create_folder(self._unfinished(), place, {name: staged}, documents)
        with self._lock:
            self._documents[kind][id] = document
            self._room.entry(size)
        self.idempotency.landed(call, place)
        return dict(document)

    def load_scan(self, id: str) -> Scan:
        """The scan, bit for bit as the library read it from the upload. HttpProblem 404."""
        file = self.file("scans", id)
        try:
            return read_scan(file)
        except UNREADABLE:
            raise HttpProblem(404, f"scan '{id}' is damaged: its {file.name} cannot be read") from None

    def rename_recording(self, id: str, name: str) -> Document:
        """Call a recording something else; its document. HttpProblem 404, StorageError."""
        with self._lock:
            document = {**self.document("recordings", id), "name": name}
            place = self.root / "recordings" / id
            size = folder_size(place)
            atomic_files.replace_json(self._unfinished(), place / "recording.json", document)
            self._room.entry(folder_size(place) - size)
            self._documents["recordings"][id] = document
        return dict(document)

    # Sessions

    @contextmanager
    def session_draft(self, document: Mapping[str, Any]) -> Iterator[Document]:
        """Make a session's folder that nobody sees until `land_session`, and that is gone at the end without it; its
        document, to which `id` and `created` are added. HttpProblem 404 where its model or a scan is not here."""
        id = _new_id()
        draft = {**copy.deepcopy(dict(document)), "id": id, "created": document.get("created") or _now()}
        with self._lock:
            self._check_uses(draft)
            self._drafts[id] = draft  # from here on what it uses cannot be deleted
        folder = self.session_folder(id)
        try:
            with storage_told():
                folder.mkdir()
            yield copy.deepcopy(draft)
        finally:
            with self._lock:
                self._drafts.pop(id, None)
            shutil.rmtree(folder, ignore_errors=True)

    def land_session(self, id: str, response: Mapping[str, Any], call: Call | None = None) -> None:
        """Let a draft's folder, in which nothing may be open, become a session's; `response` answers `call`."""
        place = self.root / "sessions" / id
        with self._lock:
            documents = {"session.json": self._drafts[id], **_answer(call, response)}
            atomic_files.land_folder(self.session_folder(id), place, documents)
            self._documents["sessions"][id] = self._drafts.pop(id)
        self.idempotency.landed(call, place)

    def write_session(self, id: str, document: Mapping[str, Any]) -> None:
        """Replace a session's document. HttpProblem 404 where it, its model or a scan is not here."""
        with self._lock:
            if id in self._drafts:  # written when it lands
                self._drafts[id] = copy.deepcopy(dict(document))
                return
            place = self.session_folder(id) / "session.json"
            self._check_uses(document)
            atomic_files.replace_json(self._unfinished(), place, document)
            self._documents["sessions"][id] = copy.deepcopy(dict(document))

    def sessions(self) -> list[tuple[str, Document | None]]:
        """Every session's id and document, oldest first; None where the document is damaged."""
        with self._lock:
            return list(copy.deepcopy(self._documents["sessions"]).items())

    def session_folder(self, id: str) -> Path:
        """The folder of a session. HttpProblem 404."""
        with self._lock:
            if id in self._drafts:
                return atomic_files.there(self._incoming) / f"{id}.session"
            self._check_there("sessions", id)
            return self.root / "sessions" / id

    # All kinds alike

    def documents(self, kind: Kind) -> list[Document]:
        """Every entry's document, oldest first."""
        with self._lock:
            known = [(id, document) for id, document in self._documents[kind].items() if document is not None]
        return [dict(document) for id, document in known if self._there(kind, id)]

    def document(self, kind: Kind, id: str) -> Document:
        """An entry's document: `id`, `created`, and what its kind has. HttpProblem 404."""
        with self._lock:
            self._check_there(kind, id)
            document = self._documents[kind][id]
        if document is None:
            raise HttpProblem(404, f"{KINDS[kind]} '{id}' is damaged: its {KINDS[kind]}.json cannot be read")
        return dict(document)

    def file(self, kind: Kind, id: str) -> Path:
        """An entry's file, to read only. HttpProblem 404."""
        file = self.root / kind / id / str(self.document(kind, id).get("file", "file"))
        if not file.is_file():
            raise HttpProblem(404, f"{KINDS[kind]} '{id}' is damaged: its {file.name} is gone")
        return file

    def delete(self, kind: Kind, id: str) -> None:
        """Forget an entry; nobody may have a session's recording open for writing. HttpProblem 404, and 409 where a
        session uses it."""
        with self._lock:
            self._check_known(kind, id)
            sessions = {**self._documents["sessions"], **self._drafts}
            users = [session for session, document in sessions.items() if id in _uses(document, kind)]
            if users:
                more = f" and {len(users) - 1} more" if len(users) > 1 else ""
                raise HttpProblem(409, f"{KINDS[kind]} '{id}' is used by session '{users[0]}'{more}; delete it first")
            place = self.root / kind / id
            size = folder_size(place)
            self.idempotency.keep(place)
            atomic_files.remove_folder(self._unfinished(), place)
            del self._documents[kind][id]
            if kind == "sessions":
                self._room.sessions_changed()
            else:
                self._room.entry(-size)

    def _check_known(self, kind: Kind, id: str) -> None:
        known = self._documents[kind]
        if id not in known:
            there = f"there is 1 {KINDS[kind]}" if len(known) == 1 else f"there are {len(known)} {kind}"
            raise HttpProblem(404, f"{KINDS[kind]} '{id:.40}' is not here; {there}")

    def _check_there(self, kind: Kind, id: str) -> None:
        self._check_known(kind, id)
        if not self._there(kind, id):
            raise HttpProblem(404, f"{KINDS[kind]} '{id}' is gone: somebody has removed its folder; delete it")

    def _there(self, kind: Kind, id: str) -> bool:
        return (self.root / kind / id).is_dir()

    def _check_uses(self, document: Mapping[str, Any]) -> None:
        kinds: tuple[Kind, ...] = ("models", "scans")
        for kind in kinds:
            for id in _uses(document, kind):
                self._check_there(kind, id)

    def _unfinished(self, suffix: str = "partial") -> Path:
        return atomic_files.there(self._incoming) / f"{_new_id()}.{suffix}"


def _model_file(staged: Path, file_name: str) -> str:
    """The name of a URDF or zip in its entry; the stem is the model's name where the URDF says none."""
    with staged.open("rb") as file:
        suffix = ".zip" if file.read(2) == b"PK" else ".urdf"
    return f"{Path(safe_name(file_name)).stem}{suffix}"


def safe_name(name: str) -> str:
    """`name` as a file name without folders that is safe anywhere: letters, digits, `.`, `-`, `_`; never empty."""
    last = re.split(r"[/\\]", name)[-1]
    stem, dot, suffix = last.rpartition(".")
    cleaned = re.sub(r"[^A-Za-z0-9._-]", "_", stem if dot else last).lstrip(".")[:80] or "upload"
    kept = re.sub(r"[^A-Za-z0-9]", "", suffix)[:10] if dot else ""
    return f"{cleaned}.{kept}" if kept else cleaned


def _answer(call: Call | None, response: Mapping[str, Any]) -> dict[str, Document]:
    """The answer to `call` as a file of the entry that it makes."""
    return {} if call is None else {ANSWER: call.answered(response)}


def _uses(document: Mapping[str, Any] | None, kind: Kind) -> set[str]:
    """Ids of the models or scans that a session's document names."""
    if document is None or kind not in ("models", "scans"):
        return set()
    if kind == "models":
        return {document["model_id"]} if document.get("model_id") else set()
    added = [change.get("scan_id") for change in document.get("changes") or ()]
    return {id for id in (*(document.get("scan_ids") or ()), *added) if id}


def _whole(path: Path) -> Document | None:
    document = atomic_files.read_json(path)
    return document if document is not None and is_sound(document) else None


def _created(document: Document | None) -> str:
    return str((document or {}).get("created", ""))


def _new_id() -> str:
    return secrets.token_hex(8)


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


def sha256_of(path: Path) -> str:
    """The digest by which entries tell their file."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
