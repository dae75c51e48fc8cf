"""Is a call that is made twice done once? Answers kept by Idempotency-Key, over restarts, for a day."""

from __future__ import annotations

import errno
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest

from app.problems import HttpProblem
from app.store import atomic_files
from app.store.idempotency import KEEP_SECONDS, IdempotencyKeys, call_key
from app.store.store import Store

ROOM = 1 << 24


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    opened = Store(tmp_path / "data", ROOM)
    yield opened
    opened.close()


def reopened(store: Store) -> Store:
    store.close()
    return Store(store.root, ROOM)


def test_a_call_made_twice_is_done_once(store: Store) -> None:
    made = []

    def make() -> dict[str, object]:
        made.append(1)
        return {"id": len(made)}

    assert store.idempotency.once("k", "print", make) == {"id": 1}
    assert store.idempotency.once("k", "print", make) == {"id": 1}
    store = reopened(store)
    assert store.idempotency.once("k", "print", make) == {"id": 1}
    with pytest.raises(HttpProblem, match="was used for a call with other content") as caught:
        store.idempotency.once("k", "other", make)
    assert caught.value.status == 422
    assert store.idempotency.once("other k", "other", make) == {"id": 2}
    assert store.idempotency.once(None, "print", make) == {"id": 3}
    store.close()


def test_a_call_that_failed_may_be_made_again(store: Store) -> None:
    def fail() -> dict[str, object]:
        raise HttpProblem(422, "no")

    with pytest.raises(HttpProblem, match="no"):
        store.idempotency.once("k", "print", fail)
    assert store.idempotency.once("k", "print", lambda: {"id": 1}) == {"id": 1}


def test_the_same_call_at_the_same_time_has_to_wait(store: Store) -> None:
    begun, go_on = threading.Event(), threading.Event()

    def slow() -> dict[str, object]:
        begun.set()
        go_on.wait()
        return {"id": 1}

    first = threading.Thread(target=store.idempotency.once, args=("k", "print", slow))
    first.start()
    begun.wait()
    with pytest.raises(HttpProblem, match="still at work") as caught:
        store.idempotency.once("k", "print", slow)
    assert caught.value.status == 409
    go_on.set()
    first.join()
    assert store.idempotency.once("k", "print", slow) == {"id": 1}


def test_what_was_made_is_answered_even_where_it_cannot_be_remembered(
    store: Store, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "full")

    monkeypatch.setattr(atomic_files, "write_json", full)
    assert store.idempotency.once("k", "print", lambda: {"id": 1}) == {"id": 1}
    assert "could not be kept" in caplog.text


def test_answers_are_forgotten_after_a_day_and_beyond_a_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now = [1000.0]
    (tmp_path / "incoming").mkdir()
    kept = IdempotencyKeys(tmp_path / "remembered", tmp_path / "incoming", lambda: now[0])
    kept.remember("old", "print", {"id": 1})
    now[0] += KEEP_SECONDS - 1
    kept.remember("new", "print", {"id": 2})
    assert kept.remembered("old") is not None
    now[0] += 2
    assert kept.remembered("old") is None
    assert kept.remembered("new") == ("print", {"id": 2})
    assert len(list((tmp_path / "remembered").iterdir())) == 1
    monkeypatch.setattr("app.store.idempotency.MOST", 3)
    for number in range(5):
        kept.remember(f"key {number}", "print", {"id": number})
    assert [kept.remembered(f"key {number}") is not None for number in range(5)] == [False, False, True, True, True]


def test_a_key_belongs_to_its_call() -> None:
    assert call_key("POST /a", "k") != call_key("POST /b", "k")
    assert call_key("POST /a", None) is None
    for header in ("", "x" * 256, "a\tb"):
        with pytest.raises(HttpProblem, match="1 to 255 printable characters"):
            call_key("POST /a", header)
