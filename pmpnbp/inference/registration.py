"""Which small move would lay the rendered surface onto the observed one? One Gauss-Newton step of registration.

Random variations find the way out of a wrong place, but need very many draws to come to rest in a right one when the
object has many joints. Where the render lies near the scan, the depth residuals and their derivatives point there:
least squares over all pixels, in the root pose and all joint positions at once. What the residuals do not hold is as
free as before, so draws about the step, spread as the least squares leave them, explore just that.

A pixel's depth changes as the face moves that it shows. How parts move is a difference of their poses, so that joints
of any kind need no formula.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.joint_draws import within_limits
from pmpnbp.inference.mrf import LEAST_LEVER
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.joint_projection import LENGTH_PER_RADIAN
from pmpnbp.potentials.unary import normal_equations
from pmpnbp.settings import Schedule

# Metres that a surface is moved for a derivative, at the rim of the largest part where it turns.
PROBE = 0.0005
# A surface seen so much aslant that its depth changes by more than this many times its motion is all outline.
STEEPEST = 8.0
NO_NUISANCES = np.zeros(0, dtype=np.int64)
# Pixels take part whose residual is within so many times the tolerance: near it, and to be drawn in from farther away.
NEAR, FAR = 1.0, 3.0
# Standard deviations of the draws, in those of the least squares.
NARROWEST, WIDEST = 0.1, 3.0


def register(
    rng: np.random.Generator,
    problem: Problem,
    roots: Array,
    joints: Array,
    count: int,
    plan: Schedule,
    tolerance: float,
) -> tuple[Array, Array]:
    """Proposals near each of H configurations (H, 7), (H, D): root poses (H, 4 + 2 count, 7), joint vectors
    (H, 4 + 2 count, D).

    The first four are the whole and half steps with the pixels NEAR and FAR; then `count` draws about the whole step
    with NEAR and `count` about the present place. A prior holds each parameter to where it is, as wide as the
    diffusion, so that one which moves nothing visible does not run away.
    """
    information, gradient = linearised(problem, roots, joints, tolerance, np.array([FAR, NEAR]))
    information += np.diag(1.0 / widths(problem, plan) ** 2)
    return moved(problem, roots, joints, steps_and_draws(rng, information, gradient, (1.0, 0.5), count))


def steps_and_draws(
    rng: np.random.Generator, information: Array, gradient: Array, shares: Sequence[float], count: int
) -> Array:
    """Moves (H, G S + 2 count, P) by the normal equations (H, G, P, P), (H, G, P) of G gates, the last of them NEAR: of
    each gate's least squares S shares of the step; then `count` draws about the last gate's whole step and as many
    about the present place, spread as these least squares leave them."""
    many = len(information)
    whole = np.linalg.solve(information, gradient[..., None])[..., 0]
    steps = np.stack([share * whole for share in shares], axis=2).reshape(many, -1, whole.shape[-1])
    spread = np.linalg.cholesky(np.linalg.inv(information[:, -1]))
    scale = np.exp(rng.uniform(np.log(NARROWEST), np.log(WIDEST), (many, 2 * count, 1)))
    draws = np.einsum("hij,hcj->hci", spread, scale * rng.standard_normal((many, 2 * count, whole.shape[-1])))
    draws[:, :count] += whole[:, -1, None]
    return np.concatenate([steps, draws], axis=1)


def curvature(
    problem: Problem, root: Array, joints: Array, tolerance: float, free: NDArray[np.int64] = NO_NUISANCES
) -> Array:
    """(6 + D + F, 6 + D + F): the whole-object score falls by x C x with a small move x: the root's translation,
    metres, and rotation vector about its centre, joints, and the nuisances numbered `free` (F,). Only depths that move
    count, outlines do not."""
    information, _ = linearised(problem, root[None], joints[None], tolerance, np.array([NEAR]), free=free)
    found: Array = information[0, 0]
    return found


def linearised(
    problem: Problem,
    roots: Array,
    joints: Array,
    tolerance: float,
    gates: Array,
    *,
    free: NDArray[np.int64] = NO_NUISANCES,
) -> tuple[Array, Array]:
    """Of configurations (H, 7), (H, D): information (H, G, P, P) and gradient (H, G, P) of the depth residuals smaller
    than each of `gates` (G,) tolerances, in squares of the tolerance; P = 6 + D + F parameters, the last of them the
    nuisances numbered `free` (F,).

    A joint at its limit cannot be moved across it and is probed the other way.
    """
    model = problem.mrf.model
    placing = 6 + model.dof
    steps = np.concatenate([probes(problem), PROBE / problem.nuisance_levers[free]])
    blocked = ~model.wraps & (joints + steps[6:placing] > model.upper)
    signed = np.tile(steps, (len(roots), 1))
    signed[:, 6:placing][blocked] *= -1.0
    moves = signed[:, None] * np.concatenate([np.zeros((1, len(steps))), np.eye(len(steps))])
    nuisances = problem.nuisances
    if nuisances is not None:
        nuisances = np.tile(nuisances, (1 + len(steps), 1))
        nuisances[:, free] += moves[0, :, placing:]
    part_poses = problem.part_poses(*moved(problem, roots, joints, moves[..., :placing]), nuisances)
    return normal_equations(
        problem.observation,
        problem.surfaces,
        part_poses,
        signed,
        problem.score(tolerance),
        gates * tolerance,
        STEEPEST,
        nuisances,
    )


def probes(problem: Problem) -> Array:
    """(6 + D,) what each parameter is moved by for a derivative."""
    turn = PROBE / max(float(problem.mrf.radii.max()), LEAST_LEVER)
    return np.concatenate([np.full(3, PROBE), np.full(3, turn), np.where(problem.joint_turns, turn, PROBE)])


def widths(problem: Problem, plan: Schedule) -> Array:
    """(6 + D,) how far each parameter may stray where the scan does not hold it."""
    position, rotation = max(plan.diffusion_position, PROBE), max(plan.diffusion_rotation, PROBE)
    return np.concatenate(
        [
            np.full(3, position),
            np.full(3, rotation),
            np.where(problem.joint_turns, position / LENGTH_PER_RADIAN, position),
        ]
    )


def moved(problem: Problem, roots: Array, joints: Array, moves: Array) -> tuple[Array, Array]:
    """Each of the configurations (H, 7), (H, D) after its `moves` (H, C, 6 + D): the root's translation and rotation
    vector about its centre, joints."""
    model = problem.mrf.model
    there = poses.perturb(roots[:, None], moves[..., :3], moves[..., 3:6], problem.mrf.centres[0])
    return there, within_limits(joints[:, None] + moves[..., 6:], model.lower, model.upper, model.wraps)
