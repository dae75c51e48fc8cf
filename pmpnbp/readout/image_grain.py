"""How far does an image's grain hide where an object is? Outlines are told by whole pixels, and each is off by some of
one; a part is known as well as its outline's pixels say together.

Parts are off each on their own. Of a chain's links each is where it is seen, to a millimetre, whatever the joints
before it are; so neighbouring joints are off in opposite senses, and its end is known as well as its beginning.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.mrf import Mrf
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials import nuisances
from pmpnbp.potentials.unary import renders

# Pixels by which one of an outline is off, the standard deviation: of a place within a pixel it is 0.29, and the sensor
# mixes depths at edges. All of a part's outline is off by WHOLE besides, however long it is, and all of an object's
# outlines are too far in or out by INWARD, which a free depth scale is taken in by. Set on seeds up to 69 of
# `benchmarks.belief`, docs/algorithm.md.
EDGE, WHOLE, INWARD = 0.32, 0.018, 0.06
# Where sizes are free, a part may be off by so much of what they may be: sizes along three axes are not all that may be
# wrong of a model.
SHAPE = 0.17
# Beside an outline is what lies behind it by more than so many tolerances: up to that, what is seen there may confirm
# either. A surface that falls away so steeply counts, too: without it coverage is the same, and next views are chosen
# less well.
JUMP = 2.0
# Metres or radians by which a coordinate is moved to see how far it moves parts.
LITTLE = 1e-4
# Metres: what outlines leave more open than this they do not tell at all, and the depths alone say where it is.
UNTOLD = 0.02


def grain(problem: Problem, root: Array, joints: Array) -> Array:
    """(6 + D, 6 + D) covariance of a configuration's coordinates, by which it is hidden: root (7,), the translation and
    rotation vector about its centre, metres and radians, and joints (D,). Zero in what no outline tells."""
    mrf = problem.mrf
    here = mrf.part_poses(root, joints)
    sharp, astray, away = np.zeros(mrf.nodes), shape(problem), np.zeros((3, 3))
    scale_stds, _, _ = nuisances.split(problem.nuisance_std, len(problem.observation.views))
    middles = poses.transform_points(here, mrf.centres)
    reach = float((np.linalg.norm(middles - middles.mean(axis=0), axis=1) + mrf.radii).max())
    for place, (view, _, depth, number) in enumerate(
        renders(problem.observation, problem.surfaces, here, problem.nuisances)
    ):
        if view.distance <= 0:
            continue
        near = (depth > 0) & (view.depth > 0) & (np.abs(view.depth - depth) < problem.tolerance_end)
        footprint = view.distance / view.camera.fx
        sharp += sharpness(outline_pixels(depth, number, near, problem.tolerance_end, mrf.nodes), footprint, astray)
        # what seems smaller by its outlines seems farther off
        gap = middles.mean(axis=0) - np.asarray(view.camera.pose_world_camera)[:3]
        away += np.outer(gap, gap) * min(INWARD * footprint / reach, scale_stds[place]) ** 2
    size = 6 + len(joints)
    moves = LITTLE * np.concatenate([np.zeros((1, size)), np.eye(size)])
    # a joint at its limit is moved beyond it: this is geometry alone
    parts = mrf.part_poses(poses.perturb(root, moves[:, :3], moves[:, 3:6], mrf.centres[0]), joints + moves[:, 6:])
    (found,) = hidden_by_grain(mrf, parts[None], np.full((1, size), LITTLE), sharp[None])
    found[:3, :3] += away / max(len(problem.observation.views), 1) ** 2
    return found


def shape(problem: Problem) -> Array:
    """(N,) metres by which each part may be off as its model is not quite its shape; 0 where sizes are fixed."""
    return SHAPE * float(problem.nuisance_std[-3:].max()) * problem.mrf.radii


def sharpness(count: Array, footprint: float, astray: Array) -> Array:
    """(..., N), 1 / metres squared: what outlines of `count` (..., N) pixels, each `footprint` metres wide, tell of
    parts that are `astray` (N,) metres besides."""
    variance = (EDGE**2 / np.maximum(count, 1.0) + WHOLE**2) * footprint**2 + astray**2
    return np.where(count > 0, 1 / variance, 0.0)


def outline_pixels(
    depth: NDArray[np.float32], number: NDArray[np.int16], shown: NDArray[np.bool_], tolerance: float, nodes: int
) -> Array:
    """(N,) of each part, the pixels of its outline that are `shown` (h, w), in a render's depth and part number (h, w):
    beside which nothing is, or something farther off. tolerance : metres"""
    beyond = np.where(depth > 0, depth, np.inf)
    beside = ndimage.maximum_filter(beyond, size=3, mode="nearest")
    return np.bincount(number[shown & (beside > beyond + JUMP * tolerance)], minlength=nodes).astype(np.float64)


def hidden_by_grain(mrf: Mrf, parts: Array, steps: Array, sharp: Array) -> Array:
    """(T, P, P) covariances of P coordinates: of the fit, by least squares, of the object to parts that are each off on
    their own, as much by their turns as in their middles.

    parts : (T, 1 + P, N, 7), as they are and with each coordinate moved by its step (T, P)
    sharp : (T, N), what outlines tell of each part, 1 / metres squared
    """
    shifts, turns = poses.perturbation(parts[:, :1], parts[:, 1:], mrf.centres)
    # of points along a line as far as `radii` to both sides the distance from the middle is this, in the mean square
    rims = mrf.radii[:, None] / np.sqrt(3) * turns
    slopes = np.concatenate([shifts, rims], axis=-1) / steps[:, :, None, None]
    levers = np.sqrt((slopes**2).sum(axis=-1).max(axis=-1))
    # what moves nothing, or only by rounding
    levers = np.where(levers > 1e-6, levers, 1.0)
    slopes = slopes / levers[:, :, None, None]
    told = np.einsum("tpna,tn,tqna->tpq", slopes, sharp, slopes, optimize=True)
    values, axes = np.linalg.eigh(told)
    variances = np.where(values > UNTOLD**-2.0, 1 / np.maximum(values, UNTOLD**-2.0), 0.0)
    found = np.einsum("tpk,tk,tqk->tpq", axes, variances, axes)
    scaled: Array = found / (levers[:, :, None] * levers[:, None, :])
    return scaled
