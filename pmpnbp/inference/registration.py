"""Which small move would lay the rendered surface onto the observed one? One Gauss-Newton step of registration.

Random variations find the way out of a wrong place, but need very many draws to come to rest in a right one when the
object has many joints. Where the render lies near the scan, the depth residuals and their derivatives point there:
least squares over all pixels, in the root pose and all joint positions at once. What the residuals do not hold is as
free as before, so draws about the step, spread as the least squares leave them, explore just that.

The derivatives are differences of renders: joints of any kind, and parts that hide each other, need no formula.
"""

from __future__ import annotations

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.joint_draws import within_limits
from pmpnbp.inference.mrf import LEAST_LEVER
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.joint_projection import LENGTH_PER_RADIAN
from pmpnbp.potentials.unary import render
from pmpnbp.scene.observation import OBJECT, SUPPORT, View
from pmpnbp.settings import Schedule

# Metres that a surface is moved for a difference of renders, at the rim of the largest part where it turns.
PROBE = 0.0005
# A depth that changes by more than this many probes is another surface coming into view, and no derivative.
STEEPEST = 8.0
# Pixels take part whose residual is within so many times the tolerance: near it, and to be drawn in from farther away.
NEAR, FAR = 1.0, 3.0
# Standard deviations of the draws, in those of the least squares.
NARROWEST, WIDEST = 0.1, 3.0


def register(
    rng: np.random.Generator, problem: Problem, root: Array, joints: Array, count: int, plan: Schedule, tolerance: float
) -> tuple[Array, Array]:
    """Proposals near a configuration: root poses (4 + 2 count, 7), joint vectors (4 + 2 count, D).

    The first four are the whole and half steps with the pixels NEAR and FAR; then `count` draws about the whole step
    with NEAR and `count` about the present place. A prior holds each parameter to where it is, as wide as the
    diffusion, so that one which moves nothing visible does not run away.
    """
    residual, slope, weight = _residuals(problem, root, joints)
    held = np.diag(1.0 / _widths(problem, plan) ** 2)
    steps = []
    for gate in (FAR, NEAR):
        used = weight * (np.abs(residual) < gate * tolerance) / tolerance**2
        information = (slope * used) @ slope.T + held
        step = np.linalg.solve(information, slope @ (used * residual))
        steps += [step, 0.5 * step]
    spread = np.linalg.cholesky(np.linalg.inv(information))
    scale = np.exp(rng.uniform(np.log(NARROWEST), np.log(WIDEST), (2 * count, 1)))
    draws = scale * rng.standard_normal((2 * count, len(step))) @ spread.T
    draws[:count] += step
    return _moved(problem, root, joints, np.concatenate([steps, draws]))


def curvature(problem: Problem, root: Array, joints: Array, tolerance: float) -> Array:
    """(6 + D, 6 + D): the whole-object score falls by x C x with a small move x: the root's translation, metres, and
    rotation vector about its centre, and joints. Only depths that move count, outlines do not."""
    residual, slope, weight = _residuals(problem, root, joints)
    used = weight * (np.abs(residual) < NEAR * tolerance) / tolerance**2
    found: Array = (slope * used) @ slope.T
    return found


def _residuals(problem: Problem, root: Array, joints: Array) -> tuple[Array, Array, Array]:
    """What `_linearised` gives, of all views together."""
    probes = _probes(problem)
    lines = [_linearised(problem, view, root, joints, probes) for view in problem.observation.views]
    return (
        np.concatenate([line[0] for line in lines]),
        np.concatenate([line[1] for line in lines], axis=1),
        np.concatenate([line[2] for line in lines]),
    )


def _probes(problem: Problem) -> Array:
    """(6 + D,) what each parameter is moved by for a derivative."""
    turn = PROBE / max(float(problem.mrf.radii.max()), LEAST_LEVER)
    return np.concatenate([np.full(3, PROBE), np.full(3, turn), np.where(problem.joint_turns, turn, PROBE)])


def _widths(problem: Problem, plan: Schedule) -> Array:
    """(6 + D,) how far each parameter may stray where the scan does not hold it."""
    position, rotation = max(plan.diffusion_position, PROBE), max(plan.diffusion_rotation, PROBE)
    return np.concatenate(
        [
            np.full(3, position),
            np.full(3, rotation),
            np.where(problem.joint_turns, position / LENGTH_PER_RADIAN, position),
        ]
    )


def _moved(problem: Problem, root: Array, joints: Array, moves: Array) -> tuple[Array, Array]:
    """Configurations after `moves` (C, 6 + D): the root's translation and rotation vector about its centre, joints."""
    model = problem.mrf.model
    roots = poses.perturb(root, moves[:, :3], moves[:, 3:6], problem.mrf.centres[0])
    return roots, within_limits(joints + moves[:, 6:], model.lower, model.upper, model.wraps)


def _linearised(problem: Problem, view: View, root: Array, joints: Array, probes: Array) -> tuple[Array, Array, Array]:
    """Of the pixels in which the object is compared with the scan: residual depths (P,), metres, their slopes
    (6 + D, P) by parameter, and weights (P,), the most that a pixel's score can be.

    A joint at its limit cannot be moved across it and is probed the other way.
    """
    model = problem.mrf.model
    blocked = ~model.wraps & (joints + probes[6:] > model.upper)
    signed = probes * np.concatenate([np.ones(6), np.where(blocked, -1.0, 1.0)])
    moves = np.concatenate([np.zeros((1, len(signed))), np.diag(signed)])
    part_poses = model.part_poses(*_moved(problem, root, joints, moves))
    reward = np.zeros(view.depth.shape)
    reward[view.category == OBJECT] = 1.0
    reward[view.category == SUPPORT] = problem.settings.support_reward
    depth, number = render(view.camera, problem.surfaces, part_poses[0])
    pixels = np.nonzero((number >= 0) & (reward > 0))
    here, part = depth[pixels].astype(np.float64), number[pixels]
    slopes = np.zeros((len(signed), len(here)))
    for k, probe in enumerate(signed):
        moved, owner = render(view.camera, problem.surfaces, part_poses[1 + k])
        change = moved[pixels] - here
        slopes[k] = np.where((owner[pixels] == part) & (np.abs(change) < STEEPEST * PROBE), change / probe, 0.0)
    return view.depth[pixels] - here, slopes, reward[pixels]
