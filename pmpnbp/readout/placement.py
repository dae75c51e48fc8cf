"""Where does the estimate have everything, and how far are the particles spread about it?

What follows from where it stands and from the posterior stays as it is while these do: it is worked out once, when it
is first asked for, and taken over from iteration to iteration.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry.poses import Array
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.tree_estimate import agreeing
from pmpnbp.potentials import unary
from pmpnbp.readout import particle_statistics
from pmpnbp.readout.object_posterior import nuisance_stds
from pmpnbp.readout.posterior import Doubt, Posterior, Spread, link_modes, spread
from pmpnbp.readout.unknown import unknown
from pmpnbp.scene.articulated_object import rows_of_parts

# The scan may be this much in front of a part's surface, metres, and still be the part: noise, a slightly wrong pose.
VISIBLE_TOLERANCE = 0.02


@dataclass(frozen=True, eq=False)
class Standing:
    """Part poses and joint positions that agree with the tree.

    given : the problem; problem : the same with the nuisances that the estimate takes
    part_poses : (N, 7), part in world; joint_positions : (D,); link_poses : (L, 7), link in world, in the model's order
    posterior : what the scan leaves open; None where it was not read out
    """

    given: Problem
    problem: Problem
    part_poses: Array
    joint_positions: Array
    link_poses: Array
    posterior: Posterior | None

    @cached_property
    def spread(self) -> Spread | None:
        """The posterior about the estimate, link by link and joint by joint."""
        if self.posterior is None:
            return None
        return spread(self.problem, self.posterior, self.part_poses[0], self.joint_positions)

    @cached_property
    def visible_fractions(self) -> Array:
        """(N,) of every part, 0 to 1."""
        problem = self.problem
        return unary.visible_fractions(
            problem.observation, problem.surfaces, self.part_poses, VISIBLE_TOLERANCE, problem.nuisances
        )

    @cached_property
    def log_likelihoods(self) -> Array:
        """(N,) natural logs of the unary potentials."""
        nodes = np.arange(len(self.part_poses), dtype=np.int32)
        return self.problem.unary(nodes, self.part_poses, self.problem.tolerance_end, "rasteriser")

    @cached_property
    def hypotheses(self) -> list[list[tuple[float, Array, Array]]]:
        """Of each link the posterior's modes, see `posterior.link_modes`; none where there is no posterior."""
        model = self.problem.mrf.model
        return [[] for _ in model.links] if self.posterior is None else link_modes(model, self.posterior)

    @cached_property
    def unknown(self) -> tuple[str, ...]:
        """A sentence for each joint and turn that the scan does not tell at all."""
        if self.posterior is None or self.spread is None:
            return ()
        return unknown(self.problem, self.posterior, self.spread)

    @cached_property
    def nuisance_stds(self) -> Array:
        """(K,) of the posterior, or where there is none yet by the score's curvature, see
        `object_posterior.nuisance_stds`; of a problem that has nuisances."""
        if self.posterior is not None and self.posterior.nuisance_stds is not None:
            return self.posterior.nuisance_stds
        return nuisance_stds(self.problem, self.part_poses[0], self.joint_positions)


def standing(
    problem: Problem, report: IterationReport, posterior: Posterior | None, before: Standing | None = None
) -> Standing:
    """Where the estimate of an iteration has everything, or the middle of its posterior where there is one.

    before : of the iteration before, which is taken where nothing of it has changed
    """
    centre = None if posterior is None else posterior.centre
    if centre is None:
        taking = problem.taking(report.nuisances)
        root, joints = agreeing(taking, report)
    elif before is not None and before.given is problem and before.posterior is posterior:
        return before
    else:
        taking, root, joints = problem.taking(centre.nuisances), centre.root, centre.joints
    model = taking.mrf.model
    part_poses = model.part_poses(root, joints)
    return Standing(problem, taking, part_poses, joints, model.link_poses(part_poses, joints), posterior)


@dataclass(frozen=True)
class Placement:
    """Where everything is, how far the particles are spread about it, and the posterior: what is soon told.

    standing : where the estimate has everything, and what the posterior says about it
    particles : (T, L, 7), those of every link, link in world; particle i of a link has the weight of particle i of the
    part that `parts_of_links` names
    particle_covariances : (L, 6, 6), see `particle_statistics.covariance`
    """

    standing: Standing
    particles: Array
    particle_covariances: Array

    @property
    def problem(self) -> Problem:
        """With the nuisances that the placement takes."""
        return self.standing.problem

    @property
    def part_poses(self) -> Array:
        """(N, 7), part in world."""
        return self.standing.part_poses

    @property
    def joint_positions(self) -> Array:
        """(D,) the joint vector; agrees with the part poses."""
        return self.standing.joint_positions

    @property
    def link_poses(self) -> Array:
        """(L, 7), link in world, in the model's order."""
        return self.standing.link_poses

    @property
    def posterior(self) -> Posterior | None:
        """What the scan leaves open; None where it was not read out."""
        return self.standing.posterior

    @property
    def spread(self) -> Spread | None:
        """The same about the estimate, or None."""
        return self.standing.spread

    @property
    def std_xyz(self) -> Array | None:
        """(L, 3) standard deviations of the positions along the world's axes, metres, or None."""
        return None if self.spread is None else particle_statistics.std_xyz(self.spread.covariances)

    def certain(self, max_std: float) -> NDArray[np.bool_]:
        """(L,): which links are certain, up to `max_std`, metres: see `posterior.Spread.certain`."""
        if self.posterior is None or self.spread is None:
            return np.zeros(len(self.link_poses), dtype=bool)
        return self.spread.certain(self.posterior, max_std)

    def doubts(self, max_std: float) -> dict[Doubt, NDArray[np.bool_]]:
        """(L,) each: why links are not certain, see `posterior.Spread.doubts`; nothing where there is no posterior."""
        if self.posterior is None or self.spread is None:
            return {}
        return self.spread.doubts(self.posterior, max_std)

    @property
    def particle_std_xyz(self) -> Array:
        """(L, 3) standard deviations of the particles' positions along the world's axes, metres."""
        return particle_statistics.std_xyz(self.particle_covariances)


def place(
    problem: Problem, report: IterationReport, posterior: Posterior | None = None, before: Placement | None = None
) -> Placement:
    """Where the estimate of an iteration has everything, or the middle of its posterior where there is one. The same
    problem, report and posterior give the same numbers.

    posterior : as `mixture.read_out` gave it, where it did
    before : of the iteration before, so that what has stayed is not worked out again
    """
    found = standing(problem, report, posterior, None if before is None else before.standing)
    problem, joints = found.problem, found.joint_positions
    model, belief = problem.mrf.model, report.belief
    rng = np.random.default_rng([problem.seed, report.iteration])
    stds = particle_statistics.joint_stds(rng, model, belief, joints)
    # Joints that a link outside all parts hangs on are spread as the particles are; a part's links do not see this.
    moved = joints + stds * rng.standard_normal((belief.log_weights.shape[1], model.dof))
    particles = model.link_poses(np.swapaxes(belief.poses, 0, 1), moved)
    covariances = np.empty((len(model.links), 6, 6))
    for weights, rows in zip(np.exp(belief.log_weights), rows_of_parts(model), strict=True):
        covariances[rows] = particle_statistics.covariance(found.link_poses[rows], particles[:, rows], weights)
    return Placement(found, particles, covariances)
