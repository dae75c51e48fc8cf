"""The specification of articulated registration's normal equations, from differences of renders in plain NumPy, one
object at a time."""

from __future__ import annotations

import numpy as np

from pmpnbp.geometry.poses import Array
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.registration import STEEPEST, moved, probes
from pmpnbp.potentials.kernels.reference import patch_weights
from pmpnbp.potentials.unary import render
from pmpnbp.scene.observation import CONTINUED, OBJECT, SUPPORT, View


def linearised(
    problem: Problem, view: View, root: Array, joints: Array, tolerance: float
) -> tuple[Array, Array, Array]:
    """Of the pixels in which the object is compared with the scan: residual depths (P,), metres, their slopes
    (6 + D, P) by parameter, and weights (P,), the most that a pixel's score can be."""
    model, score = problem.mrf.model, problem.score(tolerance)
    # a fifth of a probe: few pixels then show another face after the move than before it
    steps = probes(problem) / 5
    blocked = ~model.wraps & (joints + steps[6:] > model.upper)
    signed = steps * np.concatenate([np.ones(6), np.where(blocked, -1.0, 1.0)])
    moves = np.concatenate([np.zeros((1, len(signed))), np.diag(signed)])
    roots, positions = moved(problem, root[None], joints[None], moves[None])
    part_poses = model.part_poses(roots[0], positions[0])
    depth, number = render(view.camera, problem.surfaces, part_poses[0])
    reward = np.zeros(view.depth.shape)
    reward[(view.category == OBJECT) | (view.category == CONTINUED)] = 1.0
    reward[view.category == SUPPORT] = score.support_reward
    if score.continued_reward < 1.0:
        reward *= patch_weights(view.depth, depth, view.patches, tolerance, score.continued_reward)[view.patches]
    pixels = np.nonzero((number >= 0) & (reward > 0))
    here, part = depth[pixels].astype(np.float64), number[pixels]
    slopes = np.zeros((len(signed), len(here)))
    for k, probe in enumerate(signed):
        after, owner = render(view.camera, problem.surfaces, part_poses[1 + k])
        change = after[pixels] - here
        slopes[k] = np.where(owner[pixels] == part, change / probe, 0.0)
    # the first three parameters move every surface along the axes
    slopes *= np.linalg.norm(slopes[:3], axis=0) < STEEPEST
    return view.depth[pixels] - here, slopes, reward[pixels] * (here / score.unit_distance) ** 2


def normal_equations(
    problem: Problem, root: Array, joints: Array, tolerance: float, gates: Array
) -> tuple[Array, Array]:
    """Information (G, 6 + D, 6 + D) and gradient (G, 6 + D) of all views together."""
    size = 6 + problem.mrf.model.dof
    information, gradient = np.zeros((len(gates), size, size)), np.zeros((len(gates), size))
    for view in problem.observation.views:
        residual, slope, weight = linearised(problem, view, root, joints, tolerance)
        for k, gate in enumerate(gates):
            used = weight * (np.abs(residual) < gate * tolerance) / tolerance**2
            information[k] += (slope * used) @ slope.T
            gradient[k] += slope @ (used * residual)
    return information, gradient
