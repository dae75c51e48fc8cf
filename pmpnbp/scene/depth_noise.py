"""How noisy is a scan? The standard deviation of its depths, from its own surfaces or by the kind of sensor, and how
many of its pixels err together, which its surfaces tell."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pmpnbp.geometry.poses import Array
from pmpnbp.scene.observation import View

# Median of a standard normal deviate's size; variance of a second difference, in those of its pixels.
NORMAL_MEDIAN, SECOND_DIFFERENCE = 0.6745, 6.0
# Standard deviation, metres, of a depth of z metres: the coefficients of 1, z and z². Structured light as Nguyen, Izadi
# and Lovell (2012) measured it of a Kinect, time of flight as Fankhauser et al. (2015) of its successor; stereo by
# geometry: a tenth of a pixel of disparity, 50 mm between the cameras, 600 pixels of focal length.
COEFFICIENTS = {
    "structured_light": (0.0015, -0.0015, 0.0019),
    "time_of_flight": (0.0015, -0.0005, 0.0003),
    "stereo": (0.0, 0.0, 0.0033),
}
# A surface is about as far away as the object up to this ratio of their depths: the noise of what is farther may be
# another, of a bare wall without what stereo finds again. All surfaces are asked where fewer second differences tell.
NEAR, ENOUGH = 1.4, 500
# A second difference of so many deviations is of a step or a bend.
STEP = 4.0
# Pixels across the blocks whose means are compared, each twice as many as the last; how many blocks beside one another
# tell enough; and how many times as large as of pixels that each err on their own their variance has to be: of 388 such
# scans it was 2.6 at the most.
BLOCKS, FEW, ALONE = (2, 4, 8), 30, 3.0
# Pixels that err as one, at the least, where any do: differences farther apart have steps and bends in them as well.
LEAST = 1.5
# A deviation is so many times what neighbours' differences tell at the most: of a real arm's curved links they are 3.5
# times as large, and a tolerance as wide as that lost its wrist. What is left out is in the area.
WIDEST = 1.7
# So many times a pixel's own deviation is what the posterior has it tell where each errs on its own: pixels share what
# steps of depth, outlines and the mesh do. Set on even seeds of `benchmarks.belief`, docs/algorithm.md.
SHARED = 1.25
# Pixels from one to the next where neighbours err together, so that their differences have all of the error.
LAGS = (2, 3, 4)


class DepthNoise(NamedTuple):
    """std : metres, of a pixel's depth, at the median depth of the view's OBJECT pixels; 0 where there are none
    area : so many pixels err as one: the mean of n has the variance std² × area / n; 1 where each errs on its own
    """

    std: float
    area: float


def depth_noise(view: View, sensor: str = "estimated") -> DepthNoise:
    """How noisy a view's depths are. sensor : one of COEFFICIENTS, which then tell the deviation, or "estimated", by
    the view's surfaces.

    Noise of depth grows with its square, as that of a disparity does; in inverse depth, linear on planes, it is the
    same everywhere, and is what second differences of neighbours have. Their median passes over steps and bends. It
    passes over what neighbours share as well, the errors of stereo matching or of a filter. These are in the second
    differences of blocks' means, whose variance falls with the number of pixels only where each errs on its own (Allan
    1966), and of pixels farther apart.
    """
    if not view.distance:
        return DepthNoise(0.0, 1.0)
    measured = view.depth > 0
    everywhere = np.where(measured, 1.0 / np.where(measured, view.depth, 1.0), np.nan)
    inverse = np.where(np.abs(np.log(everywhere * view.distance)) < np.log(NEAR), everywhere, np.nan)
    own, count = _deviation(inverse, 1)
    if count < ENOUGH:
        inverse = everywhere
        own, _ = _deviation(inverse, 1)
    larger, area = _together(_flat(inverse, own))
    std = larger * own * view.distance**2
    if sensor in COEFFICIENTS:
        std = float(np.polynomial.polynomial.polyval(view.distance, COEFFICIENTS[sensor]))
    return DepthNoise(std, area)


def told_noise(stds: Array, areas: Array) -> Array:
    """(V,) deviations that the posterior goes by, a pixel telling SHARED times as much: of depths with deviations
    `stds`, of which `areas` (V,) pixels err as one."""
    found: Array = stds * np.where(areas > 1, np.sqrt(areas) / SHARED, 1.0)
    return found


def _flat(inverse: Array, deviation: float) -> Array:
    """Inverse depths (h, w), nan where there are none or a step or a bend is. A pixel that was not measured between two
    that were has their mean: of blocks with holes few would be left."""
    flat = inverse.copy()
    for kept in (flat, flat.T):
        hole = np.isnan(kept[1:-1])
        kept[1:-1][hole] = (kept[2:] + kept[:-2])[hole] / 2
    return _without_bends(flat, inverse, 1, deviation)


def _without_bends(flat: Array, image: Array, step: int, deviation: float) -> Array:
    """`flat` (h, w) without what a step or a bend is in, nan there: where a second difference of an `image` (h, w), of
    pixels `step` apart that have a `deviation`, is too large for noise."""
    kept = flat.copy()
    for own, turned in ((kept, image), (kept.T, image.T)):
        bent = np.abs(_second_differences(turned, step)) > STEP * np.sqrt(SECOND_DIFFERENCE) * deviation
        for first in (0, step, 2 * step):
            own[first : len(bent) + first][bent] = np.nan
    return kept


def _together(flat: Array) -> tuple[float, float]:
    """How many times as large as neighbours' differences tell a deviation is; and how many pixels err as one."""
    own, _ = _deviation(flat, 1)
    if own <= 0:
        return 1.0, 1.0
    area, means, deviation = 1.0, flat, own
    for block in BLOCKS:
        half = block // 2
        if half > 1:
            # steps and bends that only blocks tell
            means = _without_bends(means, means, half, deviation)
        means = (means[half:] + means[:-half]) / 2
        means = (means[:, half:] + means[:, :-half]) / 2
        deviation, count = _deviation(means, block)
        if count >= FEW * block**2:
            area = max(area, (block * deviation / own) ** 2)
    if area < ALONE:
        return 1.0, 1.0
    apart = max(_deviation(flat, lag)[0] for lag in LAGS) / own
    larger = min(max(apart, 1.0), WIDEST, float(np.sqrt(area / LEAST)))
    return larger, area / larger**2


def _second_differences(image: Array, step: int) -> Array:
    """(h - 2 step, w), down an image (h, w), of pixels `step` apart."""
    return image[2 * step :] - 2.0 * image[step:-step] + image[: -2 * step]


def _deviation(image: Array, step: int) -> tuple[float, int]:
    """Standard deviation of an image's pixels, by second differences along both axes; and the number of these."""
    bends = np.concatenate([_second_differences(turned, step).ravel() for turned in (image, image.T)])
    bends = np.abs(bends[np.isfinite(bends)])
    if not len(bends):
        return 0.0, 0
    return float(np.median(bends) / NORMAL_MEDIAN / np.sqrt(SECOND_DIFFERENCE)), len(bends)
