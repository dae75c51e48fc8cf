"""When is a view drawn? After each new iteration and each change of what it shows, newest only, while somebody looks.

Each view has a thread of its own, so that a slow one delays nobody, the inference least of all; at most RATE times a
second, since what is in a slow browser's socket cannot be taken back. What it has in common with other views is made
once (`scenery`). What fails in here is logged and told in the view's `error`, and ends neither the thread nor anything
else.
"""

from __future__ import annotations

import logging
import threading
import time
from contextlib import nullcontext
from typing import Any

import numpy as np
from cachetools import LRUCache

from app.next_views import WORTH, next_views, uncertain
from app.problems import HttpProblem
from app.sessions.source import Source
from app.viewer.camera import Camera
from app.viewer.caption import captioned
from app.viewer.client_page import scene_only
from app.viewer.draw import Drawing
from app.viewer.frames import colours, frame
from app.viewer.gizmos import PRIOR, dragged_prior, dragged_region, proposal_at
from app.viewer.legend import legend
from app.viewer.picking import picked
from app.viewer.places import place
from app.viewer.scene_frame import SceneFrame
from app.viewer.scenery import Scenery
from app.viewer.stage import Stage
from app.viewer.view import DrawnScene, Find, View
from app.viewer.view_state import Eye, Layers, Look, ViewState
from pmpnbp.errors import PmpnbpError
from pmpnbp.geometry.poses import Array
from pmpnbp.json_text import json_bytes
from pmpnbp.readout.snapshot import Snapshot
from pmpnbp.readout.view_planning import PlannedView

# Pictures a second, at most; and the same of a running session where the processor draws them, or where too many look:
# of the newest iteration, and where somebody has one after the other shown.
RATE, ECONOMY_RATE, ECONOMY_PLAYED_RATE = 12.0, 0.5, 2.0
# The newest iteration of a running session stands for the newest one to all views for this share of the time from one
# picture to the next, and for so many seconds at most: less than all of it, so that the next picture is of another one.
SHARED, SHARED_AT_MOST = 0.84, 0.4
# Stages kept: of the session, of the one it is compared with, and of one of them before a change.
STAGES = 3

# A view's first picture makes every node of its scene, 50 ms of the interpreter: one view at a time, so that those who
# open many at once let others have their answers in between.
_beginning = threading.Lock()

_log = logging.getLogger("pmpnbp.server")


class Painter:
    """Draws one view, in a thread that it starts. find : a session, or recording, by its id; scenery : what it shares
    with other views"""

    def __init__(self, view: View, source: Source, find: Find, scenery: Scenery) -> None:
        self._view = view
        self._source = source
        self._find = find
        self._scenery = scenery
        self._wake = threading.Event()
        # set where nothing has to be spared any more: a thread that is woken takes the interpreter from others
        self._at_once = threading.Event()
        self._painting = threading.Lock()
        self._drawing: Drawing | None = None
        # what it holds of the scenery
        self._stages: LRUCache[int, Stage] = LRUCache(STAGES)
        self._snapshot: Snapshot | None = None
        self._scene: SceneFrame | None = None
        # of what is drawn, and of what was told as drawn
        self._drawn_key: object = None
        self._told_key: object = None
        # whether there is a newer iteration than the newest that views share just now
        self._behind = False
        self._theme: str | None = None
        self.camera = Camera(self._wake.set, self._moved)
        self._ends = [source.events.listen(self._come), view.listen(self._happened)]
        self._thread = threading.Thread(target=self._run, name=f"view-{view.view_id}", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread, after what it draws just now."""
        self._wake.set()
        if threading.current_thread() is not self._thread:
            self._thread.join()

    def html(self) -> str:
        """The scene as it is now, as a page that needs no server. Raises HttpProblem where there is nothing to draw."""
        with self._painting:
            self._paint(self._view.state.model_copy(update={"economy": False}))  # who opens it may have a graphics card
            page = scene_only(self._view.server.scene.as_html(dark_mode=self._view.state.theme == "dark"))
            assert self._snapshot is not None
            name = self._source.status().get("name") or self._source.id
            return captioned(page, self._view.state.theme, str(name), self._snapshot.result, self._view.legend)

    def place(self, look: Look, state: ViewState) -> Eye:
        """Where the place of that name is for what the view would show in `state`. Raises HttpProblem where there is
        nothing yet."""
        snapshot = self._scenery.snapshot(self._source, state.iteration, 0.0)
        own = self._scenery.stage(self._source, snapshot, snapshot.problem.observation.scan_count)
        return place(look, snapshot.placed.part_poses, state, own, self.camera.aspect)

    # The thread

    def _run(self) -> None:
        last = 0.0
        while not self._over():
            self._wake.wait(self.camera.wait())
            if self._over():
                break
            self._wake.clear()
            self._at_once.clear()
            while (wait := last + 1 / self._rate() - time.monotonic()) > 0 and not self._over():
                self._at_once.wait(wait)
                self._at_once.clear()
            self._wake.clear()
            began, error = time.monotonic(), None
            try:
                self.camera.tend()
                seen = self._view.clients > 0
                # the first picture is made before anybody looks: a browser is still starting viser's program then
                if self._view.state.hidden or (self._drawing is not None and not seen):
                    continue
                with self._painting:
                    # what changes no picture, as a state that is told, must not delay the next one
                    last = began if self._paint(self._view.state, seen) or self._behind else last
                if self._behind:
                    self._wake.set()
            except (HttpProblem, PmpnbpError) as problem:
                error = str(problem)
            except Exception as problem:
                if self._over():
                    break
                _log.exception("view %s of %s cannot be drawn", self._view.view_id, self._source.id)
                error = f"the scene could not be drawn: {type(problem).__name__}: {problem}"
            if error != self._view.error:
                self._view.error = error
                self._view.tell("view")
        for end in self._ends:
            end()

    def _rate(self) -> float:
        if self._source.idle:
            return RATE
        if self._view.slowed is not None:
            return ECONOMY_RATE
        if self._view.state.economy:
            return ECONOMY_RATE if self._view.state.iteration is None else ECONOMY_PLAYED_RATE
        return min(RATE, self._view.pace)

    def _over(self) -> bool:
        return self._view.closed

    def _come(self) -> None:
        """There is an iteration, or another state of the session."""
        self._wake.set()
        if self._source.idle:
            self._at_once.set()

    def _happened(self, what: str) -> None:
        if what != "drawn":
            self._wake.set()
        if what == "closed":
            self._at_once.set()

    def _paint(self, state: ViewState, seen: bool = True) -> bool:
        """Draw what is to be seen now, unless that is what was drawn last; whether anything was drawn that is `seen`,
        which is told."""
        newest_for = min(SHARED / self._rate(), SHARED_AT_MOST)
        snapshot = self._scenery.snapshot(self._source, state.iteration, newest_for)
        newest = self._source.archive.iteration
        self._behind = snapshot.iteration < (newest if state.iteration is None else min(state.iteration, newest))
        other = None if state.compare is None else self._find(state.compare.session_id)
        compared = None
        if other is not None and state.compare is not None:
            compared = other, self._scenery.snapshot(other, state.compare.iteration, newest_for)
        key = (
            (self._source.id, snapshot.row["event"], snapshot.iteration),
            None if compared is None else compared[1].row["event"],
            json_bytes(state.model_dump(exclude={"camera", "look", "hidden"})),
        )
        self._apply_theme(state)
        if key == self._told_key:
            return False
        own = self._stage(self._source, snapshot, snapshot.problem.observation.scan_count)
        if key != self._drawn_key:
            against = None if compared is None else (compared[1], self._stage(*compared, 0))
            scene = self._scenery.frame(
                key, lambda: frame(snapshot, state, own, compared=against, next_views=planned(snapshot, state))
            )
            with nullcontext() if self._drawing else _beginning:
                self._begin(own)
                assert self._drawing is not None
                self._drawing.draw(scene)
            self._snapshot, self._scene, self._drawn_key = snapshot, scene, key
        if not seen:
            return False
        self._tell_drawn(state, own)
        self._told_key = key
        return True

    def _tell_drawn(self, state: ViewState, own: Stage) -> None:
        assert self._scene is not None and self._snapshot is not None
        serial = 1 if self._view.drawn is None else self._view.drawn.serial + 1
        particles = dict(self._scene.particles)
        self._view.drawn = DrawnScene(iteration=self._snapshot.iteration, particles=particles, serial=serial)
        told = legend(self._scene, state, colours(own, state.theme))
        if told != self._view.legend:
            self._view.legend = told
            self._view.tell("view")
        self._view.tell("drawn")

    def _stage(self, source: Source, snapshot: Snapshot, scans: int) -> Stage:
        found = self._scenery.stage(source, snapshot, scans)
        self._stages[id(found)] = found
        return found

    # viser

    def _apply_theme(self, state: ViewState) -> None:
        if state.theme != self._theme:
            self._view.server.gui.configure_theme(
                dark_mode=state.theme == "dark", show_logo=False, show_share_button=False
            )
            self._theme = state.theme

    def _begin(self, own: Stage) -> None:
        """What is done once, before the first picture."""
        if self._drawing is not None:
            return
        server = self._view.server
        self._drawing = Drawing(server, self._dragged)
        server.scene.set_up_direction(own.up)
        self.camera.begin(server, own.eye)
        self.camera.look(self._view.state.camera)
        server.scene.on_click()(self._clicked)

    def _moved(self, eye: Eye) -> None:
        self._view.change(ViewState(camera=eye))

    def _clicked(self, event: Any) -> None:
        scene = self._scene
        if scene is None:
            return
        targets, origin, ray = scene.targets, np.array(event.ray_origin), np.array(event.ray_direction)
        box = proposal_at(self._view.state.proposals, origin, ray)
        if box is not None:
            self._view.change(ViewState(region=box, show=Layers(region=True)))
            return
        pick = picked(targets, origin, ray)
        if pick is not None:
            part, particle = pick
            self._view.change(ViewState(part=targets.parts[part], particle=particle))

    def _dragged(self, name: str, pose: Array, done: bool) -> None:
        state = self._view.state
        if name == PRIOR and state.prior is not None:
            self._view.change(ViewState(prior=dragged_prior(state.prior, pose)))
        elif name != PRIOR and state.region is not None:
            self._view.change(ViewState(region=dragged_region(state.region, name, pose[:3])))


def planned(snapshot: Snapshot, state: ViewState) -> list[PlannedView]:
    """From where it is worth to look at what is not certain of the selected part, else of the whole object, where that
    is shown."""
    posterior, model = snapshot.placed.posterior, snapshot.problem.mrf.model
    if not state.show.next_views or posterior is None or posterior.fit.verdict != "good":
        return []
    asked = next((part.links for part in model.parts if part.name == state.part), model.links)
    found = next_views(snapshot, uncertain(snapshot, asked, snapshot.criteria.max_std))
    return [one.view for one in found if one.gain >= WORTH]
