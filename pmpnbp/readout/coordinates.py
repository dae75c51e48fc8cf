"""Which numbers of an object can be set against each other? Every draw of the posterior, coordinate by coordinate: the
joints, and where links are and how they are turned. Draw i of each is of one configuration of the whole object, so that
two coordinates side by side show what the scan ties together.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.readout.marginals import around
from pmpnbp.readout.placement import Placement
from pmpnbp.readout.posterior import Posterior
from pmpnbp.scene.articulated_object import ArticulatedObject


@dataclass(frozen=True, kw_only=True)
class Coordinate:
    """One number of the object.

    link : the link it is of, None for a joint; name : x, y, z, roll, pitch or yaw, else `joint NAME` (`joint NAME/x`
    for joints with several axes); unit : m or rad; values : (K,) of the draws; estimate : the same of the estimate
    """

    link: str | None
    name: str
    unit: Literal["m", "rad"]
    values: Array
    estimate: float


def coordinates(
    model: ArticulatedObject, posterior: Posterior, placed: Placement, links: Sequence[str]
) -> list[Coordinate]:
    """Every joint's axes, then of each of `links`, which the model has, x, y, z (metres, in world), roll, pitch and yaw
    (radians, about world's fixed X, Y, Z in this order). Angles are counted from the estimate, at most half a turn to
    either side, and may lie beyond ±pi."""
    found = list(_of_joints(model, posterior, placed))
    if links:
        drawn = posterior.link_poses(model)
        for link in links:
            row = model.links.index(link)
            found += _of_pose(link, drawn[:, row], placed.link_poses[row])
    return found


def _of_joints(model: ArticulatedObject, posterior: Posterior, placed: Placement) -> Iterator[Coordinate]:
    at, drawn = placed.joint_positions, posterior.drawn_joints
    drawn = np.where(model.wraps, around(drawn, at), drawn)
    for joint in model.joints:
        revolute, _ = joint.elementary_axes()
        for axis, entry in enumerate(joint.coordinates):
            own = joint.name if len(joint.coordinates) == 1 else model.coordinate_names[entry]
            yield Coordinate(
                link=None,
                name=f"joint {own}",
                unit="rad" if revolute[axis] else "m",
                values=joint.positions(drawn)[:, axis],
                estimate=float(joint.positions(at)[axis]),
            )


def _of_pose(link: str, drawn: Array, at: Array) -> Iterator[Coordinate]:
    for axis, name in enumerate("xyz"):
        yield Coordinate(link=link, name=name, unit="m", values=drawn[:, axis], estimate=float(at[axis]))
    angles, here = poses.to_rpy(drawn[:, 3:]), poses.to_rpy(at[3:])
    for axis, name in enumerate(("roll", "pitch", "yaw")):
        values = around(angles[:, axis], here[axis])
        yield Coordinate(link=link, name=name, unit="rad", values=values, estimate=float(here[axis]))
