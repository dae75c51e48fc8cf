"""What does a JSON file in the data directory do that says something else than the server wrote?"""

from __future__ import annotations

import json
import secrets
import shutil
from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import settings

from app.problems import MEDIA_TYPE
from tests.app.small_sessions import after, ids_of
from tests.app.upload_calls import upload

NOUNS = {"models": "model", "scans": "scan", "recordings": "recording", "sessions": "session"}
RUBBISH: tuple[Any, ...] = (None, 5, -1, 1e300, "x", "\ud800", [], [5], {}, {"a": 5}, True, [{"scan_id": 5}])
# Each member in turn gets another third of it, as members of a kind are read alike; `--hypothesis-profile=search`: all.
IN_TURN = 1 if settings.get_current_profile_name() == "search" else 3


@pytest.fixture(scope="module")
def copies(serve_for_module: Callable[..., Any]) -> tuple[Any, dict[str, list[str]]]:
    """A server that has started with a sound entry of each kind, and a copy for each member and each kind of rubbish;
    and the copies' ids."""
    served = serve_for_module()
    session = after(served.client, 2)
    model, scan = ids_of(served.client, session)
    file = served.client.get(f"{session}/recording").content
    recording = upload(served.client, "recordings", "a.sqlite", file).json()["id"]
    sound = {"models": model, "scans": scan, "recordings": recording, "sessions": session.rpartition("/")[2]}
    served.stop()
    made: dict[str, list[str]] = {}
    for kind, id in sound.items():
        place = served.config.data_dir / kind / id
        document = json.loads((place / f"{NOUNS[kind]}.json").read_text())
        for place_in_turn, member in enumerate(document):
            for rubbish in (*RUBBISH[place_in_turn % IN_TURN :: IN_TURN], ...):
                copy = secrets.token_hex(8)
                made.setdefault(kind, []).append(copy)
                shutil.copytree(place, place.with_name(copy))
                other = {**document, "id": copy, member: rubbish}
                if rubbish is ...:
                    del other[member]
                (place.with_name(copy) / f"{NOUNS[kind]}.json").write_text(json.dumps(other))
    return serve_for_module(data_dir=served.config.data_dir, max_sessions=10_000), made


def test_it_starts_and_tells_what_is_whole(copies: tuple[Any, dict[str, list[str]]]) -> None:
    served, made = copies
    for kind, ids in made.items():
        told = served.client.get(f"/api/v1/{kind}")
        assert told.status_code == 200 and len(told.json()) >= 1
        for id in ids:
            for path in (f"/api/v1/{kind}/{id}", f"/api/v1/sessions/{id}", f"/api/v1/sessions/{id}/estimate"):
                answer = served.client.get(path)
                assert answer.status_code in (200, 404, 409), f"{path}: {answer.status_code} {answer.text[:200]}"
                assert answer.status_code == 200 or answer.headers["Content-Type"] == MEDIA_TYPE
    # a session that does not tell what it was given cannot be reset to it
    lost = [one["id"] for one in served.client.get("/api/v1/sessions").json() if "session.json" in (one["error"] or "")]
    assert lost
    for id in lost:
        said = served.client.get(f"/api/v1/sessions/{id}/estimate").json()["detail"]
        assert said == f"session '{id}' is failed: its session.json is damaged; only delete helps"


def test_it_can_be_removed(copies: tuple[Any, dict[str, list[str]]]) -> None:
    served, made = copies
    for kind in ("sessions", "recordings", "models", "scans"):
        for id in made[kind]:
            answer = served.client.delete(f"/api/v1/{kind}/{id}")
            assert answer.status_code in (204, 404), f"{kind} {id}: {answer.status_code} {answer.text[:200]}"
        assert len(served.client.get(f"/api/v1/{kind}").json()) == 1
