"""An answer's head waits for what follows it at once, and for nothing else."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import pytest

from app.http.answers import Answers


class Sent:
    """A transport that notes what is sent, and that it is closed."""

    def __init__(self) -> None:
        self.seen: list[bytes | str] = []

    def write(self, data: bytes) -> None:
        self.seen.append(data)

    def close(self) -> None:
        self.seen.append("closed")

    def is_closing(self) -> bool:
        return "closed" in self.seen


def whole(answers: Answers) -> None:
    answers.write(b"head ")
    answers.write(b"body")
    answers.write(b"")  # as at the end of a message


def empty(answers: Answers) -> None:
    answers.write(b"head")
    answers.write(b"")


def in_pieces(answers: Answers) -> None:
    answers.write(b"head 1")
    answers.write(b"2")
    answers.write(b"3")


def broken_off(answers: Answers) -> None:
    answers.write(b"head")
    answers.close()


@pytest.mark.parametrize(
    ("act", "at_once"),
    [(whole, [b"head body"]), (empty, [b"head"]), (in_pieces, [b"head 12", b"3"]), (broken_off, [b"head", "closed"])],
)
def test_what_is_written_at_once_is_sent_at_once(act: Callable[[Answers], None], at_once: list[Any]) -> None:
    async def run() -> None:
        sent = Sent()
        answers = Answers(sent, asyncio.get_running_loop(), sent.close)  # type: ignore[arg-type]
        act(answers)
        assert sent.seen == at_once
        assert answers.is_closing() == ("closed" in at_once)
        await asyncio.sleep(0)
        assert sent.seen == at_once

    asyncio.run(run())


def test_a_head_that_nothing_follows_is_sent_alone() -> None:
    """As of a stream of events, of which the first may be long in coming."""

    async def run() -> None:
        sent = Sent()
        answers = Answers(sent, asyncio.get_running_loop(), sent.close)  # type: ignore[arg-type]
        answers.write(b"head")
        assert sent.seen == []
        await asyncio.sleep(0)
        assert sent.seen == [b"head"]
        answers.write(b"event")
        assert sent.seen == [b"head", b"event"]

    asyncio.run(run())
