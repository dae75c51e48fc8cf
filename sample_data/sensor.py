"""What does a structured-light depth camera make of a scene? Noise, quantisation and holes over a perfect depth image.

Axial noise grows with the square of the range (Nguyen, Izadi and Lovell 2012, 3DIMPVT: 1.2 mm + 1.9 mm (z - 0.4)^2);
depth comes from a disparity in eighths of a pixel (focal length 580 px, baseline 75 mm); outlines waver by half a
pixel; pixels at depth discontinuities, on grazing surfaces and at random are lost. Dark surfaces, which send
little of the pattern back, are measured in patches only.
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

Image = NDArray[np.float64]


def axial_sigma(depth: Image) -> Image:
    """Standard deviation, metres, of the noise along z at `depth`, metres."""
    return 0.0012 + 0.0019 * (depth - 0.4) ** 2


def quantised(depth: Image) -> Image:
    """`depth` in metres, moved to the nearest depth that a whole number of disparity steps gives; 0 stays 0."""
    with np.errstate(divide="ignore", invalid="ignore"):
        disparity = np.round(FOCAL_BASELINE / depth / DISPARITY_STEP) * DISPARITY_STEP
        return np.where(depth > 0, FOCAL_BASELINE / disparity, 0.0)


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


def measured(depth: Image, cosine: Image, rng: np.random.Generator) -> NDArray[np.uint16]:
    """What the sensor reports: (height, width) uint16, millimetres, 0 where it has no depth.

    depth : (height, width), metres along z, 0 where the ray meets nothing; cosine : of the angle between the ray and
    the surface's normal
    """
    seen = wavering_outlines(depth, rng)
    noisy = quantised(np.where(seen > 0, np.maximum(seen + rng.normal(0.0, axial_sigma(seen)), 1e-3), 0.0))
    lost = at_edge(depth) & (rng.random(depth.shape) < EDGE_LOSS)
    lost |= rng.random(depth.shape) < RANDOM_LOSS
    lost |= np.abs(cosine) < np.cos(GRAZING)
    lost |= (depth <= 0) | (depth > FARTHEST)
    return np.where(lost, 0, np.rint(noisy * 1000)).astype(np.uint16)


def lost_in_patches(dark: NDArray[np.bool_], rng: np.random.Generator) -> NDArray[np.bool_]:
    """Pixels (height, width) that are lost of the surfaces that `dark` marks: DARK_LOSS of them, in patches."""
    smooth = ndimage.gaussian_filter(rng.standard_normal(dark.shape), PATCH)
    return dark & (smooth < np.quantile(smooth[dark], DARK_LOSS)) if dark.any() else dark
