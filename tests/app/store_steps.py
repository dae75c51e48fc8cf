"""Kill a store's work at every step it makes on the disk, and say what the next start finds.

A process of its own, as it forks. Prints a JSON line for each action: how many steps it was killed at, and what was
wrong afterwards. Run it: `python -m tests.app.store_steps FOLDER`.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from app.store.disk_room import folder_size
from app.store.idempotency import Call
from app.store.store import KINDS, Store
from app.store.stored_scan import write_scan
from pmpnbp.geometry.camera import Camera
from pmpnbp.scene.observation import Scan

# Everything that changes what is on the disk is announced to an audit hook before it happens.
STEPS = ("open", "os.rename", "os.mkdir", "os.remove", "os.rmdir", "os.truncate", "os.link")
MAX_BYTES = 1 << 30
SCAN = Scan(Camera(3, 2, 1.0, 1.0, 1.0, 0.5), np.arange(1, 7, dtype=np.float32).reshape(2, 3))


def main(folder: Path) -> None:
    """Every action, killed at each of its steps in turn."""
    base = folder / "base"
    first = _base(base)
    actions: dict[str, Callable[[Store], object]] = {
        "add_model": _add_model,
        "add_scan": _add_scan,
        "delete_scan": lambda store: store.delete("scans", first["free"]),
        "create_session": lambda store: create_session(store, {"scan_ids": [first["used"]], "name": "new"}),
        "create_session_with_key": lambda store: _create_with_key(store, first["used"]),
        "write_session": lambda store: store.write_session(first["session"], {"id": first["session"], "name": "new"}),
        "delete_session": lambda store: store.delete("sessions", first["session"]),
        "add_model_with_key": lambda store: _with_key(store, "new key"),
        "delete_model_with_key": lambda store: store.delete("models", first["model"]),
    }
    for name, action in actions.items():
        step, wrong = 0, []
        before, after = _seen(base), None
        done = False
        found = []
        while not done:
            step += 1
            root = folder / f"{name}-{step}"
            shutil.copytree(base, root)
            done = _run(root, action, step)
            found.append(_seen(root))
            if done:
                after = found[-1]
            wrong += [f"step {step}: {line}" for line in _damage(root)]
            shutil.rmtree(root)
        if _shape(before) == _shape(after):
            wrong.append("the action changed nothing")
        for number, seen in enumerate(found, 1):
            if _shape(seen) not in (_shape(before), _shape(after)):
                wrong.append(f"step {number}: neither before nor after")
        print(json.dumps({"action": name, "steps": step - 1, "wrong": wrong}))


def _base(root: Path) -> dict[str, str]:
    store = Store(root, MAX_BYTES)
    used, free = _add_scan(store), _add_scan(store)
    model = _with_key(store, "a key")
    session = create_session(store, {"scan_ids": [used], "name": "old"})
    store.close()
    return {"used": used, "free": free, "session": session, "model": model}


def create_session(store: Store, document: Mapping[str, Any], call: Call | None = None) -> str:
    """A session with a recording that none is; its id."""
    with store.session_draft(document) as draft:
        (store.session_folder(draft["id"]) / "recording.sqlite").write_bytes(b"x" * 5000)
        store.land_session(draft["id"], {"id": "a session"}, call)
    return str(draft["id"])


def _create_with_key(store: Store, scan: str) -> None:
    def make(call: Call | None) -> dict[str, Any]:
        create_session(store, {"scan_ids": [scan], "name": "new"}, call)
        return {}

    store.idempotency.once("new key", "print", make)


def _with_key(store: Store, key: str) -> str:
    """The id of a model that a call with a key has made."""
    return str(store.idempotency.once(key, "print", lambda call: {"id": _add_model(store, call)})["id"])


def _add_scan(store: Store) -> str:
    with store.staging() as staging:
        write_scan(staging.folder / "scan.npz", SCAN)
        return str(store.add("scans", staging.folder / "scan.npz", "a.pcd", {"points": 6})["id"])


def _add_model(store: Store, call: Call | None = None) -> str:
    with store.staging() as staging:
        (staging.folder / "a.urdf").write_text("<robot/>")
        return str(store.add("models", staging.folder / "a.urdf", "a.urdf", {"name": "a"}, call)["id"])


def _run(root: Path, action: Callable[[Store], object], step: int) -> bool:
    """Let a child begin `action` and die before its `step`-th change of the disk; whether it came to its end."""
    child = os.fork()
    if child == 0:
        left = step
        store = Store(root, MAX_BYTES)

        def count(event: str, arguments: tuple[object, ...]) -> None:
            nonlocal left
            if event in STEPS:
                left -= 1
                if left == 0:
                    os._exit(9)

        sys.addaudithook(count)
        try:
            action(store)
        except BaseException:
            os._exit(1)
        os._exit(0)
    status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if status == 1:
        raise SystemExit(f"the action failed in {root.name}")
    return status == 0


def _seen(root: Path) -> dict[str, object]:
    """What the next start finds."""
    store = Store(root, MAX_BYTES)
    try:
        seen: dict[str, object] = {kind: store.documents(kind) for kind in ("models", "scans", "recordings")}
        keys = {key: _known(store, key) for key in ("a key", "new key")}
        return seen | {"sessions": dict(store.sessions()), "keys": keys}
    finally:
        store.close()


def _shape(seen: dict[str, object] | None) -> object:
    """What does not depend on chance: how many entries, and what sessions and the key say."""
    if seen is None:
        return None
    counts = [len(seen[kind]) for kind in KINDS]  # type: ignore[arg-type]
    names = sorted(str(found and found.get("name")) for found in seen["sessions"].values())  # type: ignore[attr-defined]
    return counts, names, seen["keys"]


def _known(store: Store, key: str) -> bool:
    """Whether a call with the key is answered without being made."""
    made: list[Call | None] = []
    store.idempotency.once(key, "print", lambda call: made.append(call) or {})  # type: ignore[func-returns-value]
    return not made


def _damage(root: Path) -> list[str]:
    wrong = []
    store = Store(root, MAX_BYTES)
    for scan in store.documents("scans"):
        if not np.array_equal(store.load_scan(scan["id"]).depth, SCAN.depth):
            wrong.append("a scan is damaged")
    for model in store.documents("models"):
        if store.file("models", model["id"]).read_text() != "<robot/>":
            wrong.append("a model is damaged")
    if any(document is None for _, document in store.sessions()):
        wrong.append("a session is damaged")
    if any((root / "incoming").iterdir()):
        wrong.append("incoming/ is not empty")
    for kind in KINDS:
        entries = store.documents(kind)
        listed = {entry["id"] for entry in entries}
        if {place.name for place in (root / kind).iterdir()} != listed:
            wrong.append(f"{kind}/ holds a folder that is not listed")
    if store.used_bytes() != sum(folder_size(root / kind) for kind in KINDS):
        wrong.append("the bytes are not counted right")
    store.close()
    return wrong


if __name__ == "__main__":
    main(Path(sys.argv[1]))
