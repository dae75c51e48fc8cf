"""What do sessions look at, and what for? Models and observations that were made of the store's files lately: whoever
begins anew, or opens the same again, does not wait for them twice."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from threading import Lock

import numpy as np
from cachetools import LRUCache, cached

from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.observation import Observation, Scan
from pmpnbp.scene.observe import observe
from pmpnbp.scene.urdf import load_model

# Bytes of meshes kept, and observations, each of which has about a megabyte.
MODEL_BYTES, OBSERVATIONS = 64 << 20, 8


def _state(file: Path) -> tuple[Path, int, int]:
    """What is another where the file is."""
    try:
        found = file.stat()
    except OSError:  # which who reads it will say
        return file, 0, 0
    return file, found.st_mtime_ns, found.st_size


def _mesh_bytes(model: ArticulatedObject) -> int:
    meshes = [mesh for part in model.parts for mesh in (part.mesh, part.inference_mesh)]
    return sum(mesh.vertices.nbytes + mesh.faces.nbytes for mesh in meshes)


@cached(
    LRUCache(MODEL_BYTES, getsizeof=_mesh_bytes), key=lambda file, triangles: (_state(file), triangles), lock=Lock()
)
def model_in(file: Path, triangles: int) -> ArticulatedObject:
    """The model in a file, with so many triangles a part at most. Raises ModelError."""
    return load_model(file, triangle_budget=triangles)


@cached(
    LRUCache(OBSERVATIONS),
    key=lambda files, _, roi, width, length: (*map(_state, files), None if roi is None else tuple(roi), width, length),
    lock=Lock(),
)
def observation_of(
    files: Sequence[Path], scans: Sequence[Scan], roi: Sequence[float] | None, width: int, length: float
) -> Observation:
    """What `scans` make of the scene, which are read from `files`, as `scene.observe` has it. Raises ScanError."""
    return observe(scans, None if roi is None else np.array(roi, dtype=np.float64), width=width, length=length)
