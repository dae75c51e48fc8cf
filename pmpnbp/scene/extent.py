"""How long is an object? From end to end, joints at rest."""

from __future__ import annotations

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.patches import length


def length_of(model: ArticulatedObject) -> float:
    """Metres from one end to the other of the longest part, or of the object at rest where that is longer."""
    clouds = _at_rest(model)
    return max(map(length, [*clouds, np.concatenate(clouds)]))


def lengths_along_root(model: ArticulatedObject) -> Array:
    """(3,) metres: how far the object at rest and the root part's origin are from end to end along that part's axes."""
    reach: Array = np.ptp(np.concatenate([np.zeros((1, 3)), *_at_rest(model)]), axis=0)
    return reach


def _at_rest(model: ArticulatedObject) -> list[Array]:
    """Of each part that has a surface, its vertices (V, 3) in the root part's frame, joints at rest."""
    at_rest = model.part_poses(poses.IDENTITY, np.clip(0.0, model.lower, model.upper))
    return [
        poses.transform_points(pose, part.mesh.vertices)
        for pose, part in zip(at_rest, model.parts, strict=True)
        if len(part.mesh.vertices)
    ]
