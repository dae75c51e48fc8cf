"""One open view: what it shows, who looks at it, and what was drawn last.

It is told what to show by the page, over REST, and by whoever clicks and drags in the scene; both end in its state, and
whoever listens is told of both.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import viser
from pydantic import BaseModel, Field

from app.problems import HttpProblem
from app.sessions.source import Source
from app.viewer.legend import LegendEntry
from app.viewer.view_state import ViewState, merged
from app.viewer.viser_server import address, open_server

if TYPE_CHECKING:
    from app.viewer.painter import Painter

Find = Callable[[str], Source]


class DrawnScene(BaseModel):
    """What the 3D view last drew."""

    iteration: int = Field(description="number of the iteration")
    particles: dict[str, int] = Field(description="by part, how many particles; empty where they are not shown")
    serial: int = Field(description="counts what was drawn in this view")


class ViewStatus(ViewState):
    """What a 3D view shows, and what came of it."""

    drawn: DrawnScene | None = Field(description="null where nothing was drawn yet")
    legend: list[LegendEntry] = Field(description="what the marks mean that were drawn last")
    clients: int = Field(description="browsers that show the scene")
    revision: int = Field(
        description="counts the changes of what is told here; of an answer and an event, the higher is the newer, "
        "whichever came first; begins again where the view was forgotten"
    )
    error: str | None = Field(description="one sentence, where the state cannot be drawn; the scene stays as it was")
    slowed: str | None = Field(
        description="one sentence, where so many views are looked at that this one is drawn less often while its "
        "session runs; null again once there is room"
    )


@dataclass(eq=False)
class View:
    """A view of `source` (None: of nothing), which is the session `session_id`. Thread-safe.

    server : viser's; opened with the first client
    clients : browsers that show it; keepers : all that keep it from being closed; painter : who draws it
    pace : pictures a second, at most; slowed : why it is drawn much less often than it could be, or None
    """

    session_id: str
    view_id: str
    source: Source | None
    clients: int = 0
    keepers: int = 0
    last_left: threading.Timer | None = field(default=None, repr=False)
    drawn: DrawnScene | None = None
    legend: Sequence[LegendEntry] = ()
    error: str | None = None
    pace: float = math.inf
    slowed: str | None = None
    painter: Painter | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        self._lock = threading.Lock()
        self._state = ViewState()
        self._revision = 0
        self._told: dict[str, Any] = {}
        self._listeners: dict[object, Callable[[str], None]] = {}
        # apart from the other, so that nobody who asks for the state waits while viser starts
        self._opening = threading.Lock()
        self._opened: tuple[viser.ViserServer, str] | None = None
        self.closed = False

    @property
    def server(self) -> viser.ViserServer:
        """viser's server of the view."""
        return self._open()[0]

    def address(self) -> tuple[str, str]:
        """Where its websocket is, and the secret that a connection has to carry; for this process only. Like `server`
        it waits while viser starts."""
        server, secret = self._open()
        return address(server), secret

    @property
    def state(self) -> ViewState:
        """What it shows."""
        return self._state

    def change(self, change: ViewState) -> ViewState:
        """Merge the members that `change` was given into the state, and tell the listeners. Raises ViewStateError."""
        with self._lock:
            old, self._state = self._state, merged(self._state, change)
            new = self._state
        if new != old:
            self.tell("view")
        return new

    def answer(self) -> dict[str, Any]:
        """The state as REST shows it, with what was drawn and how many look."""
        with self._lock:
            told = self._state.model_dump() | {
                "drawn": self.drawn_members(),
                "legend": [entry.model_dump() for entry in self.legend],
                "clients": self.clients,
                "error": self.error,
                "slowed": self.slowed,
            }
            if told != self._told:
                self._told = told
                self._revision += 1
            return told | {"revision": self._revision}

    def drawn_members(self) -> dict[str, Any] | None:
        """What was drawn last, as REST shows it."""
        return None if self.drawn is None else self.drawn.model_dump()

    def listen(self, wake: Callable[[str], None]) -> Callable[[], None]:
        """Call `wake` with what happened: "view" (its state changed), "drawn", "clients" (somebody came or went) or
        "closed", from any thread; it must return at once. What is returned ends that."""
        key = object()
        with self._lock:
            self._listeners[key] = wake
        return lambda: self._forget(key)

    def tell(self, what: str) -> None:
        """Tell the listeners."""
        with self._lock:
            listeners = list(self._listeners.values())
        for wake in listeners:
            wake(what)

    def close(self) -> None:
        """End it. A second call does nothing."""
        with self._lock:
            if self.closed:
                return
            self.closed = True
            last_left = self.last_left
        if last_left is not None:
            last_left.cancel()
        self.tell("closed")
        with self._opening:
            if self._opened is not None:
                self._opened[0].stop()

    def _open(self) -> tuple[viser.ViserServer, str]:
        with self._opening:
            if self.closed:
                raise HttpProblem(404, f"view '{self.view_id}' is closed")
            if self._opened is None:
                self._opened = open_server()
            return self._opened

    def _forget(self, key: object) -> None:
        with self._lock:
            self._listeners.pop(key, None)
