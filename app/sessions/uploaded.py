"""What does an uploaded recording show? The same as the session it came from, but for what would make it iterate.

It knows no truth, for a recording keeps none.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path, PurePath
from tempfile import TemporaryDirectory
from typing import Any

from app.problems import HttpProblem
from app.sessions.events import Events
from app.sessions.source import Source, no_view
from app.sessions.trace_row import row_of, verdict
from pmpnbp.errors import PmpnbpError
from pmpnbp.inference.arrival import ScanMode, present
from pmpnbp.json_text import without_nan
from pmpnbp.readout.result import pose_members
from pmpnbp.recording import Change, Inputs, IterationArchive, Recording
from pmpnbp.recording.trace_rows import event_of
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.prior import GaussianPrior, UniformPrior
from pmpnbp.settings import SessionOptions, Settings


class UploadedRecording(Source):
    """The recording at `path`, whose entry in the store is `document`. name : what people call it"""

    kind = "recording"
    state = "recorded"

    def __init__(self, id: str, path: Path, document: Mapping[str, Any]) -> None:
        self._document = dict(document)
        self.name: str = document.get("name") or PurePath(document.get("file_name", "")).stem
        archive = IterationArchive(path, f"recording '{id}'", remedy="delete", foreign_row=row_of)
        self._inputs: Inputs | None = None
        self._changes: list[dict[str, Any]] = []
        self._came: list[tuple[int, tuple[str, Scan], ScanMode]] = []
        self._max_std = SessionOptions.max_std
        try:
            changes = archive.open(None)
            reached = max([archive.iteration, *(change.after_iteration + 1 for change in changes)])
            with Recording(path) as recording, TemporaryDirectory(prefix="recording-") as folder:
                self._inputs = replace(recording.restored_inputs(Path(folder), 0), settings=recording.settings(reached))
                self._max_std, views = recording.max_std(), len(self._inputs.scans)
                self._changes = _changes_as_a_session_has_them(changes, recording.settings(0), views)
            for change in changes:
                if change.scan is not None:
                    name = f"{id}/{views + len(self._came)}"
                    self._came.append((change.after_iteration, (name, change.scan), change.mode))
        except (PmpnbpError, OSError, ValueError) as error:
            # of a file that cannot be read the system tells where it lies, too, which is nobody else's to know
            archive.damage = (isinstance(error, OSError) and error.strerror) or str(error)
        first = event_of(archive.iteration) + 1
        super().__init__(id, Events(first, first), archive)

    def status(self) -> dict[str, Any]:
        """What REST shows of it."""
        inputs = self._inputs
        return {
            "id": self.id,
            "kind": self.kind,
            "tags": [],
            "view_url": f"/sessions/{self.id}/",
            **self.progress(),
            "model_id": None,
            "scan_ids": [],
            "method": self._document.get("method"),
            "particles": self._document.get("particles"),
            "seed": self._document.get("seed"),
            "roi": None if inputs is None or inputs.roi is None else inputs.roi.tolist(),
            "prior": None if inputs is None else without_nan(_prior_members(inputs.prior)),
            "config": {} if inputs is None else without_nan(asdict(inputs.settings)),
            "max_std": self._max_std,
            "created": self._document.get("created"),
        }

    def progress(self) -> dict[str, Any]:
        """Where it ends."""
        row = self.archive.row
        return {
            "name": self.name,
            "state": self.state,
            "iteration": row["iteration"],
            "iterations": row["iteration"] or 0,
            "until": "iterations",
            **verdict(row),
            "error": self.archive.damage,
            "position": None,
            "reading_out": False,
        }

    def call(self, name: str) -> None:
        """Its name from now on, of which those who listen hear."""
        self.name = name
        self._publish("state", self.progress())

    def changes(self) -> list[dict[str, Any]]:
        """What was changed on the way; scans have no ids here, but are named by the order that they came in."""
        return list(self._changes)

    def scan(self, view: int, iteration: int | None = None) -> tuple[str, Scan]:
        """A view's scan, and a name that nothing else has. HttpProblem 404."""
        self.archive.check()
        first = () if self._inputs is None else self._inputs.scans
        named = [(f"{self.id}/{number}", scan) for number, scan in enumerate(first)]
        scans, _ = present(named, self._came, iteration)
        if view >= len(scans):
            raise no_view(self, view, len(scans))
        return scans[view]

    def close(self) -> None:
        """End the event streams, and read-outs."""
        self.read_outs.close()
        self.events.close()
        self.archive.close()

    def cannot_iterate(self) -> HttpProblem:
        """The 409 for whatever would change it."""
        return HttpProblem(
            409, f"'{self.id}' is a recording; it cannot iterate; create a session from its model and scans"
        )


def _changes_as_a_session_has_them(changes: Sequence[Change], began: Settings, views: int) -> list[dict[str, Any]]:
    """The changes as a session has them: the settings that are others than before, or the view that came to the first
    `views`."""
    found: list[dict[str, Any]] = []
    settings = asdict(began)
    for change in changes:
        if change.settings is not None:
            new = asdict(change.settings)
            config = {name: value for name, value in new.items() if value != settings[name]}
            found.append({"after_iteration": change.after_iteration, "config": config})
            settings = new
        if change.scan is not None:
            name = f"view {views}"
            found.append({"after_iteration": change.after_iteration, "scan_id": name, "mode": change.mode})
            views += 1
    return found


def _prior_members(prior: UniformPrior | GaussianPrior) -> dict[str, Any]:
    """The members of prior.json."""
    if isinstance(prior, UniformPrior):
        return {"kind": "uniform", "orientation": prior.orientation}
    joints = {name: {"position": position, "std": std} for name, (position, std) in prior.joints.items()}
    return {
        "kind": "gaussian",
        "link": prior.link,
        "pose": pose_members(prior.pose_world_link),
        "std_xyz": prior.std_xyz.tolist(),
        "std_rpy": prior.std_rpy.tolist(),
        "joints": joints,
    }
