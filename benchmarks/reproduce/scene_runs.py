"""One run of a method on a sample scene of known truth: errors, spread and seconds, iteration by iteration."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.reproduce.ledger import Asked, Result
from benchmarks.trials import PROJECT, Case, load_case, load_region, rough_prior, shortened
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import problem as problems
from pmpnbp.inference import run as engine
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.problem import Problem
from pmpnbp.readout.estimate import place
from pmpnbp.scene.prior import GaussianPrior, UniformPrior
from pmpnbp.scene.urdf import load_model
from pmpnbp.settings import Settings, changed, preset

SAMPLE_DATA = PROJECT / "sample_data"
# Particles of a part that are kept of an iteration to be drawn.
DRAWN = 200


@dataclass(frozen=True)
class Variant:
    """A way to infer. title : in figures and tables; method, preset and config, settings beyond it : what makes it"""

    title: str
    method: str
    preset: str
    config: Mapping[str, Any] = field(default_factory=dict)

    @property
    def settings(self) -> Settings:
        """All settings."""
        return changed(preset(self.preset), self.config)


# Message passing, or the filter, by itself: no search before it, and no estimate of the whole object behind it.
_ALONE = {"search_iterations": 0, "object_estimate": False, "anneal_iterations": 12}
VARIANTS = {
    "robust": Variant("PMPNBP, robust", "pmpnbp", "robust"),
    "paper": Variant("PMPNBP, as in the paper", "pmpnbp", "paper"),
    "filter": Variant("particle filter", "particle_filter", "robust"),
    "robust_alone": Variant("message passing alone", "pmpnbp", "robust", _ALONE),
    "filter_alone": Variant("particle filter alone", "particle_filter", "robust", _ALONE),
}


def asked_of(
    scene: str, variant: str, seed: int, *, particles: int, iterations: int, prior: bool = False, **more: Any
) -> dict[str, Any]:
    """What `perform` is asked for.

    scene : folder of the scan below sample_data; seed : of the inference, and of the prior's draw
    prior : whether the root is known to `metres` and `degrees` per axis, else nothing but the region of interest is
    more : `metres`, `degrees`; `budget`, seconds up to which it goes on beyond its iterations; `keep`, iterations whose
        particles come with the result
    """
    shared = {"scene": scene, "variant": variant, "seed": seed, "particles": particles, "iterations": iterations}
    return shared | {"prior": prior} | more


def perform(asked: Asked) -> Result:
    """The run. Its result is what JSON can hold.

    parts : their names; judged : whether a part is seen well enough to count; shares : how much of each is seen
    seconds : (I + 1) since the start, the preparation included; add : (I + 1, N) metres; std : (I + 1, N) metres, the
        largest standard deviation of a part's position along an axis
    kept : by iteration, `particles`, (N, T, 3) positions, and `poses`, (N, 7), of the estimate
    """
    variant = VARIANTS[asked["variant"]]
    settings = variant.settings
    case = scene_case(asked["scene"], settings.image_width, settings.triangles)
    _warm(asked["scene"], asked["variant"], asked["prior"])
    prior = _prior(case, asked)
    keep = set(asked.get("keep", ()))
    rows: list[tuple[float, Array, Array]] = []
    kept: dict[str, Any] = {}
    began = time.perf_counter()
    problem = problems.build(
        case.model, case.observation, prior, settings,
        particles=asked["particles"], seed=asked["seed"], method=variant.method,
    )  # fmt: skip
    state, report = engine.begin(problem)
    spent = time.perf_counter() - began
    while True:
        rows.append((spent, case.errors(report.mle), _std(problem, report)))
        if report.iteration in keep:
            kept[str(report.iteration)] = _drawn(report)
        if report.iteration >= asked["iterations"] and spent >= asked.get("budget", 0.0):
            break
        began = time.perf_counter()
        state, report = engine.advance(state, problem)
        spent += time.perf_counter() - began
    seconds, add, std = zip(*rows, strict=True)
    return {
        "parts": [part.name for part in case.model.parts],
        "judged": case.judged.tolist(),
        "shares": np.round(case.shares, 4).tolist(),
        "seconds": np.round(seconds, 5).tolist(),
        "add": np.round(add, 6).tolist(),
        "std": np.round(std, 6).tolist(),
        "kept": kept,
    }


@lru_cache(maxsize=8)
def scene_case(scene: str, width: int, triangles: int) -> Case:
    """The scene in `sample_data/<scene>` with its region of interest."""
    folder = SAMPLE_DATA / scene
    model = load_model(model_file(scene), triangle_budget=triangles)
    settings = changed(Settings(), {"image_width": width, "triangles": triangles})
    return load_case(scene, model, folder, load_region(folder), settings)


def model_file(scene: str) -> Path:
    """The URDF of a scene's object."""
    return next((SAMPLE_DATA / scene).parent.glob("*.urdf"))


@lru_cache(maxsize=64)
def _warm(scene: str, variant: str, known: bool) -> None:
    """Once a process: kernels are compiled, or read from their cache, outside the time that is measured."""
    chosen = VARIANTS[variant]
    settings = chosen.settings
    case = scene_case(scene, settings.image_width, settings.triangles)
    prior = _prior(case, {"prior": known, "seed": 0, "metres": 0.1, "degrees": 5.0})
    short = shortened(settings, search=1, anneal=1, refine=1)
    problem = problems.build(case.model, case.observation, prior, short, particles=50, seed=0, method=chosen.method)
    state, report = engine.begin(problem)
    while report.iteration < 4:
        state, report = engine.advance(state, problem)
    place(problem, report)


def _prior(case: Case, asked: Asked) -> UniformPrior | GaussianPrior:
    if not asked["prior"]:
        return UniformPrior("upright")
    rng = np.random.default_rng([77, asked["seed"]])
    return rough_prior(rng, case, case.model.parts[0].links[0], asked["metres"], asked["degrees"])


def _std(problem: Problem, report: IterationReport) -> Array:
    """(N,) of each part, by the first of its links."""
    model = problem.mrf.model
    links = [model.links.index(part.links[0]) for part in model.parts]
    return place(problem, report).std_xyz[links].max(axis=1)


def _drawn(report: IterationReport) -> dict[str, Any]:
    """Particles by their weights, so that a picture of points shows the belief."""
    rng = np.random.default_rng(report.iteration)
    belief = report.belief
    weights = np.exp(belief.log_weights)
    rows = [rng.choice(len(one), DRAWN, p=one / one.sum()) for one in weights]
    return {
        "particles": np.round([belief.poses[node, taken, :3] for node, taken in enumerate(rows)], 4).tolist(),
        "poses": np.round(report.mle, 6).tolist(),
    }
