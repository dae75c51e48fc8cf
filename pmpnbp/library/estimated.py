"""What an estimate consists of: links, joints, alternatives and nuisances, each read from its entry in result.json."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmpnbp.errors import EstimateError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Mode:
    """One hypothesis of a link. weight : 0 to 1; pose : (7,) x y z qw qx qy qz, link in world; covariance : (6, 6)."""

    weight: float
    pose: Array
    covariance: Array


@dataclass(frozen=True, eq=False)
class LinkEstimate:
    """Where a link of the URDF is, and how sure that is. Metres; in the estimate's `frame_id`, "world".

    pose : (7,) x y z qw qx qy qz, link in world
    covariance : (6, 6) over x, y, z and rotations about fixed X, Y, Z, as ROS has it; std_xyz : (3,); expected_add :
        mean distance over the link's surface (eq. 12) that the posterior expects; each None as long as there is no
        posterior, expected_add also for a link without surface
    certain : whether the fit is good, no other mode has it elsewhere, no deviation is larger than `max_std`, and what
        is longer than 10 cm is not turned, by more than 2° for each 2.5 mm of that
    doubts : why it is not certain, of "fit", "draws", "denied", "outside_region", "alike", "std_xyz", "expected_add",
        "elsewhere" and "turned"; None as long as there is no posterior
    visible_fraction : 0 to 1, log_likelihood : natural logarithm; None for a link without surface
    modes : the posterior's hypotheses, heaviest first
    particle_std_xyz : (3,), particle_modes : the spread and hypotheses of the algorithm's particles; no uncertainty
    """

    name: str
    pose: Array
    covariance: Array | None
    std_xyz: Array | None
    expected_add: float | None
    certain: bool
    doubts: tuple[str, ...] | None
    visible_fraction: float | None
    log_likelihood: float | None
    modes: tuple[Mode, ...]
    particle_std_xyz: Array
    particle_modes: tuple[Mode, ...]

    @property
    def matrix(self) -> Array:
        """(4, 4), the pose as a homogeneous matrix: points of the link, as columns, to world."""
        from pmpnbp.geometry.poses import to_matrix  # imported here: it compiles a kernel

        return to_matrix(self.pose)


@dataclass(frozen=True, eq=False)
class JointEstimate:
    """Where a moving joint stands: metres for slides, radians for turns, of its K axes (1; planar 3, floating 6).

    type : as in the URDF; parent, child : names of links
    positions, lowers, uppers : (K,); stds : (K,) and intervals : (K, 2), the central 90 %, of the posterior, or None
        as long as there is none
    """

    name: str
    type: str
    parent: str
    child: str
    positions: Array
    stds: Array | None
    intervals: Array | None
    lowers: Array
    uppers: Array

    @property
    def position(self) -> float:
        """Of a joint with one axis. Raises EstimateError for one that has several, whose `positions` are asked for."""
        return float(self._only(self.positions))

    @property
    def std(self) -> float | None:
        """Likewise."""
        return None if self.stds is None else float(self._only(self.stds))

    @property
    def interval(self) -> Array | None:
        """(2,), likewise."""
        return None if self.intervals is None else self._only(self.intervals)

    def _only(self, values: Array) -> Any:
        if len(values) != 1:
            raise EstimateError(
                f"joint '{self.name}' is {self.type} and has {len(values)} axes; ask for positions, stds and intervals"
            )
        return values[0]


@dataclass(frozen=True, eq=False)
class Alternative:
    """One hypothesis of the whole object. weight : 0 to 1; poses : (7,) of each link by name; joints : (K,) by name."""

    weight: float
    poses: Mapping[str, Array]
    joints: Mapping[str, Array]


@dataclass(frozen=True)
class Nuisance:
    """What one thing that is no part of the object was taken for: value, its standard deviation, and its prior's."""

    value: float
    std: float
    prior_std: float


def link_of(name: str, entry: Mapping[str, Any]) -> LinkEstimate:
    """The link of this name. Raises KeyError, TypeError or ValueError for what is none."""
    covariance = entry["covariance"]
    return LinkEstimate(
        name=name,
        pose=_pose(entry["pose"]),
        covariance=None if covariance is None else _square(covariance),
        std_xyz=_array(entry["std_xyz"]),
        expected_add=entry.get("expected_add"),
        certain=entry["certain"],
        doubts=None if entry.get("doubts") is None else tuple(entry["doubts"]),
        visible_fraction=entry["visible_fraction"],
        log_likelihood=entry["log_likelihood"],
        modes=_modes(entry["modes"]),
        particle_std_xyz=np.array(entry["particle_std_xyz"], dtype=np.float64),
        particle_modes=_modes(entry.get("particle_modes") or ()),
    )


def joint_of(name: str, entry: Mapping[str, Any]) -> JointEstimate:
    """The joint of this name, likewise."""
    interval = _array(entry["interval"])
    return JointEstimate(
        name=name,
        type=entry["type"],
        parent=entry["parent"],
        child=entry["child"],
        positions=_axes(entry["position"]),
        stds=None if entry["std"] is None else _axes(entry["std"]),
        intervals=None if interval is None else interval.reshape(-1, 2),
        lowers=_axes(entry["lower"]),
        uppers=_axes(entry["upper"]),
    )


def alternative_of(entry: Mapping[str, Any]) -> Alternative:
    """Likewise."""
    return Alternative(
        entry["weight"],
        {name: _pose(link["pose"]) for name, link in entry["links"].items()},
        {name: _axes(position) for name, position in entry["joints"].items()},
    )


def _modes(entries: Any) -> tuple[Mode, ...]:
    return tuple(Mode(one["weight"], _pose(one["pose"]), _square(one["covariance"])) for one in entries)


def _pose(members: Mapping[str, Mapping[str, float]]) -> Array:
    place, turn = members["position"], members["orientation"]
    return np.array([*(place[axis] for axis in "xyz"), *(turn[axis] for axis in "wxyz")], dtype=np.float64)


def _square(numbers: Any) -> Array:
    return np.array(numbers, dtype=np.float64).reshape(6, 6)


def _array(numbers: Any) -> Array | None:
    return None if numbers is None else np.array(numbers, dtype=np.float64)


def _axes(numbers: Any) -> Array:
    return np.atleast_1d(np.array(numbers, dtype=np.float64))
