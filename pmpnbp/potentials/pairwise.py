"""How well do two neighbouring parts' poses fit the joint between them, and where may one part be, given the other?

The pairwise potential psi of the paper in two forms, the pairwise sampling, and the sums over a neighbour's message
that algorithm box 1 asks for in step 2c(i). An edge's potential is one function of the two poses: it does not matter
which of them is given. Its forms:

- `limits`, eq. 11: with dq_a, dq_b the child's poses at the lower and at the upper limits of all the edge's axes, and
  A, B, C the distances child to dq_a, child to dq_b and dq_a to dq_b (`dual_quaternions.distance`, positions and
  orientations apart), log psi = -(A + B - C)_pos² / 2 sigma_pos² - (A + B - C)_ori² / 2 sigma_ori².
- `projected`: the closest configuration of the joint within its limits, and what is left of the pose after it,
  log psi = -|residual translation|² / 2 sigma_pos² - |residual rotation|² / 2 sigma_ori². A + B - C is nearly flat
  across the axis (a sigma of 1 cm lets 3.5 cm pass on a 32 cm slide) and misjudges ranges over half a turn; this
  form does neither.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import dual_quaternions, poses
from pmpnbp.geometry.poses import Array
from pmpnbp.potentials.joint_projection import gearing, limit_axes, project
from pmpnbp.potentials.kernels.joint_sums import (
    LIMITS,
    LIMITS_SLIDE,
    LIMITS_TURN,
    PRISMATIC,
    REVOLUTE,
    Jobs,
    joint_sums,
)
from pmpnbp.scene.articulated_object import Edge

__all__ = [
    "EdgeTable",
    "Form",
    "edge_table",
    "log_potential",
    "neighbour_sums",
    "project",
    "sample_axes",
    "sample_relative",
    "stratified_axes",
]

Form = Literal["limits", "projected"]

# Pairs of samples that the NumPy path of chained axes projects at once: some tens of megabytes.
_CHUNK = 20_000

# Limit poses nearer to each other than this, metres, are at one place: far below what float32 resolves in a room.
_SAME_PLACE = 1e-9


def sample_axes(rng: np.random.Generator, edge: Edge, shape: tuple[int, ...]) -> Array:
    """Axis positions (*shape, K), metres or radians, uniform between the limits; axes of one joint move together."""
    return _axes_at(edge, rng.random((*shape, len(gearing(edge).lower))))


def sample_relative(rng: np.random.Generator, edge: Edge, shape: tuple[int, ...]) -> Array:
    """Poses of the child in the parent (*shape, 7) at axis positions uniform between the limits: pairwise sampling."""
    return edge.pose_parent_child(sample_axes(rng, edge, shape))


def stratified_axes(rng: np.random.Generator, edge: Edge, shape: tuple[int, ...], draws: int) -> Array:
    """Axis positions (*shape, draws, K), spread evenly between the limits: one in each of `draws` equal strata.

    Each draw is uniform within its stratum. The first joint's strata come in ascending order, those of any further
    joint in a random order of their own (a Latin hypercube), so every single draw's marginal is uniform on a stratum
    and the `draws` together are uniform on the range.
    """
    if len(edge.axes) == 1:  # nothing to gear, and the case that every iteration has for every message
        unit = (np.arange(draws) + rng.random((*shape, draws))) / draws
        return edge.lower + unit[..., None] * (edge.upper - edge.lower)
    free = len(gearing(edge).lower)
    strata = np.broadcast_to(np.arange(draws, dtype=np.float64)[:, None], (*shape, draws, free)).copy()
    if free > 1:
        strata[..., 1:] = rng.permuted(strata[..., 1:], axis=-2)
    return _axes_at(edge, (strata + rng.random(strata.shape)) / draws)


def log_potential(
    edge: Edge, pose_parent: Array, pose_child: Array, *, form: Form, sigma_position: float, sigma_orientation: float
) -> Array:
    """log psi (...) of the parent's and the child's poses (..., 7), which broadcast; sigmas in metres and radians.

    form : "limits" (eq. 11) or "projected", as the module's docstring gives them. 0 at best.
    """
    if form == "limits":
        return _log_limits(edge, pose_parent, pose_child, sigma_position, sigma_orientation)
    relative = poses.multiply(poses.inverse(pose_parent), pose_child)
    _, translation, rotation = project(edge, relative, length_per_radian=sigma_position / sigma_orientation)
    return -np.sum(translation**2, axis=-1) / (2 * sigma_position**2) - np.sum(rotation**2, axis=-1) / (
        2 * sigma_orientation**2
    )


def _log_limits(
    edge: Edge, pose_parent: Array, pose_child: Array, sigma_position: float, sigma_orientation: float
) -> Array:
    given = dual_quaternions.from_pose(pose_parent)
    child = dual_quaternions.from_pose(pose_child)
    dq_a, dq_b = (
        dual_quaternions.multiply(given, dual_quaternions.from_pose(edge.pose_parent_child(axes)))
        for axes in limit_axes(edge)
    )
    a_pos, a_ori = dual_quaternions.distance(child, dq_a)
    b_pos, b_ori = dual_quaternions.distance(child, dq_b)
    c_pos, c_ori = dual_quaternions.distance(dq_a, dq_b)
    # eq. 11
    return -((a_pos + b_pos - c_pos) ** 2) / (2 * sigma_position**2) - (a_ori + b_ori - c_ori) ** 2 / (
        2 * sigma_orientation**2
    )


@dataclass(frozen=True)
class EdgeTable:
    """What `neighbour_sums` needs of the edges, worked out once per object; arrays over its E edges.

    edges : the edges themselves
    kind : (E,) PRISMATIC or REVOLUTE, the closed form of the projection; -1 for a chain of several axes
    limits_kind : (E,) LIMITS, LIMITS_SLIDE or LIMITS_TURN, what eq. 11 needs
    frame_parent, frame_child : (E, 7) the joint's frame in the parent and in the child, with the axis along z
    shape : (E, 2) see `joint_sums`
    lower, upper : (E, 7) poses of the child in the parent at the lower and upper limits
    limits_distance : (E, 2) distance between those two, metres and radians
    """

    edges: tuple[Edge, ...]
    kind: NDArray[np.int32]
    limits_kind: NDArray[np.int32]
    frame_parent: Array
    frame_child: Array
    shape: NDArray[np.float32]
    lower: Array
    upper: Array
    limits_distance: NDArray[np.float32]


def edge_table(edges: Sequence[Edge]) -> EdgeTable:
    """The table of `edges`, in their order."""
    count = len(edges)
    kind = np.full(count, -1, dtype=np.int32)
    limits_kind = np.full(count, LIMITS, dtype=np.int32)
    frame_parent, frame_child = np.tile(poses.IDENTITY, (2, count, 1))
    shape = np.zeros((count, 2), dtype=np.float32)
    lower, upper = np.tile(poses.IDENTITY, (2, count, 1))
    distance = np.zeros((count, 2), dtype=np.float32)
    for e, edge in enumerate(edges):
        lower[e], upper[e] = (edge.pose_parent_child(axes) for axes in limit_axes(edge))
        distance[e] = dual_quaternions.distance(
            dual_quaternions.from_pose(lower[e]), dual_quaternions.from_pose(upper[e])
        )
        if not edge.revolute.any():
            limits_kind[e] = LIMITS_SLIDE
        elif distance[e, 0] < _SAME_PLACE:
            limits_kind[e] = LIMITS_TURN
        if len(edge.axes) != 1:
            continue
        aligned = np.concatenate([np.zeros(3), _turn_z_to(edge.axes[0])])
        frame_parent[e] = poses.multiply(edge.poses_before[0], aligned)
        frame_child[e] = poses.multiply(poses.inverse(edge.pose_after), aligned)
        if edge.revolute[0]:
            kind[e] = REVOLUTE
            middle = (edge.lower[0] + edge.upper[0]) / 2
            turned = poses.from_rotation_vector(np.array([0.0, 0.0, middle]))
            frame_parent[e] = poses.multiply(frame_parent[e], np.concatenate([np.zeros(3), turned]))
            quarter = min((edge.upper[0] - edge.lower[0]) / 4, np.pi / 2)
            shape[e] = np.cos(quarter), np.sin(quarter)
        else:
            kind[e] = PRISMATIC
            shape[e] = edge.lower[0], edge.upper[0]
    return EdgeTable(tuple(edges), kind, limits_kind, frame_parent, frame_child, shape, lower, upper, distance)


def neighbour_sums(
    table: EdgeTable,
    edge: NDArray[np.integer],
    s_is_parent: NDArray[np.bool_],
    poses_s: Array,
    poses_t: Array,
    log_weights_t: Array,
    *,
    form: Form,
    sigma_position: float,
    sigma_orientation: float,
    islands_s: NDArray[np.int32] | None = None,
    islands_t: NDArray[np.int32] | None = None,
) -> Array:
    """log W_u (Q, M) of algorithm box 1, step 2c(i), for Q jobs at once.

    A job is a directed edge t → s and one other neighbour u of t; its row is over the samples i of the message to s:
    log W_u^i = log sum_j exp(log_weights_t_j) psi(X_s = poses_s_i, X_t = poses_t_j).

    edge : (Q,) entries of `table`; s_is_parent : (Q,) whether s is the edge's parent (t its child) or the reverse
    poses_s : (Q, M, 7), the samples mu_ts; poses_t : (Q, M2, 7) and log_weights_t : (Q, M2), the message u → t
    islands_s : (Q, M), islands_t : (Q, M2), int32: samples of different islands do not meet (psi is 0); both or none
    A sample without a partner, or none with a weight above zero, gives -inf. Never NaN for finite poses, however far
    apart. Absolute error at most 2e-3 where the result is above -40, for normalised log weights, samples within a few
    metres of each other and sigmas from 2 mm and 0.05 rad up.
    """
    edge = np.asarray(edge, dtype=np.int64)
    parent = np.asarray(s_is_parent, dtype=np.bool_)
    # Beliefs are read-only, and a kernel would be compiled once more for read-only arrays.
    poses_s = np.require(poses_s, np.float64, ["C", "W"])
    poses_t = np.require(poses_t, np.float64, ["C", "W"])
    log_weights = np.require(log_weights_t, np.float64, ["C", "W"])
    if islands_s is None or islands_t is None:
        start = np.zeros(poses_s.shape[:2], dtype=np.int32)
        stop = np.full(poses_s.shape[:2], poses_t.shape[1], dtype=np.int32)
    else:
        order, start, stop = _ranges_of_islands(islands_s, islands_t)
        poses_t = np.take_along_axis(poses_t, order[..., None], axis=1)
        log_weights = np.take_along_axis(log_weights, order, axis=1)
    if form == "limits":
        kind, shape = table.limits_kind[edge], table.limits_distance[edge]
        frames, child_frames = table.lower[edge], np.broadcast_to(poses.IDENTITY, (len(edge), 7))
    else:
        kind, shape = table.kind[edge], table.shape[edge]
        frames, child_frames = table.frame_parent[edge], table.frame_child[edge]
    frames_s = np.where(parent[:, None], frames, child_frames)
    frames_t = np.where(parent[:, None], child_frames, frames)
    jobs = Jobs(kind, parent, frames_s, frames_t, table.upper[edge], shape, poses_s, poses_t, log_weights, start, stop)
    closed, chained = np.flatnonzero(kind >= 0), np.flatnonzero(kind < 0)
    if len(chained) == 0:
        return joint_sums(jobs, sigma_position, sigma_orientation)
    result = np.empty(poses_s.shape[:2])
    result[closed] = joint_sums(jobs.only(closed), sigma_position, sigma_orientation)
    for q in chained:
        result[q] = _chained_sums(table.edges[edge[q]], jobs, int(q), sigma_position, sigma_orientation)
    return result


def _ranges_of_islands(
    islands_s: NDArray[np.int32], islands_t: NDArray[np.int32]
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]]:
    """An order (Q, M2) that puts islands together, and each sample of s's range (Q, M), (Q, M) of partners in it."""
    order = np.argsort(islands_t, axis=1, kind="stable")
    ordered = np.take_along_axis(islands_t, order, axis=1)
    start = np.empty(islands_s.shape, dtype=np.int32)
    stop = np.empty(islands_s.shape, dtype=np.int32)
    for q in range(len(order)):
        start[q] = np.searchsorted(ordered[q], islands_s[q], side="left")
        stop[q] = np.searchsorted(ordered[q], islands_s[q], side="right")
    return order, start, stop


def _chained_sums(edge: Edge, jobs: Jobs, q: int, sigma_position: float, sigma_orientation: float) -> Array:
    """The projected form of job `q` (M,) over a chain of axes, a block of samples at a time."""
    poses_s, poses_t = jobs.poses_s[q], jobs.poses_t[q]
    columns = np.arange(len(poses_t))
    result = np.empty(len(poses_s))
    rows = max(1, _CHUNK // max(1, len(poses_t)))
    for first in range(0, len(poses_s), rows):
        part = slice(first, first + rows)
        i, j = np.nonzero((columns >= jobs.start[q, part, None]) & (columns < jobs.stop[q, part, None]))
        s, t = poses_s[part][i], poses_t[j]
        parent, child = (s, t) if jobs.s_is_parent[q] else (t, s)
        log_psi = np.full((len(poses_s[part]), len(poses_t)), -np.inf)
        log_psi[i, j] = log_potential(
            edge, parent, child, form="projected", sigma_position=sigma_position, sigma_orientation=sigma_orientation
        )
        result[part] = np.logaddexp.reduce(log_psi + jobs.log_weights[q], axis=1, initial=-np.inf)
    return result


def _turn_z_to(axis: Array) -> Array:
    """A quaternion (4,) that turns z to the unit vector `axis`."""
    q = np.array([1.0 + axis[2], -axis[1], axis[0], 0.0])
    length = np.linalg.norm(q)
    # Half a turn about x where the axis points against z, and the formula has no direction left.
    return q / length if length > 1e-6 else np.array([0.0, 1.0, 0.0, 0.0])


def _axes_at(edge: Edge, fraction: Array) -> Array:
    free = gearing(edge)
    return (free.lower + fraction * (free.upper - free.lower)) @ free.matrix.T + free.offset
