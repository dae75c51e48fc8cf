"""Where is every link, where stands every joint, and how sure is that? Reads an iteration out.

Part poses and joint positions always agree with the kinematic tree: see `tree_estimate.agreeing`. Everything is
reported for links, though the inference knows parts only. How sure one can be is the posterior's to say; the particles'
own spread stands beside it, under names that begin with `particle`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.belief import Belief, IterationReport
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials import nuisances
from pmpnbp.readout import particle_statistics
from pmpnbp.readout.placement import Placement, Standing, place
from pmpnbp.readout.posterior import Doubt, Posterior, Spread
from pmpnbp.scene.articulated_object import Joint, parts_of_links, rows_of_parts
from pmpnbp.settings import SessionOptions


@dataclass(frozen=True)
class ModeEstimate:
    """One hypothesis of a link: weight; pose (7,), link in world; covariance (6, 6) about it."""

    weight: float
    pose: Array
    covariance: Array


@dataclass(frozen=True)
class LinkEstimate:
    """A link of the URDF.

    part : the part it belongs to, or that it was reached from where it is in none
    pose : (7,), link in world
    covariance : (6, 6) of the posterior about it, see `particle_statistics.covariance`; expected_add : metres, the mean
        distance over the surface (eq. 12) that the posterior expects; both None where there is no posterior,
        expected_add also without a surface
    doubts : why it is not certain, see `posterior.Spread.doubts`; None where there is no posterior
    visible_fraction : 0 to 1, log_likelihood : natural log of the unary potential; both of its part at the estimate,
        and None where it is in no part that has a surface
    modes : the posterior's hypotheses, heaviest first; none where there is no posterior
    particle_std_xyz : (3,) metres, the spread of the particles; particle_modes : the hypotheses among these
    """

    name: str
    part: int
    pose: Array
    covariance: Array | None
    expected_add: float | None
    doubts: tuple[Doubt, ...] | None
    visible_fraction: float | None
    log_likelihood: float | None
    modes: tuple[ModeEstimate, ...]
    particle_std_xyz: Array
    particle_modes: tuple[ModeEstimate, ...]

    @property
    def certain(self) -> bool:
        """Whether there is a posterior and no doubt."""
        return self.doubts == ()

    @property
    def std_xyz(self) -> Array | None:
        """(3,) standard deviations of the position along the world's axes, metres, or None."""
        return None if self.covariance is None else particle_statistics.std_xyz(self.covariance)


@dataclass(frozen=True)
class JointEstimate:
    """A moving joint: position, std, lower, upper (K,) and interval (K, 2), the central 90 % of the posterior, metres
    or radians, of its K axes (1; planar 3, floating 6); std and interval are None where there is no posterior."""

    joint: Joint
    position: Array
    std: Array | None
    interval: Array | None
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
class Alternative:
    """One hypothesis of the whole object: weight; link_poses (L, 7), in the model's order; joint_positions (D,)."""

    weight: float
    link_poses: Array
    joint_positions: Array


@dataclass(frozen=True)
class Estimate:
    """What an iteration says about the object.

    part_poses : (N, 7), part in world; joint_positions : (D,) the joint vector; both agree with the tree
    depth_noise : standard deviation of each scan's depths at the object, metres, that the inference goes by, None of
        one that shows nothing of the region; depth_noise_area : pixels of it that err as one, see
        `scene/depth_noise.py`
    depth_distortion : likewise, of errors that are smooth over all of a part, see `scene/depth_distortion.py`
    posterior : what the scan leaves open, or None where it was not read out; alternatives : its modes, heaviest first
    unknown : a sentence for each joint and turn that the scan does not tell at all
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
    depth_noise: tuple[float | None, ...]
    depth_noise_area: tuple[float | None, ...]
    depth_distortion: tuple[float | None, ...]
    nuisances: tuple[NuisanceEstimate, ...] = ()
    posterior: Posterior | None = None
    alternatives: tuple[Alternative, ...] = ()
    unknown: tuple[str, ...] = ()

    @property
    def certain(self) -> bool:
        """Whether every link is."""
        return all(link.certain for link in self.links)

    @property
    def fit(self) -> str | None:
        """Whether what should be seen is seen: good, doubtful or none; None where there is no posterior."""
        return None if self.posterior is None else self.posterior.fit.verdict

    @property
    def fit_reason(self) -> str | None:
        """Why, in a sentence."""
        return None if self.posterior is None else self.posterior.fit.reason

    @property
    def explained(self) -> float | None:
        """The share of what should be seen that the scan confirms, 0 to 1."""
        return None if self.posterior is None else self.posterior.fit.explained

    @property
    def effective_draws(self) -> float | None:
        """How many draws of equal weight would tell as much as the posterior's."""
        return None if self.posterior is None else self.posterior.effective_sample_size

    @property
    def posterior_iteration(self) -> int | None:
        """The iteration that the posterior was read out from: at rest the first one, as long as the estimate stays."""
        return None if self.posterior is None else self.posterior.iteration


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

    placed : what `place` gave, with the posterior where there is one
    max_std : metres, up to which a link is certain; seconds : wall time of the inference so far
    """
    placed = placed or place(problem, report)
    problem = placed.problem
    model, belief, observation, stands = problem.mrf.model, report.belief, problem.observation, placed.standing
    part_poses, fractions, likelihoods = stands.part_poses, stands.visible_fractions, stands.log_likelihoods
    particle_modes = _particle_modes(problem, belief, placed)
    posterior, told, doubts = placed.posterior, placed.spread, placed.doubts(max_std)
    reached_from = parts_of_links(model)
    with_surface = {link for part in model.parts if part.visible for link in part.links}
    links = []
    for row, name in enumerate(model.links):
        part = reached_from[name]
        links.append(
            LinkEstimate(
                name=name,
                part=part,
                pose=placed.link_poses[row],
                covariance=None if told is None else told.covariances[row],
                expected_add=None if told is None else _number(told.expected_add[row]),
                doubts=None if told is None else tuple(why for why, of in doubts.items() if of[row]),
                visible_fraction=float(fractions[part]) if name in with_surface else None,
                log_likelihood=float(likelihoods[part]) if name in with_surface else None,
                modes=tuple(ModeEstimate(*mode) for mode in stands.hypotheses[row]),
                particle_std_xyz=placed.particle_std_xyz[row],
                particle_modes=tuple(particle_modes[row]),
            )
        )
    moving = tuple(_joint_estimate(joint, placed, told) for joint in model.joints if joint.kind != "fixed")
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
        observation.by_scan(problem.noise),
        observation.by_scan(problem.noise_area),
        observation.by_scan(view.distortion * view.distance for view in observation.views),
        _nuisance_estimates(stands),
        posterior,
        _alternatives(stands),
        stands.unknown,
    )


def _particle_modes(problem: Problem, belief: Belief, placed: Placement) -> list[list[ModeEstimate]]:
    """Of each link the hypotheses among its particles, heaviest first."""
    model = problem.mrf.model
    found: list[list[ModeEstimate]] = [[] for _ in model.links]
    for node, rows in enumerate(rows_of_parts(model)):
        weights = np.exp(belief.log_weights[node])
        for mode in particle_statistics.modes(belief.poses[node], weights, problem.mrf.centres[node]):
            own, share = placed.particles[mode.members][:, rows], weights[mode.members]
            middles = poses.mean(own, share)
            covariances = particle_statistics.covariance(middles, own, share)
            for row, middle, covariance in zip(rows, middles, covariances, strict=True):
                found[row].append(ModeEstimate(mode.weight, middle, covariance))
    return found


def _nuisance_estimates(stands: Standing) -> tuple[NuisanceEstimate, ...]:
    problem = stands.problem
    if problem.nuisances is None:
        return ()
    names, stds = nuisances.names(problem.observation.scan_numbers), stands.nuisance_stds
    return tuple(
        NuisanceEstimate(names[k], float(problem.nuisances[k]), float(stds[k]), float(problem.nuisance_std[k]))
        for k in np.flatnonzero(problem.nuisance_std)
    )


def _joint_estimate(joint: Joint, placed: Placement, told: Spread | None) -> JointEstimate:
    lower, upper = joint.limits()
    position = joint.positions(placed.joint_positions)
    if told is None:
        return JointEstimate(joint, position, None, None, lower, upper)
    std = abs(joint.multiplier) * told.joint_stds[list(joint.coordinates)]
    ends = np.sort([joint.positions(end) for end in told.joint_intervals], axis=0)
    return JointEstimate(joint, position, std, ends.T, lower, upper)


def _alternatives(stands: Standing) -> tuple[Alternative, ...]:
    modes = () if stands.posterior is None else stands.posterior.modes
    return tuple(
        Alternative(mode.weight, np.array([own[number][1] for own in stands.hypotheses]), mode.joints)
        for number, mode in enumerate(modes)
    )


def _number(value: float) -> float | None:
    return None if np.isnan(value) else float(value)
