"""When does news reach the streams of events?"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable

from app.routes import event_stream
from app.routes.event_stream import AT_ONCE, PAUSE, SECONDS_AT_MOST, News, news


class Source:
    """What tells its listeners."""

    def __init__(self) -> None:
        self.listeners: list[Callable[..., None]] = []

    def listen(self, wake: Callable[..., None]) -> Callable[[], None]:
        self.listeners.append(wake)
        return lambda: self.listeners.remove(wake)

    def tell(self, *words: str) -> None:
        for wake in list(self.listeners):
            wake(*words)


def test_words_come_once_each_in_their_order_from_any_thread() -> None:
    async def heard() -> list[str]:
        source = Source()
        with news(source.listen) as found:
            thread = threading.Thread(target=lambda: [source.tell(word) for word in ("b", "a", "b", "c")])
            thread.start()
            thread.join()
            return await found.words()

    assert asyncio.run(heard()) == ["b", "a", "c"]


def test_who_listens_alone_does_not_wait() -> None:
    """After news that came just now the next comes a pause later, and no more."""

    async def heard() -> list[list[str]]:
        source = Source()
        found = []
        with news(source.listen) as one:
            for word in "abc":
                source.tell(word)
                found.append(await one.words(seconds=5.0))
        return found

    assert asyncio.run(heard()) == [["a"], ["b"], ["c"]]


def test_many_hear_in_turn_and_none_is_forgotten() -> None:
    """Those that wait longest first: nobody hears twice before everybody has heard once."""

    async def order() -> list[int]:
        source, found = Source(), []
        count = 7 * AT_ONCE

        async def hear(number: int) -> None:
            with news(source.listen) as one:
                for _ in range(2):
                    await one.words(seconds=60.0)
                    found.append(number)
                    if len(found) % AT_ONCE == 0:
                        source.tell("more")

        tasks = [asyncio.create_task(hear(number)) for number in range(count)]
        await asyncio.sleep(0)
        source.tell("first")
        await asyncio.gather(*tasks)
        return found

    found = asyncio.run(order())
    count = len(found) // 2
    assert sorted(found[:count]) == sorted(found[count:]) == list(range(count))


def test_so_many_that_one_would_wait_too_long() -> None:
    """They are told in larger groups; a loop whose clock stands still but for its timers counts the seconds."""

    class Loop(asyncio.SelectorEventLoop):
        now = 0.0

        def time(self) -> float:
            return self.now

        def call_at(self, when, callback, *arguments, context=None):  # type: ignore[no-untyped-def]
            if callback.__qualname__.startswith(event_stream._Post.__qualname__):
                self.now = max(self.now, when)
                return self.call_soon(callback, *arguments, context=context)
            return super().call_at(when, callback, *arguments, context=context)

    async def seconds() -> float:
        loop = asyncio.get_running_loop()
        source = Source()
        count = round(4 * AT_ONCE * SECONDS_AT_MOST / PAUSE)
        listening = [News() for _ in range(count)]
        for one in listening:
            source.listen(one.tell)
        source.tell("all")
        for one in listening:
            assert await one.words(seconds=1e6) == ["all"]
        return loop.time()

    with asyncio.Runner(loop_factory=Loop) as runner:
        # the rest, too small a group at last, is told a few at a time
        assert runner.run(seconds()) < 6 * SECONDS_AT_MOST
