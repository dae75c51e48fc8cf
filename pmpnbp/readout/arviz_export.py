"""How do the posterior's draws come into ArviZ? As an `InferenceData`, which saves itself as netCDF.

ArviZ takes draws of equal weight, and ours are weighted: they are resampled. Each draw is taken about as often as it
weighs, by systematic resampling, and then shuffled by the seed, so that neither order nor chain means anything. A heavy
draw is there many times, so what the draws tell is not what `arviz.ess` makes of them, but the attribute
`effective_sample_size`.
"""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Mapping
from types import ModuleType
from typing import Any

import numpy as np

from pmpnbp.errors import PmpnbpError
from pmpnbp.readout.posterior import Posterior
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


def to_inference_data(
    model: ArticulatedObject,
    posterior: Posterior,
    *,
    draws: int = DRAWS,
    seed: int = 0,
    attributes: Mapping[str, object] | None = None,
) -> Any:
    """The posterior as an `arviz.InferenceData` of one chain of `draws` draws of equal weight; the same arguments give
    the same numbers.

    Group `posterior`: `joint_position` (chain, draw, joint), metres or radians, by the names of the model's joint
    vector; `link_position` (chain, draw, link, axis), metres, and `link_orientation` (chain, draw, link, component),
    w x y z with w >= 0, of the links in world. Group `sample_stats`: of each draw its `log_weight` before it was
    resampled, and the `mode` it is of, 0 the heaviest.

    attributes : of the whole, beside its own: the fit, the modes' weights, the effective sample size. Raises
    MissingArvizError.
    """
    arviz = load_arviz()
    chosen = np.random.default_rng(seed).permutation(posterior.even_draws(draws))
    links = posterior.link_poses(model)[chosen]
    orientation = np.where(links[..., 3:4] < 0, -links[..., 3:], links[..., 3:])
    values = {"link_position": links[None, ..., :3], "link_orientation": orientation[None]}
    dims = {"link_position": ["link", "axis"], "link_orientation": ["link", "component"]}
    coords: dict[str, list[str]] = {"link": list(model.links), "axis": list("xyz"), "component": list("wxyz")}
    if model.dof:  # netCDF keeps no axis of length zero
        values["joint_position"] = posterior.drawn_joints[None, chosen]
        dims["joint_position"], coords["joint"] = ["joint"], list(model.coordinate_names)
    told: dict[str, object] = {
        "model": model.name,
        "iteration": posterior.iteration,
        "fit": posterior.fit.verdict,
        "fit_reason": posterior.fit.reason,
        "explained": posterior.fit.explained,
        "effective_sample_size": posterior.effective_sample_size,
        "mode_weights": [mode.weight for mode in posterior.modes],
        "created_by": f"pmpnbp {version()}",
    }
    return arviz.from_dict(
        posterior=values,
        sample_stats={"log_weight": posterior.log_weights[None, chosen], "mode": posterior.mode[None, chosen]},
        coords=coords,
        dims=dims,
        attrs=told | dict(attributes or {}),
    )
