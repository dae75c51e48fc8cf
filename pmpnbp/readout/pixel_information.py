"""What do the pixels of a picture tell of where an object's parts are? Each tells how far its part is off in one
direction, an outline's across the outline, a surface's along its normal, and by how much they are off themselves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.flying_pixels import NEIGHBOURS

# Standard deviations: an outline's pixel is off across it by EDGE pixels, and a surface's depth by FACE of what a pixel
# measures there, divided by the square root of how many of the scan's are one, for these are off themselves. Set on
# even seeds of `benchmarks.belief`, docs/algorithm.md.
EDGE, FACE = 0.85, 0.52
# What moves and tilts a part is not all of a smooth error: depths of one surface have it in common over so many radians
# of the picture, so that no more of them count than there are patches as wide.
ALIKE = 0.04
# Beside an outline is what lies behind it by more than so many tolerances: up to that, what is seen there may confirm
# either. A surface that falls away so steeply counts, too: without it coverage is the same, and next views are chosen
# less well.
JUMP = 2.0
# An outline with what lies behind it on both sides of a pixel has no direction there.
ONE_SIDED = 0.3
# Cosine of the slant, between a ray and a surface's normal, from which on a depth tells of a surface at all.
GRAZING = 0.17
# Rows and columns of pixels.
Pixels = tuple[NDArray[np.int64], NDArray[np.int64]]


@dataclass(frozen=True, kw_only=True)
class Stretch:
    """Along what parts are stretched where sizes are free, in world: from their origins (N, 3), along the root part's
    axes as each part carries them, the rows of (N, 3, 3)."""

    origins: Array
    axes: Array


def told_of_parts(
    camera: Camera,
    depth: NDArray[np.float32],
    number: NDArray[np.int16],
    shown: NDArray[np.bool_],
    middles: Array,
    tolerance: float,
    noise: float,
    finer: float = 1.0,
    binned: int = 1,
    distortion: float = 0.0,
    stretch: Stretch | None = None,
) -> Array:
    """(N, 6, 6) Fisher information of parts' translations, metres, and rotation vectors about their `middles` (N, 3) in
    world: what those pixels of a render tell that are `shown` (h, w). With a `stretch` it is (N, 10, 10): then of the
    camera's depth scale and of sizes along three axes, too, as shares, see `potentials/nuisances.py`.

    depth, number : (h, w) of the render, metres and parts; tolerance : metres; noise : metres, of a depth that errs on
    its own
    finer : the pixels of the image that is scored are so many times narrower than the camera's
    binned : so many pixels of the scan, across and down, are one of the image that is scored
    distortion : the deviation of smooth errors, as a share of the depth
    """
    pixel = 1 / (camera.fx * finer * np.sqrt(binned))
    (row, column), across = outlines(depth, shown, tolerance)
    x, y, _ = _rays(camera, (row, column)).T
    aside = np.stack([across[:, 0], across[:, 1], -(across[:, 0] * x + across[:, 1] * y)], axis=1)
    # of a pixel of outline the image that is scored has `finer`, of a surface's as many squared
    off = EDGE * depth[row, column, None] * pixel
    found = _gathered(camera, depth, number, (row, column), np.sqrt(finer) * aside / off, middles, stretch)
    (row, column), normals = facing(camera, depth, number, shown)
    z = depth[row, column, None].astype(np.float64)
    off = np.hypot(z * np.hypot(FACE * pixel, distortion * ALIKE * camera.fx * finer), noise)
    return found + _gathered(camera, depth, number, (row, column), finer * z * normals / off, middles, stretch)


def outlines(depth: NDArray[np.float32], shown: NDArray[np.bool_], tolerance: float) -> tuple[Pixels, Array]:
    """Pixels (P,) of outlines in a render's depth (h, w), among those that are `shown` (h, w): beside which nothing is,
    or something farther off, and on one side only; directions (P, 2) to there, columns and rows, of length 1."""
    beyond = np.where(depth > 0, depth, np.inf)
    beside = ndimage.maximum_filter(beyond, size=3, mode="nearest")
    row, column = np.nonzero(shown & (beside > beyond + JUMP * tolerance))
    last = np.array(depth.shape) - 1
    around = np.clip(np.stack([row, column], axis=1)[:, None] + NEIGHBOURS, 0, last)
    farther = beyond[around[..., 0], around[..., 1]] > (beyond[row, column] + JUMP * tolerance)[:, None]
    across = farther @ (NEIGHBOURS[:, ::-1] / np.linalg.norm(NEIGHBOURS, axis=1)[:, None])
    length = np.linalg.norm(across, axis=1)
    kept = length > ONE_SIDED
    return (row[kept], column[kept]), across[kept] / length[kept, None]


def facing(
    camera: Camera, depth: NDArray[np.float32], number: NDArray[np.int16], shown: NDArray[np.bool_]
) -> tuple[Pixels, Array]:
    """Pixels (P,) that are `shown` (h, w) and face the camera, of a render's depth and part number (h, w), and normals
    (P, 3) of their surfaces in its frame, 1 / metres: with points on them their product is 1."""
    inverse = np.divide(1.0, depth, out=np.zeros(depth.shape), where=depth > 0)
    row, column = np.nonzero(shown)
    x, y, _ = _rays(camera, (row, column)).T
    right, down = (_slope(inverse, number, axis)[row, column] for axis in (1, 0))
    normal = np.stack([right * camera.fx, down * camera.fy, np.zeros(len(row))], axis=1)
    normal[:, 2] = inverse[row, column] - normal[:, 0] * x - normal[:, 1] * y
    far = depth[row, column] * np.sqrt(1 + x**2 + y**2)
    kept = np.linalg.norm(normal, axis=1) * far * GRAZING < 1
    return (row[kept], column[kept]), normal[kept]


def _rays(camera: Camera, pixels: Pixels) -> Array:
    """(P, 3): `Camera.rays` of some pixels, in double precision."""
    row, column = pixels
    return np.stack([(column - camera.cx) / camera.fx, (row - camera.cy) / camera.fy, np.ones(len(row))], axis=1)


def _slope(inverse: Array, number: NDArray[np.int16], axis: int) -> Array:
    """(h, w): by how much an inverse depth (h, w) grows from a pixel of a part to the next along an axis; of the
    differences to both sides the smaller, nan where there is none."""
    step = np.where(np.diff(number, axis=axis) == 0, np.diff(inverse, axis=axis), np.nan)
    none = np.full_like(inverse, np.nan)
    after, before = none.copy(), none
    inner, outer = [slice(None)] * 2, [slice(None)] * 2
    inner[axis], outer[axis] = slice(None, -1), slice(1, None)
    after[tuple(inner)], before[tuple(outer)] = step, step
    smaller = np.where(np.abs(after) < np.abs(before), after, before)
    return np.where(np.isnan(before), after, smaller)


def _gathered(
    camera: Camera,
    depth: NDArray[np.float32],
    number: NDArray[np.int16],
    pixels: Pixels,
    directions: Array,
    middles: Array,
    stretch: Stretch | None,
) -> Array:
    """(N, 6, 6) or (N, 10, 10), as from `told_of_parts`: what pixels tell, each of how far its own part is off in a
    direction (P, 3) of the camera's frame, as long as a metre has of its deviations."""
    row, column = pixels
    pose, owner = np.asarray(camera.pose_world_camera, dtype=np.float64), number[row, column]
    seen = _rays(camera, pixels) * depth[row, column, None]
    at, straight = poses.transform_points(pose, seen), poses.rotate(pose[3:], directions)
    columns = [straight, np.cross(at - middles[owner], straight)]
    if stretch is not None:
        # a scale moves what is seen along its ray, which is across no outline
        columns.append((seen * directions).sum(axis=1, keepdims=True))
        along = [np.einsum("pka,pa->pk", stretch.axes[owner], one) for one in (at - stretch.origins[owner], straight)]
        columns.append(along[0] * along[1])
    rows = np.concatenate(columns, axis=1)
    order = np.argsort(owner, kind="stable")
    ends = np.searchsorted(owner[order], np.arange(len(middles)), side="right")
    parts = np.split(rows[order], ends)[: len(middles)]
    return np.array([part.T @ part for part in parts])
