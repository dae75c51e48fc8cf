"""How noisy is a scan? The standard deviation of its depths, from its own surfaces or by the kind of sensor."""

from __future__ import annotations

import numpy as np

from pmpnbp.scene.observation import View

# Median of a standard normal deviate's size; variance of a second difference, in those of its pixels.
NORMAL_MEDIAN, SECOND_DIFFERENCE = 0.6745, 6.0
# Standard deviation, metres, of a depth of z metres: the coefficients of 1, z and z². Structured light as Nguyen, Izadi
# and Lovell (2012) measured it of a Kinect, time of flight as Fankhauser et al. (2015) of its successor; stereo by
# geometry: a tenth of a pixel of disparity, 50 mm between the cameras, 600 pixels of focal length.
SENSORS = {
    "structured_light": (0.0015, -0.0015, 0.0019),
    "time_of_flight": (0.0015, -0.0005, 0.0003),
    "stereo": (0.0, 0.0, 0.0033),
}


def depth_noise(view: View, sensor: str = "estimated") -> float:
    """Standard deviation in metres of a pixel's depth, at the median depth of the view's OBJECT pixels; 0 where there
    are none. sensor : one of SENSORS, or "estimated", by the view's surfaces.

    Noise of depth grows with its square, as that of a disparity does; in inverse depth, linear on planes, it is the
    same everywhere, and is what second differences of neighbours have. Their median passes over steps and bends. It
    passes over what a filter has smoothed as well, errors that neighbours share: then the kind of sensor says more.
    """
    if not view.distance:
        return 0.0
    if sensor in SENSORS:
        return float(np.polynomial.polynomial.polyval(view.distance, SENSORS[sensor]))
    measured = view.depth > 0
    inverse = np.where(measured, 1.0 / np.where(measured, view.depth, 1.0), np.nan)
    bends = np.concatenate([(a[2:] - 2.0 * a[1:-1] + a[:-2]).ravel() for a in (inverse, inverse.T)])
    bends = np.abs(bends[np.isfinite(bends)])
    if not len(bends):
        return 0.0
    deviation = np.median(bends) / NORMAL_MEDIAN / np.sqrt(SECOND_DIFFERENCE)
    return float(deviation * view.distance**2)
