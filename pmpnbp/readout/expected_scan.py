"""What would a scan from another place tell? Draws of the posterior, rendered from there and scored as pixels are.

It would tell two things. Which of the draws it is: `told_apart` counts what their images differ by, which is as much as
there is to know of a drawer that may be anywhere, and no more than the draws are dense. And how sharply that is then
seen: the curvature of the score, which is Fisher's information of the pixels, as the view's distance, its slant and its
share of every part make it; what outlines tell, which have no curvature, is added.

Surfaces that were seen and that the object does not explain block the sight, and so do the support planes, floor, wall
or table top, for a camera on their other side.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials import nuisances
from pmpnbp.potentials.unary import render, renders
from pmpnbp.readout.image_grain import (
    blunted,
    distorted,
    distorted_as_one,
    hidden_by_grain,
    noise_apart,
    unknown_camera,
)
from pmpnbp.readout.log_posterior import confidence
from pmpnbp.readout.pixel_information import told_of_parts
from pmpnbp.scene.observation import SUPPORT
from pmpnbp.scene.sizes import resized

# Metres behind the object at which everything else is taken to be.
BEHIND = 1.0
# Pixels about a blocking point that it hides.
BLOCKED = 1
# Metres that a surface is moved for a derivative: less than in registration, else what a turn adds at second order
# would seem to tell a camera's place.
PROBE = 1e-4
# A surface slanted by more shows no depth to a camera: structured light loses it there (Nguyen et al. 2012). Its depth
# changes so much with a small move that it would seem to tell most of all.
GRAZING = np.deg2rad(80.0)
# Of variances by grain what has a smaller share of the largest one is not told at all.
UNHIDDEN = 1e-9


@dataclass(frozen=True, kw_only=True)
class ExpectedScan:
    """A scan that is not made yet.

    problem : its noise and nuisances are those of the scan alone, whose one view they are of
    camera : that it is rendered with; share : of the working images' pixels one of the camera's is so many
    hidden : (h w,) metres from which on nothing is seen: 0 everywhere for a camera behind a support plane
    """

    problem: Problem
    camera: Camera
    hidden: NDArray[np.float32]
    share: float


@dataclass(frozen=True, kw_only=True)
class Probed:
    """T configurations, moved in each of P coordinates, of which the first three are the translation of the whole.

    roots : (T, 7) and joints : (T, D), as they are
    parts : (T, 1 + P, N, 7) part poses, as they are and with each coordinate moved by its step; steps : (T, P), of
    PROBE at the surface
    strided : (T, P, N, 7) moved by strides (T, P), as far as the score tells a surface; 0 of what needs no such
    """

    roots: Array
    joints: Array
    parts: Array
    steps: Array
    strided: Array
    strides: Array


def expected_scan(problem: Problem, camera: Camera, target: Array, blocking: Array) -> ExpectedScan:
    """The scan that `camera` would make of an object at `target` (3,), behind `blocking_points`, all in world: by the
    sensor of the first view, whose noise grows with the distance squared, and as large in the working image."""
    first = problem.observation.views[0]
    distance = float(np.linalg.norm(target - np.asarray(camera.pose_world_camera)[:3]))
    before = first.distance or distance
    # the new camera's pose, and what it has wrong at all depths, is as unknown as that of any further view
    sizes = problem.nuisance_levers[-3:]
    levers = nuisances.levers(np.array([before, distance]), sizes)
    stds, levers = (
        nuisances.of_last_views(of_both, 2, 1)
        for of_both in (nuisances.prior_stds(problem.settings, levers, 2), levers)
    )
    given = replace(
        problem,
        noise=problem.noise[:1] * (distance / before) ** 2,
        noise_area=problem.noise_area[:1],
        nuisance_std=stds,
        nuisance_levers=levers,
        nuisances=np.concatenate([np.zeros(len(stds) - 3), problem.mrf.model.sizes]),
    )
    planes = problem.observation.planes
    beyond = np.any(planes[:, :3] @ np.asarray(camera.pose_world_camera)[:3] + planes[:, 3] < 0)
    hidden = np.zeros(camera.width * camera.height, dtype=np.float32) if beyond else _blocked(camera, blocking)
    return ExpectedScan(problem=given, camera=camera, hidden=hidden, share=(first.camera.fx / camera.fx) ** 2)


def told_apart(scan: ExpectedScan, parts: Array) -> Array:
    """(K, K) nats by which the scan would tell draw j of part poses (K, N, 7) from draw i, were i the truth."""
    if not scan.hidden.any():
        return np.zeros((len(parts), len(parts)))
    seen = _seen(scan, parts, np.zeros(len(scan.problem.nuisance_std)))
    depth = np.array([render(scan.camera, scan.problem.surfaces, draw)[0].ravel() for draw in seen])
    # where something stands before all draws nothing is told
    shown = np.any((depth > 0) & (depth <= scan.hidden), axis=0)
    if not shown.any():
        return np.zeros((len(parts), len(parts)))
    depth = depth[:, shown].astype(np.float64)
    depth = np.where(depth > 0, depth, depth.max() + BEHIND)
    # a pixel weighs by the square of its distance, as in the score, and as many of the working images' as it holds
    area = (depth.min(axis=0) / scan.problem.unit_distance) ** 2 * scan.share
    told = np.array([np.minimum(((depth - one) / scan.problem.tolerance_end) ** 2, 1.0) @ area for one in depth])
    return confidence(scan.problem) * told


def told_about(scan: ExpectedScan, probed: Probed) -> Array:
    """(T, P, P): were one of T configurations the truth, the information that the scan alone would have of P
    coordinates: by its surfaces, by outlines as sharply as its grain shows them, and no sharper than grain and what its
    camera's place has wrong."""
    problem, grain = scan.problem, hidden(scan, probed)
    outlines = np.linalg.pinv(grain, rcond=UNHIDDEN, hermitian=True)
    offset_stds = nuisances.split(problem.nuisance_std, 1)[1][0]
    centre, size = problem.mrf.centres[0], grain.shape[-1]
    unknown = unknown_camera(scan.camera, offset_stds, probed.roots, centre, size)
    return blunted(information(scan, probed) + outlines, grain + unknown)


def information(scan: ExpectedScan, probed: Probed) -> Array:
    """(T, P, P): were one of T configurations the truth, the inverse of the covariance with which the surfaces in the
    scan alone would tell P coordinates, whatever the nuisances are but its camera's place."""
    problem, (count, size) = scan.problem, probed.steps.shape
    if not scan.hidden.any():
        return np.zeros((count, size, size))
    unfixed = problem.nuisance_std.copy()
    nuisances.split(unfixed, 1)[1][:] = 0.0
    free = np.flatnonzero(unfixed)
    probes = PROBE / problem.nuisance_levers[free]
    offsets = np.zeros((len(free), len(problem.nuisance_std)))
    offsets[:, free] = np.diag(probes)
    seen = np.concatenate(
        [_seen(scan, probed.parts, np.zeros(len(problem.nuisance_std))), _sized(scan, probed, offsets)], axis=1
    )
    found = np.array([_curvature(scan, each) for each in seen])
    scale = 1 / np.concatenate([probed.steps, np.tile(probes, (count, 1))], axis=1)
    found *= 2 * confidence(problem) * scan.share * scale[:, :, None] * scale[:, None, :]
    found[:, range(size), range(size)] += _of_outlines(scan, probed, found[:, range(size), range(size)])
    own, shared, others = found[:, :size, :size], found[:, :size, size:], found[:, size:, size:]
    others = others + np.diag(problem.nuisance_std[free] ** -2.0)
    left: Array = own - shared @ np.linalg.solve(others, np.swapaxes(shared, 1, 2))
    return left


def hidden(scan: ExpectedScan, probed: Probed) -> Array:
    """(T, P, P): of the T configurations the covariance by which the scan's image would hide the coordinates by its
    grain, whatever its pixels tell."""
    problem, here, finer = scan.problem, probed.parts[:, 0], float(np.sqrt(scan.share))
    told, noise = [], float(noise_apart(problem)[0])
    radii, first = problem.mrf.radii, problem.observation.views[0]
    distortion, binned = first.distortion, first.binned
    every = poses.transform_points(here, problem.mrf.centres)
    for middles, maps in zip(every, _seen(scan, here, np.zeros(len(problem.nuisance_std))), strict=True):
        depth, number = render(scan.camera, problem.surfaces, maps)
        shown = (depth > 0) & (depth <= scan.hidden.reshape(depth.shape))
        seen = told_of_parts(
            scan.camera, depth, number, shown, middles, problem.tolerance_end, noise, finer, binned, distortion
        )
        told.append(distorted(seen, scan.camera, distortion, middles, radii))
    unknown = distorted_as_one(scan.camera, distortion, every, radii, 0, probed.steps.shape[1])
    return hidden_by_grain(problem.mrf, probed.parts, probed.steps, [(np.array(told), unknown)])


def _sized(scan: ExpectedScan, probed: Probed, offsets: Array) -> Array:
    """(T, F, N, 12) maps of the configurations where nuisances are `offsets` (F, K) from what they are taken for."""
    model = scan.problem.mrf.model
    larger = resized(model, model.sizes + nuisances.split(offsets, 1)[2])
    roots, joints = (np.repeat(each[:, None], len(offsets), axis=1) for each in (probed.roots, probed.joints))
    return _seen(scan, larger.part_poses(roots, joints), offsets)


def _seen(scan: ExpectedScan, parts: Array, offsets: Array) -> Array:
    """(..., N, 12) maps of part poses (..., N, 7) as the camera has them, with nuisances `offsets` (..., K) from what
    they are taken for."""
    assert scan.problem.nuisances is not None
    pose, axes = np.asarray(scan.camera.pose_world_camera, dtype=np.float64), scan.problem.surfaces.axes_at_zero
    return nuisances.apparent(scan.problem.nuisances + offsets, 0, 1, pose, parts, axes)


def _of_outlines(scan: ExpectedScan, probed: Probed, curved: Array) -> Array:
    """(T, P): what outlines tell of the coordinates that are strided, beside what is `curved` (T, P). They lose in
    proportion to a stride; the variance of a density that falls so, Laplace's, is twice the square of the length on
    which it falls by a nat."""
    found = np.zeros_like(curved)
    for row, strides in enumerate(probed.strides):
        moved = np.flatnonzero(strides)
        told = told_apart(scan, np.concatenate([probed.parts[row, :1], probed.strided[row, moved]]))[0, 1:]
        beyond = np.maximum(told - 0.5 * curved[row, moved] * strides[moved] ** 2, 0.0)
        found[row, moved] = 0.5 * (beyond / strides[moved]) ** 2
    return found


def _curvature(scan: ExpectedScan, parts: Array) -> Array:
    """(P, P): what the score of the scan of maps of parts (1 + P, N, 12), the first of them, loses with steps to the
    others, in pixels: those which show the same surface all the time, and not aslant."""
    images = [render(scan.camera, scan.problem.surfaces, each) for each in parts]
    depth, which = (np.array([image[kind].ravel() for image in images]) for kind in (0, 1))
    changes = (depth[1:] - depth[0]).astype(np.float64)
    # of a unit's translation the depth changes by one over the cosine of the slant
    steepest = np.maximum(np.linalg.norm(changes[:3], axis=0), np.abs(changes).max(axis=0))
    used = (depth[0] > 0) & (depth[0] <= scan.hidden) & np.all(which == which[0], axis=0)
    used &= steepest < PROBE / np.cos(GRAZING)
    changes, nearness = changes[:, used], depth[0, used] / scan.problem.unit_distance
    found: Array = (changes * nearness**2) @ changes.T / scan.problem.tolerance_end**2
    return found


def blocking_points(problem: Problem, root: Array, joints: Array) -> Array:
    """(B, 3) points in world that were measured, that no support plane holds and that the object at a configuration
    (7,), (D,) does not explain."""
    found = []
    parts = problem.mrf.part_poses(root, joints)
    for view, _, depth, _ in renders(problem.observation, problem.surfaces, parts, problem.nuisances):
        near = (depth > 0) & (np.abs(view.depth - depth) < 2 * problem.tolerance_end)
        chosen = (view.depth > 0) & (view.category != SUPPORT) & ~near
        points = view.camera.back_project(view.depth)[chosen]
        found.append(poses.transform_points(np.asarray(view.camera.pose_world_camera, dtype=np.float64), points))
    return np.concatenate(found) if found else np.zeros((0, 3))


def _blocked(camera: Camera, points: Array) -> NDArray[np.float32]:
    """(h w,) metres from which on pixels are hidden by points (B, 3) in world; infinite where none is."""
    nearest = np.full(camera.width * camera.height, np.inf, dtype=np.float32)
    if len(points):
        inside = poses.transform_points(poses.inverse(np.asarray(camera.pose_world_camera, dtype=np.float64)), points)
        inside = inside[inside[:, 2] > 0.05]
        pixel = np.rint(camera.project(inside)[:, :2]).astype(np.int64)
        within = np.all((pixel >= 0) & (pixel < [camera.width, camera.height]), axis=1)
        np.minimum.at(nearest, pixel[within, 1] * camera.width + pixel[within, 0], inside[within, 2].astype(np.float32))
    size = 2 * BLOCKED + 1
    spread = ndimage.minimum_filter(nearest.reshape(camera.height, camera.width), size=size, mode="nearest")
    found: NDArray[np.float32] = spread.ravel()
    return found
