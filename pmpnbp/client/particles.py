"""What is believed of a link, what do its neighbours say of it, and what does the scan leave open? Weighted poses."""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False, kw_only=True)
class WeightedPoses:
    """Poses of a link, with weights.

    particles : (M, 7) x y z qw qx qy qz, metres, link in world
    log_weights : (M,) natural logarithms of the weights, which sum to 1
    frame_id : name of the world frame
    """

    link: str
    iteration: int
    frame_id: str
    particles: Array = field(repr=False)
    log_weights: Array = field(repr=False)


@dataclass(frozen=True, eq=False, kw_only=True)
class Belief(WeightedPoses):
    """The belief about a link. part : that it moves with; log_unary : (M,) natural logarithms of the unary potential,
    before tempering"""

    part: str
    log_unary: Array = field(repr=False)


@dataclass(frozen=True, eq=False, kw_only=True)
class Message(WeightedPoses):
    """What one part says about where a link of another is.

    sender, receiver : names of the parts
    log_unary, log_neighbour : (M,) natural logarithms of the factors of the sender's own unary potential and of the
        messages of its other neighbours
    """

    sender: str
    receiver: str
    log_unary: Array = field(repr=False)
    log_neighbour: Array = field(repr=False)


@dataclass(frozen=True, eq=False, kw_only=True)
class PosteriorDraws(WeightedPoses):
    """What the scan leaves open of a link; draw i of every link is of one configuration of the object.

    posterior_iteration : the iteration that the posterior was read out from
    mode : (M,) of which of the estimate's `alternatives` each draw is
    """

    posterior_iteration: int
    mode: NDArray[np.int64] = field(repr=False)


def belief(npz: bytes) -> Belief:
    """Raises KeyError, ValueError or zipfile.BadZipFile where the file holds none, as all of these."""
    found = loaded(npz)
    return Belief(**_common(found), part=str(found["part"]), log_unary=found["log_unary"])


def message(npz: bytes) -> Message:
    """Likewise."""
    found = loaded(npz)
    return Message(
        **_common(found),
        sender=str(found["from"]),
        receiver=str(found["to"]),
        log_unary=found["log_unary"],
        log_neighbour=found["log_neighbour"],
    )


def posterior_draws(npz: bytes) -> PosteriorDraws:
    """Likewise."""
    found = loaded(npz)
    return PosteriorDraws(**_common(found), posterior_iteration=int(found["posterior_iteration"]), mode=found["mode"])


def loaded(npz: bytes) -> dict[str, NDArray[Any]]:
    """The arrays in the file, by name; likewise."""
    with np.load(io.BytesIO(npz), allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def _common(found: dict[str, NDArray[Any]]) -> dict[str, Any]:
    return {
        "link": str(found["link"]),
        "iteration": int(found["iteration"]),
        "frame_id": str(found["frame_id"]),
        "particles": found["particles"].reshape(-1, 7),
        "log_weights": found["log_weights"],
    }
