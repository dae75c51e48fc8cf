"""What was clicked at? The particle nearest to the click's ray, else the part that the ray meets first."""

from __future__ import annotations

import numpy as np

from app.viewer.scene_frame import Floats, Targets
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array

# Radians: how far beside a particle a click may be. About ten pixels of a view 900 pixels high.
AIM = 0.009


def picked(targets: Targets, origin: Array, direction: Array) -> tuple[int, int | None] | None:
    """Number of the part, and of the particle where one was hit; None for nothing.

    origin, direction : (3,), the ray, world; the direction need not have length 1
    """
    ray = direction / np.linalg.norm(direction)
    if targets.particles_shown:
        particle = nearest_particle(targets.particles, origin, ray)
        if particle is not None:
            return particle
    if targets.estimate_shown:
        part = first_part(targets, origin, ray)
        if part is not None:
            return part, None
    return None


def nearest_particle(points: Array, origin: Array, ray: Array) -> tuple[int, int] | None:
    """Part and index of the point of (N, T, 3) that is seen nearest to the ray, within AIM of it; None for none."""
    offset = points - origin
    along = offset @ ray
    beside = np.linalg.norm(offset - along[..., None] * ray, axis=-1)
    angle = np.where(along > 0, np.arctan2(beside, along), np.inf)
    part, index = np.unravel_index(int(angle.argmin()), angle.shape)
    return (int(part), int(index)) if angle[part, index] <= AIM else None


def first_part(targets: Targets, origin: Array, ray: Array) -> int | None:
    """Number of the part whose surface the ray meets first; None where it meets none."""
    best, nearest = None, np.inf
    for number, (pose, corners) in enumerate(zip(targets.poses, targets.corners, strict=True)):
        back = poses.inverse(pose)
        distance = _first_hit(corners, poses.transform_points(back, origin), poses.rotate(back[3:], ray))
        if distance < nearest:
            best, nearest = number, distance
    return best


def _first_hit(corners: Floats, origin: Array, ray: Array) -> float:
    """Distance along a ray to the first of the triangles (F, 3, 3); infinite for none (Möller and Trumbore 1997)."""
    first = corners[:, 0].astype(np.float64)
    one, other = corners[:, 1] - first, corners[:, 2] - first
    across = np.cross(ray, other)
    determinant = np.einsum("fc,fc->f", one, across)
    with np.errstate(divide="ignore", invalid="ignore"):
        offset = origin - first
        u = np.einsum("fc,fc->f", offset, across) / determinant
        turned = np.cross(offset, one)
        v = turned @ ray / determinant
        distance = np.einsum("fc,fc->f", other, turned) / determinant
        hit = (np.abs(determinant) > 1e-12) & (u >= 0) & (v >= 0) & (u + v <= 1) & (distance > 0)
    return float(distance[hit].min()) if hit.any() else np.inf
