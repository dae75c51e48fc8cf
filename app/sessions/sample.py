"""What can a sample session look at? The scenes of `sample_data/`: cabinets, a cupboard, and a mobile manipulator."""

from __future__ import annotations

import json
import shutil
import zipfile
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from app.store.store import Staging, Store, sha256_of
from app.uploads.summaries import read_model, read_scan
from pmpnbp.errors import storage_told


@dataclass(frozen=True)
class Sample:
    """A scene of the sample data.

    scene : what it is asked for by; place : its folder, in that of its object; title : what is shown of it
    about : what is to be seen, one sentence; prior : whether the session starts from the scene's prior
    """

    scene: str
    place: str
    title: str
    about: str
    prior: bool = False

    @property
    def name(self) -> str:
        """What its session is called."""
        return f"Sample: {self.title}"


_TOLD_APART = "The drawers lie flush: only edges tell them apart."
_FROM_ABOVE = "The top drawer hides the others: nobody can tell how far they are open."
_ROBOT = "Twelve links and eleven joints, from a rough prior of the base."
_PARTIAL = "Base, torso and head are dark: the sensor measures them in patches only."
_HIDDEN = "The top drawer hides all but a corner of the second one."
SAMPLES = (
    Sample("open", "cabinet/open", "a cabinet with an open drawer", "Every drawer is seen well."),
    Sample("self_occluded", "cabinet/self_occluded", "a cabinet that hides a drawer", _HIDDEN),
    Sample(
        "arm", "cabinet/arm", "a cabinet behind a robot arm", "An arm stands in front that is no part of the model."
    ),
    Sample("blanket", "cabinet/blanket", "a cabinet under a blanket", "A cloth covers half of the front."),
    Sample("closed", "cabinet/closed", "a closed cabinet", _TOLD_APART),
    Sample("from_above", "cabinet/from_above", "a cabinet seen from above", _FROM_ABOVE),
    Sample("door", "door/ajar", "a cupboard with its door ajar", "One hinge, a revolute joint."),
    Sample("robot", "robot/scan_0", "a mobile manipulator", _ROBOT, prior=True),
    Sample("robot_partial", "robot/partial", "a mobile manipulator, seen in part", _PARTIAL, prior=True),
)
# That of `serve --demo`.
DEMO, NAME = SAMPLES[0].scene, SAMPLES[0].name


def sample_document(store: Store, scene: str = "open") -> dict[str, Any]:
    """What `Sessions.create` takes for the sample `scene`.

    Model and scan are put into the store unless they are there from a sample before. Raises KeyError for a scene that
    SAMPLES does not have.
    """
    sample = {known.scene: known for known in SAMPLES}[scene]
    place = Path(str(files("sample_data"))) / sample.place
    with storage_told(), store.staging() as staging:
        model_id = _model(store, staging, place.parent)
    with storage_told(), store.staging() as staging:
        scan_id = _scan(store, staging, place)
    return {
        "name": sample.name,
        "sample": scene,
        "model_id": model_id,
        "scan_ids": [scan_id],
        "roi": _json(place / "roi.json")["roi"],
        "prior": _json(place / "prior.json") if sample.prior else None,
        "truth": {
            name: members for name, members in _json(place / "truth.json").items() if name in ("links", "joints")
        },
    }


def _model(store: Store, staging: Staging, folder: Path) -> str:
    """The id of the URDF in `folder`, zipped with its meshes where it has some."""
    source = folder / f"{folder.name}.urdf"
    meshes = sorted((folder / "meshes").glob("*"))
    staged = staging.folder / (f"{folder.name}.zip" if meshes else source.name)
    if meshes:
        with zipfile.ZipFile(staged, "w", zipfile.ZIP_DEFLATED) as archive:
            for path in (source, *meshes):
                # without the file's time: the same bytes each time, by which it is known again
                archive.writestr(zipfile.ZipInfo(path.relative_to(folder).as_posix()), path.read_bytes())
    else:
        shutil.copyfile(source, staged)
    found = _with_digest(store.documents("models"), sha256_of(staged))
    if found is not None:
        return found
    summary = read_model(staged)
    return str(store.add("models", staged, staged.name, summary)["id"])


# Of what the scans of places become in a store, each told once it was read.
_digests: dict[Path, str] = {}


def _scan(store: Store, staging: Staging, place: Path) -> str:
    """The id of the depth image in `place`, called by its scene's name, as all of them are files `depth.png`."""
    scans = store.documents("scans")
    known = _with_digest(scans, _digests.get(place))
    if known is not None:
        return known
    depth, camera, out = (staging.folder / name for name in (f"{place.name}.png", "camera.json", "scan.npz"))
    shutil.copyfile(place / "depth.png", depth)
    shutil.copyfile(place / "camera.json", camera)
    summary = read_scan(depth, camera, out)
    _digests[place] = sha256_of(out)
    return _with_digest(scans, _digests[place]) or str(store.add("scans", out, depth.name, summary)["id"])


def _with_digest(entries: list[dict[str, Any]], digest: str | None) -> str | None:
    """The id of the entry with the content that has this digest."""
    return next((str(entry["id"]) for entry in entries if digest and entry.get("sha256") == digest), None)


def _json(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8"))
