"""A view over REST, and a browser's websocket that looks at it, for tests of views."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from websockets.exceptions import ConnectionClosed

from benchmarks.view_socket import view_socket
from tests.app import small_sessions as small


def until(asked: Callable[[], Any]) -> Any:
    """What `asked` gives as soon as that is something."""
    while not (found := asked()):
        time.sleep(small.PATIENCE)
    return found


def state(served: Any, view: str, **change: Any) -> dict[str, Any]:
    """The view's state, after a change where one is given."""
    answer = served.client.patch(view, json=change) if change else served.client.get(view)
    assert answer.status_code == 200, answer.text
    found: dict[str, Any] = answer.json()
    return found


def drawn(served: Any, view: str, iteration: int) -> dict[str, Any]:
    """What is drawn, once it is that iteration."""
    return until(lambda: (found := state(served, view)["drawn"]) and found["iteration"] == iteration and found)


@contextmanager
def looking(served: Any, view: str, reads: bool = True) -> Iterator[None]:
    """A browser's websocket on a view, which reads what it is sent, or nothing."""
    session_id, view_id = view.split("/")[4], view.split("/")[6]
    ended = threading.Event()

    async def look() -> None:
        options = {"origin": served.url, "max_queue": 1, "close_timeout": 1}
        async with view_socket(served.url, session_id, view_id, **options) as socket:
            while not ended.is_set():
                try:
                    await asyncio.wait_for(socket.recv() if reads else asyncio.sleep(1), 0.05)
                except TimeoutError:
                    continue
                except ConnectionClosed:  # its session was deleted
                    return

    thread = threading.Thread(target=lambda: asyncio.run(look()))
    thread.start()
    until(lambda: state(served, view)["clients"])
    try:
        yield
    finally:
        ended.set()
        thread.join()


def painter(served: Any, view: str) -> Any:
    views = served.app.state.views
    return views._views[view.split("/")[4], view.split("/")[6]].painter
