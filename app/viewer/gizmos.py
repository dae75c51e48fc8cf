"""What can be dragged in a view? The region of interest by two opposite corners, and the mean of a gaussian prior.

What they say is in the view state; a new session can be made with it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from app.viewer.ellipsoids import ellipsoid, radius_scale
from app.viewer.scene_frame import Floats, Handle, Label, Lines, Node
from app.viewer.stage import Stage
from app.viewer.view_state import Theme, ViewState
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.pictures.palette import rgb
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.observation import Observation
from pmpnbp.scene.prior import GaussianPrior, load_prior

LOW, HIGH, PRIOR = "/region/low", "/region/high", "/prior/handle"
# Sizes as shares of the object's.
_CORNER, _TURN = 0.09, 0.22
# Of a prior that nobody has said anything about: 8 cm and 8.6 degrees.
STD_XYZ, STD_RPY = 0.08, 0.15
# Metres around what may be the object, of a region that nobody has drawn.
_AROUND = 0.05

# How much larger the number of the chosen one is.
EMPHASIS = 1.5
# Of what could be chosen instead.
OFFERED: Mapping[Theme, tuple[int, int, int]] = {"light": rgb("#59626f"), "dark": rgb("#9ba6b4")}
# Of what somebody may do: drag it, or look from there.
ACCENT: Mapping[Theme, tuple[int, int, int]] = {"light": rgb("#345bb5"), "dark": rgb("#8fb0ff")}


def gizmos(stage: Stage, state: ViewState) -> Iterator[Node]:
    """The nodes of region and prior, where they are shown and there is one."""
    for number, box in enumerate(state.proposals, start=1):
        yield from _proposal(number, np.array(box), state.theme, box == state.region and state.show.region)
    if state.show.region and state.region is not None:
        yield from _region(np.array(state.region), stage, state.theme)
    if state.show.prior and state.prior is not None:
        prior = load_prior(state.prior, stage.model)
        if isinstance(prior, GaussianPrior):
            yield from _prior(prior, stage, state)


def default_region(observation: Observation) -> tuple[float, ...]:
    """x0 y0 z0 x1 y1 z1, metres, world: the session's own, else a box around what may be the object."""
    box = observation.roi
    if box is None:
        points = observation.points if len(observation.points) else np.zeros((1, 3))
        low, high = np.percentile(points, (1, 99), axis=0)
        box = np.concatenate([low - _AROUND, high + _AROUND])
    return tuple(round(float(value), 4) for value in box)


def default_prior(
    model: ArticulatedObject, links: Mapping[str, Mapping[str, Any]], region: Sequence[float] | None
) -> dict[str, Any]:
    """A gaussian prior as prior.json for the first part's link: turned as the estimate `links` (of result.json) has it,
    the object's middle in the middle of `region`; where the estimate has it, where there is no region."""
    link = model.parts[0].links[0]
    prior = {
        "kind": "gaussian",
        "link": link,
        "pose": links[link]["pose"],
        "std_xyz": [STD_XYZ] * 3,
        "std_rpy": [STD_RPY] * 3,
    }
    if region is None:
        return prior
    mean = load_prior(prior, model)
    assert isinstance(mean, GaussianPrior)
    pose, box = mean.pose_world_link.copy(), np.array(region)
    around = [
        poses.transform_points(at, part.mesh.vertices)
        for at, part in zip(_placed(model, mean), model.parts, strict=True)
        if part.visible
    ]
    middle = (
        np.min([one.min(axis=0) for one in around], axis=0) + np.max([one.max(axis=0) for one in around], axis=0)
    ) / 2
    pose[:3] += (box[:3] + box[3:]) / 2 - middle
    return dragged_prior(prior, pose)


def dragged_region(region: Sequence[float], corner: str, position: Array) -> tuple[float, ...]:
    """The region after its corner LOW or HIGH was dragged to `position` (3,); never less than a centimetre wide."""
    low, high = np.array(region[:3]), np.array(region[3:])
    if corner == LOW:
        low = np.minimum(position, high - 0.01)
    else:
        high = np.maximum(position, low + 0.01)
    return tuple(round(float(value), 4) for value in (*low, *high))


def dragged_prior(prior: Mapping[str, Any], pose: Array) -> dict[str, Any]:
    """The prior with its mean at `pose` (7,), link in world."""
    x, y, z, qw, qx, qy, qz = (round(float(value), 6) for value in pose)
    members = {"position": {"x": x, "y": y, "z": z}, "orientation": {"x": qx, "y": qy, "z": qz, "w": qw}}
    return {**prior, "pose": members}


def proposal_at(proposals: Sequence[Sequence[float]], origin: Array, ray: Array) -> tuple[float, ...] | None:
    """Which of the boxes (6,) a ray from `origin` (3,) along `ray` (3,), world, meets first, or None."""
    nearest, found = np.inf, None
    for box in proposals:
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = (np.array(box).reshape(2, 3) - origin) / ray
        near, far = np.nanmax(np.min(ends, axis=0)), np.nanmin(np.max(ends, axis=0))
        if near <= far and far > 0 and near < nearest:
            nearest, found = near, tuple(box)
    return found


def box_corners(box: Array) -> Array:
    """(8, 3) of a box (6,)."""
    return np.array([[box[3 * up + axis] for axis, up in enumerate(ends)] for ends in product((0, 1), repeat=3)])


def _edges(box: Array) -> Floats:
    """(12, 2, 3): those of a box (6,)."""
    corners = box_corners(box)
    pairs = [(a, b) for a in range(8) for b in range(a) if bin(a ^ b).count("1") == 1]
    edges: Floats = corners[np.array(pairs)].astype(np.float32)
    return edges


def _proposal(number: int, box: Array, theme: Theme, chosen: bool) -> Iterator[Node]:
    if not chosen:  # else it is the region, which is drawn itself
        yield Lines(f"/proposals/{number}", _edges(box), OFFERED[theme], 1.5)
    top = np.array([*(box[:2] + box[3:5]) / 2, box[5]])
    size = EMPHASIS if chosen else 1.0
    yield Label(f"/proposals/{number}/number", f"{number}", size, np.concatenate([top, poses.IDENTITY[3:]]))


def _region(box: Array, stage: Stage, theme: Theme) -> Iterator[Node]:
    yield Lines("/region/box", _edges(box), ACCENT[theme], 2.5)
    size = _CORNER * stage.size
    for name, corner in ((LOW, box[:3]), (HIGH, box[3:])):
        yield Handle(name, np.concatenate([corner, poses.IDENTITY[3:]]), size, turns=False)


def _prior(prior: GaussianPrior, stage: Stage, state: ViewState) -> Iterator[Node]:
    colour, pose = ACCENT[state.theme], prior.pose_world_link
    yield Handle(PRIOR, pose, _TURN * stage.size, turns=True)
    yield ellipsoid("/prior/spread", pose[:3], radius_scale(state.confidence) * prior.std_xyz, colour, 0.16)
    # the whole object with its joints as the prior has them, else at rest: what is laid into the scan has to be seen
    part_poses = _placed(stage.model, prior)
    for number, shape in enumerate(stage.shapes):
        if shape is not None:
            yield Lines(f"/prior/edges/{number}", shape.edges, colour, 1.5, part_poses[number])


def _placed(model: ArticulatedObject, prior: GaussianPrior) -> Array:
    """(N, 7): the parts' poses where the prior's link is at its mean."""
    joints = np.clip(0.0, model.lower, model.upper)
    for joint in model.joints:
        if joint.name in prior.joints and joint.mimic is None:
            joints[joint.coordinates[0]] = prior.joints[joint.name][0]
    parts = model.part_poses(poses.IDENTITY, joints)
    link = model.link_poses(parts, joints)[model.links.index(prior.link)]
    return poses.multiply(poses.multiply(prior.pose_world_link, poses.inverse(link)), parts)
