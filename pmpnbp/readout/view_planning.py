"""From where to look next? Views ranked by how much a scan from there is expected to tell of some links.

Draws of the posterior are rendered from each view (`expected_scan`). Were one of them the truth, a scan would tell the
others from it by as much as their images differ, and its own place as sharply as the score falls beside it. A draw
stands for its neighbourhood, all that lies nearer to it than to the next, so that two things together are left after
the scan: the draws that it does not tell from the true one, and what is left of the neighbourhood. Averaged over which
draw is the truth they give the standard deviations that are expected, and the fall of the entropy of the links'
positions, which is the gain: down to the deviation that is asked for, as no more is needed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.held_part import Held
from pmpnbp.inference.log_weights import normalise
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.registration import moved
from pmpnbp.readout.expected_scan import PROBE, Probed, blocking_points, expected_scan, told_about, told_apart
from pmpnbp.readout.mixture import coordinate_levers
from pmpnbp.readout.posterior import LONG, TURN, Posterior, alike_parts
from pmpnbp.scene.articulated_object import parts_of_links
from pmpnbp.settings import SessionOptions

# Draws that are told apart, and every how manyth of them is looked at more sharply.
DRAWS, EVERY = 40, 8
# Pixels across and down of the images they are told apart in, and their field of view.
WIDTH, HEIGHT, FIELD = 96, 72, np.deg2rad(60.0)
# Candidates around the object: turns, and heights over its middle in shares of the distance; from no higher than this.
TURNS, STEEP = 12, (0.25, 0.65)
# Places of a link that are told: its origin, and of the part that it moves with the middle and three as far from that
# as its surface is in the mean, about so much of the way to the rim; of a long part at least as far as a turn by which
# nobody is certain moves by the deviation that is asked for.
PLACES, OUT = 5, 0.5
# Metres: what is known better is taken to be known so well.
LEAST = 1e-5
# Share of a coordinate's variance that the open ones explain where it follows them; less may be by chance.
FOLLOWS = 0.5
# Nats that a view which shows nothing may seem to tell, by rounding: it tells none, and others then decide.
ROUNDING = 1e-9
# Views whose gains over their costs are the same to this share of the best one's are as good as each other.
TIE = 0.01


@dataclass(frozen=True)
class PlannedView:
    """pose : (7,) of the camera in world; cost : what it takes to get there, above 0."""

    pose: Array
    cost: float = 1.0


@dataclass(frozen=True)
class RankedView:
    """A view, what it is expected to tell, nats, and the standard deviations (A, 3), metres, of the asked links'
    positions that are expected after it."""

    view: PlannedView
    gain: float
    std_xyz: Array


def around(problem: Problem, posterior: Posterior) -> list[PlannedView]:
    """Views from all around the object at the first camera's distance, from two heights."""
    middle = _middle(problem, posterior)
    up = problem.observation.up
    eye = np.asarray(problem.observation.views[0].camera.pose_world_camera[:3], dtype=np.float64)
    away = eye - middle
    distance = float(np.linalg.norm(away))
    flat = away - (away @ up) * up
    flat = flat / max(float(np.linalg.norm(flat)), 1e-9)
    across = np.cross(up, flat)
    found = []
    for steep in STEEP:
        for turn in 2 * np.pi * np.arange(TURNS) / TURNS:
            level = np.sqrt(1 - steep**2) * (np.cos(turn) * flat + np.sin(turn) * across)
            found.append(PlannedView(looking_at(middle + distance * (level + steep * up), middle, up)))
    return found


def ranked(
    problem: Problem,
    posterior: Posterior,
    links: Sequence[int],
    views: Sequence[PlannedView],
    max_std: float = SessionOptions.max_std,
) -> list[RankedView]:
    """The views, best first: by what they are expected to tell of `links`, numbers in the model's order, over their
    cost. max_std : metres, what is known to within it needs not be told. Of views that tell as much the cheaper one
    comes first, then the one that is expected to tell more beyond that, then that which turns the camera less."""
    model = problem.mrf.model
    chosen = _chosen(posterior)
    near, is_open, following = _neighbourhoods(problem, posterior, chosen)
    roots, joints = _what_is_open(problem, posterior, chosen, following)
    offsets = _offsets(problem, posterior, links)
    parts, places = model.part_poses(roots, joints), _places(problem, roots, joints, links, offsets)
    some = chosen[EVERY // 2 :: EVERY]
    around_some = near[posterior.mode[some]]
    probed, slopes = _probed(problem, posterior, some, is_open, links, offsets)
    middle, blocking = _middle(problem, posterior), blocking_points(problem, posterior.root, posterior.joints)

    def left(told: Array, neighbourhoods: NDArray[np.floating]) -> Array:
        """(K, PLACES A, 3, 3) covariances of places, were each draw the truth."""
        linear = np.einsum("tpac,tpq,tqad->tacd", slopes, neighbourhoods, slopes, optimize=True)
        return _mixed(np.exp(normalise(-told)), places) + np.repeat(linear, EVERY, axis=0)

    before = left(np.zeros((DRAWS, DRAWS)), around_some)
    found = []
    for view in views:
        scan = expected_scan(problem, _camera(view.pose), middle, blocking)
        told = told_about(scan, probed)
        after = left(told_apart(scan, parts), np.linalg.inv(np.linalg.inv(around_some) + told))
        variances = np.minimum(_diagonal(after), _diagonal(before))[:, : len(links)]
        gain, beyond = (_fall(before, after, least) for least in (max_std, LEAST))
        found.append((RankedView(view, gain, np.sqrt(variances).mean(axis=0)), beyond))
    return _in_order(problem, found)


def _in_order(problem: Problem, found: list[tuple[RankedView, float]]) -> list[RankedView]:
    cameras = np.array([view.pose_world_scan for view in problem.observation.views])
    best = max((one.gain / one.view.cost for one, _ in found), default=0.0)

    def key(pair: tuple[RankedView, float]) -> tuple[float, float, float, float]:
        one, beyond = pair
        worth = one.gain / one.view.cost / best if best > 0 else 0.0
        turn = float(poses.rotation_angle(cameras[:, 3:], one.view.pose[3:]).min())
        return -round(worth / TIE), one.view.cost, -beyond, turn

    return [one for one, _ in sorted(found, key=key)]


def _chosen(posterior: Posterior) -> NDArray[np.int64]:
    """(DRAWS,) numbers of draws, each as often as it weighs, in the place of one of them one of each mode that weighs
    so little that none would be, and yet keeps links from being certain."""
    chosen = posterior.even_draws(DRAWS)
    for number, mode in enumerate(posterior.modes):
        if mode.counts and not np.any(posterior.mode[chosen] == number):
            own = np.flatnonzero(posterior.mode == number)
            commonest = np.bincount(posterior.mode[chosen]).argmax()
            chosen[np.flatnonzero(posterior.mode[chosen] == commonest)[-1]] = own[posterior.log_weights[own].argmax()]
    return chosen


def _offsets(problem: Problem, posterior: Posterior, links: Sequence[int]) -> Array:
    """(PLACES - 1, A, 3) in the frames of the parts that links move with: the middle, and three places off it, of a
    part which looks the same turned otherwise its middle three times: no view tells that."""
    model, part_of = problem.mrf.model, parts_of_links(problem.mrf.model)
    nodes = [part_of[model.links[link]] for link in links]
    sides = np.array([model.parts[node].extents for node in nodes])
    off = np.maximum(OUT / 2 * np.linalg.norm(sides, axis=1), np.where(sides.max(axis=1) > LONG, 1 / TURN, 0.0))
    at = model.part_poses(posterior.root, posterior.joints)
    modes = np.array([model.part_poses(mode.root, mode.joints) for mode in posterior.modes])
    off = np.where(alike_parts(model, posterior, at, modes)[:, nodes].any(axis=0), 0.0, off)
    middles = problem.mrf.centres[nodes]
    return np.array([middles + off[:, None] * one for one in (np.zeros(3), *np.eye(3))])


def _places(problem: Problem, roots: Array, joints: Array, links: Sequence[int], offsets: Array) -> Array:
    """(K, PLACES A, 3) of links in configurations (K, 7), (K, D): their origins, then those at `offsets` of the parts
    that they move with: of a door whose origin is on its hinge the middle moves, of a wrist that turns only what is off
    it."""
    model, part_of = problem.mrf.model, parts_of_links(problem.mrf.model)
    parts = model.part_poses(roots, joints)
    nodes = [part_of[model.links[link]] for link in links]
    found = [poses.transform_points(parts[:, nodes], offset) for offset in offsets]
    return np.concatenate([model.link_poses(parts, joints)[:, list(links), :3], *found], axis=1)


def _mixed(weights: Array, places: Array) -> Array:
    """(I, A, 3, 3) covariances of positions (J, A, 3), by weights (I, J) that sum to 1."""
    gaps = places - places.mean(axis=0)
    means, products = np.tensordot(weights, gaps, 1), np.einsum("jac,jad->jacd", gaps, gaps)
    found: Array = np.tensordot(weights, products, 1) - np.einsum("iac,iad->iacd", means, means)
    return found


def _diagonal(covariances: Array) -> Array:
    return np.diagonal(covariances, axis1=-2, axis2=-1)


def _fall(before: Array, after: Array, least: float) -> float:
    """Nats by which the entropies of A links' x, y and z fall, in the mean over I, from covariances
    (I, PLACES A, 3, 3) of `_places`, of which a link's one counts that falls most; each down to a deviation of `least`
    metres. Not along the covariances' own axes: a link is certain by its deviations along the world's."""
    known, left = (np.maximum(np.diagonal(each, axis1=2, axis2=3), least**2) for each in (before, after))
    fall = np.maximum(0.5 * np.log(known / left).sum(axis=-1), 0.0)
    nats = float(fall.reshape(len(fall), PLACES, -1).max(axis=1).sum(axis=1).mean())
    return nats if nats > ROUNDING else 0.0


def _camera(pose: Array) -> Camera:
    focal = WIDTH / (2 * np.tan(FIELD / 2))
    return Camera(WIDTH, HEIGHT, focal, focal, (WIDTH - 1) / 2, (HEIGHT - 1) / 2, pose)


def _neighbourhoods(
    problem: Problem, posterior: Posterior, chosen: NDArray[np.int64]
) -> tuple[Array, NDArray[np.bool_], Array]:
    """Of each mode the covariance (M, 6 + D, 6 + D) that a draw of those `chosen` (K,) stands for: of open coordinates
    what lies between two of them, of the others all; which coordinates are open, (M, 6 + D), that is not known to
    within the tolerance, the root's all together; and how all follow these in the mean, (M, 6 + D, 6 + D). Coordinates
    are the root's translation and rotation vector about its centre, and joints."""
    near, is_open, following = [], [], []
    for number, mode in enumerate(posterior.modes):
        own = posterior.mode == number
        roots, weights = posterior.drawn_roots[own], np.exp(normalise(posterior.log_weights[own]))
        offsets = Held(problem.mrf, 0, mode.root, mode.joints).offsets(roots, posterior.drawn_joints[own])
        covariance = np.cov(offsets.T, aweights=weights, bias=True) + np.diag((LEAST / coordinate_levers(problem)) ** 2)
        wide = np.sqrt(np.diagonal(covariance)) * coordinate_levers(problem) >= problem.tolerance_end
        wide[:6] = wide[:6].any()
        # so many draws fill the open coordinates' volume
        count, size = max(len(np.unique(chosen[own[chosen]])), 1), max(int(wide.sum()), 1)
        share = np.where(wide, count ** (-1.0 / size), 1.0)
        near.append(covariance * np.outer(share, share))
        is_open.append(wide)
        follows = np.zeros_like(covariance)
        follows[:, wide] = covariance[:, wide] @ np.linalg.inv(covariance[np.ix_(wide, wide)])
        explained = np.einsum("ij,ij->i", follows, covariance) / np.diagonal(covariance)
        following.append(np.where((explained > FOLLOWS)[:, None], follows, 0.0))
    return np.array(near), np.array(is_open), np.array(following)


def _what_is_open(
    problem: Problem, posterior: Posterior, chosen: NDArray[np.int64], following: Array
) -> tuple[Array, Array]:
    """Roots (K, 7) and joints (K, D) of draws, of which only that is kept which is open: all coordinates follow it
    (M, 6 + D, 6 + D) about the draw's mode. Else each draw would be told from all others by its last millimetre, and
    with it what no view shows; and were the others put where the mode has them, a chain would be bent where it is
    not."""
    roots, joints = posterior.drawn_roots[chosen], posterior.drawn_joints[chosen]
    for number, mode in enumerate(posterior.modes):
        own = posterior.mode[chosen] == number
        about = Held(problem.mrf, 0, mode.root, mode.joints)
        roots[own], joints[own] = about.placed(about.offsets(roots[own], joints[own]) @ following[number].T)
    return roots, joints


def _probed(
    problem: Problem,
    posterior: Posterior,
    some: NDArray[np.int64],
    is_open: NDArray[np.bool_],
    links: Sequence[int],
    offsets: Array,
) -> tuple[Probed, Array]:
    """The draws `some` (T,), moved in each coordinate, and strided in those that are open (M, 6 + D); and how far
    `_places` of the links move for one unit of each, (T, 6 + D, PLACES A, 3)."""
    roots, joints = posterior.drawn_roots[some], posterior.drawn_joints[some]
    steps, near_roots, near_joints = _moved(problem, roots, joints, PROBE)
    strides, far_roots, far_joints = _moved(problem, roots, joints, problem.tolerance_end)
    probed = Probed(
        roots=roots,
        joints=joints,
        parts=problem.mrf.part_poses(near_roots, near_joints),
        steps=steps,
        strided=problem.mrf.part_poses(far_roots, far_joints)[:, 1:],
        strides=np.where(is_open[posterior.mode[some]], strides, 0.0),
    )
    count = len(some) * (1 + steps.shape[1])
    flat = near_roots.reshape(count, 7), near_joints.reshape(count, joints.shape[1])
    found = _places(problem, *flat, links, offsets)
    found = found.reshape(len(some), -1, *found.shape[1:])
    return probed, (found[:, 1:] - found[:, :1]) / steps[:, :, None, None]


def _moved(problem: Problem, roots: Array, joints: Array, reach: float) -> tuple[Array, Array, Array]:
    """Steps (T, 6 + D) that move the surface of configurations (T, 7), (T, D) by `reach` metres, a joint away from its
    upper limit; and root poses (T, 1 + 6 + D, 7) and joints (T, 1 + 6 + D, D), as they are and moved by each."""
    model = problem.mrf.model
    steps = np.tile(reach / coordinate_levers(problem), (len(roots), 1))
    steps[:, 6:][~model.wraps & (joints + steps[:, 6:] > model.upper)] *= -1.0
    size = steps.shape[1]
    return steps, *moved(problem, roots, joints, steps[:, None] * np.concatenate([np.zeros((1, size)), np.eye(size)]))


def looking_at(eye: Array, target: Array, up: Array) -> Array:
    """(7,) the camera at `eye` (3,) that looks at `target` (3,), `up` (3,) being up in its picture."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    side = np.cross(forward, up)
    if np.linalg.norm(side) < 1e-6:  # straight from above or below
        side = np.cross(forward, np.roll(up, 1) + 1e-3)
    side = side / np.linalg.norm(side)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([side, np.cross(forward, side), forward], axis=1)
    matrix[:3, 3] = eye
    return poses.from_matrix(matrix)


def _middle(problem: Problem, posterior: Posterior) -> Array:
    parts = problem.mrf.part_poses(posterior.root, posterior.joints)
    corners = poses.transform_points(parts, problem.mrf.centres)
    found: Array = (corners.min(axis=0) + corners.max(axis=0)) / 2
    return found
