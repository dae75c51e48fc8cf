"""The whole-object estimate: a root pose and joint positions, so that part poses and the kinematic tree agree.

Beliefs are per part, and their best particles need not fit together. Each part in turn is taken at its word and its
neighbours are put where the joints allow, as near to their own beliefs as they can be; the configurations so found,
the estimate of the iteration before, and small variations of the best are rendered whole, and the best render stays.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.belief import Belief, IterationReport, State
from pmpnbp.inference.joint_draws import within_limits
from pmpnbp.inference.mrf import LEAST_LEVER, Mrf
from pmpnbp.inference.nuisance_fit import fitted
from pmpnbp.inference.problem import DEVIATIONS, Problem
from pmpnbp.inference.registration import register
from pmpnbp.potentials.joint_projection import LENGTH_PER_RADIAN, closest_axes
from pmpnbp.potentials.kernels import tree as kernel
from pmpnbp.potentials.unary import object_scores, object_scores_by_each
from pmpnbp.settings import Schedule

# Small variations of the best configuration that are tried in one iteration, in two rounds.
VARIATIONS = 8
# Draws about the step of articulated registration, and about the present place, in each round.
REGISTRATIONS = 6
# Parts that are taken at their word in one iteration, drawn anew each time.
ANCHORS = 4
# Standard deviation in metres of the longest steps of a part along its joint.
JOINT_STEP = 0.05
# The shortest variations, as a share of the diffusion, and the share of the coordinates that one moves.
SHORTEST, MOVED = 0.02, 0.6
# The logarithm of the likelihood ratio that a reward of 1 stands for; standard deviations of the depths about a
# configuration, in that for which the tolerance that annealing ends at is made, and what the ratio's is at each, in it.
LOG_RATIO = DEVIATIONS**2 / 2
SPREADS = [(spread, 1.0 - np.log(spread) / LOG_RATIO) for spread in (2.0, 1.0, 0.5)]
# A part's mean is of the particles within this many diffusion lengths of its best.
NEAR = 3


def improve(
    rng: np.random.Generator, problem: Problem, state: State, belief: Belief, plan: Schedule
) -> tuple[Array | None, Array | None, Array, float, Array | None]:
    """Root pose (7,), joint vector (D,), part poses (N, 7), whole-object log score, and nuisances (K,) where some are
    free.

    Without the setting `object_estimate` (the paper): the best particle of each part, which need not agree
    with a tree, and no score (NaN); where particles are whole objects, the best of these.
    """
    best = belief.log_weights.argmax(axis=1)
    best_poses = belief.poses[np.arange(len(best)), best]
    if not problem.settings.object_estimate:
        if belief.joint_positions is None:
            return None, None, best_poses, float("nan"), None
        root, q = best_poses[0], belief.joint_positions[best[0]]
        score = float(configuration_scores(problem, root[None], q[None], plan.tolerance)[0])
        return root, q, best_poses, score, None
    means = np.stack([_local_mean(belief, node, int(best[node]), plan) for node in range(problem.mrf.nodes)])
    both = np.stack([best_poses, means])
    anchors = rng.permutation(len(best))[:ANCHORS]
    asked = np.tile(both, (len(anchors), 1, 1))
    roots, joints = assemble(problem.mrf, asked, np.repeat(anchors, len(both)))
    if state.root is not None and state.joints is not None:
        roots, joints = np.concatenate([roots, state.root[None]]), np.concatenate([joints, state.joints[None]])
    # what a search has told apart by millimetres is not to be confused again while the tolerance shrinks
    if problem.search_iterations:
        top = profile_scores(problem, roots, joints).argmax()
    else:
        top = configuration_scores(problem, roots, joints, plan.tolerance).argmax()
    roots, joints, scores = polish(rng, problem, roots[[top]], joints[[top]], plan, plan.tolerance, rounds=2)
    root, q, score, nuisances = roots[0], joints[0], float(scores[0]), None
    if problem.nuisances is not None:
        root, q, nuisances, score = fitted(rng, problem, root, q, plan, plan.tolerance)
    return root, q, problem.taking(nuisances).mrf.part_poses(root, q), score, nuisances


def agreeing(problem: Problem, report: IterationReport) -> tuple[Array, Array]:
    """Root pose (7,) and joint vector (D,) of the report's estimate.

    Where the report's part poses are those of the tree, as the whole-object estimate leaves them, they are taken as
    they are. Where each part's pose is its own best particle (the paper's estimate, and the start), each part in turn
    is kept where it is and the others are brought as near to their own as the joints allow; of these configurations
    the one stands that, rendered whole, explains the scan best.
    """
    problem = problem.taking(report.nuisances)
    model = problem.mrf.model
    joints = report.map_joints
    # the paper's estimate has no joint vector of its own
    if joints is not None and np.allclose(model.part_poses(report.map_poses[0], joints), report.map_poses, atol=1e-9):
        return report.map_poses[0], joints
    found = [assemble(problem.mrf, report.map_poses[None], anchor) for anchor in range(len(report.map_poses))]
    roots, vectors = np.concatenate([root for root, _ in found]), np.concatenate([q for _, q in found])
    best = int(configuration_scores(problem, roots, vectors, problem.tolerance_end).argmax())
    return roots[best], vectors[best]


def polish(
    rng: np.random.Generator,
    problem: Problem,
    roots: Array,
    joints: Array,
    plan: Schedule,
    tolerance: float,
    rounds: int,
    *,
    draws: bool = True,
    score: Array | None = None,
) -> tuple[Array, Array, Array]:
    """Each of H configurations (H, 7), (H, D) in the best place that `rounds` of small variations find it: roots,
    joints and scores (H,). draws : whether any are drawn at random, beside the steps of registration; score : (H,) what
    `configuration_scores` says of them, where that is known"""
    roots, joints = roots.copy(), joints.copy()
    best = configuration_scores(problem, roots, joints, tolerance) if score is None else score.copy()
    rows = np.arange(len(roots))
    for _ in range(rounds):
        tried = [vary(rng, problem, roots, joints, VARIATIONS, plan)] if draws else []
        tried.append(register(rng, problem, roots, joints, REGISTRATIONS if draws else 0, plan, tolerance))
        tried_roots, tried_joints = (np.concatenate(some, axis=1) for some in zip(*tried, strict=True))
        flat = tried_roots.reshape(-1, 7)
        flat_joints = tried_joints.reshape(len(flat), joints.shape[1])
        score = configuration_scores(problem, flat, flat_joints, tolerance).reshape(len(roots), -1)
        top = score.argmax(axis=1)
        better = score[rows, top] > best
        roots[better], joints[better] = tried_roots[rows, top][better], tried_joints[rows, top][better]
        best[better] = score[rows, top][better]
    return roots, joints, best


def configuration_scores(problem: Problem, roots: Array, joints: Array, tolerance: float) -> Array:
    """Whole-object log scores (C,) of root poses (C, 7) and joint vectors (C, D), the prior included."""
    part_poses = problem.mrf.part_poses(roots, joints)
    pixel_score = problem.score(tolerance)
    score = object_scores(problem.observation, problem.surfaces, part_poses, pixel_score, problem.nuisances)
    return problem.plus_prior(score, part_poses[:, problem.prior_node])


def profile_scores(problem: Problem, roots: Array, joints: Array) -> Array:
    """Whole-object log scores (C,) of root poses (C, 7) and joint vectors (C, D), the prior included, each at that of
    the SPREADS which makes it most likely: a profile likelihood, in the units of `configuration_scores` at the
    tolerance that annealing ends at.

    A spread that is wide enough for a model that is wrong by centimetres is too wide to tell a lid from a base: how
    far the depths are off is for each configuration to say (docs/algorithm.md, "The likelihood").
    """
    part_poses = problem.mrf.part_poses(roots, joints)
    pixel_scores = [problem.score(spread * np.sqrt(share) * problem.tolerance_end) for spread, share in SPREADS]
    score = object_scores_by_each(problem.observation, problem.surfaces, part_poses, pixel_scores, problem.nuisances)
    best = (score * [share for _, share in SPREADS]).max(axis=1)
    return problem.plus_prior(best, part_poses[:, problem.prior_node])


def assemble(mrf: Mrf, part_poses: Array, anchor: NDArray[np.int64] | int) -> tuple[Array, Array]:
    """Root poses (C, 7) and joint vectors (C, D) that keep part `anchor`, or part `anchor` (C,) of each, where
    `part_poses` (C, N, 7) has it and bring every other part, outwards from it, as near to its given pose as its joint
    allows."""
    anchors = np.full(len(part_poses), anchor, dtype=np.int64)
    joints = np.tile(np.clip(0.0, mrf.model.lower, mrf.model.upper), (len(part_poses), 1))
    roots = np.empty((len(part_poses), 7))
    if mrf.tree_table.before.shape[1] == 1:
        kernel.assemble(mrf.tree_table, np.require(part_poses, np.float64, ["C", "W"]), anchors, roots, joints)
        return roots, joints
    for part in np.unique(anchors):
        rows = anchors == part
        roots[rows], joints[rows] = assembled_from(mrf, part_poses[rows], joints[rows], int(part))
    return roots, joints


def assembled_from(mrf: Mrf, part_poses: Array, joints: Array, anchor: int) -> tuple[Array, Array]:
    """`assemble` for edges of any number of axes, from one part outwards. `joints` (C, D) says where those stay that
    move no axis."""
    model, table, joints = mrf.model, mrf.tree_table, joints.copy()
    placed = {anchor: part_poses[:, anchor]}
    for number, outward in zip(table.order[anchor], table.outward[anchor], strict=True):
        edge = model.edges[mrf.tree[number]]
        here, there = (edge.parent, edge.child) if outward else (edge.child, edge.parent)
        parent, child = placed[here], part_poses[:, there]
        if not outward:
            parent, child = child, parent
        axes = closest_axes(edge, poses.multiply(poses.inverse(parent), child))
        relative = edge.pose_parent_child(axes)
        placed[there] = poses.multiply(placed[here], relative if outward else poses.inverse(relative))
        coordinates, positions = edge.joint_positions(axes)
        joints[:, coordinates] = positions
    return placed[0], joints


def vary(
    rng: np.random.Generator, problem: Problem, roots: Array, joints: Array, count: int, plan: Schedule
) -> tuple[Array, Array]:
    """`count` variations of each of H configurations (H, 7), (H, D): roots (H, count, 7), joints (H, count, D).

    A quarter moves the whole object and its joints at once. The others move one part, and all the rest stays where it
    is as far as the joints allow: the root, any part, or a joint's parent along that joint, so that a frame which
    slipped along its drawers comes back without losing them. Steps are as long as the diffusion or up to fifty times
    shorter, so that both an early and a late estimate moves; those along a joint stay long (JOINT_STEP), as nothing
    else holds them.
    """
    model, mrf, many = problem.mrf.model, problem.mrf, len(roots)
    scale = np.exp(rng.uniform(np.log(SHORTEST), 0.0, (many, count, 1)))
    noise = rng.standard_normal((many, count, 6)) * (rng.random((many, count, 6)) < MOVED) * scale
    shift, turn = plan.diffusion_position * noise[..., :3], plan.diffusion_rotation * noise[..., 3:]
    at_once, _, part_rows, joint_rows = ((count + 3 - quarter) // 4 for quarter in range(4))
    reach = np.where(problem.joint_turns, plan.diffusion_position / LENGTH_PER_RADIAN, plan.diffusion_position)
    some = rng.random((many, at_once, model.dof)) < MOVED
    turned = reach * scale[:, :at_once] * rng.standard_normal(some.shape) * some
    along = count - joint_rows
    anchor, rows = np.zeros(count, dtype=np.int64), np.arange(along)
    anchor[along - part_rows : along] = rng.integers(mrf.nodes)
    moved = np.repeat(mrf.part_poses(roots, joints)[:, None], count, axis=1)
    one, centres = moved[:, rows, anchor[rows]], mrf.centres[anchor[rows]]
    moved[:, rows, anchor[rows]] = poses.perturb(one, shift[:, rows], turn[:, rows], centres)
    if model.edges:
        edge = model.edges[int(rng.integers(len(model.edges)))]
        anchor[along:] = edge.parent
        step = np.where(edge.revolute, JOINT_STEP / max(mrf.radii[edge.parent], LEAST_LEVER), JOINT_STEP)
        noise = scale[:, along:] * rng.standard_normal((many, joint_rows, len(step)))
        axes = edge.axis_positions(joints)[:, None] + step * noise
        relative = edge.pose_parent_child(within_limits(axes, edge.lower, edge.upper, edge.wraps))
        moved[:, along:, edge.parent] = poses.multiply(moved[:, along:, edge.child], poses.inverse(relative))
    apart = moved[:, at_once:].reshape(-1, mrf.nodes, 7)
    put, its_joints = assemble(mrf, apart, np.tile(anchor[at_once:], many))
    new_joints = within_limits(joints[:, None] + turned, model.lower, model.upper, model.wraps)
    return (
        np.concatenate([moved[:, :at_once, 0], put.reshape(many, count - at_once, 7)], axis=1),
        np.concatenate([new_joints, its_joints.reshape(many, count - at_once, model.dof)], axis=1),
    )


def _local_mean(belief: Belief, node: int, best: int, plan: Schedule) -> Array:
    """Mean pose of the particles near the best one."""
    near = np.linalg.norm(belief.poses[node, :, :3] - belief.poses[node, best, :3], axis=1)
    weights = np.exp(belief.log_weights[node]) * (near < NEAR * plan.diffusion_position + 1e-6)
    return poses.mean(belief.poses[node], weights)
