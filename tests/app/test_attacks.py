"""The quick ones of the attacks, and whether a script that says "held" could say otherwise. `python -m
tests.app.attacks URL` makes them all."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import Any

import httpx
import pytest

from tests.app.attacks.__main__ import attack
from tests.app.attacks.entries import packed_zeros
from tests.app.attacks.outcome import Outcome
from tests.app.attacks.target import Target


@pytest.mark.parametrize("name", ["text", "slashes"])
def test_the_server_holds(serve: Callable[..., Any], name: str) -> None:
    served = serve().ready()
    outcome = attack(name, Target(served.url))
    assert not outcome.broken, str(outcome)
    for kind in ("models", "scans", "sessions", "recordings"):  # it cleans up
        assert served.client.get(f"/api/v1/{kind}").json() == []


def test_an_attack_that_cannot_go_on_is_no_success() -> None:
    outcome = attack("slashes", Target("http://127.0.0.1:1"))
    assert len(outcome.broken) == 1 and "the attack could not go on: ConnectError" in outcome.broken[0]
    assert str(outcome).startswith("8 names with a slash: BROKEN")


@pytest.mark.parametrize(("status", "among", "held"), [(200, None, True), (500, None, False), (404, {200}, False)])
def test_an_answer_is_held_against_what_was_expected(status: int, among: set[int] | None, held: bool) -> None:
    outcome = Outcome("some attack")
    outcome.answered("GET /it", httpx.Response(status, json={"detail": "why"}), among)
    assert outcome.broken == ([] if held else [f"GET /it: {status} 'why'"])


def test_a_bomb_is_what_it_says() -> None:
    assert zlib.decompress(packed_zeros(32 << 20)) == bytes(32 << 20)
