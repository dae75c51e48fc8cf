"""Iteration 0: particles drawn from the prior (box 1 step 1a), and from matches of oriented surface points.

The paper's start puts part origins on observed points. A large part's origin is then decimetres from the truth, since
a point of its surface was seen and not its origin; the search starts from matched surface points instead. The particle
filter starts from whole objects, whose root is drawn as each part is in belief propagation.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.belief import START, SURFACE, Belief, Origin, State
from pmpnbp.inference.problem import Problem
from pmpnbp.scene.prior import UniformPrior
from pmpnbp.scene.support_planes import LEVEL
from pmpnbp.scene.surface_points import drawn_points, surface

# How often pairs of points whose inclinations differ are drawn again, and by how much the z components of their
# normals may differ.
REDRAWS, INCLINATION = 12, 0.2
# With a gaussian prior, the share of a search's first proposals that is moved onto the scan, to one of so many points;
# the scale of how much the cosine of the angle between normals may lack, and the least one that is taken; deviations of
# the prior beyond which no point is looked at.
MATCHED, CANDIDATES = 0.9, 32
DISAGREEMENT, LEAST_AGREEMENT, FARTHEST = 0.06, 0.85, 3.0
# A normal whose horizontal part is shorter than this says nothing of the yaw.
HORIZONTAL = 0.5
# Of upright matches of surfaces that are as upright (what their normals have of up) this share is put where the object
# stands on a level support plane.
UPRIGHT, STANDING = 0.3, 0.5


def start(rng: np.random.Generator, problem: Problem) -> State:
    """The state before the first iteration."""
    mrf, count = problem.mrf, problem.particles
    uniform = isinstance(problem.prior, UniformPrior)
    if uniform and problem.method == "pmpnbp":
        return State(iteration=0, belief=_unweighted(_on_the_scan(rng, problem, (mrf.nodes, count)), None))
    joints = random_joints(rng, problem, count)
    roots = _on_the_scan(rng, problem, (count,)) if uniform else prior_roots(rng, problem, joints)
    return State(iteration=0, belief=_unweighted(np.swapaxes(mrf.part_poses(roots, joints), 0, 1), joints))


def _unweighted(particles: Array, joints: Array | None) -> Belief:
    shape = particles.shape[:2]
    return Belief(
        poses=np.ascontiguousarray(particles),
        log_weights=np.full(shape, -np.log(shape[1])),
        log_unary=np.zeros(shape),
        origin=Origin.of(shape, START),
        joint_positions=joints,
    )


def _on_the_scan(rng: np.random.Generator, problem: Problem, shape: tuple[int, ...]) -> Array:
    """Poses (*shape, 7): origins on observed points, turned as the uniform prior says."""
    points = problem.observation.points
    position = points[rng.integers(len(points), size=shape)]
    return np.concatenate([position, _orientations(rng, problem, shape)], axis=-1)


def _orientations(rng: np.random.Generator, problem: Problem, shape: tuple[int, ...]) -> Array:
    """Quaternions (*shape, 4): uniform over all rotations, or upright with any yaw."""
    assert isinstance(problem.prior, UniformPrior)
    if problem.prior.orientation == "any":
        return poses.random_quaternions(rng, shape)
    turn = rng.uniform(-np.pi, np.pi, (*shape, 1)) * np.array([0.0, 0.0, 1.0])
    return poses.quaternion_multiply(upright(problem.observation.up), poses.from_rotation_vector(turn))


def upright(up: Array) -> Array:
    """The shortest rotation (4,) that takes the model's z axis to `up` (3,)."""
    cross = np.cross([0.0, 0.0, 1.0], up)
    if up[2] < -0.999999:
        return np.array([0.0, 1.0, 0.0, 0.0])
    q = np.concatenate([[1.0 + up[2]], cross])
    return q / np.linalg.norm(q)


def random_joints(rng: np.random.Generator, problem: Problem, count: int) -> Array:
    """Joint vectors (count, D) from the prior: gaussian where it names a joint, else uniform between the limits."""
    model = problem.mrf.model
    joints = rng.uniform(model.lower, model.upper, (count, model.dof))
    for coordinate, (position, std) in problem.joint_prior.items():
        drawn = position + std * rng.standard_normal(count)
        joints[:, coordinate] = np.clip(drawn, model.lower[coordinate], model.upper[coordinate])
    return joints


def prior_roots(rng: np.random.Generator, problem: Problem, joints: Array) -> Array:
    """Root poses (count, 7) for which the part that the gaussian prior names has a pose drawn from it."""
    prior = problem.prior
    assert not isinstance(prior, UniformPrior)
    count = len(joints)
    drawn = poses.perturb(
        np.broadcast_to(problem.prior_pose, (count, 7)),
        prior.std_xyz * rng.standard_normal((count, 3)),
        prior.std_rpy * rng.standard_normal((count, 3)),
    )
    pose_root_part = problem.mrf.part_poses(poses.IDENTITY, joints)[..., problem.prior_node, :]
    return poses.multiply(drawn, poses.inverse(pose_root_part))


def fresh_roots(
    rng: np.random.Generator, problem: Problem, joints: Array
) -> tuple[Array, NDArray[np.uint8], NDArray[np.int64]]:
    """Root poses (count, 7) that a search begins with, its joints at `joints` (count, D); the source (count,) of each,
    as in `Origin`, and the part (count,) that they lay on the scan: from matches of surface points; with a gaussian
    prior a few that are only drawn from it, as nothing of the object may be seen there: these lay the root."""
    source = np.full(len(joints), SURFACE, dtype=np.uint8)
    if isinstance(problem.prior, UniformPrior):
        roots, part = matched_roots(rng, problem, joints)
        return roots, source, part
    roots = prior_roots(rng, problem, joints)
    matched = round(MATCHED * len(roots))
    part = np.zeros(len(roots), dtype=np.int64)
    roots[:matched], part[:matched] = _moved_onto_the_scan(rng, problem, roots[:matched], joints[:matched])
    source[matched:] = START
    return roots, source, part


def _moved_onto_the_scan(
    rng: np.random.Generator, problem: Problem, roots: Array, joints: Array
) -> tuple[Array, NDArray[np.int64]]:
    """Root poses (count, 7), drawn from the gaussian prior, each moved so that a random surface point of the object
    lies on a point of the scan; and the part (count,) that it is on. The point of the scan is one of some CANDIDATES,
    drawn by how well its normal agrees and by the prior at the pose so moved. A point of the object that finds no such
    normal, for one that is turned away, is drawn again."""
    prior, observation = problem.prior, problem.observation
    assert not isinstance(prior, UniformPrior)
    part_poses = problem.mrf.part_poses(roots, joints)
    middles = poses.transform_points(part_poses, problem.mrf.centres)
    offset = part_poses[:, problem.prior_node, :3] - problem.prior_pose[:3]
    size = np.linalg.norm(middles - part_poses[:, [problem.prior_node], :3], axis=2) + problem.mrf.radii
    reach = FARTHEST * float(np.max(prior.std_xyz)) + float(size.max(initial=0.0))
    near = np.flatnonzero(np.linalg.norm(observation.points - problem.prior_pose[:3], axis=1) < reach)
    moved, matched = roots.copy(), np.zeros(len(roots), dtype=np.int64)
    if not len(near):
        return moved, matched
    # how well the normals agree, and the prior's density at the pose so moved: products of what a point of the scan
    # has and what one of the object has, up to what is the same for all candidates
    scaled = observation.points[near] / prior.std_xyz
    terms = np.column_stack([observation.normals[near] / DISAGREEMENT, scaled, -0.5 * (scaled**2).sum(axis=1)])
    whole = surface([part.inference_mesh for part in problem.mrf.model.parts])
    waiting = np.arange(len(roots))
    for _ in range(REDRAWS):
        point, normal, part = drawn_points(rng, whole, len(waiting))
        here = poses.transform_points(part_poses[waiting, part], point)
        turned = poses.rotate(part_poses[waiting, part, 3:], normal)
        asked = np.column_stack([turned, (here - offset[waiting]) / prior.std_xyz, np.ones(len(waiting))])
        seen = rng.integers(len(near), size=(len(waiting), CANDIDATES))
        log_density = (np.take(terms, seen, axis=0) @ asked[..., None])[..., 0]
        weights = np.exp(log_density - log_density.max(axis=1, keepdims=True))
        # the first of exponential clocks that run as fast as the weights
        chosen = (weights / rng.standard_exponential(weights.shape)).argmax(axis=1)
        at = near[seen[np.arange(len(waiting)), chosen]]
        moved[waiting, :3], matched[waiting] = roots[waiting, :3] + observation.points[at] - here, part
        waiting = waiting[(observation.normals[at] * turned).sum(axis=1) < LEAST_AGREEMENT]
        if not len(waiting):
            break
    return moved, matched


def matched_roots(rng: np.random.Generator, problem: Problem, joints: Array) -> tuple[Array, NDArray[np.int64]]:
    """Root poses (count, 7) that lay a random oriented surface point of the object, its joints at `joints` (count, D),
    on a random oriented point of the scan; and the part (count,) that it is on.

    Upright: the yaw that turns the one normal's horizontal direction to the other's (any yaw where it is vertical);
    pairs whose inclinations differ are drawn again. Any orientation: the shortest rotation, after any turn about the
    normal.
    """
    prior, observation = problem.prior, problem.observation
    assert isinstance(prior, UniformPrior)
    count = len(joints)
    part_poses = problem.mrf.part_poses(poses.IDENTITY, joints)
    whole = surface([part.inference_mesh for part in problem.mrf.model.parts])
    points, normals = np.empty((count, 3)), np.empty((count, 3))
    seen, matched = np.empty((2, count), dtype=np.int64)
    upright_world = upright(observation.up)
    inclination = observation.normals @ observation.up
    waiting = np.arange(count)
    for _ in range(REDRAWS):
        point, normal, part = drawn_points(rng, whole, len(waiting))
        points[waiting] = poses.transform_points(part_poses[waiting, part], point)
        normals[waiting] = poses.rotate(part_poses[waiting, part, 3:], normal)
        seen[waiting], matched[waiting] = rng.integers(len(observation.points), size=len(waiting)), part
        if prior.orientation == "any":
            break
        waiting = waiting[np.abs(normals[waiting, 2] - inclination[seen[waiting]]) > INCLINATION]
        if not len(waiting):
            break
    if prior.orientation == "any":
        turn = poses.from_rotation_vector(rng.uniform(-np.pi, np.pi, (count, 1)) * normals)
        rotation = poses.quaternion_multiply(_between(normals, observation.normals[seen]), turn)
    else:
        target = poses.rotate(poses.quaternion_conjugate(upright_world), observation.normals[seen])
        yaw = np.arctan2(target[:, 1], target[:, 0]) - np.arctan2(normals[:, 1], normals[:, 0])
        steep = np.hypot(target[:, 0], target[:, 1]) < HORIZONTAL
        yaw = np.where(steep, rng.uniform(-np.pi, np.pi, count), yaw)
        about_up = poses.from_rotation_vector(yaw[:, None] * np.array([0.0, 0.0, 1.0]))
        rotation = poses.quaternion_multiply(upright_world, about_up)
    roots = np.concatenate([observation.points[seen] - poses.rotate(rotation, points), rotation], axis=-1)
    # a chain that is grown begins where its root is seen
    if prior.orientation == "any" or problem.grows:
        return roots, matched
    return _stood(rng, problem, roots, seen, matched), matched


def _stood(
    rng: np.random.Generator, problem: Problem, roots: Array, seen: NDArray[np.int64], matched: NDArray[np.int64]
) -> Array:
    """Root poses (count, 7) at which points of the parts `matched` (count,) are laid on the scan's, numbered `seen`
    (count,). A match of upright surfaces leaves open how high the object is: some are moved along them to where it
    stands on a support plane, as far as the part reaches."""
    observation, mesh = problem.observation, problem.mrf.model.parts[0].inference_mesh
    level = observation.planes[observation.planes[:, :3] @ observation.up >= LEVEL]
    on_upright = np.abs(observation.normals[seen] @ observation.up) < UPRIGHT
    chosen = np.flatnonzero(on_upright & (rng.random(len(roots)) < STANDING))
    if not len(level) or not len(mesh.vertices):
        return roots
    plane = level[rng.integers(len(level), size=len(chosen))]
    above = ((plane[:, :3] * roots[chosen, :3]).sum(axis=1) + plane[:, 3]) / (plane[:, :3] @ observation.up)
    too_high = above + mesh.vertices[:, 2].min()
    within = np.abs(too_high) < 2 * problem.mrf.radii[matched[chosen]]
    roots[chosen[within], :3] -= too_high[within, None] * observation.up
    return roots


def _between(a: Array, b: Array) -> Array:
    """Shortest rotations (P, 4) that take unit vectors a (P, 3) to b (P, 3)."""
    w = 1.0 + np.einsum("pc,pc->p", a, b)
    opposite = w < 1e-9
    aside = np.cross(a, np.where(np.abs(a[:, :1]) < 0.9, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))
    q = np.concatenate(
        [np.where(opposite, 0.0, w)[:, None], np.where(opposite[:, None], aside, np.cross(a, b))], axis=1
    )
    return q / np.linalg.norm(q, axis=1, keepdims=True)
