"""Which 3D views are open? One view, with a viser server of its own, per tab that looks at a session.

A view outlives its last client for a while, so that a page that is loaded again finds its view as it was. One that
nobody keeps makes room where there are too many. Of the views that somebody looks at, those opened first are drawn at
the full rate, and the others are told that they are not.
"""

from __future__ import annotations

import re
import secrets
import threading

from app.memory import GivingBack
from app.problems import HttpProblem
from app.sessions.source import Source
from app.viewer.gizmos import default_prior, default_region
from app.viewer.painter import ECONOMY_RATE, Painter
from app.viewer.scenery import Scenery
from app.viewer.view import Find, View
from app.viewer.view_state import MAX_COORDINATE, ViewState

LINGER_SECONDS = 60.0

# Pictures a second of all views together that are drawn at the full rate: more take too much time from the inference.
ALL_RATE = 24.0

# What is said of a view that is drawn less often.
SLOWED = (
    "{} opened before this one and drawn at the full rate, the most that this server draws so; "
    f"this one is drawn every {1 / ECONOMY_RATE:g} seconds while the session runs"
)

_VIEW_ID = re.compile(r"[A-Za-z0-9_-]{1,64}")


class Views:
    """The open views of all sessions. limit : how many; full_rate : of those that are looked at, so many are drawn at
    the full rate"""

    def __init__(self, limit: int = 60, full_rate: int = 20, linger_seconds: float = LINGER_SECONDS) -> None:
        self._limit, self._full_rate = limit, full_rate
        self._linger = linger_seconds
        self._scenery = Scenery()
        self._giving_back = GivingBack()
        self._views: dict[tuple[str, str], View] = {}
        self._lock = threading.Lock()
        self._closed = False

    def __len__(self) -> int:
        return len(self._views)

    def keep(self, session_id: str, view_id: str, find: Find | None = None) -> View:
        """The view, opened where it is not, which stays open until `release`. Raises HttpProblem: no more views, or no
        such id; and where the session is not here. find : a session by its id; without it nothing is drawn."""
        if not _VIEW_ID.fullmatch(view_id):
            raise HttpProblem(404, f"view {view_id!r} cannot be; a view's name has up to 64 letters, digits, - and _")
        source = None if find is None else find(session_id)
        with self._lock:
            if self._closed:
                raise HttpProblem(503, "the server stops")
            view = self._views.get((session_id, view_id))
            closing = None
            if view is None:
                closing = self._make_room()
                view = View(session_id, view_id, source)
                view.change(_own_handles(source))
                view.listen(self._happened)
                self._views[session_id, view_id] = view
                if source is not None and find is not None:
                    view.painter = Painter(view, source, find, self._scenery)
            view.keepers += 1
            if view.last_left is not None:
                view.last_left.cancel()
                view.last_left = None
        if closing is not None:
            self._end(closing)
        return view

    def release(self, view: View) -> None:
        """What `keep` gave; the view closes a while after the last."""
        with self._lock:
            view.keepers -= 1
            if view.keepers == 0 and not view.closed:
                view.last_left = threading.Timer(self._linger, self._drop, (view,))
                view.last_left.daemon = True
                view.last_left.start()

    def join(self, session_id: str, view_id: str, find: Find | None = None) -> View:
        """As `keep`, for a browser that shows the scene."""
        view = self.keep(session_id, view_id, find)
        with self._lock:
            view.clients += 1
        view.tell("clients")
        return view

    def leave(self, view: View) -> None:
        """One client less."""
        with self._lock:
            view.clients -= 1
        view.tell("clients")
        self.release(view)

    def close_session(self, session_id: str) -> None:
        """Close every view of a session, as when it is deleted."""
        with self._lock:
            closing = [self._views.pop(key) for key in list(self._views) if key[0] == session_id]
        for view in closing:
            self._end(view)
        self._giving_back.soon()  # what it took, too

    def close(self) -> None:
        """Close all."""
        with self._lock:
            self._closed = True
            closing, self._views = self._views, {}
        for view in closing.values():
            self._end(view)
        self._giving_back.close()

    def _happened(self, what: str) -> None:
        """Give every view that is looked at its rate, and tell those that have another than before."""
        if what == "drawn":
            return
        with self._lock:
            seen = [view for view in self._views.values() if view.clients and not view.state.hidden]
            told, full = [], min(len(seen), self._full_rate)
            for place, view in enumerate(seen):
                slowed = (
                    None
                    if place < self._full_rate
                    else SLOWED.format("1 view was" if self._full_rate == 1 else f"{self._full_rate} views were")
                )
                view.pace = ALL_RATE / full
                if slowed != view.slowed:
                    view.slowed = slowed
                    told.append(view)
        for view in told:
            view.tell("view")

    def _make_room(self) -> View | None:
        """A view that nobody keeps and that has to go, where there are too many."""
        if len(self._views) < self._limit:
            return None
        idle = next((key for key, view in self._views.items() if view.keepers == 0), None)
        if idle is None:
            detail = (
                f"{self._limit} 3D views are open, the most that this server draws (its setting max_views); "
                "close one, and this one opens"
            )
            raise HttpProblem(429, detail, headers={"Retry-After": "60"})
        return self._views.pop(idle)

    def _drop(self, view: View) -> None:
        with self._lock:
            key = (view.session_id, view.view_id)
            if view.keepers > 0 or self._views.get(key) is not view:
                return
            del self._views[key]
        self._end(view)

    def _end(self, view: View) -> None:
        view.close()
        if view.painter is not None:
            view.painter.close()
        self._giving_back.soon()


def new_view_id() -> str:
    """A name for a view that no other has."""
    return secrets.token_hex(8)


def _own_handles(source: Source | None) -> ViewState:
    """The session's own region and gaussian prior, for a new view."""
    status = {} if source is None else source.status()
    region, prior = status.get("roi"), status.get("prior")
    if region is not None and max(map(abs, region)) > MAX_COORDINATE:
        region = None  # no box that could be seen
    gaussian = isinstance(prior, dict) and prior.get("kind") == "gaussian"
    return ViewState(region=region, prior=prior if gaussian else None)


def with_handles(view: View, source: Source) -> None:
    """Give region and prior of the view's state something to drag, where they are shown and say nothing yet. Raises
    HttpProblem where the session has no iteration."""
    state = view.state
    if state.show.region and state.region is None:
        view.change(ViewState(region=default_region(source.archive.read().problem.observation)))
    if state.show.prior and state.prior is None:
        snapshot = source.archive.read()
        within = view.state.region if view.state.show.region else None
        prior = default_prior(snapshot.problem.mrf.model, snapshot.result["links"], within)
        view.change(ViewState(prior=prior))
