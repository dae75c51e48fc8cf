"""Does any damaged upload hurt the server? A hundred here; `python -m tests.app.upload_attack URL` sends thousands."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import httpx
import pytest

from tests.app import mutations, upload_attack

COUNT = 60


def test_damaged_uploads_do_no_harm(served: Any) -> None:
    outcome = upload_attack.attack(served.client, COUNT, seed=1)
    assert outcome.failures == []
    assert sum(outcome.statuses.values()) == COUNT
    # an attack that is all taken in, or all refused at the door, would test little
    assert outcome.statuses[201] > 5 and outcome.statuses[422] > 30 and outcome.statuses[400] > 0
    assert list((served.config.data_dir / "incoming").iterdir()) == []


def test_the_unharmed_originals_are_taken_in(served: Any) -> None:
    answers = [upload_attack.send(served.client, sample) for sample in mutations.samples()]
    assert [answer.status_code for answer in answers] == [201] * len(answers)
    kinds = {sample.file_name.rpartition(".")[2] for sample in mutations.samples()}
    assert kinds == {"urdf", "zip", "png", "pcd", "ply", "xyz", "npy", "npz", "sqlite"}


def test_the_same_seed_gives_the_same_damage() -> None:
    def first(seed: int) -> list[bytes]:
        source = mutations.mutations(random.Random(seed))
        return [next(source).content for _ in range(50)]

    # archives carry the time they were made at
    assert [len(content) for content in first(1)] == [len(content) for content in first(1)]
    assert first(1)[0] == first(1)[0]
    assert first(1) != first(2)


def _answer(
    status: int, seconds: float = 0.1, kind: str = "application/problem+json", **members: Any
) -> httpx.Response:
    import datetime

    answer = httpx.Response(status, json=members)
    answer.headers["Content-Type"] = kind
    answer.elapsed = datetime.timedelta(seconds=seconds)
    return answer


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (lambda: _answer(500, detail="internal error"), "answered 500"),
        (lambda: _answer(422, 15.0, detail="no"), "after 15.0 s"),
        (lambda: _answer(422, kind="application/json", detail="no"), "as application/json"),
        (lambda: _answer(422, detail=""), "says ''"),
        (lambda: _answer(422, detail="cannot read /tmp/incoming/x"), "says"),
        (lambda: _answer(302, detail="no"), "answered 302"),
        (lambda: _answer(201, id=""), "without an id"),
    ],
)
def test_a_bad_answer_is_seen(answer: Callable[[], httpx.Response], says: str) -> None:
    assert says in (upload_attack.objection(answer()) or "")


def test_a_good_answer_passes() -> None:
    assert upload_attack.objection(_answer(422, detail="scan 'x' is damaged")) is None
    assert upload_attack.objection(_answer(201, id="0123456789abcdef")) is None
