"""The unary potential: how well a part, or the whole object, at a pose explains what the sensor saw (eq. 10).

The part's surface is rendered at the pose; each pixel it covers is scored against the depth observed there, and the
pixels' scores are summed over the views. The potential is the exponential of that sum times a factor which the
inference chooses, so everything here is a log potential up to scale, in pixels of the working image.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import Array
from pmpnbp.potentials.kernels import normal_equations as equations
from pmpnbp.potentials.kernels import rasterised_scores, rasteriser, splatting
from pmpnbp.potentials.kernels.pixel_scores import FIRM_BIT, pack_patches, pack_view
from pmpnbp.potentials.nuisances import apparent
from pmpnbp.potentials.pixel_kinds import in_front
from pmpnbp.potentials.surfaces import Surfaces
from pmpnbp.scene.firm_pixels import STEP
from pmpnbp.scene.observation import Observation, View
from pmpnbp.scene.reach import FARTHEST

Renderer = Literal["splats", "rasteriser"]
ALL = slice(None)
# Metres from the origin that a part may be moved to. An object, a prior and a camera that are as far away as they may
# be, and a scan's farthest pixel, together stay within a sixth of it.
BEYOND = 100 * FARTHEST


@dataclass(frozen=True)
class PixelScore:
    """How a covered pixel is scored.

    form : "robust", or "distance" for eq. 10 to the letter: minus the distance between observed and rendered point
    tolerance : metres, the difference in depth at which a robust pixel stops being explained (tau)
    free_space_cost : of a pixel whose observed surface lies behind the rendered one, or of a part behind a support
    occlusion_cost : of a pixel where something else is in front
    support_reward : share of the full reward that a pixel on a support plane can earn
    continued_reward : the same of a pixel on a smooth surface that goes on beyond the object's outline; of a part
        alone, whose outline is not the object's, on a surface longer than the object
    unit_distance : metres, at which a robust pixel counts 1; elsewhere by the square of its distance, as it covers more
        or less of a surface: what is near has more pixels of the same evidence
    firm_cost : how many times the free space cost a pixel amid a smooth surface (`View.firm`) costs at most
    firm_step : share of its depth up to which a step at a firm pixel is not noticed: behind by less it may show parts
        of two surfaces, and costs once
    through_from : metres behind the rendered surface from which on a pixel costs, where that is more than the
        tolerance: what noise may have put there costs nothing, as little as it does in front
    edge_weight : what a pixel that is not firm counts, as a share: beside a step in the depth it is of one surface or
        of the other, as a whole
    """

    form: Literal["robust", "distance"] = "robust"
    tolerance: float = 0.02
    free_space_cost: float = 1.0
    occlusion_cost: float = 0.02
    support_reward: float = 0.1
    continued_reward: float = 0.1
    unit_distance: float = 1.0
    firm_cost: float = 1.0
    firm_step: float = STEP
    through_from: float = 0.0
    edge_weight: float = 1.0

    def __post_init__(self) -> None:
        if self.form not in ("robust", "distance"):
            raise ValueError(f"form is {self.form!r}; 'robust' or 'distance' is expected")
        for name in ("tolerance", "unit_distance"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} is {getattr(self, name)}; a length above zero is expected")

    @property
    def terms(self) -> NDArray[np.float32]:
        """(10,) for the kernels: tolerance, free space cost, occlusion cost, support reward, continued reward,
        unit distance, firm cost, firm step, the square of how many tolerances behind a pixel is seen through from on,
        and edge weight."""
        costs, rewards = (self.free_space_cost, self.occlusion_cost), (self.support_reward, self.continued_reward)
        firm = (self.firm_cost, self.firm_step)
        from_on = max(self.through_from / self.tolerance, 1.0) ** 2
        terms = (self.tolerance, *costs, *rewards, self.unit_distance, *firm, from_on, self.edge_weight)
        return np.array(terms, dtype=np.float32)


def unary_scores(
    observation: Observation,
    surfaces: Surfaces,
    part: NDArray[np.integer],
    poses_world_part: Array,
    score: PixelScore,
    *,
    renderer: Renderer = "splats",
    points: int = 256,
    nuisances: Array | None = None,
) -> Array:
    """Scores (B,) float64 of part poses, each rendered alone: the sum over views and covered pixels, in pixels
    (robust) or pixels times metres (distance).

    part : (B,) numbers of parts; poses_world_part : (B, 7)
    renderer : "splats" (fast, approximate) or "rasteriser"; points : splats per part, at most those prepared
    nuisances : (K,), see `potentials/nuisances.py`; None where there are none
    A part without geometry scores 0. Raises ValueError where a pose is not finite.
    """
    parts = np.ascontiguousarray(part, dtype=np.int32)
    pose = _checked(poses_world_part, (len(parts),))
    if len(parts) and (parts.min() < 0 or parts.max() >= len(surfaces.centres)):
        raise ValueError(f"parts {parts.min()} to {parts.max()} were named; there are {len(surfaces.centres)}")
    out = np.zeros(len(parts))
    terms, robust = score.terms, score.form == "robust"
    used = min(points, surfaces.points.shape[-1])
    for number, view in enumerate(observation.views):
        seen = _apparent(observation, number, pose, surfaces, nuisances, parts)
        if renderer == "splats":
            splatting.add_scores(_image(view), surfaces.splats, parts, seen, terms, robust, used, out)
        elif renderer == "rasteriser":
            rasterised_scores.add_part_scores(_image(view), surfaces.mesh, parts, seen, terms, robust, out)
        else:
            raise ValueError(f"renderer is {renderer!r}; 'splats' or 'rasteriser' is expected")
    return out


def object_scores(
    observation: Observation,
    surfaces: Surfaces,
    poses_world_part: Array,
    score: PixelScore,
    nuisances: Array | None = None,
) -> Array:
    """Scores (B,) of whole objects, all parts drawn into one z-buffer. poses_world_part : (B, N, 7); nuisances : (K,)
    or (B, K), see `potentials/nuisances.py`, or None. Units as `unary_scores`."""
    return object_scores_by_each(observation, surfaces, poses_world_part, (score,), nuisances)[:, 0]


def object_scores_by_each(
    observation: Observation,
    surfaces: Surfaces,
    poses_world_part: Array,
    scores: Sequence[PixelScore],
    nuisances: Array | None = None,
) -> Array:
    """As `object_scores`, by each of T pixel scores of one form: (B, T). Each object is drawn once."""
    nodes = len(surfaces.centres)
    pose = _checked(poses_world_part, (len(poses_world_part), nodes))
    out = np.zeros((len(pose), len(scores)))
    terms, robust = np.stack([score.terms for score in scores]), scores[0].form == "robust"
    for number, view in enumerate(observation.views):
        seen = _apparent(observation, number, pose, surfaces, nuisances)
        rasterised_scores.add_object_scores(_image(view), surfaces.mesh, seen, terms, robust, out)
    return out


def normal_equations(
    observation: Observation,
    surfaces: Surfaces,
    poses_world_part: Array,
    probes: Array,
    score: PixelScore,
    gates: Array,
    steepest: float,
    nuisances: Array | None = None,
) -> tuple[Array, Array]:
    """Least squares of the depth residuals of H whole objects in P parameters: information (H, G, P, P) and gradient
    (H, G, P), in squares of the score's tolerance, from the pixels whose residual is below each of `gates` (G,) metres.

    poses_world_part : (H, 1 + P, N, 7), as it is and with each parameter moved by its probe; probes : (H, P)
    nuisances : (K,) or (H, 1 + P, K), see `potentials/nuisances.py`, or None
    steepest : metres that a depth changes by at most for a metre that its surface moves; one that is seen more aslant
        tells nothing
    A pixel weighs the most that it can add to the object's score.
    """
    count, moved = poses_world_part.shape[:2]
    shape = count, len(gates), moved - 1
    nodes = len(surfaces.centres)
    pose = _checked(poses_world_part, (count, moved, nodes))
    information, gradient = np.zeros((*shape, moved - 1)), np.zeros(shape)
    for number, view in enumerate(observation.views):
        seen = _apparent(observation, number, pose, surfaces, nuisances)
        equations.add_normal_equations(
            _image(view), surfaces.mesh, seen, probes, score.terms, gates, steepest, information, gradient
        )
    return information / score.tolerance**2, gradient / score.tolerance**2


def render(
    camera: Camera, surfaces: Surfaces, poses_world_part: Array
) -> tuple[NDArray[np.float32], NDArray[np.int16]]:
    """Depth (h, w) float32, metres, 0 where nothing is, and part number (h, w) int16, -1 where nothing is, of the
    parts at poses (N, 7), or maps (N, 12) as of `nuisances.apparent`, as `camera` sees them."""
    pose = _checked(poses_world_part, (len(surfaces.centres),), (7, 12))
    depth, number = rasteriser.object_depth(pose, _view(camera), surfaces.mesh)
    return depth, number


def renders(
    observation: Observation, surfaces: Surfaces, poses_world_part: Array, nuisances: Array | None = None
) -> Iterator[tuple[View, Array, NDArray[np.float32], NDArray[np.int16]]]:
    """For each view: the view; the parts at poses (N, 7) as it has them under `nuisances` (K,), which are maps (N, 12)
    unless there are none, see `potentials/nuisances.py`; depth and part number as from `render`."""
    pose = _checked(poses_world_part, (len(surfaces.centres),))
    for place, view in enumerate(observation.views):
        seen = _apparent(observation, place, pose, surfaces, nuisances)
        yield view, seen, *render(view.camera, surfaces, seen)


def render_part(camera: Camera, surfaces: Surfaces, part: int, pose_world_part: Array) -> NDArray[np.float32]:
    """Depth (h, w), metres, 0 where nothing is, of one part alone at a pose (7,) or map (12,), as `camera` sees it."""
    pose = _checked(pose_world_part, (), (7, 12))
    return rasteriser.part_depth(part, pose, _view(camera), surfaces.mesh)


def visible_fractions(
    observation: Observation,
    surfaces: Surfaces,
    poses_world_part: Array,
    tolerance: float,
    nuisances: Array | None = None,
) -> Array:
    """Fractions (N,), 0 to 1: of the pixels that each part would cover alone, those in which it is in front of all
    other parts and the observation is not more than `tolerance` metres in front of it; the largest over the views.
    nuisances : (K,), see `potentials/nuisances.py`, or None

    Pixels beyond the image do not count; a part that covers no pixel has 0.
    """
    fractions = np.zeros(len(surfaces.centres))
    for view, seen, depth, number in renders(observation, surfaces, poses_world_part, nuisances):
        hidden = in_front(view.depth, depth, tolerance)
        for node in range(len(fractions)):
            alone = render_part(view.camera, surfaces, node, seen[node])
            covered = np.count_nonzero(alone)
            if covered:
                not_hidden = np.count_nonzero((number == node) & ~hidden)
                fractions[node] = max(fractions[node], not_hidden / covered)
    return fractions


def _apparent(
    observation: Observation,
    number: int,
    pose: Array,
    surfaces: Surfaces,
    nuisances: Array | None,
    parts: NDArray[np.int32] | slice = ALL,
) -> Array:
    """These `parts` (P,) at poses (..., P, 7) as view `number` has them: these poses, or maps (..., P, 12) under
    nuisances."""
    if nuisances is None:
        return pose
    axes_at_zero = surfaces.axes_at_zero[parts]
    given = observation.views[number].pose_world_scan
    return np.ascontiguousarray(apparent(nuisances, number, len(observation.views), given, pose, axes_at_zero))


def _checked(pose: Array, shape: tuple[int, ...], numbers: tuple[int, ...] = (7,)) -> Array:
    """Poses (*shape, 7) as the kernels take them, or what else has so many `numbers`. One that is not finite, or far
    beyond any scene, becomes a pixel no kernel can look up; those read back from a recording are read-only, for which
    each kernel would be compiled once more."""
    pose = np.require(pose, np.float64, ("C", "W"))
    if pose.shape not in [(*shape, count) for count in numbers]:
        raise ValueError(f"poses have shape {pose.shape}; {(*shape, *numbers[:1])} is expected")
    if pose.size and not (pose.max() < BEYOND and pose.min() > -BEYOND):
        raise ValueError(f"a pose is not finite, or further than {BEYOND / 1000:g} km from the origin of the world")
    return pose


def _view(camera: Camera) -> tuple[Array, Array, int, int]:
    """A camera as the rasteriser takes it."""
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy], dtype=np.float64)
    return lens, poses.inverse(np.asarray(camera.pose_world_camera, dtype=np.float64)), camera.width, camera.height


@lru_cache(maxsize=16)
def _image(view: View) -> tuple[NDArray[np.int32], Array, Array, NDArray[np.int16], int]:
    """A view as the scoring kernels take it."""
    depth = np.require(view.depth, np.float32, ("C", "W"))
    packed = pack_view(depth, np.require(view.category, np.uint8, ("C", "W")))
    packed[1:-1, 1:-1][view.firm] |= FIRM_BIT
    lens, pose_camera_world, _, _ = _view(view.camera)
    return packed, lens, pose_camera_world, pack_patches(view.patches), int(view.patches.max()) + 1
