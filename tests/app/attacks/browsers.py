"""Browsers that look at views: websockets that read whatever they are sent, and show it to nobody."""

from __future__ import annotations

import asyncio
import json
import threading
from collections import Counter
from collections.abc import Sequence
from contextlib import suppress
from types import TracebackType

from websockets.asyncio.client import ClientConnection
from websockets.exceptions import ConnectionClosed, InvalidStatus, WebSocketException

from benchmarks.view_socket import view_socket
from tests.app.attacks.target import Target

# Handshakes at once; seconds for each; and how many may have no answer before the rest is not tried.
AT_ONCE = 10
PATIENCE = 20.0
MOST_UNANSWERED = 10


class Browsers:
    """A context: one view of a session for each of the `addresses`, opened one after the other.

    opened : addresses of those that were let in; refusals : of the others, by status; sentences : that came with them
    """

    def __init__(self, target: Target, session_id: str, addresses: Sequence[str]) -> None:
        self._target = target
        self._session_id = session_id
        self._addresses = addresses
        self._all_there = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._look()), daemon=True)
        self.opened: list[str] = []
        self.refusals: Counter[str] = Counter()
        self.sentences: set[str] = set()

    def __enter__(self) -> Browsers:
        self._thread.start()
        self._all_there.wait()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._loop.call_soon_threadsafe(self._end.set)
        self._thread.join()

    async def _look(self) -> None:
        self._loop, self._end = asyncio.get_running_loop(), asyncio.Event()
        reading: list[asyncio.Task[None]] = []
        gate = asyncio.Semaphore(AT_ONCE)

        async def open_one(number: int, address: str) -> None:
            async with gate:
                if self.refusals["TimeoutError"] >= MOST_UNANSWERED:
                    self.refusals["not tried, as others had no answer"] += 1
                    return
                connection = await self._open(number, address)
            if connection is not None:
                self.opened.append(address)
                reading.append(asyncio.create_task(_read(connection)))

        try:
            await asyncio.gather(*(open_one(number, address) for number, address in enumerate(self._addresses)))
        finally:
            self._all_there.set()
        await self._end.wait()
        for task in reading:
            task.cancel()
        await asyncio.gather(*reading, return_exceptions=True)

    async def _open(self, number: int, address: str) -> ClientConnection | None:
        target = self._target
        options = {"local_addr": (address, 0)} if target.several_addresses else {}
        try:
            return await view_socket(
                target.url,
                self._session_id,
                f"attacked-{number}",
                additional_headers=target.headers,
                open_timeout=PATIENCE,
                close_timeout=1,
                ping_interval=None,
                **options,
            )
        except InvalidStatus as error:
            self.refusals[str(error.response.status_code)] += 1
            self.sentences.add(_sentence(error.response.body))
        except (OSError, WebSocketException) as error:
            self.refusals[type(error).__name__] += 1
        return None


async def _read(connection: ClientConnection) -> None:
    """Whatever comes, until the connection ends or this is cancelled."""
    try:
        with suppress(ConnectionClosed):
            async for _ in connection:
                pass
    finally:
        await connection.close()


def _sentence(body: bytes | None) -> str:
    """What a problem says; empty for anything else."""
    try:
        return str(json.loads(body or b"")["detail"])
    except (ValueError, KeyError, TypeError):
        return ""
