"""How far is an estimate from the truth? The average distance metric of eq. 12, and its form for symmetric parts."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.articulated_object import Mesh
from pmpnbp.scene.surface_points import even_points

# Points of a part's surface that the metrics average over.
MODEL_POINTS = 1000


def model_points(mesh: Mesh, count: int = MODEL_POINTS) -> Array:
    """Points (count, 3) spread evenly over a mesh's surface, the set M of eq. 12; the same for the same mesh."""
    return even_points(mesh, count)


def add(points: Array, estimate: Array, truth: Array) -> float:
    """ADD, metres (eq. 12): mean distance between the same points (m, 3) at two poses (7,)."""
    difference = poses.transform_points(estimate, points) - poses.transform_points(truth, points)
    return float(np.linalg.norm(difference, axis=1).mean())


def add_s(points: Array, estimate: Array, truth: Array) -> float:
    """ADD-S, metres: mean distance from each point at the true pose to the nearest one at the estimate (Hinterstoisser
    et al. 2012), for parts whose turns cannot be told apart."""
    distance, _ = cKDTree(poses.transform_points(estimate, points)).query(poses.transform_points(truth, points))
    return float(distance.mean())
