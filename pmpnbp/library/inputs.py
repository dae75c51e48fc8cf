"""A model and a scan, as an inference is given them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pmpnbp.errors import ModelError, PmpnbpError, ScanError

if TYPE_CHECKING:
    from pmpnbp.scene.articulated_object import ArticulatedObject
    from pmpnbp.scene.observation import Scan

AnyPath: TypeAlias = str | PathLike[str]
# camera.json: its path, or its members.
CameraSource: TypeAlias = AnyPath | Mapping[str, object]


@dataclass(frozen=True, eq=False, repr=False)
class Model:
    """An articulated object.

    path : the URDF or zip, which has to stay where it is as long as inferences are made of it
    triangles : the budget that each part's mesh was reduced to
    object : parts, joints and meshes, see `pmpnbp.scene.articulated_object`
    """

    path: Path
    triangles: int
    object: ArticulatedObject

    @property
    def name(self) -> str:
        """As the URDF says."""
        return self.object.name

    @property
    def links(self) -> tuple[str, ...]:
        """Names of all links."""
        return tuple(self.object.links)

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that move."""
        return tuple(joint.name for joint in self.object.joints if joint.kind != "fixed")

    @property
    def parts(self) -> Mapping[str, tuple[str, ...]]:
        """Links that move as one, by the part's name."""
        return {part.name: part.links for part in self.object.parts}

    def __repr__(self) -> str:
        return f"<Model {self.name}: {len(self.links)} links in {len(self.parts)} parts, joints {list(self.joints)}>"


def load_model(path: AnyPath, *, triangles: int | None = None) -> Model:
    """The model in a URDF, or in a zip that holds one with its meshes. Raises ModelError.

    triangles : budget of a part's mesh in the inference; default: that of the setting `triangles`
    """
    from pmpnbp.scene import urdf
    from pmpnbp.settings import Settings

    if not isinstance(path, str | PathLike):
        raise ModelError(f"the model is {path!r:.60}; expected the path of a URDF or zip")
    budget = Settings.triangles if triangles is None else triangles
    return Model(Path(path), budget, urdf.load_model(Path(path), triangle_budget=budget))


def load_scan(source: AnyPath | NDArray[np.generic], camera: CameraSource | None = None) -> Scan:
    """A scan from a file (PNG with 16 bit millimetres, PCD, PLY, XYZ, NPY, NPZ), or from an array: depth (H, W) as
    floats, metres, 0 or NaN where nothing was measured, or points (N, 3) or (H, W, 3), metres, camera frame.

    camera : camera.json or its members; a depth image needs one. Raises ScanError.
    """
    from pmpnbp.scene import scan_files

    given = members_or_path(camera, "camera", ScanError)
    if isinstance(source, np.ndarray):
        return scan_files.scan_of(source, given)
    if not isinstance(source, str | PathLike):
        raise ScanError(f"a scan is {source!r:.60}; expected the path of a file, an array, or what load_scan gives")
    return scan_files.load_scan(Path(source), given)


def members_or_path(
    source: AnyPath | Mapping[str, object] | None, kind: str, failure: type[PmpnbpError]
) -> Path | Mapping[str, object] | None:
    """What a file KIND.json says, or the path of one, or None. Raises `failure` for anything else."""
    if source is None or isinstance(source, Mapping):
        return source
    if isinstance(source, str) and source.lstrip().startswith("{"):
        raise failure(f"the {kind} is JSON text; expected the path of a {kind}.json, or its members as a dict")
    if isinstance(source, str | PathLike):
        return Path(source)
    raise failure(f"the {kind} is {source!r:.60}; expected the path of a {kind}.json, or its members as a dict")
