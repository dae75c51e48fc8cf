"""6: two servers on one host, one browser: the cookie of one is not the other's."""

from __future__ import annotations

from contextlib import ExitStack

import httpx

from tests.app.attacks.outcome import Outcome
from tests.app.attacks.target import Target, own_server

SAME = "one-token-for-two-servers"


def attack(target: Target, outcome: Outcome) -> None:
    """The target, where it has a token, and servers of our own beside it: with another token, and with the same."""
    with ExitStack() as stack:
        first = target if target.token else stack.enter_context(own_server("--token", "the-first-token")).target
        second = stack.enter_context(own_server("--token", "another-token")).target
        outcome.did.append("opened the links of two servers with tokens of their own in one browser")
        _both(outcome, first, second, "two tokens")
        third, fourth = (stack.enter_context(own_server("--token", SAME)).target for _ in range(2))
        outcome.did.append("the same with two servers that were given the same token")
        _both(outcome, third, fourth, "the same token")


def _both(outcome: Outcome, one: Target, other: Target, told: str) -> None:
    with httpx.Client() as browser:
        for server in (one, other):
            answer = browser.get(f"{server.url}/", params={"token": server.token})
            outcome.answered(f"{told}: the link of a server", answer, {303})
        names = [cookie.name for cookie in browser.cookies.jar]
        outcome.happened.append(f"{told}: cookies {', '.join(sorted(names))}")
        for server, which in ((one, "first"), (other, "second")):
            answer = browser.get(f"{server.url}/api/v1/models")
            outcome.answered(f"{told}: GET at the {which} server after both links", answer, {200})
    for giver, taker in ((one, other), (other, one)):
        (_, value), (name, _) = _cookie(giver), _cookie(taker)
        answer = httpx.get(f"{taker.url}/api/v1/models", headers={"Cookie": f"{name}={value}"})
        outcome.answered(f"{told}: one's cookie under the other's name", answer, {401})
    name, value = _cookie(one)
    answer = httpx.get(f"{one.url}/api/v1/models", headers={"Cookie": f"{name}={value}"})
    outcome.answered(f"{told}: a server's own cookie", answer, {200})


def _cookie(server: Target) -> tuple[str, str]:
    """Name and value of the cookie that a server gives."""
    with httpx.Client() as browser:
        browser.get(f"{server.url}/", params={"token": server.token})
        (cookie,) = browser.cookies.jar
        return cookie.name, cookie.value or ""
