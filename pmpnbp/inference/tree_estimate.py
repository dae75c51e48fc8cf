"""The whole-object estimate: a root pose and joint positions, so that part poses and the kinematic tree agree.

Beliefs are per part, and their best particles need not fit together. Each part in turn is taken at its word and its
neighbours are put where the joints allow, as near to their own beliefs as they can be; the configurations so found,
the estimate of the iteration before, and small variations of the best are rendered whole, and the best render stays.
"""

from __future__ import annotations

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.belief import Belief, State
from pmpnbp.inference.joint_draws import within_limits
from pmpnbp.inference.mrf import Mrf
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.joint_projection import project
from pmpnbp.potentials.unary import object_scores
from pmpnbp.settings import Schedule

# Small variations of the best configuration that are tried in one iteration, in two rounds.
VARIATIONS = 24


def improve(
    rng: np.random.Generator, problem: Problem, state: State, belief: Belief, plan: Schedule
) -> tuple[Array, Array, Array, float]:
    """Root pose (7,), joint vector (D,), part poses (N, 7) and whole-object log score.

    Without the setting `object_estimate` (the paper): the best particle of each part, joints as in the iteration
    before, and no score (NaN).
    """
    model = problem.mrf.model
    best = belief.log_weights.argmax(axis=1)
    best_poses = belief.poses[np.arange(len(best)), best]
    if not problem.settings.object_estimate:
        root, joints = assemble(problem.mrf, best_poses, 0)
        return root, joints, best_poses, float("nan")
    means = np.stack([_local_mean(belief, node, int(best[node]), plan) for node in range(problem.mrf.nodes)])
    found = [assemble(problem.mrf, given, anchor) for given in (best_poses, means) for anchor in range(len(best))]
    if state.root is not None and state.joints is not None:
        found.append((state.root, state.joints))
    roots, joints = np.array([root for root, _ in found]), np.array([q for _, q in found]).reshape(len(found), -1)
    for _ in range(2):
        # the best so far first: ties keep it
        score = configuration_scores(problem, roots, joints, plan.tolerance)
        top = int(score.argmax())
        roots, joints = vary(rng, problem, roots[top], joints[top], VARIATIONS, plan)
    score = configuration_scores(problem, roots, joints, plan.tolerance)
    top = int(score.argmax())
    return roots[top], joints[top], model.part_poses(roots[top], joints[top]), float(score[top])


def configuration_scores(problem: Problem, roots: Array, joints: Array, tolerance: float) -> Array:
    """Whole-object log scores (C,) of root poses (C, 7) and joint vectors (C, D), the prior included."""
    part_poses = problem.mrf.model.part_poses(roots, joints)
    score, _ = object_scores(problem.observation, problem.surfaces, part_poses, problem.score(tolerance))
    if problem.prior_node >= 0 and problem.settings.prior_factor:
        score = score + problem.log_prior(part_poses[:, problem.prior_node])
    return score


def assemble(mrf: Mrf, part_poses: Array, anchor: int) -> tuple[Array, Array]:
    """Root pose (7,) and joint vector (D,) that keep part `anchor` where `part_poses` (N, 7) has it and bring every
    other part, outwards from it, as near to its given pose as its joint allows."""
    model = mrf.model
    joints = np.clip(0.0, model.lower, model.upper)
    placed = {anchor: part_poses[anchor]}
    waiting = list(model.edges)
    while waiting:
        later = []
        for edge in waiting:
            if edge.parent in placed and edge.child in placed:
                continue  # closes a loop
            if edge.parent not in placed and edge.child not in placed:
                later.append(edge)
                continue
            outward = edge.parent in placed
            here, there = (edge.parent, edge.child) if outward else (edge.child, edge.parent)
            pair = (placed[here], part_poses[there]) if outward else (part_poses[there], placed[here])
            axes, _, _ = project(edge, poses.multiply(poses.inverse(pair[0]), pair[1])[None])
            relative = edge.pose_parent_child(axes[0])
            placed[there] = poses.multiply(placed[here], relative if outward else poses.inverse(relative))
            moving = edge.multiplier != 0
            joints[edge.coordinates[moving]] = ((axes[0] - edge.offset) / np.where(moving, edge.multiplier, 1))[moving]
        if len(later) == len(waiting):
            break
        waiting = later
    return placed[0], joints


def vary(
    rng: np.random.Generator, problem: Problem, root: Array, joints: Array, count: int, plan: Schedule
) -> tuple[Array, Array]:
    """`count` variations of a configuration, itself first: root poses (1 + count, 7), joint vectors (1 + count, D).

    Steps are as long as the diffusion or up to fifty times shorter, so that both an early and a late estimate moves.
    """
    model = problem.mrf.model
    scale = np.exp(rng.uniform(np.log(0.02), 0.0, (count, 1)))
    noise = rng.standard_normal((count, 6)) * (rng.random((count, 6)) < 0.6) * scale
    pivot = problem.mrf.centres[0]
    moved = poses.perturb(
        root, plan.diffusion_position * noise[:, :3], plan.diffusion_rotation * noise[:, 3:], pivot
    )  # fmt: skip
    turned = rng.standard_normal((count, model.dof)) * (rng.random((count, model.dof)) < 0.6) * scale
    reach = np.where(problem.joint_turns, plan.diffusion_position / 0.3, plan.diffusion_position)
    varied = within_limits(joints + reach * turned, model.lower, model.upper, model.wraps)
    return np.concatenate([root[None], moved]), np.concatenate([joints[None], varied])


def _local_mean(belief: Belief, node: int, best: int, plan: Schedule) -> Array:
    """Mean pose of the particles that are near the best one: within three diffusion lengths."""
    near = np.linalg.norm(belief.poses[node, :, :3] - belief.poses[node, best, :3], axis=1)
    weights = np.exp(belief.log_weights[node]) * (near < 3 * plan.diffusion_position + 1e-6)
    return poses.mean(belief.poses[node], weights)
