"""Are depths wrong by what is smooth over all of a part? Errors that no number of pixels averages out, as large as the
scan's own flat surfaces say.

A flat surface is linear in inverse depth. What is left of it beside a plane, in cells of many pixels, is noise where
neighbouring cells know nothing of each other, and a distortion where they share it: a time-of-flight camera's wiggle
over the range, the waves of a stereo camera's calibration (depth distortion, as Teichman, Miller and Thrun 2013 call
it). The part of it that is a plane itself stays unseen.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.depth_noise import NORMAL_MEDIAN
from pmpnbp.scene.patches import plane_through

# Pixels across of the thinned image, and of its cells; what is measured of a block and on the plane of a cell at least.
WIDTH, CELL, MEASURED = 160, 5, 0.5
# Thinned pixels on a plane and pairs of neighbouring cells that tell something.
FEWEST, PAIRS = 200, 30
# Cosine, between a ray and a plane's normal, below which a surface is seen too aslant.
ASLANT = 0.34
# A distortion is what pairs share beyond so many times the variance that tells them apart: of noise that neighbouring
# pixels share as after stereo matching it is 1.45 times that, with a deviation of 0.12, and less of any other.
CHANCE = 2.0


def depth_distortion(camera: Camera, depth: NDArray[np.float32], planes: Array, base: float, growth: float) -> float:
    """Standard deviation, as a share of the depth, of errors that are smooth over much of the image; 0 where the scan
    shows none.

    depth : (height, width) metres; planes : (K, 4) flat surfaces of the scene, world, within whose tolerance
    base + growth z², metres, their pixels lie
    """
    camera, mean = _thinned(camera, depth)
    pose, rays = np.asarray(camera.pose_world_camera, dtype=np.float64), camera.rays().astype(np.float64)
    inverse = np.divide(1.0, mean, out=np.zeros_like(mean), where=mean > 0)
    lengths = np.linalg.norm(rays, axis=-1)
    shared, apart = [np.zeros(0)], [np.zeros(0)]
    for plane in planes:
        normal = poses.rotate(poses.quaternion_conjugate(pose[3:]), plane[:3])
        facing = -(rays @ normal)
        to_plane = np.divide(plane[:3] @ pose[:3] + plane[3], facing, out=np.zeros_like(mean), where=facing > 0)
        on_plane = (mean > 0) & (facing > ASLANT * lengths)
        on_plane &= np.abs(mean - to_plane) * facing < base + growth * mean**2
        inner = ndimage.binary_erosion(on_plane, border_value=1)
        if inner.sum() < FEWEST:
            continue
        error = np.where(inner, 1 - mean * plane_through(inner, inverse), 0.0)
        cells, told = _cells(error, inner)
        for one, other, both in (
            (cells[1:], cells[:-1], told[1:] & told[:-1]),
            (cells[:, 1:], cells[:, :-1], told[:, 1:] & told[:, :-1]),
        ):
            shared.append((one + other)[both] / 2)
            apart.append((one - other)[both] / 2)
    if len(every := np.concatenate(shared)) < PAIRS:
        return 0.0
    return float(np.sqrt(max(_variance(every) - CHANCE * _variance(np.concatenate(apart)), 0.0)))


def _thinned(camera: Camera, depth: NDArray[np.float32]) -> tuple[Camera, Array]:
    """The camera whose pixels are blocks of these, and their mean depths (h, w), 0 of those that are measured too
    little."""
    block = max(min(camera.width // WIDTH, camera.height), 1)
    h, w = camera.height // block, camera.width // block
    total, count = np.zeros((h, w)), np.zeros((h, w))
    for row, column in product(range(block), repeat=2):  # sums over axes take several times as long
        pixels = depth[row : h * block : block, column : w * block : block]
        total += pixels
        count += pixels > 0
    mean = np.divide(total, count, out=np.zeros((h, w)), where=count > MEASURED * block**2)
    return camera.binned(0, 0, block, w, h), mean


def _cells(error: Array, inner: NDArray[np.bool_]) -> tuple[Array, NDArray[np.bool_]]:
    """Means of what is `inner` of errors (h, w) in cells, and which of these have enough of it."""
    h, w = error.shape[0] // CELL, error.shape[1] // CELL
    total, count = (each[: h * CELL, : w * CELL].reshape(h, CELL, w, CELL).sum(axis=(1, 3)) for each in (error, inner))
    return total / np.maximum(count, 1), count >= MEASURED * CELL**2


def _variance(values: Array) -> float:
    """Of values about 0, by their median size."""
    return float(np.median(np.abs(values)) / NORMAL_MEDIAN) ** 2
