"""Which runs does the experiment "convergence" make, and what came of each? By scene and variant."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.reproduce.experiment import Options
from benchmarks.reproduce.scene_runs import asked_of
from benchmarks.statistics import at_times
from pmpnbp.geometry.poses import Array
from pmpnbp.runs.run_log import Asked, Result, RunLog

SCENES = ("cabinet/open", "cabinet/self_occluded")
MORE_SCENES = (
    "cabinet/arm",
    "cabinet/blanket",
    "cabinet/closed",
    "cabinet/from_above",
    "door/ajar",
    "robot/scan_0",
    "robot/scan_1",
    "robot/partial",
)
ITERATIONS, PARTICLES = 100, 400
WHOLE = ("robust", "paper", "filter")
# Each method by itself: from a rough prior, in so many iterations; metres and degrees per axis.
ALONE, ALONE_ITERATIONS, ROUGH = ("robust_alone", "filter_alone"), 20, (0.08, 8.6)
# Points in time at which runs are compared.
TIMES = 120


def iterations(options: Options) -> int:
    """Of a run."""
    return options.iterations or ITERATIONS


def scenes(options: Options) -> Sequence[str]:
    """The paper's kind of scene, or every sample."""
    return (*SCENES, *MORE_SCENES) if options.everything else SCENES


def belief_propagation(options: Options, _: RunLog) -> list[Asked]:
    """Both presets of PMPNBP."""
    return [
        _asked(options, scene, variant, seed)
        for scene in scenes(options)
        for variant in ("robust", "paper")
        for seed in options.seeds
    ]


def particle_filter(options: Options, run_log: RunLog) -> list[Asked]:
    """The filter with as many iterations, and on for as long as the preset `robust` took for its own."""
    found = []
    for scene in scenes(options):
        results = run_log.results([_asked(options, scene, "robust", seed) for seed in options.seeds])
        spent = [result["seconds"][-1] for result in results]
        budget = round(float(np.median(spent)), 3)
        found += [_asked(options, scene, "filter", seed, budget) for seed in options.seeds]
    return found


def alone(options: Options, _: RunLog) -> list[Asked]:
    """Both methods without search and whole-object estimate."""
    metres, degrees = ROUGH
    return [
        asked_of(
            scene,
            variant,
            seed,
            particles=options.particles or PARTICLES,
            prior=True,
            metres=metres,
            degrees=degrees,
            iterations=min(iterations(options), ALONE_ITERATIONS),
        )
        for scene in scenes(options)
        for variant in ALONE
        for seed in options.seeds
    ]


def _asked(options: Options, scene: str, variant: str, seed: int, budget: float = 0.0) -> Asked:
    known: dict[str, Any] = {"prior": True, "metres": 0.10, "degrees": 10.0} if scene.startswith("robot/") else {}
    keep = [0, iterations(options)] if seed == options.seed else []
    return asked_of(
        scene,
        variant,
        seed,
        particles=options.particles or PARTICLES,
        iterations=iterations(options),
        keep=keep,
        budget=budget,
        **known,
    )


@dataclass(frozen=True)
class Runs:
    """The runs of one variant on one scene, by seed.

    add : (R, I + 1) metres, the mean over the judged parts after each iteration; worst : the same of the largest
    seconds : (R, I + 1); at_time : (R, K) metres, `add` at the times that all variants of the scene are compared at
    """

    results: Sequence[Result]
    add: Array
    worst: Array
    seconds: Array
    at_time: Array
    worst_at_end: Array


def gathered(options: Options, run_log: RunLog) -> dict[str, dict[str, Runs]]:
    """By scene and variant."""
    asked = [*belief_propagation(options, run_log), *particle_filter(options, run_log)]
    found: dict[str, dict[str, Runs]] = {}
    for scene in scenes(options):
        results = {
            variant: run_log.results([one for one in asked if (one["scene"], one["variant"]) == (scene, variant)])
            for variant in WHOLE
        }
        times = time_grid(results["robust"])
        found[scene] = {variant: _runs(some, iterations(options), times) for variant, some in results.items()}
    return found


def time_grid(results: Sequence[Result]) -> Array:
    """(TIMES,) seconds, from the first that all have an estimate at to the median end."""
    end = float(np.median([result["seconds"][-1] for result in results]))
    return np.linspace(0.0, end, TIMES)


def _runs(results: Sequence[Result], count: int, times: Array) -> Runs:
    add, worst, seconds, at_time, at_end = [], [], [], [], []
    for result in results:
        judged = np.array(result["judged"])
        errors, spent = np.array(result["add"])[:, judged], np.array(result["seconds"])
        add.append(errors.mean(axis=1)[: count + 1])
        worst.append(errors.max(axis=1)[: count + 1])
        seconds.append(spent[: count + 1])
        at_time.append(at_times(spent, errors.mean(axis=1), times))
        at_end.append(float(at_times(spent, errors.max(axis=1), times[-1:])[0]))
    return Runs(results, *(np.array(one) for one in (add, worst, seconds, at_time, at_end)))


def alone_ends(options: Options, run_log: RunLog) -> dict[str, Array]:
    """By variant, (R,) metres: the largest error of a part that counts when a run of `alone` ends, all scenes."""
    found: dict[str, list[float]] = {variant: [] for variant in ALONE}
    every = alone(options, run_log)
    for asked, result in zip(every, run_log.results(every), strict=True):
        found[asked["variant"]].append(float(np.array(result["add"])[-1, np.array(result["judged"])].max()))
    return {variant: np.array(ends) for variant, ends in found.items()}


def beside_filter(runs: Mapping[str, Runs], variant: str) -> list[tuple[str, Array, Array]]:
    """Final errors (R,) of a variant and of the filter."""
    own, other = runs[variant], runs["filter"]
    return [
        ("equal iterations", own.add[:, -1], other.add[:, -1]),
        ("equal time", own.at_time[:, -1], other.at_time[:, -1]),
    ]
