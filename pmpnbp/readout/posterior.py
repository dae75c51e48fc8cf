"""The belief that is told: a mixture of modes of the whole object, by weighted draws, and what follows from it about an
estimate. `mixture` makes it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.joint_draws import short_way_round
from pmpnbp.inference.problem import Problem
from pmpnbp.readout.denied_parts import moving
from pmpnbp.readout.fit import Fit
from pmpnbp.readout.particle_statistics import covariance
from pmpnbp.readout.surface_distance import distances, looks_the_same, part_surfaces, turn_agreement, turns
from pmpnbp.scene.articulated_object import ArticulatedObject, parts_of_links
from pmpnbp.scene.sizes import resized

# Effective draws below which the posterior says too little to be certain by.
FEWEST_DRAWS = 20.0
# Draws that an expected distance is averaged over.
DRAWS = 64
# A link is elsewhere in a mode of more than this weight: nobody is certain of it.
DOUBT = 0.01
# Nobody is certain of a link longer than this, metres, of which more than this share of the posterior has it turned by
# more than this, radians for each metre of `max_std`: 2° at the paper's 2.5 mm. What is slender may turn about itself
# by more and hardly move its surface.
LONG, TURNED, TURN = 0.10, 0.15, 400 * np.radians(2.0)
# What is turned by less, radians, is not turned another way.
TURNED_AT_LEAST = 0.2
# The share of the draws that a joint's interval holds at the least, the central ones.
CENTRAL = 0.9
# Why a link is not certain, see `Spread.doubts`, in the order in which it is told.
Doubt = Literal["fit", "draws", "denied", "outside_region", "alike", "std_xyz", "expected_add", "elsewhere", "turned"]


@dataclass(frozen=True, kw_only=True)
class Centre:
    """The middle of what is drawn of a mode: root (7,); joints (D,); nuisances (K,), see `potentials/nuisances.py`, or
    None where all are fixed."""

    root: Array
    joints: Array
    nuisances: Array | None


@dataclass(frozen=True, kw_only=True)
class ObjectMode:
    """One hypothesis of the whole object. weight : its share of the posterior; root : (7,) and joints : (D,), its best
    configuration."""

    weight: float
    root: Array
    joints: Array

    @property
    def counts(self) -> bool:
        """Whether nobody is certain of a link that is elsewhere in it: it weighs more than DOUBT."""
        return self.weight > DOUBT

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
    nuisance_stds : (K,) standard deviations of the nuisances, see `potentials/nuisances.py`; None where all are fixed
    centre : where the object is told to be; None where the estimate is
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
    nuisance_stds: Array | None = None
    centre: Centre | None = None

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
        return even_draws(self.log_weights, count)


def numbered(model: ArticulatedObject, names: Sequence[str]) -> list[int]:
    """Numbers of the parts of these names."""
    return [node for node, part in enumerate(model.parts) if part.name in names]


def even_draws(log_weights: Array, count: int) -> NDArray[np.int64]:
    """As `Posterior.even_draws`, of draws with the weights (K,)."""
    below = np.cumsum(np.exp(log_weights))
    return np.searchsorted(below / below[-1], (np.arange(count) + 0.5) / count)


@dataclass(frozen=True, kw_only=True)
class Spread:
    """A posterior, link by link and joint by joint, about an estimate.

    covariances : (L, 6, 6), see `particle_statistics.covariance`; expected_add : (L,) metres (eq. 12) of the part that
    a link moves with, NaN where that has no surface; joint_stds : (D,) about the estimate; joint_intervals : (2, D)
    the central 90 %, and the estimate; moved : (M, L) metres (eq. 12, or of the origin where there is no surface) from
    the estimate to each mode's best configuration; alike : (M, L) whether a mode that counts has the link's part turned
    so that it looks the same; round_turns : (N,) of a part that is round about an axis, how far its turns about it
    agree, 0 (any) to 1 (all the same): the length of their mean on the unit circle; NaN of others; denied : (L,)
    whether a link is of a part, or hangs on one, that is not to be believed where it was found; beyond : (L,) likewise
    outside the region of interest; turns : (DRAWS, L)
    radians that even draws have it turned by, see `surface_distance.turns`; 0 for a link of a part that is not LONG
    """

    covariances: Array
    expected_add: Array
    joint_stds: Array
    joint_intervals: Array
    moved: Array
    alike: NDArray[np.bool_]
    round_turns: Array
    denied: NDArray[np.bool_]
    beyond: NDArray[np.bool_]
    turns: Array

    def doubts(self, posterior: Posterior, max_std: float) -> dict[Doubt, NDArray[np.bool_]]:
        """(L,) each, whether for this reason a link is not certain. fit : what should be seen is not; draws : too few
        count; denied, outside_region : its part is, or one that it hangs on; alike : where modes of more than 1 % have
        it elsewhere, it is turned so that it looks the same, which no view tells; std_xyz, expected_add : an element is
        above `max_std`, metres; elsewhere : a mode of more than 1 % has it there; turned : see LONG"""
        std = np.sqrt(np.diagonal(self.covariances, axis1=1, axis2=2)[:, :3]).max(axis=1)
        rivals = np.array([mode.counts for mode in posterior.modes])
        # the mode that is told is not elsewhere; how far it is from where it is told to be counts as spread
        rivals[np.argmin(self.moved.max(axis=1))] = False
        elsewhere = rivals[:, None] & (self.moved > max_std)
        return {
            "fit": np.full(len(std), posterior.fit.verdict != "good"),
            "draws": np.full(len(std), posterior.effective_sample_size < FEWEST_DRAWS),
            "denied": self.denied,
            "outside_region": self.beyond,
            "alike": np.any(elsewhere, axis=0) & np.all(self.alike | ~elsewhere, axis=0),
            "std_xyz": ~(std <= max_std),
            "expected_add": self.expected_add > max_std,
            "elsewhere": np.any(elsewhere, axis=0),
            "turned": self.turned(max_std),
        }

    def certain(self, posterior: Posterior, max_std: float) -> NDArray[np.bool_]:
        """(L,): of which links there is no doubt."""
        return ~np.any(list(self.doubts(posterior, max_std).values()), axis=0)

    def turned(self, max_std: float) -> NDArray[np.bool_]:
        """(L,): which links may be turned by more than goes with `max_std`, metres: see LONG."""
        return np.mean(self.turns > TURN * max_std, axis=0) > TURNED


def spread(problem: Problem, posterior: Posterior, root: Array, joints: Array) -> Spread:
    """About an estimate (7,), (D,), whose nuisances the problem has taken."""
    model = problem.mrf.model
    weights = np.exp(posterior.log_weights)
    at = model.part_poses(root, joints)
    here = model.link_poses(at, joints)
    gap = short_way_round(posterior.drawn_joints - joints, model.wraps)
    intervals = np.quantile(gap, [(1 - CENTRAL) / 2, (1 + CENTRAL) / 2], axis=0, weights=weights, method="inverted_cdf")
    # what is told lies inside its own belief, also where another mode weighs more
    intervals = np.stack([np.minimum(intervals[0], 0.0), np.maximum(intervals[1], 0.0)])
    surfaces, parts = part_surfaces(model), parts_of_links(model)

    def with_those_on(names: Sequence[str]) -> NDArray[np.bool_]:
        return np.isin(node, [below for one in numbered(model, names) for below in moving(problem.mrf, one)])

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
        alike=alike_parts(model, posterior, at, modes)[:, node],
        round_turns=turn_agreement(surfaces, at, placed),
        turns=(turns(surfaces, at, placed) * [part.extents.max() > LONG for part in model.parts])[:, node],
        denied=with_those_on(posterior.fit.denied),
        beyond=with_those_on(posterior.fit.beyond),
    )


def alike_parts(model: ArticulatedObject, posterior: Posterior, at: Array, modes: Array) -> NDArray[np.bool_]:
    """(M, N): which parts are turned in the modes (M, N, 7) that count, but look the same as at `at` (N, 7)."""
    turned = poses.rotation_angle(at[:, 3:], modes[..., 3:]) > TURNED_AT_LEAST
    turned &= np.array([mode.counts for mode in posterior.modes])[:, None]
    for mode, node in np.argwhere(turned):
        part = model.parts[node]
        turned[mode, node] = part.visible and looks_the_same(part, at[node], modes[mode, node])
    return turned


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
