"""How far does an image's grain hide where an object is? A part's outline is told by whole pixels, and its surface by
depths that err together; each of them tells how far the part is off in one direction, and no more.

Parts are off each on their own. Of a chain's links each is where it is seen, to a millimetre, whatever the joints
before it are; so neighbouring joints are off in opposite senses, and its end is known as well as its beginning.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.held_part import LITTLE, Held, shown
from pmpnbp.inference.mrf import Mrf
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials import nuisances
from pmpnbp.potentials.unary import renders
from pmpnbp.scene.depth_noise import told_noise
from pmpnbp.scene.flying_pixels import NEIGHBOURS
from pmpnbp.scene.observation import OUTSIDE, SUPPORT

# Standard deviations: an outline's pixel is off across it by EDGE pixels, and a surface's depth by FACE of what a pixel
# measures there, divided by the square root of how many of the scan's are one, for these are off themselves; and by
# NOISY of the depths' own deviations, as neighbours err together, by steps of depth, the mesh and what a pixel holds of
# another surface. All of an object's outlines are too far in or out by INWARD pixels, which a free depth scale is taken
# in by. Set on even seeds of `benchmarks.belief`, docs/algorithm.md.
EDGE, FACE, NOISY, INWARD = 0.85, 0.52, 0.92, 0.065
# A part as a whole is off by so many metres and by so much of its radius, however many pixels tell of it, and where
# sizes are free by so much more of what they may be: sizes along three axes are not all that may be wrong of a model.
LEAST, WHOLE, SHAPE = 0.00007, 0.0002, 0.04
# A part is off on its own, and the object as one, by so many times the smooth error of depth that the scan's flat
# surfaces show (`scene/depth_distortion.py`): that of it which is flat itself they do not.
DISTORTED, AS_ONE = 1.25, 0.5
# What moves and tilts a part is not all of it: depths of one surface have it in common over so many radians of the
# picture, so that no more of them count than there are patches as wide.
ALIKE = 0.04
# Beside an outline is what lies behind it by more than so many tolerances: up to that, what is seen there may confirm
# either. A surface that falls away so steeply counts, too: without it coverage is the same, and next views are chosen
# less well.
JUMP = 2.0
# An outline with what lies behind it on both sides of a pixel has no direction there.
ONE_SIDED = 0.3
# Cosine of the slant, between a ray and a surface's normal, from which on a depth tells of a surface at all.
GRAZING = 0.17
# Metres: what an image leaves more open than this it does not tell at all, and the posterior's draws alone say where it
# is.
UNTOLD = 0.02
# Rows and columns of pixels.
Pixels = tuple[NDArray[np.int64], NDArray[np.int64]]


def grain(problem: Problem, place: Held) -> Array:
    """(6 + D, 6 + D) covariance of a place's coordinates, by which it is hidden. Zero in what no image tells."""
    mrf = problem.mrf
    here = mrf.part_poses(place.root, place.joints)
    size = 6 + len(place.joints)
    told, away, loose = np.zeros((mrf.nodes, 6, 6)), [np.zeros((3, 3))], []
    scale_stds, offset_stds, _ = nuisances.split(problem.nuisance_std, len(problem.observation.views))
    middles = poses.transform_points(here, mrf.centres)
    noise = noise_apart(problem)
    middle, reach = _middle_and_reach(middles, mrf.radii)
    for camera, (view, _, depth, number) in enumerate(
        renders(problem.observation, problem.surfaces, here, problem.nuisances)
    ):
        if view.distance <= 0:
            continue
        # what may be floor, or another thing, hardly counts where it is explained, and holds nothing in its place
        telling = shown(problem, view, depth) & (view.category != SUPPORT) & (view.category != OUTSIDE)
        in_view = told_of_parts(
            view.camera,
            depth,
            number,
            telling,
            middles,
            problem.tolerance_end,
            float(noise[camera]),
            1.0,
            view.binned,
            view.distortion,
        )
        in_view = distorted(in_view, view.camera, view.distortion, middles, mrf.radii)
        unknown = distorted_as_one(view.camera, view.distortion, middles[None], mrf.radii, place.part, size)
        if offset_stds[camera].any():
            held = here[None, place.part], mrf.centres[place.part]
            unknown = unknown + unknown_camera(view.camera, offset_stds[camera], *held, size)
        else:
            # what seems smaller by its outlines seems farther off
            gap = middle - np.asarray(view.camera.pose_world_camera)[:3]
            footprint = view.distance / view.camera.fx
            away.append(np.outer(gap, gap) * min(INWARD * footprint / reach, scale_stds[camera]) ** 2)
        if unknown.any():
            loose.append((in_view[None], unknown))
        else:
            told += in_view
    # a joint at its limit is moved beyond it: this is geometry alone
    parts = mrf.part_poses(*place.placed(LITTLE * np.concatenate([np.zeros((1, size)), np.eye(size)])))
    steps = np.full((1, size), LITTLE)
    seen = [(told[None], np.zeros((1, size, size))), *loose]
    (found,) = hidden_by_grain(mrf, parts[None], steps, seen, shape(problem))
    found[:3, :3] += sum(away) / max(len(away) - 1, 1) ** 2
    return found


def unknown_camera(camera: Camera, offset_stds: Array, pose_world_part: Array, centre: Array, size: int) -> Array:
    """(..., P, P) covariance of P = `size` coordinates, of which the first six are translation and rotation vector of a
    part at (..., 7) about its `centre` (3,) with all the rest, as a camera has them wrong whose offset, see
    `potentials/nuisances.py`, has deviations (6,)."""
    moved = nuisances.camera_motion(LITTLE * np.eye(6), np.asarray(camera.pose_world_camera, dtype=np.float64))
    here = pose_world_part[..., None, :]
    slopes = np.concatenate(poses.perturbation(here, poses.multiply(moved, here), centre), axis=-1) / LITTLE
    found = np.zeros((*pose_world_part.shape[:-1], size, size))
    found[..., :6, :6] = np.einsum("...ka,k,...kb->...ab", slopes, offset_stds**2, slopes)
    return found


def blunted(information: Array, covariance: Array) -> Array:
    """Information (..., P, P) of a scan whose image hides the coordinates by a covariance (..., P, P) besides."""
    left = np.linalg.solve(np.eye(information.shape[-1]) + information @ covariance, information)
    return np.asarray(left, dtype=np.float64)


def noise_apart(problem: Problem) -> Array:
    """(V,) metres: the noise of depths that each err on their own and tell as much as the views' do."""
    return NOISY * told_noise(problem.noise, problem.noise_area)


def shape(problem: Problem) -> Array:
    """(N,) metres by which each part may be off as its model is not quite its shape; 0 where sizes are fixed."""
    return SHAPE * float(problem.nuisance_std[-3:].max()) * problem.mrf.radii


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
) -> Array:
    """(N, 6, 6) Fisher information of parts' translations, metres, and rotation vectors about their `middles` (N, 3) in
    world: what those pixels of a render tell that are `shown` (h, w).

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
    found = _gathered(camera, depth, number, (row, column), np.sqrt(finer) * aside / off, middles)
    (row, column), normals = facing(camera, depth, number, shown)
    z = depth[row, column, None].astype(np.float64)
    off = np.hypot(z * np.hypot(FACE * pixel, distortion * ALIKE * camera.fx * finer), noise)
    return found + _gathered(camera, depth, number, (row, column), finer * z * normals / off, middles)


def distorted(told: Array, camera: Camera, distortion: float, middles: Array, radii: Array) -> Array:
    """(N, 6, 6) of what is `told` of parts, (N, 6, 6) likewise, where smooth errors of depths move and tilt each on its
    own: along the line of sight, and by as much at its rim.

    distortion : the deviation of these, as a share of the depth; middles : (N, 3) in world; radii : (N,) metres
    """
    return blunted(told, smooth_errors(camera, DISTORTED * distortion, middles, radii)) if distortion else told


def distorted_as_one(camera: Camera, distortion: float, middles: Array, radii: Array, held: int, size: int) -> Array:
    """(..., P, P) covariance of P = `size` coordinates, of which the first six are translation and rotation vector of
    the part `held` about its middle with all the rest, as smooth errors of depths move and tilt the object as one.

    distortion, radii : as for `distorted`; middles : (..., N, 3) in world
    """
    found = np.zeros((*middles.shape[:-2], size, size))
    if not distortion:
        return found
    middle, reach = _middle_and_reach(middles, radii)
    lever = np.tile(np.eye(6), (*middle.shape[:-1], 1, 1))
    # what turns about the object's middle moves the part's
    lever[..., :3, 3:] = np.swapaxes(np.cross(np.eye(3), (middles[..., held, :] - middle)[..., None, :]), -1, -2)
    found[..., :6, :6] = lever @ smooth_errors(camera, AS_ONE * distortion, middle, reach) @ np.swapaxes(lever, -1, -2)
    return found


def smooth_errors(camera: Camera, deviation: float, middles: Array, radii: Array) -> Array:
    """(..., 6, 6) covariance of translation and rotation vector, about its middle (..., 3) in world, of what is as
    large as a radius (...,): along the line of sight, and tilted by as much at its rim.

    deviation : as a share of the depth
    """
    away = middles - np.asarray(camera.pose_world_camera)[:3]
    distance = np.linalg.norm(away, axis=-1)
    sight = away[..., :, None] * away[..., None, :] / distance[..., None, None] ** 2
    found, off = np.zeros((*distance.shape, 6, 6)), (deviation * distance)[..., None, None]
    found[..., :3, :3] = off**2 * sight
    found[..., 3:, 3:] = (off / np.maximum(radii, LITTLE)[..., None, None]) ** 2 * (np.eye(3) - sight)
    return found


def _middle_and_reach(middles: Array, radii: Array) -> tuple[Array, Array]:
    """The middle (..., 3) of an object whose parts' are (..., N, 3), and how far its parts, of radii (N,), reach from
    it (...,)."""
    middle = middles.mean(axis=-2)
    return middle, (np.linalg.norm(middles - middle[..., None, :], axis=-1) + radii).max(axis=-1)


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
) -> Array:
    """(N, 6, 6): what pixels tell of parts' translations and turns, each of how far its own is off in a direction
    (P, 3) of the camera's frame, as long as a metre has of its deviations."""
    row, column = pixels
    pose, owner = np.asarray(camera.pose_world_camera, dtype=np.float64), number[row, column]
    arms = poses.transform_points(pose, _rays(camera, pixels) * depth[row, column, None]) - middles[owner]
    straight = poses.rotate(pose[3:], directions)
    rows = np.concatenate([straight, np.cross(arms, straight)], axis=1)
    order = np.argsort(owner, kind="stable")
    ends = np.searchsorted(owner[order], np.arange(len(middles)), side="right")
    parts = np.split(rows[order], ends)[: len(middles)]
    return np.array([part.T @ part for part in parts])


def hidden_by_grain(mrf: Mrf, parts: Array, steps: Array, views: Sequence[tuple[Array, Array]], astray: Array) -> Array:
    """(T, P, P) covariances of P coordinates: of the fit, by least squares, of the object to parts that are each off on
    their own.

    parts : (T, 1 + P, N, 7), as they are and with each coordinate moved by its step (T, P)
    views : of each what it tells, (T, N, 6, 6), of each part's translation and rotation vector about its middle, as
        from `told_of_parts`, and the covariance (T, P, P) by which it has the object wrong as one
    astray : (N,) metres by which each part is off besides, in each view on its own
    """
    shifts, turns = poses.perturbation(parts[:, :1], parts[:, 1:], mrf.centres)
    slopes = np.concatenate([shifts, turns], axis=-1) / steps[:, :, None, None]
    reaches = np.sqrt((shifts**2).sum(axis=-1) + ((mrf.radii[:, None] * turns) ** 2).sum(axis=-1)).max(axis=-1) / steps
    # what moves nothing, or only by rounding
    levers: Array = np.where(reaches > 1e-6, reaches, 1.0)
    slopes, squared = slopes / levers[:, :, None, None], levers[:, :, None] * levers[:, None, :]
    seen = np.sum(
        [blunted(_of_coordinates(mrf, slopes, told, astray), squared * unknown) for told, unknown in views], axis=0
    )
    values, axes = np.linalg.eigh((seen + np.swapaxes(seen, 1, 2)) / 2)
    variances = np.where(values > UNTOLD**-2.0, 1 / np.maximum(values, UNTOLD**-2.0), 0.0)
    found: Array = np.einsum("tpk,tk,tqk->tpq", axes, variances, axes) / squared
    return found


def _of_coordinates(mrf: Mrf, slopes: Array, told: Array, astray: Array) -> Array:
    """(T, P, P) information of P coordinates by whose slopes (T, P, N, 6) parts are moved of which is `told`."""
    own = np.zeros((mrf.nodes, 6))
    own[:, :3] = (astray**2 + LEAST**2 + (WHOLE * mrf.radii) ** 2)[:, None]
    # of points along a line as far as the radius to both sides, turned, as much in the mean square
    own[:, 3:] = 3 * own[:, :3] / np.maximum(mrf.radii[:, None], LITTLE) ** 2
    told = np.asarray(np.linalg.solve(np.eye(6) + told * own[:, None, :], told), dtype=np.float64)
    found: Array = np.einsum("tpna,tnab,tqnb->tpq", slopes, told, slopes, optimize=True)
    return found
