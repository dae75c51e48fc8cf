"""What is a session called that nobody has named? By what it looks for, and in which scan."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from app.problems import HttpProblem
from app.sessions.document import Document
from app.store.store import Kind, Store

# Characters, as many as a name that is given may have.
LONGEST = 200


def named(document: Mapping[str, Any], store: Store) -> Document:
    """The document, called by the files of its model and scans where it has no name."""
    name = str(document.get("name") or "").strip()
    return {**document, "name": name or _readable(document, store)}


def _readable(document: Mapping[str, Any], store: Store) -> str:
    """Such as "cabinet in depth.png", or "cabinet in left.png and 2 others"."""
    scans = document.get("scan_ids") or [""]
    model = _told(store, "models", str(document.get("model_id")), "name") or "an object"
    scan = _told(store, "scans", scans[0], "file_name") or "a scan"
    others = len(scans) - 1
    more = f" and {others} other{'s' if others > 1 else ''}" if others else ""
    both = LONGEST - len(more) - len(" in ")
    # the scan's name tells sessions of one model apart, so it is the model's that is cut first
    scan = _cut(scan, both - min(len(model), both // 4))
    return f"{_cut(model, both - len(scan))} in {scan}{more}"


def _told(store: Store, kind: Kind, id: str, member: str) -> str:
    """A member of an entry's document, on one line; empty where the entry is not here: whoever needs it will say so."""
    try:
        return " ".join(str(store.document(kind, id).get(member) or "").split())
    except HttpProblem:
        return ""


def _cut(text: str, length: int) -> str:
    return text if len(text) <= length else f"{text[: length - 1]}…"
