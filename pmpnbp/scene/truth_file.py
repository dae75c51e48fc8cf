"""Where were the links really? Reads the truth.json that lies beside a sample scan."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pmpnbp.errors import ScanError
from pmpnbp.geometry import poses
from pmpnbp.names import some_of
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.json_files import finite_number, read_object


def load_truth(path: Path) -> dict[str, Any]:
    """`links`: link name to pose (7,), link in world; `joints`: joint name to position, metres or radians.

    The file is `{"links": {LINK: 4x4 matrix, nested or as 16 numbers, row-major}, "joints": {JOINT: number}}`; `joints`
    may be absent. Raises ScanError where it is not.
    """
    return truth_of(read_object(path, "truth file", ScanError), f"truth file '{path.name}'")


def check_truth(truth: Mapping[str, Any], model: ArticulatedObject) -> None:
    """ScanError where a truth names links or joints that the model does not have."""
    for kind, known in (("link", model.links), ("joint", [joint.name for joint in model.joints])):
        if unknown := [name for name in truth[f"{kind}s"] if name not in known]:
            raise ScanError(f"{kind} '{unknown[0]:.60}' of the truth is not in the model; it has {some_of(known)}")


def truth_of(members: object, name: str) -> dict[str, Any]:
    """The same of what was read from such a file; `name` is what an error calls it."""
    links = members.get("links") if isinstance(members, Mapping) else None
    joints = members.get("joints", {}) if isinstance(members, Mapping) else None
    if not isinstance(links, dict) or not isinstance(joints, dict):
        raise ScanError(f"{name} is not an object with 'links' and 'joints'")
    found = {}
    for link, matrix in links.items():
        try:
            found[link] = poses.from_matrix(np.array(matrix, dtype=np.float64).reshape(4, 4))
        except (ValueError, TypeError):
            raise ScanError(f"link '{link:.60}' of {name} has no 4x4 matrix of a pose") from None
    for joint, position in joints.items():
        if finite_number(position) is None:
            raise ScanError(f"joint '{joint:.60}' of {name} is {position!r:.60}; expected a finite number")
    return {"links": found, "joints": {joint: float(position) for joint, position in joints.items()}}
