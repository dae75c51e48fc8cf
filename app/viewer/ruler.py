"""How large is it? A ruler in the scene, at the foot of what may be the object, before it and level.

A bar on the screen would be right at one distance alone: in perspective a metre in front is longer than one behind.
This one stands where the object is, turns with the scene, and is right wherever it is looked at from.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from app.viewer.scene_frame import Floats
from pmpnbp.geometry.poses import Array

# Metres that a ruler can be long, and from mark to mark; it is the longest that is no longer than the object.
LENGTHS = ((0.05, 0.01), (0.1, 0.02), (0.2, 0.05), (0.5, 0.1), (1.0, 0.1), (2.0, 0.5), (5.0, 1.0), (10.0, 1.0))
# How high its marks are, and those at its ends, as shares of its length; how far before the object, as one of its size.
MARK, END, BEFORE = 0.04, 0.09, 0.12
# How high it stands over the floor, whose points are not to cover it, as a share of its length.
OVER = 0.02
# Of the points that may be the object so many percent are below its foot, and before it.
OUTLIERS = 0.5
# A support plane is the floor where its normal is within 18 degrees of up.
LEVEL = 0.95


@dataclass(frozen=True)
class Ruler:
    """segments : (S, 2, 3), metres, world; length, step : metres, of the whole and from mark to mark; end : (3,), where
    its label is"""

    segments: Floats
    length: float
    step: float
    end: Array

    @property
    def text(self) -> str:
        """Its length in words."""
        return f"{self.length:g} m" if self.length >= 1 else f"{100 * self.length:g} cm"


def ruler(points: Array, planes: Array, up: Array, ahead: Array, size: float) -> Ruler | None:
    """Of an object about `size` metres large, of which `points` (P, 3) may be, before a sensor that looks `ahead` (3,);
    None where there are no points. planes : (K, 4), n·x + d = 0, support planes; all in world"""
    right = np.cross(ahead, up)
    if len(points) == 0 or np.linalg.norm(right) < 1e-3:
        return None
    right /= np.linalg.norm(right)
    forward = np.cross(up, right)
    length, step = [fits for fits in LENGTHS if fits[0] <= max(size, LENGTHS[0][0])][-1]
    near = float(np.percentile(points @ forward, OUTLIERS)) - BEFORE * size
    across = float(np.median(points @ right)) - length / 2
    level = across * right + near * forward
    start = level + (_foot(points, planes, up, level) + OVER * length) * up
    marks = np.arange(round(length / step) + 1)
    heights = np.where((marks == 0) | (marks == marks[-1]), END, MARK) * length
    low = start + (step * marks)[:, None] * right
    ticks = np.stack([low, low + heights[:, None] * up], axis=1)
    line = np.stack([low[0], low[-1]])[None]
    return Ruler(np.concatenate([line, ticks]).astype(np.float32), length, step, low[-1] + heights[-1] * up)


def _foot(points: Array, planes: Array, up: Array, below: Array) -> float:
    """Metres along `up`: of the floor at `below` (3,), where one is just under the points, else of the lowest ones."""
    lowest = float(np.percentile(points @ up, OUTLIERS))
    for plane in planes:
        rise = float(plane[:3] @ up)
        if abs(rise) > LEVEL:
            height = -float(plane[:3] @ below + plane[3]) / rise
            if abs(height - lowest) < 0.1:
                return height
    return lowest
