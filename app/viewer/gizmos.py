"""What can be dragged in a view? The region of interest by two opposite corners, and the mean of a gaussian prior.

What they say is in the view state; a new session can be made with it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np

from app.viewer.ellipsoids import ellipsoid, radius_scale
from app.viewer.scene_frame import Handle, Lines, Node
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

# Of what somebody may do: drag it, or look from there.
ACCENT: Mapping[Theme, tuple[int, int, int]] = {"light": rgb("#345bb5"), "dark": rgb("#8fb0ff")}


def gizmos(stage: Stage, state: ViewState) -> Iterator[Node]:
    """The nodes of region and prior, where they are shown and there is one."""
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


def default_prior(model: ArticulatedObject, links: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """A gaussian prior as prior.json, for the first part's link where the estimate `links` (of result.json) has it."""
    link = model.parts[0].links[0]
    return {
        "kind": "gaussian",
        "link": link,
        "pose": links[link]["pose"],
        "std_xyz": [STD_XYZ] * 3,
        "std_rpy": [STD_RPY] * 3,
    }


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


def _region(box: Array, stage: Stage, theme: Theme) -> Iterator[Node]:
    corners = np.array([[box[3 * up + axis] for axis, up in enumerate(ends)] for ends in product((0, 1), repeat=3)])
    pairs = [(a, b) for a in range(8) for b in range(a) if bin(a ^ b).count("1") == 1]
    yield Lines("/region/box", corners[np.array(pairs)].astype(np.float32), ACCENT[theme], 2.0)
    size = _CORNER * stage.size
    for name, corner in ((LOW, box[:3]), (HIGH, box[3:])):
        yield Handle(name, np.concatenate([corner, poses.IDENTITY[3:]]), size, turns=False)


def _prior(prior: GaussianPrior, stage: Stage, state: ViewState) -> Iterator[Node]:
    colour, pose = ACCENT[state.theme], prior.pose_world_link
    yield Handle(PRIOR, pose, _TURN * stage.size, turns=True)
    yield ellipsoid("/prior/spread", pose[:3], radius_scale(state.confidence) * prior.std_xyz, colour, 0.16)
    for number, part in enumerate(stage.model.parts):
        shape = stage.shapes[number]
        if prior.link in part.links and shape is not None:
            own = part.poses_part_link[part.links.index(prior.link)]
            yield Lines("/prior/edges", shape.edges, colour, 1.5, poses.multiply(pose, poses.inverse(own)))
