"""What is a pixel of a scan to a surface that is rendered over it? The cases of the robust pixel score, told apart.

Pictures, the scene and their legends all show these kinds; `kernels.reference.robust_scores` says what each is worth.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from pmpnbp.scene import observation as scene


class PixelKind(IntEnum):
    """Within the tolerance a covered pixel is EXPLAINED, or ON_SUPPORT where it is on a support plane, or
    OUTSIDE_ROI, worth nothing, where it is outside the region of interest, or GOES_ON where it is on a surface longer
    than the object. Beyond it the pixel is SEEN_THROUGH where
    the observed surface lies behind the rendered one (free space is violated), or is a support plane that the rendered
    one stands behind; both cost as much. It is IN_FRONT where anything else is nearer.
    """

    NOT_COVERED = 0
    EXPLAINED = 1
    ON_SUPPORT = 2
    IN_FRONT = 3
    SEEN_THROUGH = 4
    NO_DEPTH = 5
    OUTSIDE_ROI = 6
    GOES_ON = 7


_WITHIN = {
    scene.OBJECT: PixelKind.EXPLAINED,
    scene.SUPPORT: PixelKind.ON_SUPPORT,
    scene.OUTSIDE: PixelKind.OUTSIDE_ROI,
    scene.CONTINUED: PixelKind.GOES_ON,
}


def pixel_kinds(
    observed: NDArray[np.float32], category: NDArray[np.uint8], rendered: NDArray[np.float32], tolerance: float
) -> NDArray[np.uint8]:
    """The PixelKind of each pixel, any shape. observed, rendered : metres, 0 where there is nothing; tolerance : metres
    category : as `scene.observation.View.category`"""
    difference = observed - rendered
    near = np.abs(difference) < tolerance
    behind = (difference > 0) | (category == scene.SUPPORT)
    kinds = np.where(behind, PixelKind.SEEN_THROUGH, PixelKind.IN_FRONT).astype(np.uint8)
    for what, kind in _WITHIN.items():
        kinds[near & (category == what)] = kind
    kinds[category == scene.NO_DEPTH] = PixelKind.NO_DEPTH
    kinds[rendered <= 0] = PixelKind.NOT_COVERED
    return kinds


def in_front(
    observed: NDArray[np.float32], rendered: NDArray[np.float32], tolerance: float | NDArray[np.floating]
) -> NDArray[np.bool_]:
    """Where a surface was observed nearer than the rendered one by more than `tolerance`, metres, so that this cannot
    be seen; whatever the surface is, a support plane too."""
    return (observed > 0) & (observed < rendered - tolerance)
