"""How probable is a configuration of the whole object, given the scan? The logarithm of its posterior.

The whole object is rendered there and scored as the estimate is, and the score counts as the log likelihood, times
`confidence`: a pixel's score 1 - (d/tau)^2 is a Gaussian's logarithm in the difference of depths d.
"""

from __future__ import annotations

from dataclasses import replace

from pmpnbp.geometry.poses import Array
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.unary import object_scores
from pmpnbp.scene.depth_noise import as_if_apart

# A pixel's score 1 - (d / tau)^2 counts as a Gaussian's logarithm with a standard deviation of FLOOR, metres, and so
# many times the depths' own: pixels share their errors with their neighbours (steps of depth, outlines, the mesh), so
# that each says less than its noise would have it; where the scan tells how many err as one, that is taken instead of
# SHARED. Set on even seeds of `benchmarks.belief`, docs/algorithm.md.
FLOOR, SHARED = 0.0035, 1.8


def confidence(problem: Problem) -> float:
    """Nats that a pixel's score counts, at the tolerance that annealing ends at."""
    variance = FLOOR**2 + float(as_if_apart(problem.noise, problem.noise_area, SHARED).max(initial=0.0)) ** 2
    return float(problem.tolerance_end**2 / (2 * variance))


def log_posterior(problem: Problem, roots: Array, joints: Array, nuisances: Array | None = None) -> Array:
    """(C,) up to a constant, of root poses (C, 7) and joint vectors (C, D), under nuisances (C, K) or the problem's."""
    part_poses = problem.part_poses(roots, joints, nuisances)
    # also where the inference scores by eq. 10, whose sum of distances is no logarithm of a likelihood
    scoring = replace(problem.score(problem.tolerance_end), form="robust")
    nuisances = problem.nuisances if nuisances is None else nuisances
    score = confidence(problem) * object_scores(problem.observation, problem.surfaces, part_poses, scoring, nuisances)
    if nuisances is not None:
        score = score + problem.log_nuisance_prior(nuisances)
    return problem.plus_prior(score, part_poses[:, problem.prior_node], always=True)
