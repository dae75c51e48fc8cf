"""How does an input become a problem? The one path that `pmpnbp estimate` and the server's sessions share: the same
input and seed give the same numbers, whoever asks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pmpnbp.inference import problem as problem_module
from pmpnbp.inference.problem import Problem
from pmpnbp.recording import Inputs
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.observe import observe
from pmpnbp.scene.prior import UniformPrior, load_prior
from pmpnbp.scene.urdf import load_model
from pmpnbp.settings import SessionOptions, Settings


def prepare(
    model: Path,
    scans: Sequence[Scan],
    roi: Sequence[float] | None,
    prior: Path | Mapping[str, object] | None,
    settings: Settings,
    *,
    particles: int,
    seed: int,
    method: str = SessionOptions.method,
) -> tuple[Problem, Inputs]:
    """The problem, and the inputs that a recording keeps of it.

    model : a URDF or zip; roi : x0 y0 z0 x1 y1 z1, metres, world, or None; prior : prior.json, its members, or None
    for upright anywhere; method : one of `settings.METHODS`. Raises PmpnbpError for what does not fit together.
    """
    found = load_model(model, triangle_budget=settings.triangles)
    box = None if roi is None else np.array(roi, dtype=np.float64)
    observation = observe(scans, box, width=settings.image_width)
    known = UniformPrior("upright") if prior is None else load_prior(prior, found)
    problem = problem_module.build(found, observation, known, settings, particles=particles, seed=seed, method=method)
    return problem, Inputs(model, tuple(scans), box, known, settings, particles, seed, method)
