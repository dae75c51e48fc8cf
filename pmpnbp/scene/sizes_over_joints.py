"""How large can an object look? Its height, and the sides of its footprint, over the ranges of its joints."""

from __future__ import annotations

from itertools import product

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.articulated_object import ArticulatedObject

# Joint configurations that a model is looked at in, one of them all joints at rest.
CONFIGURATIONS = 128
# Level directions, every 6° of a half turn, and upward: what is measured along them tells the smallest upright box.
_TURNS = np.arange(30) * np.pi / 30
DIRECTIONS = np.concatenate([np.stack([np.cos(_TURNS), np.sin(_TURNS), 0 * _TURNS], axis=1), [[0.0, 0.0, 1.0]]])


def reaches(points: Array) -> Array:
    """(..., 2, 31) metres: from where to where `points` (..., P, 3), z upward, reach along each of DIRECTIONS."""
    along = points @ DIRECTIONS.T
    return np.stack([along.min(axis=-2), along.max(axis=-2)], axis=-2)


def united(first: Array, second: Array) -> Array:
    """The `reaches` (..., 2, 31) of two things together."""
    low, high = np.minimum(first[..., 0, :], second[..., 0, :]), np.maximum(first[..., 1, :], second[..., 1, :])
    return np.stack([low, high], axis=-2)


def sides(reach: Array) -> Array:
    """(..., 3) metres of something with these `reaches` (..., 2, 31): its height, and the longer and the shorter side
    of the smallest upright box around it."""
    lengths = reach[..., 1, :] - reach[..., 0, :]
    pairs = np.stack([lengths[..., :15], lengths[..., 15:30]], axis=-1)
    smallest = pairs.prod(axis=-1).argmin(axis=-1)
    pair = np.take_along_axis(pairs, smallest[..., None, None], axis=-2)[..., 0, :]
    return np.concatenate([lengths[..., 30:], pair.max(axis=-1, keepdims=True), pair.min(axis=-1, keepdims=True)], -1)


def configurations(model: ArticulatedObject) -> Array:
    """(S, D): joint positions at rest, and as drawn from their ranges. The draws are the same in every call."""
    shares = np.random.default_rng(0).random((CONFIGURATIONS, model.dof))
    spread = model.lower + (model.upper - model.lower) * shares
    spread[0] = np.clip(0.0, model.lower, model.upper)
    return spread


def sides_over_joints(model: ArticulatedObject) -> Array:
    """(S, 3) metres: the `sides` of the upright model in its `configurations`; each part counts as its bounding box."""
    part_poses = model.part_poses(poses.IDENTITY, configurations(model))
    corners = [
        poses.transform_points(part_poses[:, None, number], _corners(part.mesh.vertices))
        for number, part in enumerate(model.parts)
        if part.visible
    ]
    return sides(reaches(np.concatenate(corners, axis=1)))


def _corners(vertices: Array) -> Array:
    """(8, 3): of the box around `vertices` (V, 3)."""
    ends = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
    return np.array([[ends[up][axis] for axis, up in enumerate(which)] for which in product((0, 1), repeat=3)])
