"""What pull and push are both given, so that only the message update differs: the figure, the unary potential, the
number of components, the first beliefs and the schedule that goes from loose to tight."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.reproduce.planar.pattern import Pattern, wrap
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import log_weights as lw

# log φ (K,) of a node at poses (K, 3), and the sharpness at which it is asked
Unary = Callable[[int, Array, float], Array]


@dataclass(frozen=True)
class Span:
    """A quantity that goes from `first` to `last` geometrically over the schedule's iterations."""

    first: float
    last: float

    def at(self, done: float) -> float:
        """Its value when `done` of the schedule, 0..1, is behind."""
        return float(self.first * (self.last / self.first) ** done)


@dataclass(frozen=True)
class Settings:
    """How an inference is run, whichever way its messages go.

    Tried on figures with 20 distractors and M = 200. Pull has to reach the figure by diffusion and needs to begin wide:
    from 10 pixels of ψ and 8 of noise it found a third of the nodes, from 40 and 30 three quarters. Push found 0.76 of
    them (standard error 0.06) from the wide beginning and 0.60 (0.08) from the narrow one, with M = 100 0.48 and 0.58
    (0.07 each): no difference to speak of, so that both have the same. Four times the Gibbs sweeps found no more.
    """

    components: int = 100  # M, samples or Gaussians of a message
    anneal: int = 40  # iterations until the last values are reached
    sigma_position: Span = Span(40.0, 2.5)  # pixels, standard deviation of ψ
    sigma_angle: Span = Span(0.6, 0.1)  # radians, of ψ beyond a joint's limits
    diffusion_position: Span = Span(30.0, 1.0)  # pixels, pull's noise and the widest kernel of push
    diffusion_angle: Span = Span(1.0, 0.05)  # radians, likewise
    sharpness: Span = Span(10.0, 20.0)  # factor on the score in log φ
    gibbs_sweeps: int = 5  # push only: κ of Sudderth et al. 2003


@dataclass(frozen=True)
class Plan:
    """The settings of one iteration."""

    sigma_position: float
    sigma_angle: float
    diffusion: Array  # (3,) pixels, pixels, radians
    sharpness: float


@dataclass(frozen=True)
class PlanarProblem:
    """A figure to be found in a picture of `size` pixels square."""

    pattern: Pattern
    log_unary: Unary
    settings: Settings
    size: int

    def plan(self, iteration: int) -> Plan:
        """The plan of iterations 1, 2, …"""
        settings = self.settings
        done = min((iteration - 1) / max(settings.anneal - 1, 1), 1.0)
        position, angle = settings.diffusion_position.at(done), settings.diffusion_angle.at(done)
        return Plan(
            settings.sigma_position.at(done),
            settings.sigma_angle.at(done),
            np.array([position, position, angle]),
            settings.sharpness.at(done),
        )


@dataclass(frozen=True)
class Samples:
    """A weighted set: poses (K, 3) in pixels and radians, and normalised log weights (K,)."""

    poses: Array
    log_weights: Array


@dataclass(frozen=True)
class Report:
    """What an iteration cost."""

    unary_evaluations: int  # poses at which φ was asked
    pair_evaluations: int  # terms of the sums over components


def uniform(rng: np.random.Generator, problem: PlanarProblem) -> tuple[Samples, ...]:
    """Beliefs before the first iteration: M poses of every node, uniform over the picture and all turns."""
    count = problem.settings.components
    return tuple(
        Samples(
            rng.uniform((0.0, 0.0, -np.pi), (problem.size, problem.size, np.pi), (count, 3)),
            np.full(count, -np.log(count)),
        )
        for _ in range(problem.pattern.nodes)
    )


def resample(rng: np.random.Generator, samples: Samples, count: int, noise: Array) -> Array:
    """Poses (count, 3) drawn from `samples` in random order, with Gaussian noise of standard deviations (3,): box 2,
    step 4, or draws of a kernel density."""
    drawn = rng.permuted(lw.systematic(rng, samples.log_weights, count))
    poses = samples.poses[drawn] + noise * rng.standard_normal((count, 3))
    poses[:, 2] = wrap(poses[:, 2])
    return poses
