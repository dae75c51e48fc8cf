"""What happens in a session, as it happens? Server-sent events, one stream of them whatever becomes of the connection.

After a break the client names the last event that it has heard of, and is told those after it.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from pmpnbp.client.calls import Call, Calls, Failure, understood, wait

# Seconds of silence after which a stream is dead: several of the server's pings, which come every 15 s.
SILENCE_SECONDS = 60.0
# Milliseconds before a stream that ended is opened again, where the server names none.
RETRY_MILLISECONDS = 1000


@dataclass(frozen=True)
class Event:
    """What happened. kind : "iteration", with a row of the trace; "state", with the members of the session that change
    by themselves; "error", with `error` and `iteration`. id : rises; names the event where a listener comes back"""

    id: int
    kind: str
    data: dict[str, Any]


def events(calls: Calls, path: str, last_event_id: int | None) -> Iterator[Event]:
    """Those after event `last_event_id`; None: the newest iteration, the state, and all that follows.

    Ends when the session is deleted. Raises ServerError where no server answers any more, or it refuses.
    """
    last, failures, reader = last_event_id, 0, _Reader()
    while True:
        heard = False
        headers = {"Accept": "text/event-stream"} | ({} if last is None else {"Last-Event-ID": str(last)})
        call = Call(method="GET", path=path, headers=headers, read_seconds=SILENCE_SECONDS)
        try:
            with calls.once(call) as response:
                for event in reader.read(response.iter_bytes()):
                    last, failures, heard = event.id, 0, True
                    yield event
        except Failure as failure:
            if failure.error.status == 404:
                return
            if failures >= calls.retries or not failure.again:
                raise failure.error from None
            wait(failures, failure)
            failures += 1
        else:
            # a stream ends with its session, which the next answer tells, or with a server that stops
            if not heard:
                time.sleep(reader.retry_milliseconds / 1000)


class _Reader:
    """Reads the lines of event streams. retry_milliseconds : as the server said last"""

    def __init__(self) -> None:
        self.retry_milliseconds = RETRY_MILLISECONDS

    def read(self, chunks: Iterable[bytes]) -> Iterator[Event]:
        """The events of one stream; one that is cut off is none."""
        members: dict[str, str] = {}
        for line in _lines(chunks):
            name, _, value = line.partition(":")
            if line and name:
                members[name] = value.removeprefix(" ")
                continue
            if not line and "data" in members:
                with understood("an event"):
                    event = Event(int(members["id"]), members["event"], json.loads(members["data"]))
                yield event
            if not line:
                said = members.get("retry", "")
                self.retry_milliseconds = int(said) if said.isdecimal() else self.retry_milliseconds
                members = {}


def _lines(chunks: Iterable[bytes]) -> Iterator[str]:
    """Whole lines. Only line feeds end one: what Python, too, takes for the end of a line may stand in a name."""
    rest = b""
    for chunk in chunks:
        *lines, rest = (rest + chunk).split(b"\n")
        for line in lines:
            yield line.removesuffix(b"\r").decode("utf-8", "replace")
