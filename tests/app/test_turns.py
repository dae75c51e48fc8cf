"""Does one client's crowd of long computations leave turns for the others?"""

from __future__ import annotations

import asyncio
from collections import Counter

from app.routes.turns import AT_ONCE, Turns


def test_of_every_client_one_goes_on_and_few_in_all() -> None:
    going_on: Counter[str] = Counter()
    seen: list[Counter[str]] = []

    async def compute(turns: Turns, client: str) -> None:
        async with turns.one(client):
            going_on[client] += 1
            seen.append(Counter(going_on))
            await asyncio.sleep(0.001)
            going_on[client] -= 1

    async def all_at_once() -> None:
        turns = Turns()
        await asyncio.gather(*(compute(turns, client) for client in "aaaaabbbbbcccccd"))

    asyncio.run(all_at_once())
    assert len(seen) == 16
    assert max(max(now.values()) for now in seen) == 1
    assert max(now.total() for now in seen) == AT_ONCE


def test_who_asks_once_does_not_wait_for_another_clients_crowd() -> None:
    order: list[str] = []

    async def compute(turns: Turns, client: str) -> None:
        async with turns.one(client):
            await asyncio.sleep(0.001)
            order.append(client)

    async def crowd_then_one() -> None:
        turns = Turns()
        crowd = [asyncio.create_task(compute(turns, "crowd")) for _ in range(20)]
        await asyncio.sleep(0)
        await compute(turns, "planner")
        await asyncio.gather(*crowd)

    asyncio.run(crowd_then_one())
    assert order.index("planner") <= AT_ONCE


def test_a_call_that_is_given_up_leaves_its_turn() -> None:
    async def give_up() -> None:
        turns = Turns()
        async with turns.one("a"):
            waiting = asyncio.create_task(_take(turns, "a"))
            await asyncio.sleep(0)
            waiting.cancel()
        await asyncio.wait_for(_take(turns, "a"), 60.0)  # else it would wait for ever
        assert len(turns._of) <= 1

    async def _take(turns: Turns, client: str) -> None:
        async with turns.one(client):
            pass

    asyncio.run(give_up())
