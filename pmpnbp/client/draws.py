"""What a server has drawn of the whole object, for ArviZ: the same numbers as where the inference ran here."""

from __future__ import annotations

from typing import Any

from pmpnbp.client.particles import loaded
from pmpnbp.library.estimate import Estimate
from pmpnbp.readout.arviz_export import ObjectDraws, inference_data


def to_inference_data(found: Estimate, npz: bytes, draws: int) -> Any:
    """`arviz_export.inference_data` of an estimate with its posterior.

    npz : all draws of it, as `GET /api/v1/sessions/{id}/posterior?format=npz` gives them

    Raises MissingArvizError, and KeyError, ValueError or zipfile.BadZipFile where that is none.
    """
    every = loaded(npz)
    of_all = ObjectDraws(
        links=every["links"].tolist(),
        link_poses=every["particles"],
        joints=every["joints"].tolist(),
        joint_positions=every["joint_positions"],
        log_weights=every["log_weights"],
        mode=every["mode"],
    )
    attributes = {
        "model": found.model,
        "iteration": found.posterior_iteration,
        "fit": found.fit,
        "fit_reason": found.fit_reason,
        "explained": found.explained,
        "effective_sample_size": found.effective_draws,
        "mode_weights": [one.weight for one in found.alternatives],
        "method": found.method,
        "seed": found.seed,
        "frame_id": found.frame_id,
    }
    return inference_data(of_all, draws=draws, seed=found.seed, attributes=attributes)
