"""How far does an image's grain hide where an object is? A part's outline is told by whole pixels, and its surface by
depths that err together; each of them tells how far the part is off in one direction, and no more.

Parts are off each on their own. Of a chain's links each is where it is seen, to a millimetre, whatever the joints
before it are; so neighbouring joints are off in opposite senses, and its end is known as well as its beginning.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.held_part import LITTLE, Held, shown
from pmpnbp.inference.mrf import Mrf
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials import nuisances
from pmpnbp.potentials.unary import renders
from pmpnbp.readout.pixel_information import Stretch, told_of_parts
from pmpnbp.scene.depth_noise import told_noise
from pmpnbp.scene.observation import OUTSIDE, SUPPORT

# Standard deviations: a surface's depth is off by NOISY of the depths' own, as neighbours err together, by steps of
# depth, the mesh and what a pixel holds of another surface; for the rest see `pixel_information.py`. Outlines err alike
# along an edge: what seems smaller by INWARD of a pixel at the object's rim is taken for farther off where a scale of
# depth is free, and for smaller where sizes are. Set on even seeds of `benchmarks.belief`, docs/algorithm.md.
NOISY, INWARD = 0.92, 0.08
# A part as a whole is off by so many metres and by so much of its radius, however many pixels tell of it.
LEAST, WHOLE = 0.00007, 0.0002
# A part is off on its own, and the object as one, by so many times the smooth error of depth that the scan's flat
# surfaces show (`scene/depth_distortion.py`): that of it which is flat itself they do not.
DISTORTED, AS_ONE = 1.25, 0.5
# Metres: what an image leaves more open than this it does not tell at all, and the posterior's draws alone say where it
# is.
UNTOLD = 0.02


def grain(problem: Problem, place: Held) -> Array:
    """(6 + D + F, 6 + D + F) covariance of a place's coordinates and of the F free nuisances, by which they are hidden.
    Zero in what no image tells."""
    mrf, size = problem.mrf, 6 + len(place.joints)
    here = mrf.part_poses(place.root, place.joints)
    # a joint at its limit is moved beyond it: this is geometry alone
    parts = mrf.part_poses(*place.placed(LITTLE * np.concatenate([np.zeros((1, size)), np.eye(size)])))
    slopes, levers = _slopes(mrf, parts[None], np.full((1, size), LITTLE))
    shared = _shared(problem, place, here)
    slopes = np.concatenate([_wide(slopes[0], shared.slopes.shape[-1]), shared.slopes])
    levers = np.append(levers[0], np.ones(len(shared.slopes)))
    squared = levers[:, None] * levers
    seen = np.diag(np.append(np.zeros(size), shared.stds**-2.0))
    for told, cameras, unknown in _of_views(problem, place, here, shared):
        moves = slopes.copy()
        moves[size:, :, :6] += cameras
        seen += blunted(_of_coordinates(mrf, moves[None], told[None])[0], squared * unknown)
    found = _all_left(seen, size) / squared
    # what outlines have wrong along an edge goes into a scale and sizes, which all the rest follows
    follows = found[size:] / np.diag(found)[size:, None]
    return found + follows.T @ (shared.off[:, None] ** 2 * follows)


@dataclass(frozen=True, kw_only=True)
class _Shared:
    """The free nuisances (F,), which all parts have in common.

    stds : (F,) of their priors; off : (F,) by how much outlines have scales and sizes wrong
    slopes : (F, N, R) how each but a camera's offset moves what views tell of a part: its pose and, where one of these
        is free, each view's scale and the sizes
    stretch : None where scales and sizes are fixed
    """

    stds: Array
    off: Array
    slopes: Array
    stretch: Stretch | None


def _shared(problem: Problem, place: Held, here: Array) -> _Shared:
    """With parts `here` (N, 7)."""
    mrf, views = problem.mrf, len(problem.observation.views)
    free = np.flatnonzero(problem.nuisance_std)
    stds = problem.nuisance_std[free]
    # scales come first, and sizes last
    numbers = np.append(np.arange(views), np.arange(len(problem.nuisance_std))[-3:])
    if problem.nuisances is None or not problem.nuisance_std[numbers].any():
        return _Shared(stds=stds, off=np.zeros(len(free)), slopes=np.zeros((len(free), mrf.nodes, 6)), stretch=None)
    changed = problem.nuisances + LITTLE * np.eye(len(problem.nuisances))[free]
    sized = problem.part_poses(np.tile(place.root, (len(free), 1)), np.tile(place.joints, (len(free), 1)), changed)
    own = np.concatenate(poses.perturbation(here, sized, mrf.centres), axis=-1) / LITTLE
    common = np.tile((free[:, None] == numbers)[:, None].astype(np.float64), (1, mrf.nodes, 1))
    _, reach = _middle_and_reach(poses.transform_points(here, mrf.centres), mrf.radii)
    pixels = np.array([view.distance / view.camera.fx for view in problem.observation.views])
    off = np.zeros(len(problem.nuisance_std))
    off[numbers] = INWARD / reach * np.append(pixels, np.full(3, min(pixels[pixels > 0], default=0.0)))
    turned = poses.to_matrix(here)[:, :3, :3]
    axes = np.einsum("nka,nba->nkb", problem.surfaces.axes_at_zero, turned)
    return _Shared(
        stds=stds,
        off=np.minimum(off[free], stds),
        slopes=np.concatenate([own, common], axis=-1),
        stretch=Stretch(origins=here[:, :3], axes=axes),
    )


def _of_views(problem: Problem, place: Held, here: Array, shared: _Shared) -> Iterator[tuple[Array, Array, Array]]:
    """What views tell of each part, (N, R, R), how the free nuisances (F,) that say where their own cameras stand move
    parts there, (F, N, 6), and the covariance (P, P) by which they have the object wrong as one: of each view that has
    such, then of all others together."""
    mrf, free = problem.mrf, np.flatnonzero(problem.nuisance_std)
    size, views = 6 + len(place.joints) + len(free), len(problem.observation.views)
    noise, numbers = noise_apart(problem), np.arange(views, 7 * views).reshape(views, 6)
    middles = poses.transform_points(here, mrf.centres)
    together = np.zeros((mrf.nodes, shared.slopes.shape[-1], shared.slopes.shape[-1]))
    for camera, (view, _, depth, number) in enumerate(
        renders(problem.observation, problem.surfaces, here, problem.nuisances)
    ):
        if view.distance <= 0:
            continue
        # what may be floor, or another thing, hardly counts where it is explained, and holds nothing in its place
        telling = shown(problem, view, depth) & (view.category != SUPPORT) & (view.category != OUTSIDE)
        told = told_of_parts(
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
            shared.stretch,
        )
        told = distorted(told, view.camera, view.distortion, middles, mrf.radii)
        if shared.stretch is not None:
            told = _of_one_view(told, camera, views)
        unknown = distorted_as_one(view.camera, view.distortion, middles[None], mrf.radii, place.part, size)[0]
        moved = np.zeros((len(free), mrf.nodes, 6))
        offsets = np.isin(free, numbers[camera])
        if offsets.any():
            moved[offsets] = camera_slopes(view.pose_world_scan, here, mrf.centres)[np.isin(numbers[camera], free)]
        if unknown.any() or offsets.any():
            yield told, moved, unknown
        else:
            together = together + told
    yield together, np.zeros((len(free), mrf.nodes, 6)), np.zeros((size, size))


def _of_one_view(told: Array, view: int, views: int) -> Array:
    """What one of `views` views tells of each part, of its own scale and of sizes, (N, 10, 10), among the scales of all
    views: (N, 9 + V, 9 + V)."""
    at = np.array([*range(6), 6 + view, *range(6 + views, 9 + views)])
    found = np.zeros((len(told), 9 + views, 9 + views))
    found[:, at[:, None], at] = told
    return found


def _wide(slopes: Array, count: int) -> Array:
    """Slopes (..., 6) with zeros after them, (..., `count`)."""
    return np.concatenate([slopes, np.zeros((*slopes.shape[:-1], count - 6))], axis=-1)


def camera_slopes(pose_world_camera: Array, poses_world_part: Array, centres: Array) -> Array:
    """(6, ..., 6) translations and rotation vectors, about their `centres` (..., 3), by which parts at (..., 7) appear
    to be moved for each unit of the offset of a camera that is said to stand at (7,), see `potentials/nuisances.py`."""
    moved = nuisances.camera_motion(LITTLE * np.eye(6), pose_world_camera)
    moved = moved.reshape(6, *[1] * (poses_world_part.ndim - 1), 7)
    there = poses.multiply(moved, poses_world_part)
    return np.concatenate(poses.perturbation(poses_world_part, there, centres), axis=-1) / LITTLE


def unknown_camera(camera: Camera, offset_stds: Array, pose_world_part: Array, centre: Array, size: int) -> Array:
    """(..., P, P) covariance of P = `size` coordinates, of which the first six are translation and rotation vector of a
    part at (..., 7) about its `centre` (3,) with all the rest, as a camera has them wrong whose offset, see
    `potentials/nuisances.py`, has deviations (6,)."""
    slopes = camera_slopes(np.asarray(camera.pose_world_camera, dtype=np.float64), pose_world_part, centre)
    found = np.zeros((*pose_world_part.shape[:-1], size, size))
    found[..., :6, :6] = np.einsum("k...a,k,k...b->...ab", slopes, offset_stds**2, slopes)
    return found


def blunted(information: Array, covariance: Array) -> Array:
    """Information (..., P, P) of a scan whose image hides the coordinates by a covariance (..., P, P) besides."""
    left = np.linalg.solve(np.eye(information.shape[-1]) + information @ covariance, information)
    return np.asarray(left, dtype=np.float64)


def noise_apart(problem: Problem) -> Array:
    """(V,) metres: the noise of depths that each err on their own and tell as much as the views' do."""
    return NOISY * told_noise(problem.noise, problem.noise_area)


def distorted(told: Array, camera: Camera, distortion: float, middles: Array, radii: Array) -> Array:
    """(N, R, R) of what is `told` of parts, (N, R, R) likewise, where smooth errors of depths move and tilt each on its
    own: along the line of sight, and by as much at its rim.

    distortion : the deviation of these, as a share of the depth; middles : (N, 3) in world; radii : (N,) metres
    """
    if not distortion:
        return told
    errors = np.zeros_like(told)
    errors[:, :6, :6] = smooth_errors(camera, DISTORTED * distortion, middles, radii)
    return blunted(told, errors)


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


def hidden_by_grain(mrf: Mrf, parts: Array, steps: Array, views: Sequence[tuple[Array, Array]]) -> Array:
    """(T, P, P) covariances of P coordinates: of the fit, by least squares, of the object to parts that are each off on
    their own.

    parts : (T, 1 + P, N, 7), as they are and with each coordinate moved by its step (T, P)
    views : of each what it tells, (T, N, 6, 6), of each part's translation and rotation vector about its middle, as
        from `told_of_parts`, and the covariance (T, P, P) by which it has the object wrong as one
    """
    slopes, levers = _slopes(mrf, parts, steps)
    squared = levers[:, None, :] * levers[:, :, None]
    seen = np.sum([blunted(_of_coordinates(mrf, slopes, told), squared * unknown) for told, unknown in views], axis=0)
    return _left(seen) / squared


def _slopes(mrf: Mrf, parts: Array, steps: Array) -> tuple[Array, Array]:
    """How coordinates move parts, (T, P, N, 6), translations and rotation vectors about their middles, where each moves
    what it moves most by one metre, and the metres (T, P) that it does for one unit; `parts`, `steps` as for
    `hidden_by_grain`."""
    shifts, turns = poses.perturbation(parts[:, :1], parts[:, 1:], mrf.centres)
    slopes = np.concatenate([shifts, turns], axis=-1) / steps[:, :, None, None]
    reaches = np.sqrt((shifts**2).sum(axis=-1) + ((mrf.radii[:, None] * turns) ** 2).sum(axis=-1)).max(axis=-1) / steps
    # what moves nothing, or only by rounding
    levers: Array = np.where(reaches > 1e-6, reaches, 1.0)
    return slopes / levers[:, :, None, None], levers


def _left(seen: Array) -> Array:
    """(..., P, P) covariance that information (..., P, P) leaves, by metres of which UNTOLD are nothing told."""
    values, axes = np.linalg.eigh((seen + np.swapaxes(seen, -1, -2)) / 2)
    variances = np.where(values > UNTOLD**-2.0, 1 / np.maximum(values, UNTOLD**-2.0), 0.0)
    found: Array = np.einsum("...pk,...k,...qk->...pq", axes, variances, axes)
    return found


def _all_left(seen: Array, size: int) -> Array:
    """(P, P) likewise, where of information (P, P) all that is after the first `size` numbers is told."""
    own, shared, others = seen[:size, :size], seen[:size, size:], seen[size:, size:]
    followed = np.linalg.solve(others, shared.T)
    left = _left(own - shared @ followed)
    crossed = -left @ followed.T
    return np.block([[left, crossed], [crossed.T, np.linalg.inv(others) + followed @ left @ followed.T]])


def _of_coordinates(mrf: Mrf, slopes: Array, told: Array) -> Array:
    """(T, P, P) information of P coordinates by whose slopes (T, P, N, R) parts are moved of which is `told`."""
    own = np.zeros((mrf.nodes, told.shape[-1]))
    own[:, :3] = (LEAST**2 + (WHOLE * mrf.radii) ** 2)[:, None]
    # of points along a line as far as the radius to both sides, turned, as much in the mean square
    own[:, 3:6] = 3 * own[:, :3] / np.maximum(mrf.radii[:, None], LITTLE) ** 2
    told = np.asarray(np.linalg.solve(np.eye(own.shape[1]) + told * own[:, None, :], told), dtype=np.float64)
    found: Array = np.einsum("tpna,tnab,tqnb->tpq", slopes, told, slopes, optimize=True)
    return found
