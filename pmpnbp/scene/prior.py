"""What is known of the object before the scan is looked at? Reads prior.json.

Either nothing but which way up it stands (`{"kind":"uniform","orientation":"upright"|"any"}`), or roughly where one of
its links is, and perhaps how far some joints are moved: `{"kind":"gaussian","link","pose","std_xyz","std_rpy",
"joints":{"J":{"position","std"}}}`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, cast

import numpy as np

from pmpnbp.errors import PriorError
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.scene.articulated_object import ArticulatedObject, Joint
from pmpnbp.scene.json_files import finite_number, read_object
from pmpnbp.scene.reach import FARTHEST

Orientation = Literal["upright", "any"]
MEMBERS = {"uniform": ("kind", "orientation"), "gaussian": ("kind", "link", "pose", "std_xyz", "std_rpy", "joints")}
# A joint's position may be measured beyond a limit: by so many of its deviations, or by this share of its range.
DEVIATIONS_BEYOND, SHARE_BEYOND = 3.0, 0.05


@dataclass(frozen=True)
class UniformPrior:
    """The object is anywhere in the region of interest: standing `upright` with any yaw, or turned in `any` way."""

    orientation: Orientation = "upright"


@dataclass(frozen=True)
class GaussianPrior:
    """One link's pose is known roughly; the other links follow through the joints.

    pose_world_link : (7,), x y z qw qx qy qz, metres: the mean
    std_xyz : (3,) metres; std_rpy : (3,) radians about the world's X, Y, Z: standard deviations
    joints : mean and standard deviation of the joints that something is known of, metres or radians, by name; the
        others are uniform between their limits
    """

    link: str
    pose_world_link: Array
    std_xyz: Array
    std_rpy: Array
    joints: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for array in (self.pose_world_link, self.std_xyz, self.std_rpy):
            array.setflags(write=False)


def load_prior(source: Path | Mapping[str, object], model: ArticulatedObject) -> UniformPrior | GaussianPrior:
    """The prior in the file `source`, or in an object that was already read from JSON.

    Raises PriorError where the file is missing or malformed, has a member that a prior cannot have, names a link or
    joint that `model` does not have, or puts a joint where it cannot be.
    """
    if isinstance(source, Path):
        members, name = read_object(source, "prior file", PriorError), f"prior file '{source.name}'"
    else:
        members, name = source, "the prior"
    kind = members.get("kind")
    if kind in ("uniform", "gaussian"):
        _check_members(members, MEMBERS[str(kind)], f"{name} of kind '{kind}'")
    if kind == "uniform":
        orientation = members.get("orientation", "upright")
        if orientation != "upright" and orientation != "any":
            raise PriorError(f"'orientation' of {name} is {orientation!r:.60}; expected 'upright' or 'any'")
        return UniformPrior(orientation)
    if kind == "gaussian":
        return GaussianPrior(
            _link(members, model, name),
            _pose(members, name),
            _deviations(members, "std_xyz", name),
            _deviations(members, "std_rpy", name),
            _joints(members, model, name),
        )
    raise PriorError(f"'kind' of {name} is {kind!r:.60}; expected 'uniform' or 'gaussian'")


def _check_members(members: Mapping[str, object], known: Sequence[str], what: str) -> None:
    """A name that is spelled wrong would be as if it were not there."""
    for member in members:
        if member not in known:
            raise PriorError(f"{what} has the member {member!r:.60}; it can have {', '.join(known)}")


def _link(members: Mapping[str, object], model: ArticulatedObject, name: str) -> str:
    if "link" not in members:
        raise PriorError(f"{name} has no link; expected one of {', '.join(model.links)}")
    link = members["link"]
    if not isinstance(link, str) or link not in model.links:
        raise PriorError(f"link {link!r:.60} of {name} is not in the model; it has {', '.join(model.links)}")
    return link


def _pose(members: Mapping[str, object], name: str) -> Array:
    pose = members.get("pose")
    if not isinstance(pose, Mapping):
        raise PriorError(f"{name} has no 'pose' with a position x y z and an orientation x y z w")
    _check_members(pose, ("position", "orientation"), f"'pose' of {name}")
    numbers = [*_entries(pose, "position", "xyz", name), *_entries(pose, "orientation", "wxyz", name)]
    if max(map(abs, numbers[:3])) > FARTHEST:
        raise PriorError(
            f"'position' in {name} is {pose['position']!r:.80}; expected metres, at most {FARTHEST:g} from the world's "
            "origin along each axis"
        )
    if abs(np.linalg.norm(numbers[3:]) - 1.0) > 1e-2:
        raise PriorError(f"the orientation in {name} has the length {np.linalg.norm(numbers[3:]):.4g}; expected 1")
    return poses.normalise(numbers)


def _entries(pose: Mapping[str, object], key: str, axes: str, name: str) -> list[float]:
    entries = pose.get(key)
    numbers = [finite_number(entries.get(axis)) for axis in axes] if isinstance(entries, Mapping) else [None]
    if None in numbers:
        raise PriorError(f"'{key}' in {name} is {entries!r:.80}; expected finite numbers {', '.join(sorted(axes))}")
    _check_members(cast(Mapping[str, object], entries), sorted(axes), f"'{key}' in {name}")
    return cast(list[float], numbers)


def _deviations(members: Mapping[str, object], key: str, name: str) -> Array:
    values = members.get(key)
    numbers = [finite_number(value) for value in values] if isinstance(values, list | tuple) else []
    if len(numbers) != 3 or any(number is None or not 0 < number <= FARTHEST for number in numbers):
        raise PriorError(
            f"'{key}' of {name} is {values!r:.80}; expected three standard deviations above 0, at most {FARTHEST:g}"
        )
    return np.array(numbers, dtype=np.float64)


def _joints(members: Mapping[str, object], model: ArticulatedObject, name: str) -> dict[str, tuple[float, float]]:
    entries = members.get("joints", {})
    if not isinstance(entries, Mapping):
        raise PriorError(f"'joints' of {name} is {entries!r:.60}; expected an object with the joints' names")
    usable = {joint.name: joint for joint in model.joints if _has_one_position(joint)}
    found: dict[str, tuple[float, float]] = {}
    for title, entry in entries.items():
        if title not in usable:
            raise PriorError(
                f"joint {title!r:.60} of {name} is not in the model with a position of its own; "
                f"it has {', '.join(usable) or 'none'}"
            )
        position = finite_number(entry.get("position")) if isinstance(entry, Mapping) else None
        std = finite_number(entry.get("std")) if isinstance(entry, Mapping) else None
        if position is None or std is None or not 0 < std <= FARTHEST:
            raise PriorError(
                f"joint '{title}' of {name} is {entry!r:.80}; expected a finite 'position' and a 'std' above 0, "
                f"at most {FARTHEST:g}"
            )
        _check_members(entry, ("position", "std"), f"joint '{title}' of {name}")
        found[str(title)] = (_within_reach(usable[title], position, std, name), std)
    return found


def _within_reach(joint: Joint, position: float, std: float, name: str) -> float:
    """The position, of a joint without limits the same one within half a turn of zero."""
    if joint.kind == "continuous":
        position = math.remainder(position, 2 * math.pi)
    beyond = max(joint.lower - position, position - joint.upper)
    if beyond > max(DEVIATIONS_BEYOND * std, SHARE_BEYOND * (joint.upper - joint.lower)):
        unit = "m" if joint.kind == "prismatic" else "rad"
        raise PriorError(
            f"the position of joint '{joint.name}' of {name} is {position:g} {unit}, with a 'std' of {std:g}; expected "
            f"one within its limits, {joint.lower:g} to {joint.upper:g} {unit}"
        )
    return position


def _has_one_position(joint: Joint) -> bool:
    """Whether one number places the joint: not a fixed one, one that follows another, or one of several axes."""
    return joint.mimic is None and len(joint.coordinates) == 1
