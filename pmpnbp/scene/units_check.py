"""Are model and scan in the same units? Millimetres that are taken for metres make an object a thousand times too
large, or put all that was measured a thousand times too far away; a search would end in nothing, minutes later."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pmpnbp.errors import ScanError
from pmpnbp.scene.observation import Scan

# A model is longer than its scans show of the world by this factor at the most: of a building one sees a room.
LARGER = 50.0
# Metres: no depth camera sees nothing that is farther than this.
NEAR = 0.1
# Pixels that an object is long, at the least, where what was measured is nearest.
SMALLEST = 1.0


def check_units(length: float, scans: Sequence[Scan]) -> None:
    """Raise ScanError where an object `length` metres long can hardly be in what the scans show; an infinite length is
    not known."""
    measured = [(scan.camera, scan.depth[scan.depth > 0]) for scan in scans]
    measured = [(camera, depths) for camera, depths in measured if len(depths)]
    if not measured or not 0 < length < np.inf:
        return
    farthest = max(float(depths.max()) * np.hypot(1.0, camera.widest_ray) for camera, depths in measured)
    if length > LARGER * farthest:
        doubt = "is the scan in another unit?" if farthest < NEAR else "is the model in millimetres?"
        raise ScanError(
            f"the model is {length:.3g} m long, and nothing that was measured is farther than {farthest:.2g} m from "
            f"its camera; expected both in metres: {doubt}"
        )
    nearest, pixels = max(
        ((float(depths.min()), length * camera.fx / float(depths.min())) for camera, depths in measured),
        key=lambda each: each[1],
    )
    if pixels < SMALLEST:
        raise ScanError(
            f"the model is {length:.2g} m long, {pixels:.1g} pixels where what was measured is nearest, "
            f"{nearest:.3g} m away; expected both in metres: is the scan in millimetres?"
        )
