"""Monte Carlo localisation: the particle filter that the paper compares PMPNBP with, as a pure step.

A particle is the whole object: the pose of its root and the positions of its joints (x, y, z, roll, pitch, yaw, t_a,
t_b, …). Nothing moves between two looks at one scan, so in the place of a motion model the particles are diffused with
Gaussian noise; the measurement model renders the object whole and scores it as a part is scored in belief propagation
(eq. 10). Start, search, annealing, tempering and estimate are those of belief propagation too. What is left to compare
is one set of particles over all dimensions at once against one for each part, held together by messages.

Dellaert, Fox, Burgard, Thrun: Monte Carlo localization for mobile robots (ICRA 1999).
"""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import log_weights as lw
from pmpnbp.inference.belief import OWN, Belief, IterationReport, Origin, State
from pmpnbp.inference.joint_draws import joint_spreads, within_limits
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.tree_estimate import improve
from pmpnbp.potentials.unary import object_scores
from pmpnbp.settings import Schedule


def step(rng: np.random.Generator, state: State, problem: Problem) -> tuple[State, IterationReport]:
    """Iteration `state.iteration + 1`: resample, diffuse, weigh, then the whole-object estimate."""
    began = time.perf_counter()
    problem = problem.taking(state.nuisances)
    number = state.iteration + 1
    plan = problem.schedule(number - state.search_after)
    belief, inverse_temperature = _weighed(problem, *draw(rng, state, problem, plan), plan)
    root, joints, map_poses, score, nuisances = improve(rng, problem, state, belief, plan)
    new = replace(state, iteration=number, belief=belief, root=root, joints=joints, nuisances=nuisances)
    report = IterationReport.of(
        new,
        "particle filter",
        inverse_temperature=inverse_temperature,
        tolerance=plan.tolerance,
        map_poses=map_poses,
        map_score=score,
        seconds=time.perf_counter() - began,
    )
    return new, report


def draw(
    rng: np.random.Generator, state: State, problem: Problem, plan: Schedule
) -> tuple[Array, Array, NDArray[np.int64]]:
    """Whole objects drawn from the belief and diffused: root poses (M, 7), joint vectors (M, D), ancestors (M,).

    The root moves about the middle of its part, as in belief propagation; joints stay within their limits.
    """
    belief, model = state.belief, problem.mrf.model
    assert belief.joint_positions is not None  # the filter starts with whole objects, and the search leaves them
    ancestor = lw.systematic(rng, belief.log_weights[0], problem.particles)
    noise = rng.standard_normal((len(ancestor), 6 + model.dof))
    roots = poses.perturb(
        belief.poses[0, ancestor],
        plan.diffusion_position * noise[:, :3],
        plan.diffusion_rotation * noise[:, 3:6],
        problem.mrf.centres[0],
    )
    moved = belief.joint_positions[ancestor] + joint_spreads(problem, plan) * noise[:, 6:]
    return roots, within_limits(moved, model.lower, model.upper, model.wraps), ancestor


def _weighed(
    problem: Problem, roots: Array, joints: Array, ancestor: NDArray[np.int64], plan: Schedule
) -> tuple[Belief, float]:
    """The particles with their weights, which are those of whole objects and so the same for every part, and the factor
    on the log potential. The prior is not tempered."""
    settings, nodes = problem.settings, problem.mrf.nodes
    part_poses = problem.mrf.part_poses(roots, joints)
    score = problem.score(plan.tolerance)
    unary = object_scores(problem.observation, problem.surfaces, part_poses, score, problem.nuisances)
    share = settings.effective_share
    inverse_temperature = float(lw.tempering(unary, share)) if share else settings.unary_scale
    total = problem.plus_prior(inverse_temperature * unary, part_poses[:, problem.prior_node])
    belief = Belief(
        poses=np.ascontiguousarray(np.swapaxes(part_poses, 0, 1)),
        log_weights=np.tile(lw.normalise(total), (nodes, 1)),
        log_unary=np.tile(unary, (nodes, 1)),
        origin=Origin.of((nodes, len(roots)), OWN, ancestor=ancestor),
        joint_positions=joints,
    )
    return belief, inverse_temperature
