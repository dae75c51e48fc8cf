"""Upload calls of tests, and what they look for afterwards."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import httpx

CABINET = Path(__file__).resolve().parents[2] / "sample_data" / "cabinet"


def upload(
    client: httpx.Client, kind: str, name: str, content: Any, headers: dict[str, str] | None = None, **data: str
) -> httpx.Response:
    return client.post(f"/api/v1/{kind}", files={"file": (name, content)}, data=data, headers=headers)


def detail(answer: httpx.Response, status: int) -> str:
    """The sentence of a problem with this status."""
    assert answer.status_code == status, answer.text
    assert answer.headers["Content-Type"] == "application/problem+json"
    return str(answer.json()["detail"])


def nothing_kept(served: Any) -> bool:
    folders = ("incoming", "models", "scans", "recordings")
    return not any(list((served.config.data_dir / folder).iterdir()) for folder in folders)


def emptied(served: Any) -> Any:
    """The server with nothing in its store."""
    store = served.app.state.store
    for kind in ("models", "scans", "recordings"):
        for document in store.documents(kind):
            store.delete(kind, document["id"])
    return served
