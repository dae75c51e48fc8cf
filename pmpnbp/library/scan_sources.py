"""The scans of a session: files, arrays, or what `load_scan` gave, each with its camera."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from os import PathLike
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pmpnbp.errors import ScanError
from pmpnbp.library.inputs import AnyPath, CameraSource, load_scan
from pmpnbp.scene.observation import Scan

ScanSource: TypeAlias = Scan | AnyPath | NDArray[np.generic]


def scans_of(
    scans: ScanSource | Sequence[ScanSource], camera: CameraSource | Sequence[CameraSource] | None
) -> list[Scan]:
    """With the camera of each: none, one for all, or one each. Raises ScanError."""
    sources, cameras = _listed(scans), _listed(camera)
    if not sources:
        raise ScanError("no scan was given; expected at least one")
    if len(cameras) == 1:
        cameras *= len(sources)
    if len(cameras) != len(sources):
        raise ScanError(f"{len(cameras)} cameras were given for {len(sources)} scans; expected one for all or for each")
    return [scan_of(source, of_it) for source, of_it in zip(sources, cameras, strict=True)]


def _listed(given: Any) -> list[Any]:
    """What is given as one or as several, as a list; what is neither is one, of which it is said where it is read."""
    alone = isinstance(given, Scan | str | bytes | PathLike | Mapping | np.ndarray) or not isinstance(given, Iterable)
    return [given] if alone else [*given]


def scan_of(source: ScanSource, camera: CameraSource | None) -> Scan:
    """One scan. Raises ScanError, also where one that has its camera is given another."""
    if not isinstance(source, Scan):
        return load_scan(source, camera)
    if camera is not None:
        raise ScanError("a camera was given for a scan that was loaded with its own; expected one of the two")
    return source
