"""At which size is a scan looked at? Its region of interest with a margin, because the free space around an object is
evidence too, in pixels each of which has the depth that most of a block of the scan's have, told for its middle. In a
region that is much larger than the object the pixels are smaller, so that the object has as many as in a tight one.

The pixels are turned against the scan's, by no angle that a whole number of them makes. Edges of furniture are upright
and level, and so are they in most pictures: along a row of pixels all of an edge's would be on the same side of it, and
tell its place no better than one of them does. Across turned rows they tell it as often as they are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.scene.observation import Scan

Number = TypeVar("Number", bound=np.generic)
# Of each pixel how far it is to the right and down of something, (P,) each, in blocks.
Aside = tuple[NDArray[np.floating], NDArray[np.floating]]

# Radians, of which the tangent is the square of the golden section's smaller part: multiples of it are spread as evenly
# over a pixel as can be.
TURN = float(np.arctan((3 - np.sqrt(5)) / 2))
# What is looked for fills a region that is up to so many times as long. In a larger one pixels are smaller, as in one
# of so many times its length, but by no more than the second number.
FILLED, FINER = 2.0, 2.0
# What is fewer blocks across or down is a strip.
STRIP = 4
# Measurements are of one surface where they differ from their median by a smaller share, or by so many deviations of
# what is in a block: at three metres a camera's noise, or one of its steps, is larger than the share.
ONE_SURFACE, DEVIATIONS = 0.0075, 2.5
# Measurements that differ from their median by more, in inverse depth, 1 / metres, are of no one surface: a centimetre
# at a metre, nine at three.
NO_SURFACE = 0.01
# Square of how far apart, in blocks, pixels are that tell no slope: across a row of them there is none to see.
LEVEL = 0.003


@dataclass(frozen=True)
class WorkImage:
    """camera : of the small image; depth : (h, w) float32, metres, 0 where nothing was measured; turn : radians that
    the camera is turned about its axis against the scan's; binned : so many of the scan's pixels, across and down, are
    one of these."""

    camera: Camera
    depth: NDArray[np.float32]
    turn: float
    binned: int


def work_image(
    scan: Scan, wanted: NDArray[np.bool_], width: int, margin: int, length: float = np.inf
) -> WorkImage | None:
    """The image of what is `wanted` (height, width) of a scan and of `margin` pixels around it, binned by a whole
    factor, so that it has at most `width` pixels across or down before it is turned, and up to FINER times as many
    where it is more than FILLED times as long as the object looked for, `length` metres. What is small enough as it is,
    or a strip, is only cropped. None where nothing is wanted."""
    rows, columns = np.flatnonzero(wanted.any(axis=1)), np.flatnonzero(wanted.any(axis=0))
    if len(rows) == 0:
        return None
    height, breadth = int(rows[-1] - rows[0]) + 1, int(columns[-1] - columns[0]) + 1
    across = max(height, breadth)
    finer = min(max(across / (FILLED * _seen_length(scan, wanted, length)), 1.0), FINER)
    factor = math.ceil(across / finer / (width - 2 * margin))
    if factor > 1 and min(height, breadth) >= STRIP * factor:
        return _turned(scan, wanted, rows, factor, margin)
    first, left = max(int(rows[0]) - margin, 0), max(int(columns[0]) - margin, 0)
    depth = scan.depth[first : int(rows[-1]) + 1 + margin, left : int(columns[-1]) + 1 + margin].astype(np.float32)
    return WorkImage(scan.camera.binned(left, first, 1, depth.shape[1], depth.shape[0]), depth, 0.0, 1)


def _seen_length(scan: Scan, wanted: NDArray[np.bool_], length: float) -> float:
    """Pixels of the scan, 1 at the least, that are as long as `length` metres at the median depth of what is `wanted`
    (height, width)."""
    depth = scan.depth[wanted]
    measured = depth[depth > 0]
    if not len(measured):
        return np.inf
    return max(max(scan.camera.fx, scan.camera.fy) * length / float(np.median(measured)), 1.0)


def _turned(scan: Scan, wanted: NDArray[np.bool_], rows: NDArray[np.int64], factor: int, margin: int) -> WorkImage:
    """The image of what is `wanted` (height, width), which is in `rows` (R,) only, in blocks of `factor` pixels."""
    camera, focal = scan.camera, float(np.sqrt(scan.camera.fx * scan.camera.fy)) / factor
    turn = np.array([[np.cos(TURN), np.sin(TURN)], [-np.sin(TURN), np.cos(TURN)]])
    # where the scan's pixels are in the turned image, whose axis is its pixel (0, 0)
    x = focal * (np.arange(camera.width) - camera.cx) / camera.fx
    y = focal * (np.arange(camera.height) - camera.cy) / camera.fy
    # along a row the first and the last go farthest
    both = np.array([wanted[rows].argmax(axis=1), camera.width - 1 - wanted[rows, ::-1].argmax(axis=1)])
    ends = turn @ np.stack([x[both].ravel(), np.tile(y[rows], 2)])
    left, top = np.rint(ends.min(axis=1)).astype(int) - margin
    right, bottom = np.rint(ends.max(axis=1)).astype(int) + margin
    w, h = int(right - left) + 1, int(bottom - top) + 1
    # of the scan only what the image holds
    corners = turn.T @ np.array([[left, right, left, right], [top, top, bottom, bottom]])
    across, down = (
        slice(*np.searchsorted(line, [own.min() - 1, own.max() + 1])) for line, own in zip((x, y), corners, strict=True)
    )
    at = [(one * x[across] + other * y[down, None]).astype(np.float32) for one, other in turn]
    column, row = (np.rint(own).astype(np.int32) for own in at)
    held = np.flatnonzero((column >= left) & (column <= right) & (row >= top) & (row <= bottom))
    column, row = column.ravel()[held], row.ravel()[held]
    aside = at[0].ravel()[held] - column, at[1].ravel()[held] - row
    block = (row - top) * w + column - left
    depth = block_depths(scan.depth[down, across].ravel()[held], block, w * h, factor * factor, aside)
    about = np.concatenate([np.zeros(3), poses.from_rotation_vector(np.array([0.0, 0.0, TURN]))])
    pose = poses.multiply(np.asarray(camera.pose_world_camera, dtype=np.float64), about)
    small = Camera(w, h, focal, focal, float(-left), float(-top), pose)
    return WorkImage(small, depth.reshape(h, w), TURN, factor)


def block_depths(
    depth: NDArray[np.float32], block: NDArray[np.integer], blocks: int, size: int, aside: Aside
) -> NDArray[np.float32]:
    """(blocks,) metres: the depth, in a block's middle, of the plane through those of its depths (P,) that are of one
    surface with their median, where at least half of its pixels were measured, of which there are half of `size` at
    least; else 0.

    block : (P,) that each pixel is in; aside : of the pixel from its block's middle. At an object's edge the pixels are
    on one side of the middle, and so is their mean: by that a surface would look less steep than it is.

    Of two in the middle the median is their mean where they are of one surface; else it would put points where nothing
    is, between an object's edge and what is behind it, and is the lower in every second block: always the lower would
    make all things larger by a part of a pixel. The median alone would have steps where the sensor's depths have: noise
    that is wider than a step tells, in the mean, what lies between.
    """
    measured = np.flatnonzero(depth > 0)
    block, pixels = block[measured], np.bincount(block, minlength=blocks)
    own = depth[measured].astype(np.float32)
    if not len(own):
        return np.zeros(blocks, dtype=np.float32)
    # positive floats are ordered as their bits are
    keys = block.astype(np.uint64) << np.uint64(32) | own.view(np.uint32)
    keys.sort()
    ordered = (keys & np.uint64(0xFFFFFFFF)).astype(np.uint32).view(np.float32)
    count = np.bincount(block, minlength=blocks)
    first, last = np.cumsum(count) - count, len(ordered) - 1
    lower, upper = (ordered[np.minimum(first + half, last)] for half in (np.maximum(count - 1, 0) // 2, count // 2))
    one_of_both = np.where(np.arange(blocks) % 2 == 0, lower, upper)
    reach = np.maximum(ONE_SURFACE, DEVIATIONS * _deviation(own, one_of_both, block) * one_of_both) * one_of_both
    middle = np.where(upper - lower < reach, (lower + upper) / 2, one_of_both)
    gap = own - middle[block]
    near = np.flatnonzero(np.abs(gap) < reach[block])
    kept = measured[near]
    beside = _in_the_middle(gap[near], block[near], blocks, (aside[0][kept], aside[1][kept]))
    enough = (count > 0) & (2 * count >= pixels) & (2 * pixels >= size)
    return np.where(enough, middle + beside, 0.0).astype(np.float32)


def _in_the_middle(
    values: NDArray[np.floating], block: NDArray[np.integer], blocks: int, aside: Aside
) -> NDArray[np.float64]:
    """(blocks,): what the plane through `values` (P,) of pixels, `aside` from the middle of their `block` (P,), has
    there, by least squares; of pixels too near to each other their mean; 0 where there are none."""
    mean = partial(_means, block=block, count=np.bincount(block, minlength=blocks))
    x, y = aside
    right, down, middle = mean(x), mean(y), mean(values)
    xx, yy, xy = mean(x * x) - right**2 + LEVEL, mean(y * y) - down**2 + LEVEL, mean(x * y) - right * down
    xv, yv = mean(x * values) - right * middle, mean(y * values) - down * middle
    slope = (yy * xv - xy * yv) * right + (xx * yv - xy * xv) * down
    return np.asarray(middle - slope / (xx * yy - xy**2), dtype=np.float64)


def _deviation(own: NDArray[np.float32], middle: NDArray[np.float32], block: NDArray[np.integer]) -> float:
    """1 / metres, of inverse depths within a block, in the median block: noise, steps and slopes together.

    own : (P,) metres, measured; middle : (blocks,) metres, 0 where nothing was; block : (P,) that each is in
    """
    gap = (own - middle[block]) / (middle**2)[block]
    chosen = np.flatnonzero(np.abs(gap) < NO_SURFACE)
    gap, block = gap[chosen], block[chosen]
    squares = _means(gap**2, block, np.bincount(block, minlength=len(middle)))
    return float(np.sqrt(np.median(squares[middle > 0])))


def _means(values: NDArray[np.floating], block: NDArray[np.integer], count: NDArray[np.integer]) -> NDArray[np.float64]:
    """(blocks,): of `values` (P,) in each `block` (P,), which has `count` (blocks,) of them; 0 where there are none."""
    return np.bincount(block, values, minlength=len(count)) / np.maximum(count, 1)


def turned_back(image: NDArray[Number], turn: float, camera: Camera) -> NDArray[Number]:
    """An image (h, w, ...) of a camera that is turned about its axis by `turn` radians, as it would look unturned: each
    pixel's is the nearest one's; zeros where there is none."""
    h, w = image.shape[:2]
    if turn == 0:
        return image
    back = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    corners = back @ (np.array([[0, w - 1, 0, w - 1], [0, 0, h - 1, h - 1]]) - [[camera.cx], [camera.cy]])
    low, high = np.floor(corners.min(axis=1)), np.ceil(corners.max(axis=1))
    x, y = np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1)
    column = np.rint(back[0, 0] * x + back[1, 0] * y[:, None] + camera.cx).astype(int)
    row = np.rint(back[0, 1] * x + back[1, 1] * y[:, None] + camera.cy).astype(int)
    held = (column >= 0) & (column < w) & (row >= 0) & (row < h)
    found = np.zeros((*held.shape, *image.shape[2:]), dtype=image.dtype)
    found[held] = image[row[held], column[held]]
    return found
