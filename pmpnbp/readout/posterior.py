"""What does the scan leave open? A mixture of modes of the whole object, by weighted draws; the belief that is told.

The estimate is one mode. Others are the places that the search compared last, brought to their best, where their score
comes near the estimate's: a cabinet turned by half, a look-alike beside it, a wrist the other way round. A mode weighs
as much as the posterior's integral over the root's poses (its evidence), not as its best score: a broad mode holds more
than a narrow one of the same height. The room that joints have in a mode is divided out. Else a closed cabinet would
rather be seen from behind: there each drawer may be anywhere within its range, where in front it is shut to a
millimetre, and so much more would such a place weigh for every drawer, though nothing was seen of it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry.poses import Array
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.log_weights import normalise
from pmpnbp.inference.mrf import part_motions
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.tree_estimate import agreeing, polish
from pmpnbp.readout.checkpoint import Checkpoint, go_on
from pmpnbp.readout.denied_parts import drawn_anew, moving
from pmpnbp.readout.fit import Fit, assess
from pmpnbp.readout.object_posterior import ModeDraws, log_posterior, mode_draws
from pmpnbp.readout.particle_statistics import covariance
from pmpnbp.readout.surface_distance import distances, part_surfaces, turn_agreement
from pmpnbp.scene.articulated_object import ArticulatedObject, parts_of_links
from pmpnbp.scene.sizes import resized

# Modes are told at most, and what weighs less than this is none.
MODES, LEAST_WEIGHT = 6, 1e-4
# A rival is polished where its score is worse than the estimate's by a smaller share, and drawn from where it is then
# worse by fewer nats: a broad mode may make up for some.
CLOSE, NATS = 0.2, 15.0
# After one round the others are those that are worse by fewer nats than HOPELESS: of 605 rivals on even seeds none that
# came within NATS was then worse by more than 29.
POLISH_ROUNDS, HOPELESS = 3, 50.0
# Two places are one mode where every part's middle and rim are nearer than this, metres, or than so many of its
# standard deviations.
SAME, DEVIATIONS = 0.01, 4.0
# Metres and radians: no joint is taken for better known than this where modes are weighed.
SHUT = 1e-4
# Effective draws below which the posterior says too little to be certain by.
FEWEST_DRAWS = 20.0
# Draws that an expected distance is averaged over.
DRAWS = 64
# A link is elsewhere in a mode of more than this weight: nobody is certain of it.
DOUBT = 0.01
# The central share of a joint's interval.
CENTRAL = 0.9


@dataclass(frozen=True, kw_only=True)
class ObjectMode:
    """One hypothesis of the whole object. weight : its share of the posterior; root : (7,) and joints : (D,), its best
    configuration."""

    weight: float
    root: Array
    joints: Array

    def link_poses(self, model: ArticulatedObject) -> Array:
        """(L, 7) of the model's links, in world."""
        return model.link_poses(model.part_poses(self.root, self.joints), self.joints)


@dataclass(frozen=True, kw_only=True)
class Posterior:
    """Draws of the whole object, of all modes together.

    iteration : the one whose estimate, root (7,) and joints (D,), it was read out from
    drawn_roots : (K, 7); drawn_joints : (K, D); log_weights : (K,), their exponentials sum to 1; mode : (K,) of which
    of `modes` each is
    modes : heaviest first, their weights sum to 1
    effective_sample_size : of the draws of the estimate's own mode
    fit : whether what should be seen is seen
    drawn_sizes : (K, 3) how much larger than its model each draw is, see `scene/sizes.py`; None where sizes are fixed
    """

    iteration: int
    root: Array
    joints: Array
    drawn_roots: Array
    drawn_joints: Array
    log_weights: Array
    mode: NDArray[np.int64]
    modes: tuple[ObjectMode, ...]
    effective_sample_size: float
    fit: Fit
    drawn_sizes: Array | None = None

    def part_poses(self, model: ArticulatedObject, draws: NDArray[np.int64]) -> Array:
        """(C, N, 7) of the model's parts in the draws numbered `draws` (C,), in world."""
        return self._drawn(model, draws).part_poses(self.drawn_roots[draws], self.drawn_joints[draws])

    def link_poses(self, model: ArticulatedObject) -> Array:
        """(K, L, 7) of the model's links in every draw, in world."""
        every = np.arange(len(self.log_weights))
        return self._drawn(model, every).link_poses(self.part_poses(model, every), self.drawn_joints)

    def _drawn(self, model: ArticulatedObject, draws: NDArray[np.int64]) -> ArticulatedObject:
        """The model as large as each of some draws has it."""
        return model if self.drawn_sizes is None else resized(model, self.drawn_sizes[draws])

    def even_draws(self, count: int) -> NDArray[np.int64]:
        """(count,) numbers of draws, each as often as it weighs: systematic resampling without a random offset."""
        below = np.cumsum(np.exp(self.log_weights))
        return np.searchsorted(below / below[-1], (np.arange(count) + 0.5) / count)

    def denied(self, model: ArticulatedObject) -> list[int]:
        """Numbers of the parts that are not to be believed where they were found."""
        return [node for node, part in enumerate(model.parts) if part.name in self.fit.denied]

    @property
    def told(self) -> bool:
        """Whether it can be built on: what should be seen is seen, and enough draws count."""
        return self.fit.verdict == "good" and self.effective_sample_size >= FEWEST_DRAWS


@dataclass(frozen=True, kw_only=True)
class Spread:
    """A posterior, link by link and joint by joint, about an estimate.

    covariances : (L, 6, 6), see `particle_statistics.covariance`; expected_add : (L,) metres (eq. 12) of the part that
    a link moves with, NaN where that has no surface; joint_stds : (D,) about the estimate; joint_intervals : (2, D)
    the central 90 %; moved : (M, L) metres (eq. 12, or of the origin where there is no surface) from the estimate to
    each mode's best configuration; round_turns : (N,) of a part that is round about an axis, how far its turns about
    it agree, 0 (any) to 1 (all the same): the length of their mean on the unit circle; NaN of others; denied : (L,)
    whether a link is of a part, or hangs on one, that is not to be believed where it was found
    """

    covariances: Array
    expected_add: Array
    joint_stds: Array
    joint_intervals: Array
    moved: Array
    round_turns: Array
    denied: NDArray[np.bool_]

    def certain(self, posterior: Posterior, max_std: float) -> NDArray[np.bool_]:
        """(L,): whether the fit is good, the link's part not denied, no mode of more than 1 % has it elsewhere, and no
        element of its `std_xyz`, nor its `expected_add`, is above `max_std`, metres."""
        std = np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2)[:, :3]).max(axis=1)
        rivals = np.array([mode.weight > DOUBT for mode in posterior.modes])
        # the mode that the estimate is of is not elsewhere; how far the estimate is from it counts as spread
        rivals[np.argmin(self.moved.max(axis=1))] = False
        elsewhere = np.any(rivals[:, None] & (self.moved > max_std), axis=0)
        narrow = (std <= max_std) & ~(self.expected_add > max_std)
        found: NDArray[np.bool_] = posterior.told & narrow & ~elsewhere & ~self.denied
        return found


def read_out(problem: Problem, report: IterationReport, checkpoint: Checkpoint = go_on) -> Posterior | None:
    """The posterior about the estimate of an iteration; None during the search, whose estimate is on its way. Raises
    what `checkpoint` does."""
    return None if report.searching else of_estimate(problem, report, checkpoint)


def of_estimate(problem: Problem, report: IterationReport, checkpoint: Checkpoint = go_on) -> Posterior:
    """The posterior about the estimate of an iteration, whatever its stage. The same problem and report give the same
    numbers. Raises what `checkpoint` does, which is called between rounds of draws and between modes."""
    problem = problem.taking(report.nuisances)
    root, joints = agreeing(problem, report)
    rng = np.random.default_rng([problem.seed, report.iteration, 1])
    drawn = [mode_draws(rng, problem, root, joints, checkpoint)]
    places = [(root, joints)]
    reaches = [_reach(problem, root, joints, drawn[0])]
    checkpoint()
    for rival in _contenders(rng, problem, report, root, joints, reaches[0]):
        if len(drawn) < MODES and not any(
            np.all(_part_motions(problem, *place, *rival) <= reach)
            for place, reach in zip(places, reaches, strict=True)
        ):
            places.append(rival)
            drawn.append(mode_draws(rng, problem, *rival, checkpoint))
            reaches.append(_reach(problem, *rival, drawn[-1]))
    checkpoint()
    found = _mixture(report.iteration, places, drawn, assess(problem, root, joints))
    denied = found.denied(problem.mrf.model)
    return replace(found, drawn_joints=drawn_anew(rng, problem, root, joints, denied, found.drawn_joints))


def spread(problem: Problem, posterior: Posterior, root: Array, joints: Array) -> Spread:
    """About an estimate (7,), (D,), whose nuisances the problem has taken."""
    model = problem.mrf.model
    weights = np.exp(posterior.log_weights)
    at = model.part_poses(root, joints)
    here = model.link_poses(at, joints)
    gap = posterior.drawn_joints - joints
    gap = np.where(model.wraps, gap - 2 * np.pi * np.round(gap / (2 * np.pi)), gap)
    intervals = np.quantile(gap, [(1 - CENTRAL) / 2, (1 + CENTRAL) / 2], axis=0, weights=weights, method="inverted_cdf")
    surfaces, parts = part_surfaces(model), parts_of_links(model)
    node = np.array([parts[link] for link in model.links])
    placed = posterior.part_poses(model, posterior.even_draws(DRAWS))
    mode_roots = np.array([mode.root for mode in posterior.modes])
    mode_joints = np.array([mode.joints for mode in posterior.modes])
    modes = model.part_poses(mode_roots, mode_joints)
    origins = np.linalg.norm(model.link_poses(modes, mode_joints)[..., :3] - here[:, :3], axis=-1)
    apart = distances(surfaces, at, np.concatenate([placed, modes]))[:, node]
    return Spread(
        covariances=covariance(here, posterior.link_poses(model), weights),
        expected_add=apart[:DRAWS].mean(axis=0),
        joint_stds=np.sqrt(weights @ gap**2 / weights.sum()),
        joint_intervals=joints + intervals,
        moved=np.fmax(apart[DRAWS:], origins),
        round_turns=turn_agreement(surfaces, at, placed),
        denied=np.isin(node, [below for one in posterior.denied(model) for below in moving(problem.mrf, one)]),
    )


def link_modes(model: ArticulatedObject, posterior: Posterior) -> list[list[tuple[float, Array, Array]]]:
    """Of each link its modes, heaviest first: weight, pose (7,) in the mode's best configuration, and the covariance
    (6, 6) of the mode's draws about it, see `particle_statistics.covariance`."""
    drawn = posterior.link_poses(model)
    found: list[list[tuple[float, Array, Array]]] = [[] for _ in model.links]
    for number, mode in enumerate(posterior.modes):
        at = mode.link_poses(model)
        own = posterior.mode == number
        weights = np.exp(posterior.log_weights[own] - posterior.log_weights[own].max())
        for link, entries in enumerate(found):
            entries.append((mode.weight, at[link], covariance(at[link], drawn[own, link], weights)))
    return found


def at_rest(
    problem: Problem, report: IterationReport, before: Posterior | None, checkpoint: Checkpoint = go_on
) -> Posterior | None:
    """The posterior of an iteration at rest: that of `before`, read out with the same problem, as long as the estimate
    has not moved since by what is rest. Raises what `checkpoint` does."""
    if before is not None:
        problem = problem.taking(report.nuisances)
        root, joints = agreeing(problem, report)
        moved = motions(problem, before.root, before.joints, root[None], joints[None])[0]
        if moved <= problem.settings.converged_motion:
            return before
    return read_out(problem, report, checkpoint)


def _contenders(
    rng: np.random.Generator, problem: Problem, report: IterationReport, root: Array, joints: Array, reach: Array
) -> list[tuple[Array, Array]]:
    """Root pose (7,) and joint vector (D,) of the rivals that come near an estimate (7,), (D,) at their best, of those
    that are not within `reach` (N,) of it."""
    if report.rivals is None or not len(report.rivals):
        return []
    here = float(log_posterior(problem, root[None], joints[None])[0])
    roots, q = report.rivals[:, :7], report.rivals[:, 7:]
    apart = np.any(_part_motions(problem, root, joints, roots, q) > reach, axis=1)
    left = apart & (log_posterior(problem, roots, q) > here - CLOSE * abs(here))
    roots, q = roots[left], q[left]
    plan, tolerance = problem.schedule(report.iteration), problem.tolerance_end
    for rounds, nats in ((1, HOPELESS), (POLISH_ROUNDS - 1, NATS)):
        if not len(roots):
            return []
        roots, q, _ = polish(rng, problem, roots, q, plan, tolerance, rounds)
        score = log_posterior(problem, roots, q)
        order = np.argsort(-score, kind="stable")[: np.count_nonzero(score > here - nats)]
        roots, q = roots[order], q[order]
    return list(zip(roots, q, strict=True))


def _reach(problem: Problem, root: Array, joints: Array, draws: ModeDraws) -> Array:
    """(N,) metres up to which a part is of the same mode as at a place (7,), (D,), by what is drawn about it."""
    strayed = _part_motions(problem, root, joints, draws.roots, draws.joints)
    return np.maximum(SAME, DEVIATIONS * np.sqrt(np.exp(draws.log_weights) @ strayed**2))


def motions(problem: Problem, root: Array, joints: Array, roots: Array, others: Array) -> Array:
    """(C,) metres: the largest that any part's middle or rim moves from (7,), (D,) to (C, 7), (C, D)."""
    found: Array = _part_motions(problem, root, joints, roots, others).max(axis=1)
    return found


def _part_motions(problem: Problem, root: Array, joints: Array, roots: Array, others: Array) -> Array:
    """(C, N): the same of each part."""
    mrf = problem.mrf
    return part_motions(mrf, mrf.part_poses(root, joints), mrf.part_poses(roots, others))


def _log_room(draws: ModeDraws) -> float:
    """Logarithm of the volume that a mode's joint positions fill, up to what is the same for all modes."""
    weights = np.exp(draws.log_weights)
    gap = draws.joints - weights @ draws.joints
    spread = np.einsum("k,ki,kj->ij", weights, gap, gap) + SHUT**2 * np.eye(gap.shape[1])
    return float(np.linalg.slogdet(spread)[1] / 2)


def _mixture(iteration: int, places: list[tuple[Array, Array]], drawn: list[ModeDraws], fit: Fit) -> Posterior:
    """All modes' draws, each weighed by its mode's evidence."""
    evidence = np.array([draws.log_evidence - _log_room(draws) for draws in drawn])
    log_weights = normalise(evidence)
    order = [k for k in np.argsort(-log_weights, kind="stable") if log_weights[k] > np.log(LEAST_WEIGHT) or k == 0]
    log_weights[order] = normalise(log_weights[order])
    sizes = [sizes for k in order if (sizes := drawn[k].sizes) is not None]
    return Posterior(
        iteration=iteration,
        root=places[0][0],
        joints=places[0][1],
        drawn_roots=np.concatenate([drawn[k].roots for k in order]),
        drawn_joints=np.concatenate([drawn[k].joints for k in order]),
        log_weights=np.concatenate([drawn[k].log_weights + log_weights[k] for k in order]),
        mode=np.repeat(np.arange(len(order)), [len(drawn[k].roots) for k in order]),
        modes=tuple(
            ObjectMode(weight=float(np.exp(log_weights[k])), root=places[k][0], joints=places[k][1]) for k in order
        ),
        effective_sample_size=drawn[0].effective_sample_size,
        fit=fit,
        drawn_sizes=np.concatenate(sizes) if sizes else None,
    )
