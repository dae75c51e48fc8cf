"""What does the belief say of one scene, and what of the truth? A run as `pmpnbp estimate` makes it, held against what
was rendered.

Of links that move as one, one counts, the first of its part.
"""

from __future__ import annotations

from collections import deque
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.calibrate import scenes
from benchmarks.calibrate.ranks import ranks
from benchmarks.calibrate.task import Task
from pmpnbp.errors import ScanError
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.run import steps
from pmpnbp.readout.mixture import of_estimate
from pmpnbp.readout.placement import Placement, place
from pmpnbp.readout.posterior import Posterior
from pmpnbp.readout.surface_distance import distances, part_surfaces
from pmpnbp.recording.inputs import Inputs
from pmpnbp.runs.run_log import Asked, Result

# The verdict where the scan is refused, as nothing in the region may be an object.
REFUSED = "refused"
# Square metres that keep a covariance of no extent from being singular.
TINY = 1e-12


def perform(task: Task, asked: Asked) -> Result:
    """The run of a `seed`, with the object or, where `absent`, without; its result is what JSON can hold.

    verdict : of the fit, or REFUSED; at_rest : whether it came to rest; effective : draws that count
    Where the object is there, by part (N,): shares, of it that are measured; of the first link's position errors
    (N, 3), the estimate less the truth, stds (N, 3), and offsets (N, 3), the draws' mean less the truth, metres;
    turned, radians; add and expected_add, metres, or None without a surface; certain; position_ranks (N, 3), along the
    world's axes, and ellipsoid_ranks, of how far the truth lies from the estimate, in the covariance's metric, among
    the draws. By joint coordinate (D,): joint_offsets, metres or radians, and joint_ranks.
    """
    scene = scenes.draw(task, asked["seed"], absent=asked["absent"])
    inputs = Inputs(
        Path(task.name), (scene.scan,), task.region, task.prior, task.settings, task.particles, asked["seed"]
    )
    try:
        problem = inputs.problem(task.model)
    except ScanError as error:
        return {"verdict": REFUSED, "reason": str(error)}
    step = deque(steps(problem, task.iterations), maxlen=1).pop()
    posterior = of_estimate(problem, step.report)
    told = {
        "verdict": posterior.fit.verdict,
        "reason": posterior.fit.reason,
        "at_rest": step.converged,
        "effective": round(posterior.effective_sample_size, 1),
    }
    if asked["absent"]:
        return told
    placed = place(problem, step.report, posterior)
    rng = np.random.default_rng([62, asked["seed"]])
    return told | _against_truth(rng, task, problem, scene, posterior, placed)


def _against_truth(
    rng: np.random.Generator, task: Task, problem: Problem, scene: scenes.Scene, posterior: Posterior, placed: Placement
) -> Result:
    model, spread, std_xyz = problem.mrf.model, placed.spread, placed.std_xyz
    assert spread is not None and std_xyz is not None  # there is a posterior
    first = [model.links.index(part.links[0]) for part in model.parts]
    true_parts = model.part_poses(scene.root, scene.joints)
    truth, here = true_parts[:, :3], placed.part_poses[:, :3]
    drawn = posterior.link_poses(model)[:, first, :3]
    weights = np.exp(posterior.log_weights)
    metric: Array = np.linalg.inv(spread.covariances[first, :3, :3] + TINY * np.eye(3)).astype(np.float64)
    surfaces = part_surfaces(model)
    add = distances(surfaces, placed.part_poses, true_parts)
    turned = [
        _turned(surface.axis, found, true)
        for surface, found, true in zip(surfaces, placed.part_poses, true_parts, strict=True)
    ]
    estimated = placed.joint_positions
    joints, true_joints = (_unwrapped(one, estimated, model.wraps) for one in (posterior.drawn_joints, scene.joints))
    return {
        "shares": np.round(scene.shares, 4).tolist(),
        "errors": np.round(here - truth, 7).tolist(),
        "stds": np.round(std_xyz[first], 7).tolist(),
        "offsets": np.round(np.einsum("k,knc->nc", weights, drawn) - truth, 7).tolist(),
        "turned": np.round(turned, 6).tolist(),
        "add": _numbers(add),
        "expected_add": _numbers(spread.expected_add[first]),
        "certain": placed.certain(task.max_std)[first].tolist(),
        "position_ranks": np.round(ranks(rng, drawn, truth, weights), 6).tolist(),
        "ellipsoid_ranks": np.round(
            ranks(rng, _apart(drawn, here, metric), _apart(truth, here, metric), weights), 6
        ).tolist(),
        "joint_offsets": np.round(weights @ joints - true_joints, 7).tolist(),
        "joint_ranks": np.round(ranks(rng, joints, true_joints, weights), 6).tolist(),
    }


def _apart(positions: Array, here: Array, metric: Array) -> Array:
    """(..., N) squared distances of positions (..., N, 3) from (N, 3) in metrics (N, 3, 3)."""
    gap = positions - here
    found: Array = np.einsum("...ni,nij,...nj->...n", gap, metric, gap)
    return found


def _turned(axis: Array, found: Array, true: Array) -> float:
    """Radians between orientations of poses (7,); of a part that is round about its `axis` (3,), else zero, between
    the axes."""
    if not axis.any():
        return float(poses.rotation_angle(found[3:], true[3:]))
    # a round part is the same upside down only where its ends are: the axis keeps its sign
    cosine = poses.rotate(found[3:], axis) @ poses.rotate(true[3:], axis)
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _unwrapped(joints: Array, middle: Array, wraps: NDArray[np.bool_]) -> Array:
    """Joint vectors (..., D), those that turn all the way round at most half a turn from `middle` (D,)."""
    gap = joints - middle
    return middle + np.where(wraps, gap - 2 * np.pi * np.round(gap / (2 * np.pi)), gap)


def _numbers(values: Array) -> list[float | None]:
    """As JSON has them: NaN is None."""
    return [None if np.isnan(value) else round(float(value), 7) for value in values]
