"""Act, or look again, and from where? What a planner asks, and what it is told."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pmpnbp.errors import PmpnbpError

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class View:
    """A place to look from.

    pose : (7,) x y z qw qx qy qz, metres, pose_world_camera, optical: x right, y down, z forward
    cost : what it takes to get there, as the planner gave it, or 1
    gain : nats, how much less there is to know of the links, down to `max_std`, after a scan from there
    worthwhile : whether that is worth a scan
    expected_std_xyz : by link, (3,) metres along world's axes, after such a scan
    """

    pose: Array
    cost: float
    gain: float
    worthwhile: bool
    expected_std_xyz: Mapping[str, Array]


@dataclass(frozen=True)
class Sight:
    """How much of a link is in sight at the estimate, in the view that sees most of it: shares that sum to 1.

    view : which of the scans, counted from 0; behind : by part of the object, largest first; in_front : behind
        something that is not the object
    """

    view: int
    seen: float
    behind: Mapping[str, float]
    in_front: float


@dataclass(frozen=True, eq=False)
class Decision:
    """Whether to act on the estimate.

    action : act where all asked links are certain, no_fit where the object is not seen where it should be, else look
    reason : a sentence
    max_std : metres, up to which a link is certain; links : those that were asked about; blocking : those that are not
    sight : what hides each of those, by link; None where it would cover no pixel
    views : where to look from next, best first; empty where to act
    outdated : whether scans or settings have changed since `iteration`, which is decided by as it was where it was
        asked for by its number
    """

    action: Literal["act", "look", "no_fit"]
    reason: str
    certain: bool
    iteration: int
    max_std: float
    links: tuple[str, ...]
    blocking: tuple[str, ...]
    sight: Mapping[str, Sight | None]
    views: tuple[View, ...]
    outdated: bool

    @staticmethod
    def from_dict(members: Mapping[str, Any]) -> Decision:
        """As REST has it. Raises KeyError, TypeError or ValueError where it is none."""
        return Decision(
            action=members["action"],
            reason=members["reason"],
            certain=members["certain"],
            iteration=members["iteration"],
            max_std=members["max_std"],
            links=tuple(members["links"]),
            blocking=tuple(members["blocking"]),
            sight={name: _sight(entry) for name, entry in members["sight"].items()},
            views=tuple(_view(entry) for entry in members["views"]),
            outdated=members["outdated"],
        )


def question(
    links: str | Sequence[str] | None,
    max_std: float | None,
    views: Iterable[ArrayLike | tuple[ArrayLike, float] | View] | None,
    iteration: int | None,
) -> dict[str, Any]:
    """The members of what REST is asked. Raises PmpnbpError for a view that is none."""
    asked: dict[str, Any] = {}
    if links is not None:
        asked["links"] = [links] if isinstance(links, str) else list(links)
    if max_std is not None:
        asked["max_std"] = max_std
    if iteration is not None:
        asked["iteration"] = iteration
    if views is not None:
        asked["views"] = [_place(view) for view in views]
    return asked


def _place(view: Any) -> dict[str, Any]:
    pose, cost = view, 1.0
    if isinstance(view, View):
        pose, cost = view.pose, view.cost
    elif isinstance(view, tuple | list) and len(view) == 2:
        pose, cost = view
    wanted = "expected a pose (7,), or a pair of pose and cost"
    try:
        numbers, weight = np.array(pose, dtype=np.float64), float(cost)
    except (TypeError, ValueError) as error:
        raise PmpnbpError(f"a view is {view!r}; {wanted}, all of them numbers") from error
    if numbers.shape != (7,):
        raise PmpnbpError(f"a view has the shape {numbers.shape}; {wanted}")
    x, y, z, qw, qx, qy, qz = numbers.tolist()
    place, turn = {"x": x, "y": y, "z": z}, {"x": qx, "y": qy, "z": qz, "w": qw}
    return {"pose": {"position": place, "orientation": turn}, "cost": weight}


def _view(entry: Mapping[str, Any]) -> View:
    place, turn = entry["pose"]["position"], entry["pose"]["orientation"]
    return View(
        pose=np.array([*(place[axis] for axis in "xyz"), *(turn[axis] for axis in "wxyz")], dtype=np.float64),
        cost=entry["cost"],
        gain=entry["expected_gain_nats"],
        worthwhile=entry["worthwhile"],
        expected_std_xyz={name: np.array(std, dtype=np.float64) for name, std in entry["expected_std_xyz"].items()},
    )


def _sight(entry: Mapping[str, Any] | None) -> Sight | None:
    if entry is None:
        return None
    return Sight(entry["view"], entry["seen"], entry["behind"], entry["in_front"])
