"""What is given to an inference: the object, the scan, the prior and the settings, made ready once."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pmpnbp.errors import ScanError
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import mrf as mrf_module
from pmpnbp.inference.arrival import Arrival
from pmpnbp.inference.mrf import Mrf
from pmpnbp.potentials import nuisances
from pmpnbp.potentials.nuisances import split
from pmpnbp.potentials.surfaces import Surfaces, prepare_surfaces
from pmpnbp.potentials.unary import PixelScore, Renderer, unary_scores
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.depth_noise import depth_noise
from pmpnbp.scene.extent import length_of, lengths_along_root
from pmpnbp.scene.observation import Observation, Scan
from pmpnbp.scene.observe import observe, without_longer_surfaces
from pmpnbp.scene.prior import GaussianPrior, UniformPrior
from pmpnbp.scene.reach import FARTHEST
from pmpnbp.scene.sizes import resized
from pmpnbp.settings import Schedule, SessionOptions, Settings, check_method, schedule

# A smooth surface this many times longer than the object is none of its own.
LONGER = 1.15
# Joints between the root and the part farthest from it from which on chains are grown; and may be in a search anew.
LONG_CHAIN, CHAIN = 10, 3
# Standard deviations of a prior, metres and radians, up to which it is narrow; and the share of iterations and of
# the proposals of a search that it leaves.
NARROW = 0.12, 0.25
NARROW_ITERATIONS, NARROW_PROPOSALS = 0.5, 0.5
# The tolerance is as many standard deviations of the scan's depths at least: less leaves out what is there. A surface
# is seen through from THROUGH of them on: noise puts few pixels so far behind.
DEVIATIONS, THROUGH = 2.0, 4.0
# How many times as much as others a pixel that is seen through amid a smooth surface costs at most; and the tolerance
# above which it costs no more than they do, as a multiple of the last one.
FIRM_COST, LOOSE = 6.0, 2.0


@dataclass(frozen=True, kw_only=True)
class Problem:
    """The inputs of every step.

    prior_node : the part that a gaussian prior names, or -1; prior_pose : (7,) of that part in world
    joint_prior : mean and standard deviation of the joint coordinates that the prior names
    joint_turns : (D,) whether a coordinate is an angle
    method : one of `settings.METHODS`
    noise, noise_area : (V,) of each view's depths, deviations in metres, and pixels, see `scene/depth_noise.py`
    unit_distance : metres from the cameras to what may be the object, in the median: a pixel there counts 1
    nuisance_std : (K,) prior standard deviations of the nuisances, see `potentials/nuisances.py`; 0 is fixed
    nuisance_levers : (K,) metres that the object's surface moves for one unit of each
    nuisances : (K,) what they are taken for; None where all are fixed
    grows : whether the object is looked for link by link, see `inference/chain_growth.py`
    arrival : which views came last, and after which iteration; None where all were there at the beginning
    patient : whether the object is looked for as long with a narrow prior as with another
    """

    mrf: Mrf
    observation: Observation
    surfaces: Surfaces
    prior: UniformPrior | GaussianPrior
    prior_node: int
    prior_pose: Array
    settings: Settings
    particles: int
    seed: int
    joint_prior: dict[int, tuple[float, float]]
    joint_turns: NDArray[np.bool_]
    method: str
    noise: Array
    noise_area: Array
    unit_distance: float
    nuisance_std: Array
    nuisance_levers: Array
    nuisances: Array | None
    grows: bool
    arrival: Arrival | None = None
    patient: bool = False

    @property
    def any_orientation(self) -> bool:
        """Whether the object may lie in any orientation, not only upright or as a gaussian prior says."""
        return isinstance(self.prior, UniformPrior) and self.prior.orientation == "any"

    @property
    def narrow(self) -> bool:
        """Whether a gaussian prior says where the object is so well that its search can be short."""
        if isinstance(self.prior, UniformPrior) or self.patient:
            return False
        return bool(np.max(self.prior.std_xyz) <= NARROW[0] and np.max(self.prior.std_rpy) <= NARROW[1])

    @property
    def the_other_way(self) -> Problem:
        """The same, where there are some joints in a row, to be looked for in the way that it was not before: growing
        chains finds some that walks do not, and the other way round."""
        return replace(self, grows=not self.grows) if CHAIN <= self.mrf.depth < LONG_CHAIN else self

    @property
    def search_iterations(self) -> int:
        """Iterations of the search: more for more joints in a row, for any orientation twice as many, with a narrow
        prior half; one where chains are grown, which finds all their links at once."""
        chosen = self.settings
        if chosen.search_iterations == 0:
            return 0
        if self.grows:
            return 1
        whole = (1 + self.any_orientation) * chosen.search_iterations
        if self.narrow:
            whole = max(round(NARROW_ITERATIONS * whole), 1)
        return whole + chosen.search_iterations_per_joint * max(self.mrf.depth - 2, 0)

    @property
    def anneal_iterations(self) -> int:
        """Iterations after the search over which tolerance and diffusion go on to shrink: half where a narrow prior had
        it end near the object."""
        whole = self.settings.anneal_iterations
        return math.ceil(NARROW_ITERATIONS * whole) if self.narrow and self.search_iterations else whole

    @property
    def annealed(self) -> int:
        """The last iteration, counted from where the search began, before tolerance and diffusion are at their ends."""
        return self.search_iterations + self.anneal_iterations

    @property
    def search_proposals(self) -> int:
        """Hypotheses an iteration of the search tries: more for more joints, twice as many for any orientation, half
        with a narrow prior."""
        share = (1 + self.any_orientation) * max(1.0, len(self.mrf.model.edges) / 3)
        share *= NARROW_PROPOSALS if self.narrow else 1.0
        return round(self.settings.search_proposals * share)

    def schedule(self, iteration: int) -> Schedule:
        """What the annealing has reached in an iteration, counted from where the search began."""
        plan = schedule(self.settings, iteration, self.search_iterations, self.anneal_iterations)
        return replace(plan, tolerance=max(plan.tolerance, self.tolerance_end))

    @property
    def tolerance_end(self) -> float:
        """Metres: the setting, but not below what the noisiest view asks for."""
        return max(self.settings.tolerance_end, DEVIATIONS * float(self.noise.max(initial=0.0)))

    def score(self, tolerance: float) -> PixelScore:
        """The pixel score of whole objects at a tolerance in metres: while that is loose the plain one, so that they
        pass through places that the scan denies."""
        plain = self.plain_score(tolerance)
        return plain if tolerance > LOOSE * self.tolerance_end else replace(plain, firm_cost=FIRM_COST)

    def plain_score(self, tolerance: float) -> PixelScore:
        """The pixel score of the settings at a tolerance in metres, by which no pixel costs more than another: of parts
        alone, and of what is not yet a whole object."""
        chosen = self.settings
        return PixelScore(
            chosen.pixel_score,
            tolerance,
            chosen.free_space_cost,
            chosen.occlusion_cost,
            chosen.support_reward,
            chosen.continued_reward,
            self.unit_distance,
            through_from=THROUGH * float(self.noise.max(initial=0.0)),
        )

    def unary(
        self, node: NDArray[np.integer], part_poses: Array, tolerance: float, renderer: Renderer, points: int = 0
    ) -> Array:
        """log unary potential (before tempering) of parts `node` (B,) at `part_poses` (B, 7)."""
        return unary_scores(
            self.observation,
            self.surfaces,
            node,
            part_poses,
            self.plain_score(tolerance),
            renderer=renderer,
            points=points or self.settings.splat_points,
            nuisances=self.nuisances,
        )

    def taking(self, nuisances: Array | None) -> Problem:
        """The same with nuisances (K,) taken for these, where some were estimated, and in as many views."""
        if self.nuisances is None or nuisances is None or nuisances.shape != self.nuisance_std.shape:
            return self
        sizes, mrf = self.free_sizes(nuisances), self.mrf
        if sizes is not None and not np.array_equal(sizes, mrf.model.sizes):
            mrf = mrf_module.build(resized(mrf.model, sizes))
        return replace(self, nuisances=nuisances, mrf=mrf)

    def part_poses(self, roots: Array, joints: Array, nuisances: Array | None) -> Array:
        """(..., N, 7) from root poses (..., 7), joint vectors (..., D) and nuisances (..., K), or the problem's, which
        broadcast: `mrf.part_poses`, but under other sizes."""
        sizes = self.free_sizes(nuisances)
        if sizes is None:
            return self.mrf.part_poses(roots, joints)
        return resized(self.mrf.model, sizes).part_poses(roots, joints)

    def free_sizes(self, nuisances: Array | None) -> Array | None:
        """(..., 3) of nuisances (..., K), see `scene/sizes.py`; None where sizes are fixed."""
        views = len(self.observation.views)
        if nuisances is None or not split(self.nuisance_std, views)[2].any():
            return None
        return split(nuisances, views)[2]

    def log_nuisance_prior(self, nuisances: Array) -> Array:
        """log density, up to a constant, of nuisances (..., K)."""
        free = self.nuisance_std > 0
        deviates = nuisances[..., free] / self.nuisance_std[free]
        return -0.5 * np.einsum("...k,...k", deviates, deviates)

    def log_prior(self, part_poses: Array) -> Array:
        """log density, up to a constant, of the gaussian prior at poses (..., 7) of `prior_node`."""
        assert isinstance(self.prior, GaussianPrior)
        offset = (part_poses[..., :3] - self.prior_pose[:3]) / self.prior.std_xyz
        turn = poses.quaternion_multiply(part_poses[..., 3:], poses.quaternion_conjugate(self.prior_pose[3:]))
        angle = poses.to_rotation_vector(turn) / self.prior.std_rpy
        return -0.5 * (np.einsum("...c,...c", offset, offset) + np.einsum("...c,...c", angle, angle))

    def plus_prior(self, log_score: Array, prior_poses: Array, *, always: bool = False) -> Array:
        """Log scores (...,) plus the log prior at the poses (..., 7) that they have `prior_node` at: unchanged without
        a gaussian prior, and where the settings leave it out of the factors (but `always`)."""
        if self.prior_node < 0 or not (always or self.settings.prior_factor):
            return log_score
        return log_score + self.log_prior(prior_poses)


def look(model: ArticulatedObject, scans: Sequence[Scan], roi: Array | None, settings: Settings) -> Observation:
    """What is seen of the scene in `scans`, in `roi` (6,), metres, world, or everywhere: as finely as the settings and
    the object's length ask for. Raises ScanError as `observe` does."""
    return observe(scans, roi, width=settings.image_width, length=length_of(model))


def build(
    model: ArticulatedObject,
    observation: Observation,
    prior: UniformPrior | GaussianPrior,
    settings: Settings,
    *,
    particles: int = SessionOptions.particles,
    seed: int = SessionOptions.seed,
    method: str = SessionOptions.method,
    arrival: Arrival | None = None,
) -> Problem:
    """Prepare the inputs: splat models of the parts, the MRF, the prior in the frame of its part, widened by the motion
    that there may have been since.

    Raises SettingError for a `method` that there is none of, and ScanError where the object has to be looked for and
    nothing that was seen may be it.
    """
    check_method(method)
    if isinstance(prior, UniformPrior) and not len(observation.points):
        raise ScanError("all that was measured in the region lies on floor, walls or tables; expected an object there")
    node, pose = -1, poses.IDENTITY
    known: dict[int, tuple[float, float]] = {}
    if isinstance(prior, GaussianPrior):
        prior = _moved_on(prior, model, settings, 0 if arrival is None else arrival.moves)
        node, pose = _prior_in_part(model, prior)
        coordinates = {joint.name: joint.coordinates for joint in model.joints}
        known = {c: prior.joints[name] for name in prior.joints for c in coordinates[name]}
        model = _narrowed(model, known)
    turns = np.zeros(model.dof, dtype=bool)
    for joint in model.joints:
        turns[list(joint.coordinates)] |= joint.elementary_axes()[0]
    if settings.continued_reward < 1.0:
        observation = without_longer_surfaces(observation, LONGER * length_of(model))
    mrf, views = mrf_module.build(model), observation.views
    distances = np.array([view.distance or 1.0 for view in views])
    levers = nuisances.levers(distances, np.maximum(lengths_along_root(model), mrf_module.LEAST_LEVER))
    nuisance_std = nuisances.prior_stds(settings, levers, len(views))
    noises = [depth_noise(view, settings.sensor) for view in views]
    return Problem(
        mrf=mrf,
        observation=observation,
        surfaces=prepare_surfaces(model, points=max(settings.splat_points, 64)),
        prior=prior,
        prior_node=node,
        prior_pose=pose,
        settings=settings,
        particles=particles,
        seed=seed,
        joint_prior=known,
        joint_turns=turns,
        method=method,
        noise=np.array([noise.std for noise in noises]),
        noise_area=np.array([noise.area for noise in noises]),
        unit_distance=float(np.median(distances)) if len(distances) else 1.0,
        nuisance_std=nuisance_std,
        nuisance_levers=levers,
        nuisances=np.zeros(len(levers)) if nuisance_std.any() else None,
        grows=mrf.depth >= LONG_CHAIN,
        arrival=arrival,
    )


def _moved_on(prior: GaussianPrior, model: ArticulatedObject, settings: Settings, moves: int) -> GaussianPrior:
    """What a prior says after the scene has moved on so many times: variances add up, to what a prior may have."""
    if moves == 0:
        return prior
    each = np.sqrt(moves)
    span = {joint.name: float(np.ptp([joint.lower, joint.upper])) for joint in model.joints}
    return replace(
        prior,
        std_xyz=np.minimum(np.hypot(prior.std_xyz, each * settings.moved_std_xyz), FARTHEST),
        std_rpy=np.hypot(prior.std_rpy, each * settings.moved_std_rpy),
        joints={
            name: (position, float(np.hypot(std, each * settings.moved_joint_share * span[name])))
            for name, (position, std) in prior.joints.items()
        },
    )


def _narrowed(model: ArticulatedObject, known: dict[int, tuple[float, float]]) -> ArticulatedObject:
    """The model with joint limits drawn in to three standard deviations around what the prior knows of them."""
    lower, upper, wraps = model.lower.copy(), model.upper.copy(), model.wraps.copy()
    for coordinate, (position, std) in known.items():
        middle = np.clip(position, lower[coordinate], upper[coordinate])
        lower[coordinate] = max(lower[coordinate], middle - 3 * std)
        upper[coordinate] = min(upper[coordinate], middle + 3 * std)
        wraps[coordinate] = False
    edges = []
    for edge in model.edges:
        named = np.array([int(c) in known for c in edge.coordinates])
        ends = np.stack([edge.axis_positions(lower), edge.axis_positions(upper)])
        edges.append(
            replace(
                edge,
                lower=np.where(named, np.maximum(edge.lower, ends.min(axis=0)), edge.lower),
                upper=np.where(named, np.minimum(edge.upper, ends.max(axis=0)), edge.upper),
                wraps=edge.wraps & ~named,
            )
        )
    return replace(model, edges=tuple(edges), lower=lower, upper=upper, wraps=wraps)


def _prior_in_part(model: ArticulatedObject, prior: GaussianPrior) -> tuple[int, Array]:
    """The part that the prior speaks of, and the prior's mean as that part's pose."""
    for node, part in enumerate(model.parts):
        if prior.link in part.links:
            pose_part_link = part.poses_part_link[part.links.index(prior.link)]
            return node, poses.multiply(prior.pose_world_link, poses.inverse(pose_part_link))
    # a link above the first part (a mobile base's joints): carried down to it at joint position zero, within limits
    at_rest = np.clip(0.0, model.lower, model.upper)
    known = model.link_poses(model.part_poses(poses.IDENTITY, at_rest), at_rest)
    pose_root_link = known[model.links.index(prior.link)]
    return 0, poses.multiply(prior.pose_world_link, poses.inverse(pose_root_link))
