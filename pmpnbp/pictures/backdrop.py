"""How does a scan look in calm greys? Nearer is lighter, surfaces are lit from above the camera's left shoulder, a soft
shade lies behind what stands in front, and where much was not measured there is paper.

Light is worked out at half the scan's size, for its normals are noise at full size, and brought back without crossing
depth edges.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pmpnbp.geometry.camera import Camera
from pmpnbp.pictures.palette import PAPER, rgb
from pmpnbp.scene.normals import surface_normals
from pmpnbp.scene.observation import Scan

# Unit vector towards the light, in the camera frame.
LIGHT = np.array([-0.40, -0.69, -0.60], dtype=np.float32)
# Neighbours whose depths differ by a larger share are on different surfaces.
SAME_SURFACE = 0.03
# Reach in pixels, of the half-size image, over which light is evened out, and differences in light that are kept.
REACH, KEPT_CONTRAST = 6, 0.22

Grey = NDArray[np.float32]
Value = TypeVar("Value", np.float32, np.bool_)


def backdrop(scan: Scan, width: int, height: int) -> NDArray[np.float32]:
    """The scan as a picture (height, width, 3), sRGB, 0 to 1."""
    return backdrop_and_depth(scan, width, height)[0]


def backdrop_and_depth(scan: Scan, width: int, height: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """The same, and the depth (height, width), metres, of what it shows: single lost pixels are filled, and 0 is where
    more are lost."""
    depth = resized(scan.depth, width, height)
    paper = np.array(rgb(PAPER), dtype=np.float32) / 255
    measured = depth > 0
    if not measured.any():
        return np.tile(paper, (height, width, 1)), depth
    size = max(width, height) / 640
    near, far = np.percentile(depth[measured], (1, 98))
    whole = filled(depth)
    shown = _without_specks(whole, scan)
    inverse = 1 / np.maximum(whole, 0.5 * near)
    # steps of inverse depth look alike near and far
    tone = np.clip((inverse - 1 / far) / max(1 / near - 1 / far, 1e-6), 0, 1)
    grey = 0.71 + 0.13 * tone + 0.17 * _light(scan, whole) - 0.09 * _shade_behind(inverse, size)
    lost = ndimage.gaussian_filter((shown <= 0).astype(np.float32), 0.8 * size)[..., None]
    # a trace of blue: beside saturated colours plain greys look brown
    lit = np.clip(grey[..., None] * np.array([0.985, 1.0, 1.02]), 0, 1)
    return (lit * (1 - lost) + paper * lost).astype(np.float32), shown


def resized(depth: NDArray[Value], width: int, height: int) -> NDArray[Value]:
    """A depth image, or a mask of one, at another size. Each pixel takes the one nearest to its middle: a mean over an
    edge would be a surface that is not there."""
    if depth.shape == (height, width):
        return depth
    rows = ((np.arange(height) + 0.5) * depth.shape[0] / height).astype(int)
    columns = ((np.arange(width) + 0.5) * depth.shape[1] / width).astype(int)
    return depth[rows[:, None], columns]


def filled(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """The scan without holes: each takes the nearest measurement, so that single lost pixels do not sparkle."""
    measured = depth > 0
    if measured.all() or not measured.any():
        return depth
    rows, columns = ndimage.distance_transform_edt(~measured, return_distances=False, return_indices=True)
    return depth[rows, columns]


def _without_specks(whole: NDArray[np.float32], scan: Scan) -> NDArray[np.float32]:
    """`whole`, the filled depth at a size of its own, without what was filled where more than specks are lost."""
    lost = scan.depth <= 0
    wide = lost & ndimage.binary_dilation(ndimage.binary_opening(lost, iterations=3), iterations=3)
    return np.where(resized(wide, whole.shape[1], whole.shape[0]), np.float32(0), whole)


def scaled(camera: Camera, width: int, height: int) -> Camera:
    """The same view in so many pixels."""
    across, down = width / camera.width, height / camera.height
    return Camera(
        width,
        height,
        camera.fx * across,
        camera.fy * down,
        (camera.cx + 0.5) * across - 0.5,
        (camera.cy + 0.5) * down - 0.5,
        camera.pose_world_camera,
    )


def _shade_behind(inverse: Grey, size: float) -> Grey:
    """0 to 2: how far a pixel lies behind what is around it, as if that threw a soft shade."""
    shade = np.zeros_like(inverse)
    middle = ndimage.gaussian_filter(inverse, size)
    for radius in (5, 20):
        shade += np.clip((ndimage.gaussian_filter(inverse, radius * size) - middle) / (0.15 * middle), 0, 1)
    return shade


def _light(scan: Scan, whole: NDArray[np.float32]) -> Grey:
    """How the surfaces are lit, about -0.5 to 0.5, for the filled depth image `whole` of the picture."""
    height, width = max(scan.camera.height // 2, 1), max(scan.camera.width // 2, 1)
    depth = resized(scan.depth, width, height)
    normals = surface_normals(depth, scaled(scan.camera, width, height))
    known = (normals != 0).any(axis=-1)
    lit = np.where(known, normals @ LIGHT, 0.0).astype(np.float32)
    depth = filled(depth)
    for _ in range(2):
        lit, known = _evened(lit, known, depth)
    lit = np.clip(lit - 0.6, -0.6, 0.5) * known
    return _enlarged(lit, depth, whole)


def _evened(lit: Grey, known: NDArray[np.bool_], depth: Grey) -> tuple[Grey, NDArray[np.bool_]]:
    """A mean of the light around each pixel on the same surface, over neighbours that are lit about alike."""
    total, weight = np.zeros_like(lit), np.zeros_like(lit)
    for (down, across), here, there in _neighbours(lit.shape, REACH):
        # a float64 of NumPy's would make all that follows float64
        near = np.float32(np.exp(-(down * down + across * across) / (0.5 * REACH * REACH)))
        # in place: a new array for each step takes half as long again
        alike = lit[there] - lit[here]
        alike /= KEPT_CONTRAST
        alike *= alike
        alike /= 4
        np.subtract(1, alike, out=alike)
        np.maximum(alike, 0, out=alike)
        alike[~known[here]] = 1
        step = depth[there] - depth[here]
        share = near * (known[there] & (np.abs(step, out=step) < SAME_SURFACE * depth[here]))
        share *= alike
        weight[here] += share
        share *= lit[there]
        total[here] += share
    return np.where(weight > 0, total / np.maximum(weight, 1e-9), 0).astype(np.float32), weight > 0


def _enlarged(small: Grey, small_depth: Grey, depth: Grey) -> Grey:
    """An image at the size of `depth`: bilinear, but of the four neighbours those on another surface hardly count."""
    rows = np.clip((np.arange(depth.shape[0]) + 0.5) * small.shape[0] / depth.shape[0] - 0.5, 0, small.shape[0] - 1)
    columns = np.clip((np.arange(depth.shape[1]) + 0.5) * small.shape[1] / depth.shape[1] - 0.5, 0, small.shape[1] - 1)
    total, weight = np.zeros_like(depth), np.zeros_like(depth)
    for down in (0, 1):
        row = np.minimum(rows.astype(int) + down, small.shape[0] - 1)[:, None]
        for across in (0, 1):
            column = np.minimum(columns.astype(int) + across, small.shape[1] - 1)[None]
            near = (1 - np.abs(rows[:, None] - row)) * (1 - np.abs(columns[None] - column))
            other = np.abs(small_depth[row, column] - depth) > SAME_SURFACE * depth
            share = np.maximum(near, 0) * np.where(other, 1e-4, 1) + 1e-9
            total += share * small[row, column]
            weight += share
    return (total / weight).astype(np.float32)


def _neighbours(
    shape: tuple[int, ...], reach: int
) -> Iterator[tuple[tuple[int, int], tuple[slice, slice], tuple[slice, slice]]]:
    """Every second offset within `reach`, with the slices of the pixels that have such a neighbour and of those."""
    for down in range(-reach, reach + 1, 2):
        for across in range(-reach, reach + 1, 2):
            if abs(down) < shape[0] and abs(across) < shape[1]:
                here = _inside(shape[0], -down), _inside(shape[1], -across)
                yield (down, across), here, (_inside(shape[0], down), _inside(shape[1], across))


def _inside(length: int, shift: int) -> slice:
    return slice(max(shift, 0), length + min(shift, 0))
