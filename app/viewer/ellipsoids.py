"""How far does a belief reach? The ellipsoid that holds a chosen share of a gaussian position.

The squared Mahalanobis distance of a gaussian in three dimensions is chi-square distributed with three degrees of
freedom, so the ellipsoid's radii are the standard deviations along the covariance's main axes times the root of that
distribution's quantile (2.03 for 75 %).
"""

from __future__ import annotations

import numpy as np
from scipy.special import gammaincinv

from app.viewer.scene_frame import Ellipsoids
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.pictures.palette import Colour

# A radius is drawn at least so long, metres: a covariance of rank two is still something to see.
THINNEST = 2e-4


def radius_scale(confidence: float) -> float:
    """Radii in standard deviations of the ellipsoid that holds `confidence`, 0 to 1, of a position in space."""
    # the quantile of chi-squared with 3 degrees of freedom; scipy.stats, which also has it, takes a second to import
    return float(np.sqrt(2 * gammaincinv(1.5, confidence)))


def ellipsoids(covariances: Array, confidence: float) -> tuple[Array, Array]:
    """Turns (K, 4), w x y z, of the main axes in world, and radii (K, 3), metres, along them, of position covariances
    (K, 3, 3), square metres, world."""
    variances, axes = np.linalg.eigh(covariances)
    # a mirrored frame is no rotation
    axes = axes * np.where(np.linalg.det(axes) < 0, -1.0, 1.0)[:, None, None]
    matrices = np.tile(np.eye(4), (len(axes), 1, 1))
    matrices[:, :3, :3] = axes
    radii = radius_scale(confidence) * np.sqrt(np.maximum(variances, 0.0))
    return poses.from_matrix(matrices)[:, 3:], np.maximum(radii, THINNEST)


def ellipsoid(name: str, centre: Array, radii: Array, colour: Colour, opacity: float) -> Ellipsoids:
    """The node of one ellipsoid at `centre` (3,), whose `radii` (3,) are along world's axes; metres."""
    return Ellipsoids(
        name,
        centre[None].astype(np.float32),
        np.array([[1, 0, 0, 0]], dtype=np.float32),
        radii[None].astype(np.float32),
        np.array([colour], dtype=np.uint8),
        np.array([opacity], dtype=np.float32),
    )
