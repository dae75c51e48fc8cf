"""What does a depth camera make of a scene? Noise, steps of depth and holes over a perfect depth image.

Structured light: axial noise grows with the square of the range (Nguyen, Izadi and Lovell 2012, 3DIMPVT: 1.2 mm +
1.9 mm (z - 0.4)^2), each pixel's its own; depth comes from a disparity in eighths of a pixel (focal length 580 px,
baseline 75 mm); outlines waver by half a pixel; pixels at depth discontinuities, on grazing surfaces and at random are
lost. Dark surfaces, which send little of the pattern back, are measured in patches only.

Stereo: windows are matched, so that neighbours' disparities err together, and what is in front grows over its outlines
(focal length 385 px, baseline 50 mm, disparities in thirty-seconds of a pixel); what does not match is lost in patches.

Time of flight: noise is each pixel's own, but flying pixels lie anywhere between the two sides of an outline, and two
errors are smooth: one that goes up and down with the range, and one over the picture.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

FOCAL_BASELINE = 580 * 0.075
DISPARITY_STEP = 1 / 8
JUMP = 0.03
EDGE_LOSS = 0.6
RANDOM_LOSS = 0.01
GRAZING = np.deg2rad(80.0)
LATERAL_SIGMA = 0.5
FARTHEST = 8.0
# Of a dark surface: the share that is lost, and the size of patches, a standard deviation in pixels.
DARK_LOSS = 0.7
PATCH = 7.0
# Stereo, pixels: standard deviations of a disparity's error that a window shares, and of a pixel's own; the window's
# size, a standard deviation; the disparity's step; the shares of outlines that grow by a pixel, and that are lost; the
# share of the picture that has no match, and the size of its patches.
STEREO_FOCAL_BASELINE = 385 * 0.05
SHARED_SIGMA, OWN_SIGMA, WINDOW, STEREO_STEP = 0.06, 0.02, 2.5, 1 / 32
GROWN, STEREO_EDGE_LOSS, UNMATCHED, UNMATCHED_SIZE = 0.3, 0.3, 0.015, 5.0
# Time of flight: the share of an outline's pixels that fly; standard deviations, metres, of the two smooth errors, the
# range over which the one goes up and down, and the size of the other, a standard deviation in pixels.
FLYING, WIGGLE, WIGGLE_LENGTH, SMOOTH, SMOOTH_SIZE = 0.5, 0.0014, 0.9, 0.0015, 40.0

Image = NDArray[np.float64]


def axial_sigma(depth: Image) -> Image:
    """Standard deviation, metres, of structured light's noise along z at `depth`, metres."""
    return 0.0012 + 0.0019 * (depth - 0.4) ** 2


def quantised(depth: Image, focal_baseline: float = FOCAL_BASELINE, step: float = DISPARITY_STEP) -> Image:
    """`depth` in metres, moved to the nearest depth that a whole number of disparity steps gives; 0 stays 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        disparity = np.round(focal_baseline / depth / step) * step
        return np.where(depth > 0, focal_baseline / disparity, 0.0)


def at_edge(depth: Image) -> NDArray[np.bool_]:
    """Pixels with a depth step over 3 cm to one of their four neighbours; 0 counts as far away."""
    filled = np.where(depth > 0, depth, FARTHEST)
    edge = np.zeros(depth.shape, dtype=bool)
    rows = np.abs(np.diff(filled, axis=0)) > JUMP
    columns = np.abs(np.diff(filled, axis=1)) > JUMP
    edge[1:] |= rows
    edge[:-1] |= rows
    edge[:, 1:] |= columns
    edge[:, :-1] |= columns
    return edge


def wavering_outlines(depth: Image, rng: np.random.Generator) -> Image:
    """`depth` with every pixel within reach of a discontinuity read from a place half a pixel (1 sigma) beside it.

    Only across a discontinuity: the slope of a surface is not lateral noise's doing.
    """
    height, width = depth.shape
    v, u = np.indices(depth.shape)
    shift = np.rint(rng.normal(0.0, LATERAL_SIGMA, (2, height, width))).astype(int)
    beside = depth[np.clip(v + shift[0], 0, height - 1), np.clip(u + shift[1], 0, width - 1)]
    return np.where(np.abs(beside - depth) > JUMP, beside, depth)


def structured_light(depth: Image, cosine: Image, rng: np.random.Generator) -> tuple[Image, NDArray[np.bool_]]:
    """Depths in metres, and which are lost."""
    seen = wavering_outlines(depth, rng)
    noisy = quantised(np.where(seen > 0, np.maximum(seen + rng.normal(0.0, axial_sigma(seen)), 1e-3), 0.0))
    lost = at_edge(depth) & (rng.random(depth.shape) < EDGE_LOSS)
    lost |= rng.random(depth.shape) < RANDOM_LOSS
    lost |= np.abs(cosine) < np.cos(GRAZING)
    return noisy, lost


def stereo(depth: Image, cosine: Image, rng: np.random.Generator) -> tuple[Image, NDArray[np.bool_]]:
    """Depths in metres, and which are lost."""
    filled = np.where(depth > 0, depth, 2 * FARTHEST)
    front = ndimage.minimum_filter(filled, size=3)
    seen = np.where(_patches(rng, depth.shape, WINDOW, GROWN) & (filled - front > JUMP), front, filled)
    shared = _smooth(rng, depth.shape, WINDOW)
    error = SHARED_SIGMA * shared / shared.std() + OWN_SIGMA * rng.standard_normal(depth.shape)
    disparity = np.maximum(STEREO_FOCAL_BASELINE / seen + error, STEREO_STEP)
    lost = at_edge(depth) & (rng.random(depth.shape) < STEREO_EDGE_LOSS)
    lost |= _patches(rng, depth.shape, UNMATCHED_SIZE, UNMATCHED)
    lost |= (np.abs(cosine) < np.cos(GRAZING)) & (seen == filled)
    return quantised(STEREO_FOCAL_BASELINE / disparity, STEREO_FOCAL_BASELINE, STEREO_STEP), lost | (seen > FARTHEST)


def time_of_flight(depth: Image, cosine: Image, rng: np.random.Generator) -> tuple[Image, NDArray[np.bool_]]:
    """Depths in metres, and which are lost."""
    filled = np.where(depth > 0, depth, FARTHEST)
    front, back = ndimage.minimum_filter(filled, size=3), ndimage.maximum_filter(filled, size=3)
    flies = (back - front > JUMP) & (rng.random(depth.shape) < FLYING)
    seen = np.where(flies, front + (back - front) * rng.random(depth.shape), filled)
    smooth = _smooth(rng, depth.shape, SMOOTH_SIZE)
    error = SMOOTH * smooth / smooth.std()
    error += np.sqrt(2) * WIGGLE * np.sin(2 * np.pi * (seen / WIGGLE_LENGTH + rng.random()))
    error += rng.normal(0.0, (0.001 + 0.0015 * seen**1.5) / np.sqrt(np.maximum(np.abs(cosine), 0.2)))
    lost = (rng.random(depth.shape) < RANDOM_LOSS) | (np.abs(cosine) < np.cos(GRAZING))
    return seen + error, lost


KINDS = {"structured_light": structured_light, "stereo": stereo, "time_of_flight": time_of_flight}


def measured(
    depth: Image, cosine: Image, rng: np.random.Generator, kind: str = "structured_light"
) -> NDArray[np.uint16]:
    """What a sensor reports: (height, width) uint16, millimetres, 0 where it has no depth.

    depth : (height, width), metres along z, 0 where the ray meets nothing; cosine : of the angle between the ray and
    the surface's normal; kind : one of KINDS
    """
    noisy, lost = KINDS[kind](depth, cosine, rng)
    lost |= (depth <= 0) | (depth > FARTHEST)
    return np.where(lost, 0, np.rint(noisy * 1000)).astype(np.uint16)


def lost_in_patches(dark: NDArray[np.bool_], rng: np.random.Generator) -> NDArray[np.bool_]:
    """Pixels (height, width) that are lost of the surfaces that `dark` marks: DARK_LOSS of them, in patches."""
    smooth = _smooth(rng, dark.shape, PATCH)
    return dark & (smooth < np.quantile(smooth[dark], DARK_LOSS)) if dark.any() else dark


def _smooth(rng: np.random.Generator, shape: tuple[int, ...], size: float) -> Image:
    """Noise that neighbours share, as far as `size` pixels, a standard deviation, reach."""
    found: Image = ndimage.gaussian_filter(rng.standard_normal(shape), size)
    return found


def _patches(rng: np.random.Generator, shape: tuple[int, ...], size: float, share: float) -> NDArray[np.bool_]:
    """A share of an image's pixels, in patches of a size, a standard deviation in pixels."""
    smooth = _smooth(rng, shape, size)
    found: NDArray[np.bool_] = smooth > np.quantile(smooth, 1 - share)
    return found
