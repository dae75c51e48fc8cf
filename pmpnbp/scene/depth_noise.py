"""How noisy is a scan? The standard deviation of its depths, from its own surfaces."""

from __future__ import annotations

import numpy as np

from pmpnbp.scene.observation import View

# Median of a standard normal deviate's size; variance of a second difference, in those of its pixels.
NORMAL_MEDIAN, SECOND_DIFFERENCE = 0.6745, 6.0


def depth_noise(view: View) -> float:
    """Standard deviation in metres of a pixel's depth, at the median depth of the view's OBJECT pixels; 0 where there
    are none.

    Noise of depth grows with its square, as that of a disparity does; in inverse depth, linear on planes, it is the
    same everywhere, and is what second differences of neighbours have. Their median passes over steps and bends.
    """
    measured = view.depth > 0
    inverse = np.where(measured, 1.0 / np.where(measured, view.depth, 1.0), np.nan)
    bends = np.concatenate([(a[2:] - 2.0 * a[1:-1] + a[:-2]).ravel() for a in (inverse, inverse.T)])
    bends = np.abs(bends[np.isfinite(bends)])
    if not len(bends) or not view.distance:
        return 0.0
    deviation = np.median(bends) / NORMAL_MEDIAN / np.sqrt(SECOND_DIFFERENCE)
    return float(deviation * view.distance**2)
