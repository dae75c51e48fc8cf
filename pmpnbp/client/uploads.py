"""How do models, scans, recordings, cameras and priors come to a server? As files, and arrays as a file of them."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from numpy.typing import NDArray

from pmpnbp.client.calls import COMPUTING_SECONDS, Call, Calls, json_text, understood
from pmpnbp.client.entries import Model, Scan
from pmpnbp.errors import ModelError, PmpnbpError, PriorError, RecordingError, ScanError

FilePath = str | PathLike[str]
# A file, or depth (H, W) in metres, or points (N, 3) or (H, W, 3), metres, in the camera's frame.
ScanSource = FilePath | NDArray[Any]
# A file, or its members.
Members = FilePath | Mapping[str, Any]
# As a server makes them. A file of such a name is given as a Path, or with its folder.
_ID = re.compile("[0-9a-f]{16}")


def upload_model(calls: Calls, path: FilePath) -> Model:
    """The model of a URDF, or of a zip with a URDF and its meshes, on the server. Raises ModelError, ServerError."""
    answer = _taken_in(calls, "models", _file(path, "model", ModelError), {})
    with understood("a model"):
        return Model.from_dict(answer.json())


def upload_scan(calls: Calls, source: ScanSource, camera: Members | None) -> Scan:
    """The scan of a file or an array, on the server. Raises ScanError, ServerError."""
    fields = {} if camera is None else {"camera": camera_text(camera)}
    answer = _taken_in(calls, "scans", scan_file(source), fields)
    with understood("a scan"):
        return Scan.from_dict(answer.json())


def upload_recording(calls: Calls, path: FilePath) -> Mapping[str, Any]:
    """The server's document of a recording. Raises RecordingError, ServerError."""
    answer = _taken_in(calls, "recordings", _file(path, "recording", RecordingError), {})
    with understood("a recording"):
        return dict(answer.json())


def known_id(entry: Model | Scan | ScanSource) -> str | None:
    """The id of what a server has: of a model or scan, or an id itself; None for what is to be uploaded."""
    if isinstance(entry, Model | Scan):
        return entry.id
    return entry if isinstance(entry, str) and _ID.fullmatch(entry) else None


def _taken_in(calls: Calls, kind: str, file: tuple[str, bytes | Path], fields: Mapping[str, str]) -> httpx.Response:
    form = Call(method="POST", path=kind, files={"file": file}, data=fields, read_seconds=COMPUTING_SECONDS)
    return calls.answer(form.keyed())


def scan_file(source: ScanSource) -> tuple[str, bytes | Path]:
    """Name, and content as NPZ where it is an array. Raises ScanError."""
    if not isinstance(source, np.ndarray):
        return _file(source, "scan", ScanError)
    cloud = source.ndim in (2, 3) and source.shape[-1] == 3
    if not cloud and source.ndim != 2:
        raise ScanError(
            f"the scan is an array of shape {source.shape}; expected depth (H, W), or points (N, 3) or (H, W, 3)"
        )
    if source.dtype.kind != "f":
        raise ScanError(f"the scan is an array of {source.dtype}; expected floats, in metres")
    file = io.BytesIO()
    array = source.astype(np.promote_types(source.dtype, np.float32), copy=False)
    np.savez_compressed(file, allow_pickle=False, **{"points" if cloud else "depth": array})
    return "scan.npz", file.getvalue()


def camera_text(camera: Members) -> str:
    """The text of camera.json. `T_world_camera` may be an array (4, 4). Raises ScanError."""
    if isinstance(camera, Mapping):
        members = dict(camera)
        if isinstance(members.get("T_world_camera"), np.ndarray):
            members["T_world_camera"] = members["T_world_camera"].ravel().tolist()
        return json_text(members)
    return _text(camera, f"camera file '{Path(camera).name}'", ScanError)


def prior_members(prior: Members) -> Mapping[str, Any]:
    """The members of prior.json. Raises PriorError."""
    if isinstance(prior, Mapping):
        return prior
    name = f"prior '{Path(prior).name}'"
    try:
        members = json.loads(_text(prior, name, PriorError))
    except (ValueError, RecursionError) as error:
        raise PriorError(f"{name} is no JSON: {error}") from None
    if not isinstance(members, Mapping):
        raise PriorError(f"{name} is no JSON object; expected one with the member 'kind'")
    return members


def _file(path: FilePath, noun: str, kind: type[PmpnbpError]) -> tuple[str, Path]:
    """The name as a form can carry it, which loses what cannot be written, and the place. Raises `kind` where it cannot
    be read: it is sent as it is read, however large it is."""
    place = Path(path)
    try:
        place.open("rb").close()
    except OSError as error:
        raise kind(f"{noun} '{place.name}' cannot be read: {error.strerror}") from None
    return place.name.encode("utf-8", "replace").decode(), place


def _text(path: FilePath, name: str, kind: type[PmpnbpError]) -> str:
    try:
        return Path(path).read_bytes().decode("utf-8")
    except OSError as error:
        raise kind(f"{name} cannot be read: {error.strerror}") from None
    except UnicodeDecodeError:
        raise kind(f"{name} is no text in UTF-8") from None
