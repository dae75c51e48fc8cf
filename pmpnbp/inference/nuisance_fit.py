"""Which depth scales, camera offsets and sizes fit best? Gauss-Newton steps in these and the whole object at once.

The search and the particles take nuisances for what the estimate so far has them at; here they move together with the
root pose and the joints, because neither can be told without the other: a box that is measured 1 % too far away is a
box farther away, but for its outline.
"""

from __future__ import annotations

import numpy as np

from pmpnbp.geometry.poses import Array
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.registration import FAR, NEAR, linearised, moved, steps_and_draws, widths
from pmpnbp.potentials.unary import object_scores
from pmpnbp.settings import Schedule

# Steps of one fit, the shares of a step that are tried, and draws about it and about the present place.
ROUNDS, SHARES, DRAWS = 3, (1.0, 0.5, 0.2), 12
# Standard deviations of the prior that a nuisance goes at most.
MOST = 4.0


def fitted(
    rng: np.random.Generator, problem: Problem, root: Array, joints: Array, plan: Schedule, tolerance: float
) -> tuple[Array, Array, Array, float]:
    """Root pose (7,), joint vector (D,), nuisances (K,) and whole-object log score of the best place near an estimate
    (7,), (D,) under the problem's nuisances; never a worse one."""
    assert problem.nuisances is not None
    nuisances, free = problem.nuisances, np.flatnonzero(problem.nuisance_std)
    # halves, as the score falls by the square of a step, and a prior by half of it
    precision = 0.5 / problem.nuisance_std[free] ** 2
    held = np.concatenate([1.0 / widths(problem, plan) ** 2, precision])
    best = float(scores(problem, root[None], joints[None], nuisances[None], tolerance)[0])
    for _ in range(ROUNDS):
        taken = problem.taking(nuisances)
        information, gradient = linearised(taken, root[None], joints[None], tolerance, np.array([FAR, NEAR]), free=free)
        gradient[..., -len(free) :] -= precision * nuisances[free]
        # outlines have no derivative: draws along what the depths leave free find what they say
        steps = steps_and_draws(rng, information + np.diag(held), gradient, SHARES, DRAWS)[0]
        roots, q = (found[0] for found in moved(problem, root[None], joints[None], steps[None, :, : -len(free)]))
        tried = np.tile(nuisances, (len(steps), 1))
        tried[:, free] += steps[:, -len(free) :]
        tried = np.clip(tried, -MOST * problem.nuisance_std, MOST * problem.nuisance_std)
        score = scores(problem, roots, q, tried, tolerance)
        top = int(score.argmax())
        if score[top] <= best:
            continue
        root, joints, nuisances, best = roots[top], q[top], tried[top], float(score[top])
    return root, joints, nuisances, best


def scores(problem: Problem, roots: Array, joints: Array, nuisances: Array, tolerance: float) -> Array:
    """Whole-object log scores (C,) of root poses (C, 7) and joint vectors (C, D) under nuisances (C, K), the priors of
    pose and nuisances included."""
    part_poses = problem.part_poses(roots, joints, nuisances)
    score = object_scores(problem.observation, problem.surfaces, part_poses, problem.score(tolerance), nuisances)
    return problem.plus_prior(score, part_poses[:, problem.prior_node]) + problem.log_nuisance_prior(nuisances)
