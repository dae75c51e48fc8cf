"""Is a call that is made twice done once? Answers kept by Idempotency-Key, over restarts, for a day."""

from __future__ import annotations

import errno
import hashlib
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from app.problems import HttpProblem
from app.store import atomic_files, idempotency
from app.store.idempotency import ANSWER, KEEP_SECONDS, Call, IdempotencyKeys, call_key
from app.store.store import Store
from pmpnbp.errors import StorageError

ROOM = 1 << 24


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    opened = Store(tmp_path / "data", ROOM)
    yield opened
    opened.close()


def reopened(store: Store) -> Store:
    store.close()
    return Store(store.root, ROOM)


def uploaded(store: Store, key: str | None = "k", fingerprint: str = "print") -> dict[str, Any]:
    """The answer to an upload with a key."""

    def make(call: Call | None) -> dict[str, Any]:
        with store.staging() as staging:
            (staging.folder / "x").write_text("<robot/>")
            return store.add("models", staging.folder / "x", "a.urdf", {}, call)

    return store.idempotency.once(key, fingerprint, make)


def test_a_call_made_twice_is_done_once(store: Store) -> None:
    first = uploaded(store)
    assert uploaded(store) == first
    store = reopened(store)
    assert uploaded(store) == first
    with pytest.raises(HttpProblem, match="was used for a call with other content") as caught:
        uploaded(store, fingerprint="other")
    assert caught.value.status == 422
    others = [uploaded(store, "other k", "other"), uploaded(store, None), uploaded(store, None)]
    assert len({entry["id"] for entry in (first, *others)}) == len(store.documents("models")) == 4
    store.close()


def test_a_call_is_not_made_again_when_its_entry_is_deleted(store: Store) -> None:
    first = uploaded(store)
    store.delete("models", first["id"])
    assert uploaded(store) == first
    store = reopened(store)
    assert uploaded(store) == first
    assert store.documents("models") == []
    store.close()


def test_a_call_that_failed_may_be_made_again(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "full")

    with monkeypatch.context() as patch:
        patch.setattr(atomic_files, "write_json", full)  # where its answer cannot be kept, nor can what it made
        with pytest.raises(StorageError):
            uploaded(store)
    assert store.documents("models") == []
    assert [uploaded(store)] == store.documents("models")


def test_the_same_call_at_the_same_time_has_to_wait(store: Store) -> None:
    begun, go_on = threading.Event(), threading.Event()

    def slow(call: Call | None) -> dict[str, Any]:
        begun.set()
        go_on.wait()
        return {}

    first = threading.Thread(target=store.idempotency.once, args=("k", "print", slow))
    first.start()
    begun.wait()
    with pytest.raises(HttpProblem, match="still at work") as caught:
        uploaded(store)
    assert caught.value.status == 409
    go_on.set()
    first.join()
    assert uploaded(store)["id"]


def test_answers_are_forgotten_after_a_day_and_beyond_a_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now, made = [1000.0], []
    kept = IdempotencyKeys(tmp_path / "remembered", now=lambda: now[0])

    def call(key: str) -> int:
        """How often the call was made."""

        def make(call: Call | None) -> dict[str, Any]:
            assert call is not None
            entry = tmp_path / f"entry {len(made)}"
            made.append(key)
            entry.mkdir()
            atomic_files.write_json(entry / ANSWER, call.answered({}))
            kept.landed(call, entry)
            return {}

        kept.once(key, "print", make)
        return made.count(key)

    call("old")
    now[0] += KEEP_SECONDS - 1
    call("new")
    assert call("old") == 1
    now[0] += 2
    assert call("old") == 2 and call("new") == 1
    assert len(list(tmp_path.glob(f"*/{ANSWER}"))) == 2
    monkeypatch.setattr("app.store.idempotency.MOST", 3)
    for number in range(5):
        call(f"key {number}")
    assert [call(f"key {number}") for number in (4, 3, 2, 1)] == [1, 1, 1, 2]


def commanded(store: Store, done: list[str], key: str = "k", fingerprint: str = "print") -> dict[str, Any]:
    """The answer to a command: how often it was done."""

    def act() -> dict[str, Any]:
        done.append(key)
        return {"times": len(done)}

    return store.idempotency.once(key, fingerprint, lambda call: store.idempotency.command(call, act))


def test_a_command_is_done_once_over_restarts(store: Store) -> None:
    done: list[str] = []
    assert commanded(store, done) == commanded(store, done) == {"times": 1}
    store = reopened(store)
    assert commanded(store, done) == {"times": 1}
    assert commanded(store, done, "another") == {"times": 2}
    with pytest.raises(HttpProblem, match="other content"):
        commanded(store, done, fingerprint="other")
    assert store.idempotency.command(None, lambda: {"without": "a key"}) == {"without": "a key"}
    store.close()


def test_a_command_in_which_the_server_was_killed_is_not_done_again(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The answer cannot be written any more, as where the disk is full: what the next start finds is the same."""
    done: list[str] = []
    written, write = [], idempotency.replace_json

    def once(partial: Path, place: Path, document: Any) -> None:
        written.append(document["response"])
        if len(written) > 1:
            partial.write_text("half of it")
            raise StorageError("the disk is full")
        write(partial, place, document)

    with monkeypatch.context() as patch:
        patch.setattr(idempotency, "replace_json", once)
        assert commanded(store, done) == {"times": 1}
    assert written == [None, {"times": 1}]
    for _ in range(2):
        with pytest.raises(HttpProblem, match="whether it was done is not known, so see how things stand") as caught:
            commanded(store, done)
        assert caught.value.status == 409 and done == ["k"]
        store = reopened(store)
    assert [place.suffix for place in (store.root / "remembered").iterdir()] == [".json"]
    store.close()


def test_a_command_is_not_begun_where_that_cannot_be_written(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    done: list[str] = []

    def full(*_: object) -> None:
        raise StorageError("the disk is full")

    with monkeypatch.context() as patch:
        patch.setattr(idempotency, "replace_json", full)
        with pytest.raises(StorageError):
            commanded(store, done)
    assert done == []
    assert commanded(store, done) == {"times": 1}


def test_answers_of_an_older_store_are_still_given(store: Store) -> None:
    name = hashlib.sha256(b"k").hexdigest()
    atomic_files.write_json(
        store.root / "remembered" / f"{name}.json", {"fingerprint": "print", "response": {"id": "old"}, "at": 0.0}
    )
    store = reopened(store)
    assert uploaded(store) == {"id": "old"}
    store.close()


def test_a_key_belongs_to_its_call() -> None:
    assert call_key("POST /a", "k") != call_key("POST /b", "k")
    assert call_key("POST /a", None) is None
    for header in ("", "x" * 256, "a\tb"):
        with pytest.raises(HttpProblem, match="1 to 255 printable characters"):
            call_key("POST /a", header)
