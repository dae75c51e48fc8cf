"""How probable is a configuration of the whole object, given the scan? The logarithm of its posterior.

The whole object is rendered there and scored as the estimate is, and the score counts as the log likelihood, times
`confidence`: a pixel's score 1 - (d/tau)^2 is a Gaussian's logarithm in the difference of depths d.
"""

from __future__ import annotations

from dataclasses import replace

from pmpnbp.geometry.poses import Array
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.unary import object_scores
from pmpnbp.scene.depth_noise import SHARED, told_noise

# A pixel's score 1 - (d / tau)^2 counts as a Gaussian's logarithm with a standard deviation of FLOOR, metres, and
# SHARED times the depths' own. Set on even seeds of `benchmarks.belief`, docs/algorithm.md.
FLOOR = 0.0035
# What a pixel beside a step of the scan's depth counts, as a share: such a pixel turns as a whole from one surface to
# the other, so that the score is rough there, by nats between places that are all but the same.
EDGES = 0.7


def confidence(problem: Problem) -> float:
    """Nats that a pixel's score counts, at the tolerance that annealing ends at."""
    variance = FLOOR**2 + (SHARED * float(told_noise(problem.noise, problem.noise_area).max(initial=0.0))) ** 2
    return float(problem.tolerance_end**2 / (2 * variance))


def log_posterior(problem: Problem, roots: Array, joints: Array, nuisances: Array | None = None) -> Array:
    """(C,) up to a constant, of root poses (C, 7) and joint vectors (C, D), under nuisances (C, K) or the problem's."""
    part_poses = problem.part_poses(roots, joints, nuisances)
    # also where the inference scores by eq. 10, whose sum of distances is no logarithm of a likelihood
    scoring = replace(problem.score(problem.tolerance_end), form="robust", edge_weight=EDGES)
    nuisances = problem.nuisances if nuisances is None else nuisances
    score = confidence(problem) * object_scores(problem.observation, problem.surfaces, part_poses, scoring, nuisances)
    if nuisances is not None:
        score = score + problem.log_nuisance_prior(nuisances)
    return problem.plus_prior(score, part_poses[:, problem.prior_node], always=True)
