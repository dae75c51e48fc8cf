"""Where do a view's browsers look from? From where they are told to; then from where a hand takes them, which is told.

viser's page sets its camera by itself while it loads, more than once and in no fixed order with what it is told. So a
browser is put where it should be again until it says that it is there, and when it goes back, soon after, to exactly
where it has been before without a hand.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import viser

from app.viewer.view_state import Eye

# Vertical field of view of the browser's camera, radians.
FIELD_OF_VIEW = math.radians(36)
# An eye nearer than this to another, metres, is the same; and is where it was told to be.
SAME, PLACED = 1e-3, 2e-2
# Seconds between two attempts to put a browser somewhere, how often it is tried, and between two tellings of a move.
PATIENCE, TRIES, TELLING = 0.4, 25, 0.33
# Places kept at which a browser has been without a hand.
STRAYS = 12


@dataclass(eq=False)
class _Browser:
    """One that looks. place : puts it somewhere; strays : where it has been without a hand, until a hand moves it;
    due : when it is put there again, if it is not there by then"""

    place: Callable[[Eye], None]
    placed: bool = False
    tries: int = 0
    due: float = 0.0
    strays: list[Eye] = field(default_factory=list)

    def strayed(self, eye: Eye) -> None:
        """It has been there without a hand."""
        if not self.astray(eye):
            self.strays = [*self.strays, eye][-STRAYS:]

    def astray(self, eye: Eye) -> bool:
        """Whether it has been there without a hand."""
        return any(_near(eye, stray, SAME) for stray in self.strays)


class Camera:
    """The camera of one view. Thread-safe; what a hand has done is told by `moved`, called from `tend`.

    wake : has whoever tends it look when it is next due (`wait`)
    """

    def __init__(self, wake: Callable[[], None], moved: Callable[[Eye], None]) -> None:
        self._wake = wake
        self._moved = moved
        self._lock = threading.Lock()
        self._server: viser.ViserServer | None = None
        self._browsers: dict[int, _Browser] = {}
        self._home: Eye | None = None
        self._told: Eye | None = None
        self._seen: Eye | None = None

    def begin(self, server: viser.ViserServer, home: Eye) -> None:
        """Look after the browsers of a server. home : where it is looked from unless `look` says another place"""
        server.initial_camera.fov = FIELD_OF_VIEW
        self._server, self._home = server, home
        self.look(None)
        server.on_client_connect(self._came)
        server.on_client_disconnect(self._left)

    def look(self, eye: Eye | None) -> None:
        """Look from `eye`; None: from where the view begins. Without effect before `begin`."""
        eye = eye or self._home
        if self._server is None or eye is None:
            return
        with self._lock:
            before, self._told, self._seen = self._told, eye, None
            for browser in self._browsers.values():
                browser.placed, browser.tries, browser.due = False, 0, 0.0
                if before is not None:
                    browser.strayed(before)
        self._begin_from(eye)
        self.tend()

    def wait(self) -> float | None:
        """Seconds until there is something to tend; None: until it wakes."""
        now = time.monotonic()
        with self._lock:
            waits = [browser.due - now for browser in self._browsers.values() if self._waits(browser)]
            if self._seen is not None:
                waits.append(TELLING)
        return max(min(waits), 0.0) if waits else None

    def tend(self) -> None:
        """Tell where a hand has moved the camera, and put browsers again where they should be."""
        now = time.monotonic()
        with self._lock:
            seen, self._seen = self._seen, None
            if seen is not None and self._told is not None and _near(seen, self._told, SAME):
                seen = None
            self._told = seen or self._told
            told = self._told
            due = [one for one in self._browsers.values() if self._waits(one) and one.due <= now]
            for browser in due:
                browser.tries += 1
                browser.due = now + PATIENCE
        if seen is not None:
            self._begin_from(seen)
            self._moved(seen)
        for browser in due:
            if told is not None:
                browser.place(told)

    def joined(self, name: int, place: Callable[[Eye], None]) -> None:
        """A browser has come."""
        with self._lock:
            self._browsers[name] = _Browser(place)
        self._wake()

    def reported(self, name: int, eye: Eye) -> None:
        """A browser says where it looks from."""
        with self._lock:
            browser, told = self._browsers.get(name), self._told
            if browser is None or told is None:
                return
            if not browser.placed and _near(eye, told, PLACED):
                browser.placed = True
            elif browser.placed and not browser.astray(eye):
                browser.strays.clear()
                self._seen = eye
            elif not _near(eye, told, PLACED):
                browser.placed = False
                browser.strayed(eye)
        self._wake()

    def _waits(self, browser: _Browser) -> bool:
        return not browser.placed and browser.tries < TRIES

    def _begin_from(self, eye: Eye) -> None:
        """A browser that comes, or comes again, begins there."""
        assert self._server is not None
        start = self._server.initial_camera
        start.up, start.position, start.look_at = np.array(eye.up), np.array(eye.position), np.array(eye.look_at)

    def _came(self, client: viser.ClientHandle) -> None:
        def place(eye: Eye) -> None:
            with client.atomic():
                client.camera.fov = FIELD_OF_VIEW
                client.camera.up_direction = np.array(eye.up)
                client.camera.position = np.array(eye.position)
                client.camera.look_at = np.array(eye.look_at)

        self.joined(client.client_id, place)

        @client.camera.on_update
        async def _(camera: Any) -> None:
            vectors = (camera.position, camera.look_at, camera.up_direction)
            if np.isfinite(vectors).all():
                self.reported(client.client_id, Eye(*(_rounded(vector) for vector in vectors)))

    def _left(self, client: viser.ClientHandle) -> None:
        with self._lock:
            self._browsers.pop(client.client_id, None)


def _rounded(vector: Any) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 5) for value in vector)
    return x, y, z


def _near(one: Eye, other: Eye, within: float) -> bool:
    pairs = ((one.position, other.position), (one.look_at, other.look_at), (one.up, other.up))
    return all(math.dist(a, b) < within for a, b in pairs)
