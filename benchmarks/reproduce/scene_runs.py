"""One run of a method on a scene of known truth: errors, spread and seconds, iteration by iteration."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.trials import PROJECT, Case, load_case, load_roi, rough_prior, timed, warm_kernels
from pmpnbp.geometry.poses import Array
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.problem import look
from pmpnbp.readout.mixture import of_estimate
from pmpnbp.readout.placement import Placement, place
from pmpnbp.runs.run_log import Asked, Result
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.prior import GaussianPrior, UniformPrior
from pmpnbp.scene.scan_files import load_scan
from pmpnbp.scene.urdf import load_model
from pmpnbp.settings import SessionOptions, Settings, changed, preset

SAMPLE_DATA = PROJECT / "sample_data"
# Particles of a part that are kept of an iteration to be drawn.
DRAWN = 200
# Among the iterations to be kept: the one a run ends with, whichever it is.
LAST = "last"
# The scene that kernels are made ready on.
WARMED_ON = "cabinet/open"


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

    scene : folder of the scan below sample_data, or anywhere by its full path; seed : of the inference, and of the
        prior's draw
    prior : whether the root is known to `metres` and `degrees` per axis, else nothing but the region of interest is
    more : `metres`, `degrees`; `budget`, seconds up to which it goes on beyond its iterations; `stop_at_rest`, whether
        it ends once converged; `posterior`, whether what the scan leaves open in the end is sampled; `keep`, iterations
        whose particles come with the result, or LAST; `views`, further scans of the same scene; `urdf`, the object's
        file where it is not beside the scan's folder; `digest` of both files
    """
    shared = {"scene": scene, "variant": variant, "seed": seed, "particles": particles, "iterations": iterations}
    return shared | {"prior": prior} | more


def perform(asked: Asked) -> Result:
    """The run. Its result is what JSON can hold.

    parts : their names; judged : whether a part is seen well enough to count; shares : how much of each is seen
    seconds : (I + 1) since the start, the preparation included; add : (I + 1, N) metres; std : (I + 1, N) metres, the
        largest standard deviation along an axis of the position of any of a part's links
    at_rest : the iteration in which it converged, or None
    kept : by iteration, `particles`, (N, T, 3) positions, `poses`, (N, 7), of the estimate, and `covariances`,
        (N, 3, 3) square metres, of the positions of the parts about it
    posterior : where asked for, what a result tells by draws given the scan: `add` and `std`, (N,) metres, `poses` and
        `covariances` likewise, and `certain`, (N,) whether all of a part's links are
    """
    variant = VARIANTS[asked["variant"]]
    case = case_of(asked)
    _warm(asked["variant"])
    keep = set(asked.get("keep", ()))
    rows: list[tuple[float, Array, Array]] = []
    kept: dict[str, Any] = {}
    for made in timed(
        case,
        _prior(case, asked),
        variant.settings,
        seed=asked["seed"],
        particles=asked["particles"],
        method=variant.method,
    ):
        report, placed = made.report, place(made.problem, made.report)
        rows.append((made.seconds, case.errors(report.map_poses), _std(case, placed.particle_std_xyz)))
        if report.iteration in keep:
            kept[str(report.iteration)] = _drawn(case, report, placed)
        if asked.get("stop_at_rest", False) and made.at_rest is not None:
            break
        if report.iteration >= asked["iterations"] and made.seconds >= asked.get("budget", 0.0):
            break
    if LAST in keep:
        kept[LAST] = _drawn(case, report, placed)
    seconds, add, std = zip(*rows, strict=True)
    more = {}
    if asked.get("posterior", False):
        told = place(made.problem, report, of_estimate(made.problem, report))
        if told.spread is not None and told.std_xyz is not None:
            more["posterior"] = {
                "add": np.round(case.errors(told.part_poses), 6).tolist(),
                "std": np.round(_std(case, told.std_xyz), 6).tolist(),
                "poses": np.round(told.part_poses, 6).tolist(),
                "covariances": _positions(case, told.spread.covariances).tolist(),
                "certain": _of_parts(case, told.certain(SessionOptions.max_std)).tolist(),
            }
    return more | {
        "parts": [part.name for part in case.model.parts],
        "judged": case.judged.tolist(),
        "shares": np.round(case.shares, 4).tolist(),
        "seconds": np.round(seconds, 5).tolist(),
        "add": np.round(add, 6).tolist(),
        "std": np.round(std, 6).tolist(),
        "at_rest": made.at_rest,
        "kept": kept,
    }


def case_of(asked: Asked) -> Case:
    """What is looked at in a run."""
    settings = preset(VARIANTS[asked["variant"]].preset)
    views = tuple(asked.get("views", ()))
    return scene_case(asked["scene"], settings.image_width, settings.triangles, asked.get("urdf"), views)


@lru_cache(maxsize=8)
def scene_case(scene: str, width: int, triangles: int, urdf: str | None = None, views: tuple[str, ...] = ()) -> Case:
    """The scene in `sample_data/<scene>` with its region of interest.

    urdf : of the object, where it is not beside the scene's folder
    views : further scans of the same scene; of a part that share counts which is seen in the scan that shows most
    """
    model = load_model(model_file(scene) if urdf is None else Path(urdf), triangle_budget=triangles)
    settings = changed(Settings(), {"image_width": width, "triangles": triangles})
    folders = [SAMPLE_DATA / one for one in (scene, *views)]
    roi = load_roi(folders[0])
    cases = [load_case(scene, model, folder, roi, settings) for folder in folders]
    if not views:
        return cases[0]
    scans = [scene_scan(one) for one in (scene, *views)]
    shares = np.max([case.shares for case in cases], axis=0)
    return replace(cases[0], observation=look(model, scans, roi, settings), shares=shares)


@lru_cache(maxsize=8)
def scene_scan(scene: str) -> Scan:
    """What its camera saw."""
    return load_scan(SAMPLE_DATA / scene / "depth.png", SAMPLE_DATA / scene / "camera.json")


def model_file(scene: str) -> Path:
    """The URDF of a sample scene's object."""
    return next((SAMPLE_DATA / scene).parent.glob("*.urdf"))


@lru_cache(maxsize=64)
def _warm(variant: str) -> None:
    """Once a process: kernels are compiled, or read from their cache, outside the time that is measured. They are the
    same for every scene."""
    settings = VARIANTS[variant].settings
    case = scene_case(WARMED_ON, settings.image_width, settings.triangles)
    warm_kernels(case, settings, VARIANTS[variant].method)


def _prior(case: Case, asked: Asked) -> UniformPrior | GaussianPrior:
    if not asked["prior"]:
        return UniformPrior("upright")
    rng = np.random.default_rng([77, asked["seed"]])
    return rough_prior(rng, case, case.model.parts[0].links[0], asked["metres"], asked["degrees"])


def _std(case: Case, std_xyz: Array) -> Array:
    """(N,) of each part, by that of its links which is spread most. std_xyz : (L, 3)"""
    links, largest = case.model.links, std_xyz.max(axis=1)
    return np.array([max(largest[links.index(link)] for link in part.links) for part in case.model.parts])


def _of_parts(case: Case, links: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(N,): whether it holds of all of a part's links, of which it does or does not (L,)."""
    return np.array([all(links[case.model.links.index(link)] for link in part.links) for part in case.model.parts])


def _positions(case: Case, covariances: Array) -> Array:
    """(N, 3, 3) of the position of each part, by its first link. covariances : (L, 6, 6)"""
    return np.round(covariances[case.first_links, :3, :3], 12)


def _drawn(case: Case, report: IterationReport, placed: Placement) -> dict[str, Any]:
    """Particles by their weights, so that a picture of points shows the belief."""
    rng = np.random.default_rng(report.iteration)
    belief = report.belief
    weights = np.exp(belief.log_weights)
    rows = [rng.choice(len(one), DRAWN, p=one / one.sum()) for one in weights]
    return {
        "particles": np.round([belief.poses[node, taken, :3] for node, taken in enumerate(rows)], 4).tolist(),
        "poses": np.round(report.map_poses, 6).tolist(),
        "covariances": _positions(case, placed.particle_covariances).tolist(),
    }
