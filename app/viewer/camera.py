"""Where do a view's browsers look from? From where REST says; then from where a hand moves them, which is reported.

viser's page sets its camera by itself while it loads, more than once and in no fixed order with what it is told. So a
browser is told again until it reports that it is there, and again where it goes back, soon after, to exactly a place
where it has been without a hand (a stray), or half of the way: it sets where it is and what it looks at one after the
other. Each browser is in one of four states:

              (joins; `look` from any state)
                            |
                            v     told ATTEMPTS times in vain
       reports a stray   PLACING ----------------------------> ABANDONED
        .----------------^  |                                      |
        |                   | reports that it is there             | reports that it is there
        |                   v                                      |
        `---------------- PLACED <---------------------------------'
                            |
                            | reports any other place
                            v
                          MOVED    every report is a hand's
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np
import viser
from pydantic import ValidationError

from app.viewer.places import FIELD_OF_VIEW
from app.viewer.view_state import Eye

# Metres within which two eyes are the same, and within which a browser is where it was told to be.
SAME, ARRIVED = 1e-3, 2e-2
# A browser is told so often, and so many seconds apart, where to look from.
ATTEMPTS, RETRY_SECONDS = 25, 0.4
# Seconds between two reports of a hand's move.
REPORT_SECONDS = 0.33
# Where viser's page begins, before it was ever reported there: so many metres, its (3, 3, 3), from the origin, which it
# looks at, turned with what is up in the scene.
PAGE_DISTANCE = math.sqrt(27.0)
# Strays kept of a browser.
STRAYS = 12


class Placement(Enum):
    """How far a browser is where it was told to look from; see the picture above."""

    PLACING = "it is told where to look from, and not there yet"
    PLACED = "it is there"
    MOVED = "a hand has moved it since"
    ABANDONED = "it never got there, and is told no more"


@dataclass(eq=False)
class Browser:
    """A browser that looks. place : tells it where from; due : time at which it is told again

    strays : where it has been without a hand, until a hand moves it"""

    place: Callable[[Eye], None]
    placement: Placement = Placement.PLACING
    attempts: int = 0
    due: float = 0.0
    strays: list[Eye] = field(default_factory=list)

    def send(self, left: Eye | None) -> None:
        """Have it look from elsewhere; `left` is where it was told to look from until now."""
        self.placement, self.attempts, self.due = Placement.PLACING, 0, 0.0
        if left is not None:
            self._note_stray(left)

    def count_attempt(self, now: float) -> None:
        """It is told where to look from, now and in a while again."""
        self.attempts += 1
        self.due = now + RETRY_SECONDS
        if self.attempts == ATTEMPTS:
            self.placement = Placement.ABANDONED

    def report(self, eye: Eye, wanted: Eye) -> bool:
        """It looks from `eye`, and is wanted at `wanted`: whether a hand has moved it."""
        there = _near(eye, wanted, ARRIVED)
        if self.placement in (Placement.PLACING, Placement.ABANDONED):
            if there:
                self.placement = Placement.PLACED
            else:
                self._note_stray(eye)
            return False
        if self.placement is Placement.PLACED and self._is_without_a_hand(eye, wanted):
            if not there:
                self.placement = Placement.PLACING if self.attempts < ATTEMPTS else Placement.ABANDONED
            return False
        self.placement = Placement.MOVED
        self.strays.clear()
        return True

    def _note_stray(self, eye: Eye) -> None:
        if not any(_near(eye, stray, SAME) for stray in self.strays):
            self.strays = [*self.strays, eye][-STRAYS:]

    def _is_without_a_hand(self, eye: Eye, wanted: Eye) -> bool:
        """Whether it is still where it is wanted, at a stray, at what viser's page begins with, or half at one of them
        and half at another."""
        known = (wanted, *self.strays)
        position = _at_page_distance(eye) or any(math.dist(eye.position, one.position) < SAME for one in known)
        look_at = math.hypot(*eye.look_at) < SAME or any(math.dist(eye.look_at, one.look_at) < SAME for one in known)
        return position and look_at


class Camera:
    """The camera of one view. Thread-safe; a hand's move is reported by `moved`, called from `tend`.

    wake : has whoever tends it look when it is next due (`wait`)
    """

    def __init__(self, wake: Callable[[], None], moved: Callable[[Eye], None]) -> None:
        self._wake = wake
        self._moved = moved
        self._lock = threading.Lock()
        self._server: viser.ViserServer | None = None
        self._browsers: dict[int, Browser] = {}
        self._home: Eye | None = None
        # of the picture that was told of last, width over height
        self.aspect: float | None = None
        self._wanted: Eye | None = None
        self._by_hand: Eye | None = None

    def begin(self, server: viser.ViserServer, home: Eye) -> None:
        """Look after the browsers of a server. home : where it is looked from unless `look` says another place"""
        self._server, self._home = server, home
        self.look(None)
        server.on_client_connect(self._connected)
        server.on_client_disconnect(self._disconnected)

    def look(self, eye: Eye | None) -> None:
        """Look from `eye`; None: from where the view begins. Without effect before `begin`."""
        eye = eye or self._home
        if self._server is None or eye is None:
            return
        with self._lock:
            left, self._wanted, self._by_hand = self._wanted, eye, None
            for browser in self._browsers.values():
                browser.send(left)
        self._begin_from(eye)
        self.tend()

    def wait(self) -> float | None:
        """Seconds until there is something to tend; None: until it wakes."""
        now = time.monotonic()
        with self._lock:
            waits = [browser.due - now for browser in self._placing()]
            if self._by_hand is not None:
                waits.append(REPORT_SECONDS)
        return max(min(waits), 0.0) if waits else None

    def tend(self) -> None:
        """Report where a hand has moved the camera, and tell browsers again that are not where they should be."""
        now = time.monotonic()
        with self._lock:
            moved, self._by_hand = self._by_hand, None
            if moved is not None and self._wanted is not None and _near(moved, self._wanted, SAME):
                moved = None
            self._wanted = wanted = moved or self._wanted
            due = [browser for browser in self._placing() if browser.due <= now]
            for browser in due:
                browser.count_attempt(now)
        if moved is not None:
            self._begin_from(moved)
            self._moved(moved)
        for browser in due:
            if wanted is not None:
                browser.place(wanted)

    def joined(self, name: int, place: Callable[[Eye], None]) -> None:
        """A browser has come."""
        with self._lock:
            self._browsers[name] = Browser(place)
        self._wake()

    def reported(self, name: int, eye: Eye) -> None:
        """A browser says where it looks from."""
        with self._lock:
            browser = self._browsers.get(name)
            if browser is None or self._wanted is None:
                return
            if browser.report(eye, self._wanted):
                self._by_hand = eye
        self._wake()

    def _placing(self) -> list[Browser]:
        return [browser for browser in self._browsers.values() if browser.placement is Placement.PLACING]

    def _begin_from(self, eye: Eye) -> None:
        """A browser that comes, or comes again, begins there."""
        assert self._server is not None
        start = self._server.initial_camera
        start.fov = eye.field_of_view or FIELD_OF_VIEW
        start.up, start.position, start.look_at = np.array(eye.up), np.array(eye.position), np.array(eye.look_at)

    def _connected(self, client: viser.ClientHandle) -> None:
        def place(eye: Eye) -> None:
            with client.atomic():
                client.camera.fov = eye.field_of_view or FIELD_OF_VIEW
                client.camera.up_direction = np.array(eye.up)
                client.camera.position = np.array(eye.position)
                client.camera.look_at = np.array(eye.look_at)

        self.joined(client.client_id, place)

        @client.camera.on_update
        async def _(camera: Any) -> None:
            vectors = (camera.position, camera.look_at, camera.up_direction)
            try:
                position, look_at, up = (tuple(round(float(value), 5) for value in vector) for vector in vectors)
                own = round(float(camera.fov), 5)
                field_of_view = None if math.isclose(own, FIELD_OF_VIEW, abs_tol=1e-3) else own
                eye = Eye(position=position, look_at=look_at, up=up, field_of_view=field_of_view)
                self.aspect = float(camera.aspect)
            except ValidationError:
                return  # a page that is being laid out may look nowhere
            self.reported(client.client_id, eye)

    def _disconnected(self, client: viser.ClientHandle) -> None:
        with self._lock:
            self._browsers.pop(client.client_id, None)


def _at_page_distance(eye: Eye) -> bool:
    return math.isclose(math.hypot(*eye.position), PAGE_DISTANCE, abs_tol=SAME)


def _near(one: Eye, other: Eye, within: float) -> bool:
    pairs = ((one.position, other.position), (one.look_at, other.look_at), (one.up, other.up))
    return all(math.dist(a, b) < within for a, b in pairs)
