"""Which small move would lay the rendered surface onto the observed one? A Gauss-Newton step of articulated registration.

Random variations find the way out of a wrong place, but need very many draws to come to rest in a right one when the
object has many joints. Where the render already lies near the scan, the depth residuals and their derivatives point
there: least squares over all pixels, in the root pose and all joint positions at once. The derivatives are differences
of renders, so that whatever joints an object has, and what hides what, needs no formula of its own.
"""

from __future__ import annotations

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.joint_draws import within_limits
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.unary import render
from pmpnbp.scene.observation import OBJECT, SUPPORT, View
from pmpnbp.settings import Schedule

# Metres that a part's middle, or its rim, is moved for a difference of renders.
PROBE = 0.0005
# Differences in depth of more than this many probes are a surface coming into view, and no derivative.
STEEPEST = 8.0
# A pixel takes part where its residual is within so many times the tolerance; one proposal for each.
GATES = (1.0, 3.0)
# Shares of the full step that are proposed.
SHARES = (1.0, 0.5)


def register(rng: np.random.Generator, problem: Problem, root: Array, joints: Array, count: int, plan: Schedule, tolerance: float) -> tuple[Array, Array]:
    """Proposals near a configuration, one for each gate and share: root poses (C, 7), joint vectors (C, D).

    A parameter that moves nothing visible stays where it is: the step is held back as by a gaussian prior about the
    present place, as wide as the diffusion.
    """
    model, mrf = problem.mrf.model, problem.mrf
    radius = max(float(mrf.radii.max()), 0.02)
    probe = np.concatenate([np.full(3, PROBE), np.full(3, PROBE / radius), np.where(problem.joint_turns, PROBE / radius, PROBE)])
    width = np.concatenate([
        np.full(3, plan.diffusion_position), np.full(3, plan.diffusion_rotation),
        np.where(problem.joint_turns, plan.diffusion_position / 0.3, plan.diffusion_position),
    ])
    moves = np.concatenate([np.zeros((1, len(probe))), np.diag(probe)])
    part_poses = model.part_poses(*_moved(problem, root, joints, moves))
    residuals, slopes, weights = [], [], []
    for view in problem.observation.views:
        residual, slope, weight = _linearised(problem, view, part_poses, probe)
        residuals.append(residual)
        slopes.append(slope)
        weights.append(weight)
    residual, slope, weight = np.concatenate(residuals), np.concatenate(slopes, axis=1), np.concatenate(weights)
    steps = []
    for gate in GATES:
        used = weight * (np.abs(residual) < gate * tolerance) / tolerance**2
        hessian = (slope * used) @ slope.T + np.diag(1.0 / width**2)
        full = np.linalg.solve(hessian, slope @ (used * residual))
        steps += [share * full for share in SHARES]
        if gate == 1.0:
            spread = np.linalg.cholesky(np.linalg.inv(hessian))
            scale = np.exp(rng.uniform(np.log(0.1), np.log(3.0), (count, 1)))
            steps += list(scale * rng.standard_normal((count, len(probe))) @ spread.T)
            steps += list(full + scale * rng.standard_normal((count, len(probe))) @ spread.T)
    return _moved(problem, root, joints, np.stack(steps))


def _moved(problem: Problem, root: Array, joints: Array, moves: Array) -> tuple[Array, Array]:
    """Configurations after `moves` (C, 6 + D): the root's translation and rotation vector about its centre, joints."""
    model = problem.mrf.model
    roots = poses.perturb(root, moves[:, :3], moves[:, 3:6], problem.mrf.centres[0])
    return roots, within_limits(joints + moves[:, 6:], model.lower, model.upper, model.wraps)


def _linearised(problem: Problem, view: View, part_poses: Array, probe: Array) -> tuple[Array, Array, Array]:
    """Residual depths (P,), metres, their slopes (6 + D, P) by parameter and weights (P,) of the pixels in which a
    part is compared with the scan. part_poses : (1 + 6 + D, N, 7), the first unmoved"""
    reward = np.zeros(view.depth.shape)
    reward[view.category == OBJECT] = 1.0
    reward[view.category == SUPPORT] = problem.settings.support_reward
    depth, number = render(view.camera, problem.surfaces, part_poses[0])
    pixels = np.nonzero((number >= 0) & (reward > 0))
    here, part = depth[pixels].astype(np.float64), number[pixels]
    slopes = np.zeros((len(probe), len(here)))
    for k in range(len(probe)):
        moved, owner = render(view.camera, problem.surfaces, part_poses[1 + k])
        slope = (moved[pixels] - here) / probe[k]
        same = (owner[pixels] == part) & (np.abs(moved[pixels] - here) < STEEPEST * PROBE)
        slopes[k] = np.where(same, slope, 0.0)
    return view.depth[pixels] - here, slopes, reward[pixels]
