"""The observation: a black and white picture of the figure among distractors, and how well a shape explains it.

Distractors are circles and rectangles of the figure's own sizes, strewn uniformly over the picture and over the figure,
so that a shape by itself says little and only the joints tell the figure from clutter (Isard 2003).

A shape's score is the share of its inside that is white, less the share of a ring around it that is white beyond what
the figure's own neighbours cover. Both shares are taken at points laid out once per shape, so that a score is a
hundred look-ups. `score_slowly` says the same without a compiler.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks.reproduce.planar.pattern import CIRCLE, LENGTH, RADIUS, RECTANGLE, UPRIGHT, WIDTH, Pattern, wrap
from pmpnbp.geometry.poses import Array

SIZE = 300  # pixels, width and height of the picture
_SPACING = 3.0  # pixels between the points inside
_RING = 3.0  # pixels from a shape's edge to its ring
_CIRCLES = 5  # one distractor in so many is a circle, which is more than one node in nine
_UPRIGHT_SOFTNESS = 0.1  # radians, standard deviation beyond UPRIGHT

Picture = NDArray[np.uint8]


@dataclass(frozen=True)
class Scene:
    """A picture and what is in it."""

    picture: Picture  # (SIZE, SIZE) row y, column x; 1 is white
    truth: Array  # (N, 3) poses of the figure
    clutter: Array  # (K, 3) poses of the distractors
    clutter_shape: NDArray[np.int64]  # (K,) CIRCLE or RECTANGLE


@dataclass(frozen=True)
class Layout:
    """Where a shape is looked at: points (P, 2) in its frame, in pixels, the first `inside` of them in it."""

    points: Array
    inside: int
    allowed: float  # share of the ring that may be white at no cost


def layout(shape: int) -> Layout:
    """A grid inside the shape, then a ring; a rectangle's ring leaves out its ends, where its neighbours are."""
    if shape == CIRCLE:
        steps = np.arange(-RADIUS + _SPACING / 2, RADIUS, _SPACING)
        grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        inside = grid[np.hypot(*grid.T) <= RADIUS]
        outer = RADIUS + _RING
        turns = np.arange(48) * 2 * np.pi / 48
        ring = outer * np.stack([np.cos(turns), np.sin(turns)], axis=-1)
        # A distractor's ring is all black and the true one's is not: what four arms cover must cost nothing.
        return Layout(np.concatenate([inside, ring]), len(inside), 4 * WIDTH / (2 * np.pi * outer))
    along = np.arange(-LENGTH / 2 + _SPACING / 2, LENGTH / 2, _SPACING)
    over = np.arange(-WIDTH / 2 + _SPACING / 2, WIDTH / 2, _SPACING)
    inside = np.stack(np.meshgrid(along, over), axis=-1).reshape(-1, 2)
    side = WIDTH / 2 + _RING
    ring = np.concatenate([np.stack([along, np.full_like(along, edge)], axis=-1) for edge in (-side, side)])
    return Layout(np.concatenate([inside, ring]), len(inside), 0.0)


LAYOUTS = {shape: layout(shape) for shape in (CIRCLE, RECTANGLE)}


def covers(shape: int, pose: Array) -> NDArray[np.bool_]:
    """(SIZE, SIZE) whether the centre of each pixel lies in the shape at `pose` (3,)."""
    y, x = np.mgrid[:SIZE, :SIZE] - pose[1::-1, None, None]
    if shape == CIRCLE:
        return x * x + y * y <= RADIUS**2
    cosine, sine = np.cos(pose[2]), np.sin(pose[2])
    along, over = cosine * x + sine * y, cosine * y - sine * x
    return (np.abs(along) <= LENGTH / 2) & (np.abs(over) <= WIDTH / 2)


def draw_scene(rng: np.random.Generator, pattern: Pattern, truth: Array, clutter: int) -> Scene:
    """The figure at `truth` (N, 3) and `clutter` distractors, all white on black."""
    shapes = np.where(np.arange(clutter) % _CIRCLES == 0, CIRCLE, RECTANGLE)
    poses = rng.uniform((0.0, 0.0, -np.pi), (SIZE, SIZE, np.pi), (clutter, 3))
    picture = np.zeros((SIZE, SIZE), dtype=np.uint8)
    for shape, pose in zip((*pattern.shape, *shapes), (*truth, *poses), strict=True):
        picture |= covers(shape, pose).astype(np.uint8)
    picture.setflags(write=False)
    return Scene(picture, truth, poses, shapes)


def score_slowly(picture: Picture, shape: int, pose: Array) -> float:
    """What `_scores` computes, for one pose (3,)."""
    looked = LAYOUTS[shape]
    cosine, sine = np.cos(pose[2]), np.sin(pose[2])
    white = []
    for x, y in looked.points:
        column = int(np.floor(pose[0] + cosine * x - sine * y + 0.5))
        row = int(np.floor(pose[1] + sine * x + cosine * y + 0.5))
        within = 0 <= column < picture.shape[1] and 0 <= row < picture.shape[0]
        white.append(int(picture[row, column]) if within else 0)
    inside, ring = white[: looked.inside], white[looked.inside :]
    return sum(inside) / len(inside) - max(sum(ring) / len(ring) - looked.allowed, 0.0)


@njit(cache=True, nogil=True)
def _scores(picture, points, inside, allowed, poses, out):  # type: ignore[no-untyped-def]
    height, width = picture.shape
    ring = len(points) - inside
    for k in range(len(poses)):
        x0, y0 = poses[k, 0] + 0.5, poses[k, 1] + 0.5
        cosine, sine = np.cos(poses[k, 2]), np.sin(poses[k, 2])
        white_in, white_out = 0, 0
        for p in range(len(points)):
            x, y = points[p, 0], points[p, 1]
            column = int(np.floor(x0 + cosine * x - sine * y))
            row = int(np.floor(y0 + sine * x + cosine * y))
            if 0 <= column < width and 0 <= row < height and picture[row, column]:
                if p < inside:
                    white_in += 1
                else:
                    white_out += 1
        out[k] = white_in / inside - max(white_out / ring - allowed, 0.0)


def scores(picture: Picture, shape: int, poses: Array) -> Array:
    """Scores (...,) in -1..1 of a shape at `poses` (..., 3)."""
    looked = LAYOUTS[shape]
    flat = np.ascontiguousarray(poses.reshape(-1, 3))
    out = np.empty(len(flat))
    _scores(picture, looked.points, looked.inside, looked.allowed, flat, out)
    return out.reshape(poses.shape[:-1])


def log_unary(picture: Picture, pattern: Pattern, node: int, poses: Array, sharpness: float) -> Array:
    """log φ (...,) of a node at `poses` (..., 3): `sharpness` times the score; node 0 also has to stand upright."""
    found = sharpness * scores(picture, pattern.shape[node], poses)
    if node == 0:
        beyond = np.maximum(np.abs(wrap(poses[..., 2])) - UPRIGHT, 0.0)
        found = found - 0.5 * (beyond / _UPRIGHT_SOFTNESS) ** 2
    return found
