"""Where is every link, where stands every joint, and how sure is that? Reads an iteration out into `result.json`.

Part poses and joint positions always agree with the kinematic tree: see `agreeing`. Everything is reported for links,
though the inference knows parts only: a part's particles are carried to each of its links.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.tree_estimate import assemble, configuration_scores
from pmpnbp.potentials import nuisances
from pmpnbp.potentials.unary import visible_fractions
from pmpnbp.readout import particle_statistics
from pmpnbp.readout.object_posterior import nuisance_stds
from pmpnbp.scene.articulated_object import ArticulatedObject, Joint
from pmpnbp.settings import SessionOptions

SCHEMA = "pmpnbp/estimate-1"
OF_RUN = ["model", "method", "seed", "iteration", "converged", "frame_id", "stamp", "certain", "max_std", "seconds"]
# The scan may be this much in front of a part's surface, metres, and still be the part: noise, a slightly wrong pose.
VISIBLE_TOLERANCE = 0.02


@dataclass(frozen=True)
class Placement:
    """Where everything is, and how far the particles are spread about it: the part of an estimate that is soon made.

    part_poses : (N, 7), part in world; joint_positions, joint_stds : (D,) the joint vector; both agree with the tree
    link_poses : (L, 7), link in world, in the model's order; covariances : (L, 6, 6), see
    `particle_statistics.covariance`; particles : (T, L, 7), those of every link, link in world; particle i of
    a link has the weight of particle i of the part that `parts_of_links` names
    """

    part_poses: Array
    joint_positions: Array
    joint_stds: Array
    link_poses: Array
    covariances: Array
    particles: Array

    @property
    def std_xyz(self) -> Array:
        """(L, 3) standard deviations of the positions along the world's axes, metres."""
        return particle_statistics.std_xyz(self.covariances)

    def certain(self, max_std: float) -> NDArray[np.bool_]:
        """(L,): whether every element of a link's `std_xyz` is at most `max_std`, metres."""
        found: NDArray[np.bool_] = np.all(self.std_xyz <= max_std, axis=1)
        return found


@dataclass(frozen=True)
class ModeEstimate:
    """One hypothesis of a link: weight; pose (7,) mean of its particles, link in world; covariance (6, 6) about it."""

    weight: float
    pose: Array
    covariance: Array


@dataclass(frozen=True)
class LinkEstimate:
    """A link of the URDF.

    part : the part it belongs to, or that it was reached from where it is in none
    pose : (7,), link in world; covariance : (6, 6) of the belief about it, see `particle_statistics.covariance`
    visible_fraction : 0 to 1, log_likelihood : natural log of the unary potential; both of its part at the estimate,
        and None where it is in no part that has a surface
    modes : the hypotheses, heaviest first
    """

    name: str
    part: int
    pose: Array
    covariance: Array
    visible_fraction: float | None
    log_likelihood: float | None
    modes: tuple[ModeEstimate, ...]

    @property
    def std_xyz(self) -> Array:
        """(3,) standard deviations of the position along the world's axes, metres."""
        return particle_statistics.std_xyz(self.covariance)


@dataclass(frozen=True)
class JointEstimate:
    """A moving joint: position, std, lower, upper (K,), metres or radians, of its K axes (1; planar 3, floating 6)."""

    joint: Joint
    position: Array
    std: Array
    lower: Array
    upper: Array


@dataclass(frozen=True)
class NuisanceEstimate:
    """What one nuisance is taken for, see `potentials/nuisances.py`: its value and standard deviation given the scan,
    and that of its prior about 0; shares, metres or radians."""

    name: str
    value: float
    std: float
    prior_std: float


@dataclass(frozen=True)
class Estimate:
    """What an iteration says about the object.

    part_poses : (N, 7), part in world; joint_positions : (D,) the joint vector; both agree with the tree
    depth_noise : standard deviation of each view's depths at the object, metres, that the inference goes by
    """

    model: str
    method: str
    seed: int
    iteration: int
    converged: bool
    frame_id: str
    stamp: float | None
    max_std: float
    seconds: float
    part_poses: Array
    joint_positions: Array
    links: tuple[LinkEstimate, ...]
    joints: tuple[JointEstimate, ...]
    depth_noise: tuple[float, ...]
    nuisances: tuple[NuisanceEstimate, ...] = ()

    def link_certain(self, link: LinkEstimate) -> bool:
        """Whether every element of the link's `std_xyz` is at most `max_std`."""
        return bool(np.all(link.std_xyz <= self.max_std))

    @property
    def certain(self) -> bool:
        """Whether every link is."""
        return all(self.link_certain(link) for link in self.links)


def place(problem: Problem, report: IterationReport) -> Placement:
    """Where the estimate of an iteration has everything. The same problem and report give the same numbers."""
    model, belief = problem.mrf.model, report.belief
    root, joints = agreeing(problem, report)
    part_poses = model.part_poses(root, joints)
    link_poses = model.link_poses(part_poses, joints)
    rng = np.random.default_rng([problem.seed, report.iteration])
    stds = particle_statistics.joint_stds(rng, model, belief, joints)
    # Joints that a link outside all parts hangs on are spread as they are uncertain; a part's links do not see this.
    spread = joints + stds * rng.standard_normal((belief.log_weights.shape[1], model.dof))
    particles = model.link_poses(np.swapaxes(belief.poses, 0, 1), spread)
    weights, part = np.exp(belief.log_weights), parts_of_links(model)
    covariances = [
        particle_statistics.covariance(link_poses[row], particles[:, row], weights[part[name]])
        for row, name in enumerate(model.links)
    ]
    return Placement(part_poses, joints, stds, link_poses, np.array(covariances), particles)


def estimate(
    problem: Problem,
    report: IterationReport,
    placed: Placement | None = None,
    *,
    max_std: float = SessionOptions.max_std,
    converged: bool = False,
    seconds: float = 0.0,
) -> Estimate:
    """The estimate of an iteration. The same problem and report give the same numbers.

    placed : what `place` gave, where it is there already
    max_std : metres, up to which a link is certain; seconds : wall time of the inference so far
    """
    problem = problem.taking(report.nuisances)
    model, belief, observation = problem.mrf.model, report.belief, problem.observation
    placed = placed or place(problem, report)
    part_poses = placed.part_poses
    fractions = visible_fractions(observation, problem.surfaces, part_poses, VISIBLE_TOLERANCE, problem.nuisances)
    likelihoods = problem.unary(
        np.arange(len(part_poses), dtype=np.int32), part_poses, problem.tolerance_end, "rasteriser"
    )
    weights = np.exp(belief.log_weights)
    modes = [
        particle_statistics.modes(belief.poses[node], weights[node], problem.mrf.centres[node])
        for node in range(len(part_poses))
    ]
    reached_from = parts_of_links(model)
    with_surface = {link for part in model.parts if part.visible for link in part.links}
    links = []
    for row, name in enumerate(model.links):
        part = reached_from[name]
        found = []
        for mode in modes[part]:
            own, share = placed.particles[mode.members, row], weights[part, mode.members]
            middle = poses.mean(own, share)
            found.append(ModeEstimate(mode.weight, middle, particle_statistics.covariance(middle, own, share)))
        links.append(
            LinkEstimate(
                name,
                part,
                placed.link_poses[row],
                placed.covariances[row],
                float(fractions[part]) if name in with_surface else None,
                float(likelihoods[part]) if name in with_surface else None,
                tuple(found),
            )
        )
    moving = tuple(_joint_estimate(joint, placed) for joint in model.joints if joint.kind != "fixed")
    return Estimate(
        model.name,
        problem.method,
        problem.seed,
        report.iteration,
        converged,
        observation.frame_id,
        observation.stamp,
        max_std,
        seconds,
        part_poses,
        placed.joint_positions,
        tuple(links),
        moving,
        tuple(problem.noise.tolist()),
        _nuisance_estimates(problem, part_poses[0], placed.joint_positions),
    )


def _nuisance_estimates(problem: Problem, root: Array, joints: Array) -> tuple[NuisanceEstimate, ...]:
    if problem.nuisances is None:
        return ()
    names = nuisances.names(len(problem.observation.views), [part.name for part in problem.mrf.model.parts])
    stds = nuisance_stds(problem, root, joints)
    return tuple(
        NuisanceEstimate(names[k], float(problem.nuisances[k]), float(stds[k]), float(problem.nuisance_std[k]))
        for k in np.flatnonzero(problem.nuisance_std)
    )


def agreeing(problem: Problem, report: IterationReport) -> tuple[Array, Array]:
    """Root pose (7,) and joint vector (D,) of the report's estimate.

    Where the report's part poses are those of the tree, as the whole-object estimate leaves them, they are taken as
    they are. Where each part's pose is its own best particle (the paper's estimate, and the start), each part in turn
    is kept where it is and the others are brought as near to their own as the joints allow; of these configurations
    the one stands that, rendered whole, explains the scan best.
    """
    model = problem.mrf.model
    joints = report.map_joints
    # the paper's estimate has no joint vector of its own
    if joints is not None and np.allclose(model.part_poses(report.map_poses[0], joints), report.map_poses, atol=1e-9):
        return report.map_poses[0], joints
    found = [assemble(problem.mrf, report.map_poses[None], anchor) for anchor in range(len(report.map_poses))]
    roots, vectors = np.concatenate([root for root, _ in found]), np.concatenate([q for _, q in found])
    best = int(configuration_scores(problem, roots, vectors, problem.tolerance_end).argmax())
    return roots[best], vectors[best]


def parts_of_links(model: ArticulatedObject) -> dict[str, int]:
    """For every link the part it is in, or else that which `ArticulatedObject.link_poses` reaches it from."""
    owner = {link: index for index, part in enumerate(model.parts) for link in part.links}
    parent = {joint.child: joint.parent for joint in model.joints}
    link = model.parts[0].links[0]
    while link in parent:
        link = parent[link]
        owner.setdefault(link, 0)
    for joint in model.joints:
        owner.setdefault(joint.child, owner[joint.parent])
    return owner


def _joint_estimate(joint: Joint, placed: Placement) -> JointEstimate:
    lower, upper = joint.limits()
    std = abs(joint.multiplier) * placed.joint_stds[list(joint.coordinates)]
    return JointEstimate(joint, joint.positions(placed.joint_positions), std, lower, upper)


def to_result(found: Estimate, truth: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """The members of `result.json`, in its order; `truth`, what `errors` gives, comes last under that name."""
    links = {
        link.name: {
            "pose": pose_members(link.pose),
            "covariance": link.covariance.reshape(-1).tolist(),
            "std_xyz": link.std_xyz.tolist(),
            "certain": found.link_certain(link),
            "visible_fraction": link.visible_fraction,
            "log_likelihood": link.log_likelihood,
            "modes": [
                {
                    "weight": mode.weight,
                    "pose": pose_members(mode.pose),
                    "covariance": mode.covariance.reshape(-1).tolist(),
                }
                for mode in link.modes
            ],
        }
        for link in found.links
    }
    joints = {
        entry.joint.name: {
            "type": entry.joint.kind,
            "position": number_or_list(entry.position),
            "std": number_or_list(entry.std),
            "lower": number_or_list(entry.lower),
            "upper": number_or_list(entry.upper),
            "parent": entry.joint.parent,
            "child": entry.joint.child,
        }
        for entry in found.joints
    }
    result: dict[str, Any] = {
        "schema": SCHEMA,
        **{name: getattr(found, name) for name in OF_RUN},
        "links": links,
        "joints": joints,
        "depth_noise": list(found.depth_noise),
        "nuisances": {
            entry.name: {"value": entry.value, "std": entry.std, "prior_std": entry.prior_std}
            for entry in found.nuisances
        },
    }
    return result if truth is None else result | {"truth": dict(truth)}


def pose_members(pose: Array) -> dict[str, dict[str, float]]:
    """A pose (7,) as JSON has it; the scalar part of its quaternion is not negative, so that equal poses look equal."""
    x, y, z, qw, qx, qy, qz = (pose if pose[3] >= 0 else np.concatenate([pose[:3], -pose[3:]])).tolist()
    return {"position": {"x": x, "y": y, "z": z}, "orientation": {"x": qx, "y": qy, "z": qz, "w": qw}}


def number_or_list(values: Array) -> float | list[float]:
    """A joint's (K,) numbers as REST and result.json have them: a number where it has one axis."""
    numbers: list[float] = values.tolist()
    return numbers[0] if len(numbers) == 1 else numbers
