"""A session on a server: what it is told, and what it tells."""

from __future__ import annotations

import time
import webbrowser
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import Any, Literal, TypeVar, cast

import httpx
import numpy as np
from numpy.typing import ArrayLike

from pmpnbp.client import event_stream, particles
from pmpnbp.client.calls import COMPUTING_SECONDS, Call, Calls, path_of, understood
from pmpnbp.client.decisions import Decision, View, question
from pmpnbp.client.entries import Scan, regions_of
from pmpnbp.client.event_stream import Event
from pmpnbp.client.particles import Belief, Message, PosteriorDraws
from pmpnbp.client.uploads import Members, ScanSource, known_id, prior_members, upload_scan
from pmpnbp.errors import EstimateError, PmpnbpError, ServerError, StorageError
from pmpnbp.files import written_whole
from pmpnbp.library.estimate import NOTHING_TO_DRAW_FROM, Estimate
from pmpnbp.scene.region import Region

Goal = Literal["iterations", "converged", "certain"]
Wait = Literal["converged", "certain", "idle"]
Told = TypeVar("Told")

# Seconds that one call waits for a session: below the minute after which proxies give a silent server up.
WAIT_SECONDS = 50.0
# Seconds beyond that until an answer is there, or the server is taken for gone.
ANSWER_SECONDS = 30.0
_BUSY = ("running", "waiting")


class RemoteSession:
    """One session, or uploaded recording; made by `Client.session` and `Client.open_session`. Thread-safe.

    Every method may raise ServerError: its text is the server's sentence, its `status` that of HTTP, and None where no
    server answered. An iteration is a number from 0, the start, on; None: the newest.

    id : 16 hexadecimal digits; name : what people call it, or None
    """

    def __init__(self, calls: Calls, members: Mapping[str, Any]) -> None:
        self._calls = calls
        self.id: str = members["id"]
        self.name: str | None = members["name"]
        self._page: str = members["view_url"]
        self._kind = "recordings" if members.get("kind") == "recording" else "sessions"

    @staticmethod
    def of_recording(calls: Calls, members: Mapping[str, Any]) -> RemoteSession:
        """An uploaded recording, of what the server lists of it."""
        id, name = members["id"], members["name"] or Path(members["file_name"]).stem
        return RemoteSession(calls, {"id": id, "name": name, "view_url": f"/sessions/{id}/", "kind": "recording"})

    def __repr__(self) -> str:
        called = "" if self.name is None else f", '{self.name}',"
        return f"<RemoteSession {self.id}{called} on {self._calls.address}>"

    @property
    def url(self) -> str:
        """Of its page. A server with a token lets a browser in that has opened a link with the token before."""
        return self._calls.address + self._page

    def show(self) -> None:
        """Open its page in a browser, by a link with the token where there is one. Raises PmpnbpError where none
        opens."""
        if not webbrowser.open(self._calls.link(self._page)):
            raise PmpnbpError(f"no browser opens on this machine; the page is at {self.url}")

    # What it is told

    def run(self, iterations: int | None = None, until: Goal = "iterations") -> dict[str, Any]:
        """Iterate in the background, and return at once.

        iterations : so many more; None: up to the session's own number, that many where it has made them
        until : end before that as soon as the inference is at rest ("converged"), or every link is "certain"; what is
            at rest will not become certain by iterating, and ends, too

        Gives what `status` does.
        """
        asked = {"until": until} if iterations is None else {"iterations": iterations, "until": until}
        return self._told("POST", "run", json=asked)

    def step(self, iterations: int = 1) -> dict[str, Any]:
        """So many more iterations (1 to 1000), and wait for them however long they take; fewer where it is paused
        meanwhile, as by a server that stops. Gives what `status` does."""
        return self._told("POST", "step", json={"iterations": iterations}, read_seconds=0.0)

    def pause(self) -> dict[str, Any]:
        """Stop after the present iteration. Gives what `status` does."""
        return self._told("POST", "pause")

    def reset(
        self,
        *,
        roi: ArrayLike | None = None,
        prior: Members | None = None,
        method: str | None = None,
        particles: int | None = None,
        seed: int | None = None,
    ) -> dict[str, Any]:
        """Back to iteration 0, with the settings and scans now in force. Gives what `status` does.

        roi : (6,) x0 y0 z0 x1 y1 z1, metres in world, another region of interest; prior : another prior, prior.json as
            a file or as its members; method, particles, seed : others; None: as it was
        """
        given = {
            "roi": None if roi is None else np.ravel(roi),
            "prior": None if prior is None else prior_members(prior),
            "method": method,
            "particles": particles,
            "seed": seed,
        }
        return self._told("POST", "reset", json={name: value for name, value in given.items() if value is not None})

    def change(self, **settings: bool | int | float | str) -> dict[str, Any]:
        """Other settings from the next iteration on; those not named stay. Gives what `status` does."""
        return self._told("PATCH", json={"config": settings})

    def rename(self, name: str) -> dict[str, Any]:
        """Call it by another name, of 1 to 200 characters, at once. Gives what `status` does."""
        self._calls.answer(Call(method="PATCH", path=path_of(self._kind, self.id), json={"name": name}).keyed())
        told = self.status()
        with understood("a session"):
            self.name = told["name"]
        return told

    def tag(self, *tags: str) -> dict[str, Any]:
        """These are all the tags that it has from now on: words that it is found by, up to 20 of 1 to 40 characters,
        none to remove them. Gives what `status` does."""
        return self._told("PATCH", json={"tags": tags})

    def add_scan(
        self, scan: Scan | ScanSource, mode: Literal["joins", "replaces"] = "joins", *, camera: Members | None = None
    ) -> dict[str, Any]:
        """Another scan in the same world frame, from the next iteration on.

        scan : one of the server's, its id, or what `Client.upload_scan` takes, with `camera`
        mode : it "joins" the others as a further view of the same scene, or "replaces" them, as the scene has changed

        Gives what `status` does. Raises ScanError where a scan to upload cannot be used.
        """
        id = known_id(scan)
        if id is None:
            id = upload_scan(self._calls, cast(ScanSource, scan), camera).id
        return self._told("POST", "scans", json={"scan_id": id, "mode": mode})

    def delete(self) -> None:
        """Delete it, and its recording."""
        self._calls.answer(Call(method="DELETE", path=path_of(self._kind, self.id)))

    # What it tells

    def status(self) -> dict[str, Any]:
        """What it was made of and how far it is: state (paused, waiting, running, failed or recorded), iteration,
        converged, certain, fit, error and all that `GET /api/v1/sessions/{id}` describes."""
        return self._read("a session", httpx.Response.json, read_seconds=0.0)

    def wait(self, until: Wait = "converged", timeout: float = 600.0) -> Estimate:
        """The estimate once that is so, or once the session has come to rest without it, as after a restart of the
        server: what comes says which.

        until : nothing moves any more ("converged"), every link is "certain", or it does not iterate ("idle")
        timeout : seconds; ServerError where they are over, and where the session is failed
        """
        end = time.monotonic() + timeout
        while True:
            left = max(0.0, end - time.monotonic())
            seconds = min(left, WAIT_SECONDS)
            to_json, patience = httpx.Response.json, seconds + ANSWER_SECONDS
            members = self._read("an estimate", to_json, "estimate", read_seconds=patience, wait=until, timeout=seconds)
            with understood("an estimate"):
                state, so = members["state"], until != "idle" and members[until]
            if state not in _BUSY:
                self._check()
                return self._estimate(members)
            # an estimate knows nothing of a change that no iteration has seen yet
            if so and self.status()[until]:
                return self._estimate(members)
            if left == 0.0:
                raise ServerError(f"session '{self.id}' is not {until} after {timeout:g} s, but {state}")

    def estimate(self, iteration: int | None = None, posterior: bool = False) -> Estimate:
        """Where every link is, and how sure that is, as result.json has it; metres and radians, in world. It can be
        drawn (`picture`) and shown (`show`).

        posterior : read the posterior out though the inference is not at rest in that iteration
        """
        wanted = "true" if posterior else None
        members = self._read("an estimate", httpx.Response.json, "estimate", iteration=iteration, posterior=wanted)
        return self._estimate(members)

    def picture(self, width: int | None = None, iteration: int | None = None) -> bytes:
        """PNG: the estimate over its first scan, as the camera sees it. width : pixels; default: the camera's."""
        return self._read("a picture", httpx.Response.read, "estimate.png", width=width, iteration=iteration)

    def regions(self) -> list[Region]:
        """The things that stand in its scans apart from floor, walls and tables, the likest its model first: boxes that
        `reset(roi=…)` takes."""
        found = self._read("regions", httpx.Response.json, "regions")
        with understood("regions"):
            return regions_of(found)

    def decision(
        self,
        links: str | Sequence[str] | None = None,
        max_std: float | None = None,
        views: Iterable[ArrayLike | tuple[ArrayLike, float] | View] | None = None,
        iteration: int | None = None,
    ) -> Decision:
        """Act on the estimate, or look again, and from where?

        links : names of those that count; default: all
        max_std : metres, up to which a link is certain; default: the session's
        views : the planner's own, to be ranked: poses (7,) x y z qw qx qy qz, metres, pose_world_camera, optical, or
            pairs of such a pose and its cost (1 where none is given); default: views around the object

        Raises PmpnbpError for a view that is none.
        """
        asked = Call(
            method="POST",
            path=path_of("sessions", self.id, "decision"),
            json=question(links, max_std, views, iteration),
            read_seconds=COMPUTING_SECONDS,
        )
        answer = self._calls.answer(asked)
        with understood("a decision"):
            return Decision.from_dict(answer.json())

    def belief(self, link: str, iteration: int | None = None) -> Belief:
        """What is believed of a link: the particles of its part, carried to it."""
        return self._npz("a belief", particles.belief, "beliefs", link, iteration=iteration)

    def message(self, sender: str, receiver: str, iteration: int | None = None) -> Message:
        """What the part of one link says about the place of another's, that a joint connects with it."""
        return self._npz("a message", particles.message, "messages", sender, receiver, iteration=iteration)

    def posterior(self, link: str, iteration: int | None = None) -> PosteriorDraws:
        """Where a link may be, given the scan: draws of the posterior, read out for this where that is not done yet."""
        return self._npz("a posterior", particles.posterior_draws, "posterior", link, iteration=iteration)

    def trace(self, after: int = -1) -> list[dict[str, Any]]:
        """A row for each iteration beyond `after`: seconds, effective sample size, standard deviations, notes, and all
        that `GET /api/v1/sessions/{id}/trace` describes."""

        def rows(response: httpx.Response) -> list[dict[str, Any]]:
            return list(response.json()["iterations"])

        return self._read("a trace", rows, "trace", after=after)

    def events(self, last_event_id: int | None = None) -> Iterator[Event]:
        """What happens, as it happens, whatever becomes of the connection; ends when the session is deleted.

        last_event_id : go on after this event; default: begin with the newest iteration and the state
        """
        return event_stream.events(self._calls, path_of("sessions", self.id, "events"), last_event_id)

    def recording(self, path: str | PathLike[str]) -> Path:
        """The session as a file at `path`, which `pmpnbp view` and `pmpnbp.open_recording` open: all of it, or nothing
        where it does not come to its end. Raises StorageError where it cannot be written there."""
        place = Path(path)
        call = Call(method="GET", path=path_of("sessions", self.id, "recording"), read_seconds=COMPUTING_SECONDS)
        try:
            with written_whole(place) as partial:

                def write(response: httpx.Response) -> None:
                    with partial.open("wb") as file:
                        for chunk in response.iter_bytes():
                            file.write(chunk)

                self._calls.used(call, write)
        except OSError as error:
            raise StorageError(f"recording '{place.name}' cannot be written: {error.strerror}") from None
        return place

    # How

    def _told(self, method: str, *steps: str, json: Any = None, read_seconds: float = COMPUTING_SECONDS) -> Any:
        path = path_of("sessions", self.id, *steps)
        answer = self._calls.answer(Call(method=method, path=path, json=json, read_seconds=read_seconds).keyed())
        with understood("a session"):
            return answer.json()

    def _read(
        self,
        what: str,
        read: Callable[[httpx.Response], Told],
        *steps: str,
        read_seconds: float = COMPUTING_SECONDS,
        **params: Any,
    ) -> Told:
        response = self._calls.get("sessions", self.id, *steps, read_seconds=read_seconds, **params)
        with understood(what):
            return read(response)

    def _npz(self, what: str, read: Callable[[bytes], Told], *steps: str, iteration: int | None) -> Told:
        return self._read(what, lambda response: read(response.content), *steps, iteration=iteration, format="npz")

    def _check(self) -> None:
        """ServerError where it is failed."""
        status = self.status()
        if status["state"] == "failed":
            raise ServerError(f"session '{self.id}' is failed: {status['error']}")

    def _estimate(self, members: Mapping[str, Any]) -> Estimate:
        with understood("an estimate"):
            own = ("session_id", "state", "outdated")
            result = {name: value for name, value in members.items() if name not in own}
            found = Estimate.from_dict(result, _Iteration(self, result["iteration"]))
            return replace(found, outdated=members.get("outdated") is True)


@dataclass(frozen=True)
class _Iteration:
    """What an estimate was made of."""

    session: RemoteSession
    iteration: int

    def picture(self, width: int | None) -> bytes:
        """PNG."""
        return self.session.picture(width, self.iteration)

    def show(self) -> None:
        """The session's page."""
        self.session.show()

    def to_arviz(self, draws: int) -> Any:
        """As `Estimate.to_arviz`; the server reads the iteration's posterior out where it has not."""
        from pmpnbp.client import draws as drawn  # brings what only this needs
        from pmpnbp.readout.arviz_export import load_arviz

        load_arviz()
        found = self.session.estimate(self.iteration, posterior=True)
        if found.fit is None:
            raise EstimateError(NOTHING_TO_DRAW_FROM)
        return self.session._npz(
            "a posterior", lambda npz: drawn.to_inference_data(found, npz, draws), "posterior", iteration=self.iteration
        )
