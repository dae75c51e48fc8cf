"""How do the posterior's draws come into ArviZ? As an `InferenceData`, which saves itself as netCDF.

ArviZ takes draws of equal weight, and ours are weighted: they are resampled. Each draw is taken about as often as it
weighs, by systematic resampling, and then shuffled by the seed, so that neither order nor chain means anything. A heavy
draw is there many times, so what the draws tell is not what `arviz.ess` makes of them, but the attribute
`effective_sample_size`.
"""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmpnbp.errors import PmpnbpError
from pmpnbp.geometry.poses import Array
from pmpnbp.readout.posterior import Posterior, even_draws
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.version import version

DRAWS = 1000


class MissingArvizError(PmpnbpError):
    """ArviZ, which only this export needs, is not installed."""


def load_arviz() -> ModuleType:
    """The package. Raises MissingArvizError where it is not installed."""
    try:
        with warnings.catch_warnings():
            # it announces its next version on the first import of a day
            warnings.simplefilter("ignore", FutureWarning)
            return importlib.import_module("arviz")
    except ModuleNotFoundError:
        raise MissingArvizError("draws for ArviZ need its package: pip install 'pmpnbp[arviz]'") from None


@dataclass(frozen=True, kw_only=True, eq=False)
class ObjectDraws:
    """Draws of the whole object, K of them.

    links : names of the L links; link_poses : (K, L, 7) x y z qw qx qy qz, metres, in world
    joints : names of the joint vector; joint_positions : (K, D) metres or radians
    log_weights : (K,), their exponentials sum to 1; mode : (K,) of which mode each is, 0 the heaviest
    """

    links: Sequence[str]
    link_poses: Array
    joints: Sequence[str]
    joint_positions: Array
    log_weights: Array
    mode: NDArray[np.int64]


def to_inference_data(
    model: ArticulatedObject,
    posterior: Posterior,
    *,
    draws: int = DRAWS,
    seed: int = 0,
    attributes: Mapping[str, object] | None = None,
) -> Any:
    """The posterior as `inference_data` has its draws; attributes : of the whole, beside its own: the fit, the modes'
    weights, the effective sample size. Raises MissingArvizError."""
    told: dict[str, object] = {
        "model": model.name,
        "iteration": posterior.iteration,
        "fit": posterior.fit.verdict,
        "fit_reason": posterior.fit.reason,
        "explained": posterior.fit.explained,
        "effective_sample_size": posterior.effective_sample_size,
        "mode_weights": [mode.weight for mode in posterior.modes],
    }
    every = ObjectDraws(
        links=model.links,
        link_poses=posterior.link_poses(model),
        joints=model.coordinate_names,
        joint_positions=posterior.drawn_joints,
        log_weights=posterior.log_weights,
        mode=posterior.mode,
    )
    return inference_data(every, draws=draws, seed=seed, attributes=told | dict(attributes or {}))


def inference_data(found: ObjectDraws, *, draws: int, seed: int, attributes: Mapping[str, object]) -> Any:
    """An `arviz.InferenceData` of one chain of `draws` draws of equal weight, with `attributes` of the whole; the same
    arguments give the same numbers.

    Group `posterior`: `joint_position` (chain, draw, joint), metres or radians, by the names of the model's joint
    vector; `link_position` (chain, draw, link, axis), metres, and `link_orientation` (chain, draw, link, component),
    w x y z with w >= 0, of the links in world. Group `sample_stats`: of each draw its `log_weight` before it was
    resampled, and the `mode` it is of, 0 the heaviest. Raises MissingArvizError.
    """
    arviz = load_arviz()
    chosen = np.random.default_rng(seed).permutation(even_draws(found.log_weights, draws))
    links = found.link_poses[chosen]
    orientation = np.where(links[..., 3:4] < 0, -links[..., 3:], links[..., 3:])
    values = {"link_position": links[None, ..., :3], "link_orientation": orientation[None]}
    dims = {"link_position": ["link", "axis"], "link_orientation": ["link", "component"]}
    coords: dict[str, list[str]] = {"link": list(found.links), "axis": list("xyz"), "component": list("wxyz")}
    if len(found.joints):  # netCDF keeps no axis of length zero
        values["joint_position"] = found.joint_positions[None, chosen]
        dims["joint_position"], coords["joint"] = ["joint"], list(found.joints)
    return arviz.from_dict(
        posterior=values,
        sample_stats={"log_weight": found.log_weights[None, chosen], "mode": found.mode[None, chosen]},
        coords=coords,
        dims=dims,
        attrs={**attributes, "created_by": f"pmpnbp {version()}"},
    )
