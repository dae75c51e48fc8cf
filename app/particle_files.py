"""How do weighted poses leave the server? As JSON, as NPZ for NumPy, or as PLY, which 3D viewers open."""

from __future__ import annotations

import io
from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry.poses import Array
from pmpnbp.json_text import json_bytes

Format = Literal["json", "npz", "ply"]
MEDIA_TYPES: Mapping[Format, str] = {
    "json": "application/json",
    "npz": "application/octet-stream",
    "ply": "application/octet-stream",
}
# Numbers beside each pose, (T,), by name.
Columns = Mapping[str, NDArray[Any]]
COMPONENTS = ("x", "y", "z", "qw", "qx", "qy", "qz")


def written(members: Mapping[str, Any], particles: Array, columns: Columns, form: Format) -> bytes:
    """Particles (T, 7), x y z qw qx qy qz, metres, and `columns` (T,) of each, as a file.

    members : what JSON tells besides; text and numbers of it are in the NPZ too
    """
    if form == "json":
        lists = {name: values.tolist() for name, values in columns.items()}
        return json_bytes({**members, "particles": particles.tolist(), **lists})
    if form == "npz":
        file = io.BytesIO()
        arrays: dict[str, Any] = {**columns, **{name: np.array(value) for name, value in members.items()}}
        np.savez(file, particles=particles, **arrays)
        return file.getvalue()
    return _ply(members, particles, columns)


def _ply(members: Mapping[str, Any], particles: Array, columns: Columns) -> bytes:
    names = (*COMPONENTS, *columns)
    header = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {name} {' '.join(str(value).split())}" for name, value in members.items()),
        f"element vertex {len(particles)}",
        *(f"property double {name}" for name in names),
        "end_header",
    ]
    table = np.column_stack([particles, *columns.values()]).astype("<f8")
    return "\n".join([*header, ""]).encode("ascii", "backslashreplace") + table.tobytes()
