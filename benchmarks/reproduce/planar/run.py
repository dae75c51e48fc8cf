"""One trial of the comparison: a figure, its clutter and one method, with the error and the seconds of an iteration."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np
from numba import njit

from benchmarks.reproduce.planar import pull, push
from benchmarks.reproduce.planar.pattern import configuration, four_arms
from benchmarks.reproduce.planar.picture import SIZE, Scene, draw_scene, log_unary
from benchmarks.reproduce.planar.problem import PlanarProblem, Report, Samples, Settings
from pmpnbp.geometry.poses import Array

Method = Literal["pull", "push"]
METHODS: tuple[Method, ...] = ("pull", "push")

_MODE = 6.0  # pixels, standard deviation of the kernel that finds a belief's highest mode


@dataclass(frozen=True)
class Trial:
    """What a run left: per iteration the error, in pixels, of the nodes' centres and the seconds it took."""

    seed: int
    method: Method
    components: int
    clutter: int
    errors: Array  # (iterations, N)
    seconds: Array  # (iterations,)
    reports: tuple[Report, ...]
    estimate: Array  # (N, 3) of the last iteration

    @property
    def mean_error(self) -> Array:
        """(iterations,) pixels, mean over the nodes."""
        return self.errors.mean(axis=1)


@njit(cache=True, nogil=True)
def _densities(poses, weights, scale, out):  # type: ignore[no-untyped-def]
    for i in range(len(poses)):
        total = 0.0
        for j in range(len(poses)):
            dx, dy = poses[j, 0] - poses[i, 0], poses[j, 1] - poses[i, 1]
            cost = scale * (dx * dx + dy * dy)
            if cost < 20.0:
                total += weights[j] * np.exp(-cost)
        out[i] = total


def top_mode(belief: Samples) -> Array:
    """(3,) the weighted mean of the samples around the place where the belief's samples are densest.

    The mean of all would lie between modes, and the heaviest sample is one draw's luck.
    """
    weights = np.exp(belief.log_weights)
    density = np.empty(len(weights))
    _densities(belief.poses, weights, 0.5 / _MODE**2, density)
    top = belief.poses[int(density.argmax())]
    near = weights * np.exp(-0.5 * np.sum((belief.poses[:, :2] - top[:2]) ** 2, axis=1) / _MODE**2)
    near /= near.sum()
    turn = np.angle(np.sum(near * np.exp(1j * belief.poses[:, 2])))
    return np.array([*(near @ belief.poses[:, :2]), float(turn)])


def scene(seed: int, clutter: int) -> Scene:
    """The picture of a seed: the same for both methods and every number of components."""
    rng = np.random.default_rng([seed, 0])
    pattern = four_arms()
    return draw_scene(rng, pattern, configuration(rng, pattern, SIZE), clutter)


def trial(
    seed: int, method: Method, components: int, iterations: int, clutter: int, settings: Settings | None = None
) -> Trial:
    """Runs a method on the picture of `seed` with `clutter` distractors, with `settings` in the place of the
    defaults but for the number of components. Compile first: see `warm_up`."""
    if method not in METHODS:
        raise ValueError(f"method {method!r} is not known; there are {', '.join(METHODS)}")
    seen = scene(seed, clutter)
    pattern = four_arms()
    settings = replace(settings or Settings(), components=components)
    problem = PlanarProblem(pattern, partial(log_unary, seen.picture, pattern), settings, SIZE)
    way = pull if method == "pull" else push
    state = way.start(np.random.default_rng([seed, 1]), problem)
    errors, seconds, reports = np.empty((iterations, pattern.nodes)), np.empty(iterations), []
    estimate = np.empty((pattern.nodes, 3))
    for iteration in range(iterations):
        rng = np.random.default_rng([seed, 2 + iteration])
        began = time.perf_counter()
        state, report = way.step(rng, state, problem)
        seconds[iteration] = time.perf_counter() - began
        reports.append(report)
        estimate = np.stack([top_mode(belief) for belief in state.beliefs])
        errors[iteration] = np.hypot(*(estimate - seen.truth)[:, :2].T)
    return Trial(seed, method, components, clutter, errors, seconds, tuple(reports), estimate)


def warm_up() -> None:
    """Compiles what both methods call, so that no trial is charged with it."""
    for method in METHODS:
        trial(0, method, 4, 2, 1)
