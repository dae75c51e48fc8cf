"""Which estimates does a folder of scene folders ask for? One for each folder in it that holds a scan.

A scene is a folder with a camera.json, or with a scan named `depth`, `scan` or `cloud`; it may hold a model, a roi.json
and a prior.json of its own. A model at the top serves every scene that has none.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from pmpnbp.batch.row import Entry
from pmpnbp.errors import ManifestError
from pmpnbp.scene.scan_files import SUFFIXES

NAMES = ("depth", "scan", "cloud")
MODELS = (".urdf", ".zip")


def scenes(folder: Path) -> Iterator[Entry]:
    """The scenes in `folder`, by name. Raises ManifestError where it cannot be read."""
    try:
        model = _model(folder)
        inside = sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))
    except OSError as error:
        raise ManifestError(f"folder '{folder.name}' cannot be read: {error.strerror}") from None
    for scene in inside:
        where = f"scene '{scene.name}' of folder '{folder.resolve().name}'"
        try:
            scan = _scan(scene)
            if scan is None:
                continue
            members: dict[str, Any] = {"name": scene.name, "scan": scan}
            for member in ("camera", "roi", "prior"):
                if (scene / f"{member}.json").is_file():
                    members[member] = f"{member}.json"
            own = _model(scene) or model
            if own is not None:
                members["model"] = str(own.resolve())
        except ManifestError as error:
            yield Entry(where=where, folder=scene, fault=str(error))
        except OSError as error:
            yield Entry(where=where, folder=scene, fault=f"it cannot be read: {error.strerror}")
        else:
            yield Entry(where=where, folder=scene, members=members)


def _scan(scene: Path) -> str | None:
    """The name of a scene's scan; None for a folder that is no scene."""
    there = sorted(
        path for path in scene.iterdir() if path.suffix.lower() in SUFFIXES and not path.name.startswith(".")
    )
    named = [path for path in there if path.stem.lower() in NAMES]
    if not named and not (scene / "camera.json").is_file():
        return None
    return _only(named or there, "scan").name


def _model(folder: Path) -> Path | None:
    there = sorted(path for path in folder.iterdir() if path.suffix.lower() in MODELS and not path.name.startswith("."))
    return _only(there, "model") if there else None


def _only(there: Sequence[Path], what: str) -> Path:
    if not there:
        raise ManifestError(f"it has a camera.json and no {what}; expected one of {', '.join(SUFFIXES)}")
    if len(there) > 1:
        names = ", ".join(f"'{path.name}'" for path in there[:3]) + (" and others" if len(there) > 3 else "")
        raise ManifestError(f"it holds {len(there)} {what}s, {names}; expected one, or a manifest that names them")
    return there[0]
