"""The runs of `pmpnbp reproduce push`: which there are, how one is made, and their errors and seconds together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from benchmarks.reproduce.experiment import Options
from benchmarks.reproduce.planar import run as planar
from pmpnbp.geometry.poses import Array
from pmpnbp.runs.run_log import Asked, Result, RunLog

COMPONENTS = (25, 50, 100, 200, 400)
ITERATIONS, CLUTTER = 45, 20
# Pixels: a node nearer than this to its place is found; and the share of nodes that makes a run a success.
FOUND, SHARE = 10.0, 7 / 9


def perform(asked: Asked) -> Result:
    """One run: `errors` (I, N) pixels and `seconds` (I,) of its iterations, `unary` and `pairs`, how often the unary
    potential and a pair of components were asked in an iteration, and the estimate (N, 3)."""
    _warm()
    trial = planar.trial(asked["seed"], asked["method"], asked["components"], asked["iterations"], asked["clutter"])
    return {
        "errors": np.round(trial.errors, 3).tolist(),
        "seconds": np.round(trial.seconds, 6).tolist(),
        "unary": trial.reports[-1].unary_evaluations,
        "pairs": trial.reports[-1].pair_evaluations,
        "estimate": np.round(trial.estimate, 3).tolist(),
    }


@lru_cache(maxsize=1)
def _warm() -> None:
    planar.warm_up()


def every_run(options: Options, _: RunLog) -> list[Asked]:
    """Both methods on the same pictures, with every number of components."""
    return [
        {
            "method": method,
            "components": components,
            "seed": seed,
            "clutter": CLUTTER,
            "iterations": options.iterations or ITERATIONS,
        }
        for components in components_of(options)
        for seed in options.seeds
        for method in planar.METHODS
    ]


def components_of(options: Options) -> tuple[int, ...]:
    """The numbers of components that are compared."""
    return COMPONENTS if options.particles is None else (options.particles // 2, options.particles)


@dataclass(frozen=True)
class Runs:
    """Of one method and number of components: errors (R, I, N) pixels; seconds (R, I) of each iteration."""

    errors: Array
    seconds: Array
    unary: int
    pairs: int

    @property
    def mean_error(self) -> Array:
        """(R, I) pixels, over the nodes."""
        return self.errors.mean(axis=2)

    @property
    def final(self) -> Array:
        """(R,) pixels, the same at the end."""
        return self.mean_error[:, -1]

    @property
    def nodes_found(self) -> Array:
        """(R,) share of the nodes that are found at the end."""
        return np.mean(self.errors[:, -1] < FOUND, axis=1)

    @property
    def spent(self) -> Array:
        """(I,) seconds up to each iteration, medians over the runs."""
        return np.cumsum(np.median(self.seconds, axis=0))

    @property
    def run_seconds(self) -> float:
        """Median of a whole run."""
        return float(np.median(self.seconds.sum(axis=1)))

    @property
    def iteration_seconds(self) -> float:
        """Median over all iterations."""
        return float(np.median(self.seconds))

    @property
    def successes(self) -> int:
        """Runs that end with seven of nine nodes found: more than half of the arms, and the circle."""
        return int(np.sum(self.nodes_found >= SHARE - 1e-9))


Found = Mapping[str, Mapping[int, Runs]]


def gathered(options: Options, run_log: RunLog) -> Found:
    """By method and number of components."""
    found: dict[str, dict[int, Runs]] = {method: {} for method in planar.METHODS}
    asked = every_run(options, run_log)
    for method, by_components in found.items():
        for components in components_of(options):
            results = run_log.results(
                [one for one in asked if (one["method"], one["components"]) == (method, components)]
            )
            by_components[components] = Runs(
                np.array([result["errors"] for result in results]),
                np.array([result["seconds"] for result in results]),
                results[0]["unary"],
                results[0]["pairs"],
            )
    return found
