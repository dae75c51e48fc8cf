"""A server's models, scans and sessions, in Python: the same as `pmpnbp.estimate` and `pmpnbp.Session`, over REST."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from os import PathLike
from types import TracebackType
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from pmpnbp.client import uploads
from pmpnbp.client.calls import COMPUTING_SECONDS, Call, Calls, path_of, understood
from pmpnbp.client.entries import Model, Scan, regions_of
from pmpnbp.client.session import RemoteSession
from pmpnbp.client.uploads import FilePath, Members, ScanSource, known_id, prior_members
from pmpnbp.errors import PmpnbpError, ServerError
from pmpnbp.scene.region import Region
from pmpnbp.settings import Method


class Client:
    """A server, by its address. Thread-safe; `close`, or the end of a `with`, closes its connections.

    Every method may raise ServerError: its text is the server's sentence, its `status` that of HTTP, and None where no
    server answered.

    url : such as http://127.0.0.1:8080, or the link that a server with a token prints at its start, token and all
    token : of the server, where it has one and the link does not carry it
    timeout : seconds without a byte from the server until it is taken for gone; where a call makes it compute, ten
        minutes, where those are more
    retries : how often a call is made again that the server was too busy for (429, 503) or that it did not hear, as
        while it starts anew: over 23 s in all, where it names no time, and half as often where it has never answered;
        none does more the second time
    """

    def __init__(self, url: str, token: str | None = None, *, timeout: float = 60.0, retries: int = 6) -> None:
        self._calls = Calls(url, token, timeout, retries)

    def __repr__(self) -> str:
        return f"<Client of {self.url}>"

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close its connections."""
        self._calls.close()

    @property
    def url(self) -> str:
        """Of the server, without a token."""
        return self._calls.address

    def upload_model(self, path: FilePath) -> Model:
        """A URDF, or a zip with a URDF and its meshes. Raises ModelError where it cannot be read here."""
        return uploads.upload_model(self._calls, path)

    def upload_scan(self, source: ScanSource, camera: Members | None = None) -> Scan:
        """A scan.

        source : a file (PNG of 16 bit with millimetres, PCD, PLY, XYZ, NPY, NPZ), or an array of floats: depth (H, W),
            metres, 0 or NaN where there is none, or points (N, 3) or (H, W, 3), metres, in the camera's optical frame
        camera : camera.json as a file or as its members, of which `T_world_camera` may be an array (4, 4), metres, that
            takes the optical frame to world; needed for depth

        Raises ScanError where it cannot be read here.
        """
        return uploads.upload_scan(self._calls, source, camera)

    def upload_recording(self, path: FilePath) -> RemoteSession:
        """A recording, as `RemoteSession.recording`, `pmpnbp.Session` and `pmpnbp estimate --recording` write one: a
        session that can be read, and only read. Raises RecordingError where the file cannot be read here."""
        return self.open_session(uploads.upload_recording(self._calls, path)["id"])

    def models(self) -> list[Model]:
        """All of the server's, oldest first."""
        answer = self._calls.get("models")
        with understood("a list of models"):
            return [Model.from_dict(entry) for entry in answer.json()]

    def scans(self) -> list[Scan]:
        """All of the server's, oldest first."""
        answer = self._calls.get("scans")
        with understood("a list of scans"):
            return [Scan.from_dict(entry) for entry in answer.json()]

    def sessions(self, *tags: str, limit: int | None = None, offset: int = 0) -> list[RemoteSession]:
        """The server's that have all of these tags, or all, oldest first: `limit` of them at most, without the first
        `offset`."""
        answer = self._calls.get("sessions", tag=tags, limit=limit, offset=offset)
        with understood("a list of sessions"):
            return [RemoteSession(self._calls, entry) for entry in answer.json()]

    def recordings(self) -> list[RemoteSession]:
        """Those that were uploaded, as sessions that can be read, oldest first; `delete` of one forgets it."""
        answer = self._calls.get("recordings")
        with understood("a list of recordings"):
            return [RemoteSession.of_recording(self._calls, entry) for entry in answer.json()]

    def delete_model(self, id: str) -> None:
        """Delete a model that no session uses."""
        self._delete("models", id)

    def delete_scan(self, id: str) -> None:
        """Delete a scan that no session uses."""
        self._delete("scans", id)

    def regions(self, model: Model | str, scans: Scan | str | Sequence[Scan | str]) -> list[Region]:
        """Where in scans of the server's one of its models may stand, the likest first: boxes, of which one may be the
        `roi` of a session. model, scans : what uploads gave, or ids; views of one scene"""
        ids = [str(known_id(scan) or scan) for scan in _several(scans)]
        found = self._calls.get("models", str(known_id(model) or model), "regions", scan_id=ids)
        with understood("regions"):
            return regions_of(found.json())

    def session(
        self,
        model: Model | FilePath,
        scans: Scan | ScanSource | Sequence[Scan | ScanSource],
        *,
        camera: Members | None = None,
        method: Method | None = None,
        particles: int | None = None,
        iterations: int | None = None,
        seed: int | None = None,
        roi: ArrayLike | None = None,
        prior: Members | None = None,
        max_std: float | None = None,
        name: str | None = None,
        **settings: bool | int | float | str,
    ) -> RemoteSession:
        """A session, made at iteration 0; `run` or `step` makes it iterate. What is not given is as the server has it.

        model : one of the server's, its id, or a file to upload
        scans : one or several, each one of the server's, its id, or what `upload_scan` takes; views of one scene
        camera : of the scans to upload, as `upload_scan` takes it
        particles : of each part; iterations : that `run` makes where it is told no number; seed : of its random numbers
        roi : (6,) x0 y0 z0 x1 y1 z1, metres in world, the region of interest
        prior : prior.json as a file or as its members
        max_std : metres, up to which a link is certain
        settings : by name, as `GET /api/v1/settings` lists them

        Where the server refuses to make it, what was uploaded for it is deleted. Raises ModelError, ScanError or
        PriorError where a file cannot be read here.
        """
        options: dict[str, Any] = {
            "method": method,
            "particles": particles,
            "iterations": iterations,
            "seed": seed,
            "roi": None if roi is None else np.ravel(roi),
            "prior": None if prior is None else prior_members(prior),
            "max_std": max_std,
            "name": name,
            "config": settings or None,
        }
        asked = {option: value for option, value in options.items() if value is not None}
        uploaded: list[tuple[str, str]] = []
        try:
            asked["model_id"] = self._model_id(model, uploaded)
            asked["scan_ids"] = [self._scan_id(scan, camera, uploaded) for scan in _several(scans)]
            call = Call(method="POST", path="sessions", json=asked, read_seconds=COMPUTING_SECONDS)
            answer = self._calls.answer(call.keyed())
        except PmpnbpError as error:
            # with no server there, there is nobody to be asked
            if not isinstance(error, ServerError) or error.status is not None:
                self._forget(uploaded)
            raise
        with understood("a session"):
            return RemoteSession(self._calls, answer.json())

    def open_session(self, id: str) -> RemoteSession:
        """A session that is there already, or an uploaded recording, which can only be read."""
        answer = self._calls.get("sessions", id)
        with understood("a session"):
            return RemoteSession(self._calls, answer.json())

    def _model_id(self, model: Model | FilePath, uploaded: list[tuple[str, str]]) -> str:
        id = known_id(model)
        if id is None:
            id = self.upload_model(cast(FilePath, model)).id
            uploaded.append(("models", id))
        return id

    def _scan_id(self, scan: Scan | ScanSource, camera: Members | None, uploaded: list[tuple[str, str]]) -> str:
        id = known_id(scan)
        if id is None:
            id = self.upload_scan(cast(ScanSource, scan), camera).id
            uploaded.append(("scans", id))
        return id

    def _forget(self, uploaded: list[tuple[str, str]]) -> None:
        for kind, id in uploaded:
            with suppress(ServerError):  # what it is to tell of is the error before
                self._delete(kind, id)

    def _delete(self, kind: str, id: str) -> None:
        self._calls.answer(Call(method="DELETE", path=path_of(kind, id)))


def _several(scans: Scan | ScanSource | Sequence[Scan | ScanSource]) -> Sequence[Scan | ScanSource]:
    return [scans] if isinstance(scans, Scan | str | PathLike | np.ndarray) else scans
