"""How far is a belief's spread from the exact one? Measured on a chain for which the exact belief is a formula.

Parts in a row slide along x, each between limits; the unary potential of each is a Gaussian about a place of its own.
A uniform joint of half range h has the variance h²/3; with Gaussians of that variance for the joints, the exact belief
is the solution of a tridiagonal system, which is what Gaussian belief propagation computes. That the joints are
uniform and not Gaussian changes means by less than 1 mm and standard deviations by less than 4 % (a grid says so in
tests/statistical/test_gaussian.py).

Run it: `python -m benchmarks.gaussian_chain`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import belief_propagation, problem
from pmpnbp.inference.belief import START, Belief, Origin, State
from pmpnbp.inference.problem import Problem
from pmpnbp.scene.articulated_object import ArticulatedObject, Joint
from pmpnbp.scene.meshes import box
from pmpnbp.scene.observation import Observation
from pmpnbp.scene.parts import LinkSurface, assemble
from pmpnbp.scene.prior import UniformPrior
from pmpnbp.settings import Settings, changed, preset

OFFSET = 0.3
HALF_RANGE = 0.05
# Where each part's own evidence puts it off its place in the row, and how sure that is, metres.
SHIFTS = np.array([0.03, -0.02, 0.04, 0.0])
SPREADS = np.array([0.04, 0.03, 0.05, 0.04])


@dataclass(frozen=True, kw_only=True)
class GaussianProblem(Problem):
    """A problem whose unary potentials are Gaussians of the position. means : (N, 3), stds : (N,), metres."""

    means: Array
    stds: Array

    def unary(self, node: Array, part_poses: Array, tolerance: float, renderer: str, points: int = 0) -> Array:
        """As `Problem.unary`: the log potential, whatever the tolerance and the renderer."""
        number = np.asarray(node, dtype=np.int64)
        offset = (part_poses[:, :3] - self.means[number]) / self.stds[number, None]
        return -0.5 * np.sum(offset**2, axis=1)


def row_of_parts(count: int, half_range: float = HALF_RANGE) -> ArticulatedObject:
    """`count` small blocks, each sliding along x by ±`half_range` about OFFSET from the one before."""
    joints = tuple(
        Joint(
            f"slide{k}",
            "prismatic",
            f"part{k - 1}",
            f"part{k}",
            poses.from_xyz_rpy([OFFSET, 0, 0], [0, 0, 0]),
            np.array([1.0, 0, 0]),
            -half_range,
            half_range,
            (k - 1,),
        )
        for k in range(1, count)
    )
    block = LinkSurface(exact=(box([0.1, 0.1, 0.1]),))
    return assemble("row", "part0", joints, {f"part{k}": block for k in range(count)}, 100, 1.0)


def gaussian_problem(
    settings: Settings, shifts: Array, stds: Array, particles: int, seed: int = 0, half_range: float = HALF_RANGE
) -> GaussianProblem:
    """A row of parts whose evidence is `shifts` (N,) off their places, with standard deviations `stds` (N,), metres."""
    up = np.array([0.0, 0.0, 1.0])
    nothing = Observation((), np.zeros((1, 3)), up[None], np.zeros((0, 4)), up, None)
    built = problem.build(
        row_of_parts(len(shifts), half_range),
        nothing,
        UniformPrior("upright"),
        settings,
        particles=particles,
        seed=seed,
    )
    means = np.zeros((len(shifts), 3))
    means[:, 0] = OFFSET * np.arange(len(shifts)) + shifts
    return GaussianProblem(**vars(built), means=means, stds=np.asarray(stds))


def exact(shifts: Array, stds: Array, half_range: float = HALF_RANGE) -> tuple[Array, Array]:
    """Means off each part's place in the row and standard deviations (N,), metres, of the Gaussian chain."""
    count = len(shifts)
    precision = np.diag(1.0 / np.asarray(stds) ** 2)
    for k in range(count - 1):
        coupling = 3.0 / half_range**2
        precision[k : k + 2, k : k + 2] += coupling * np.array([[1.0, -1.0], [-1.0, 1.0]])
    covariance = np.linalg.inv(precision)
    return covariance @ (np.asarray(shifts) / np.asarray(stds) ** 2), np.sqrt(np.diag(covariance))


def start(rng: np.random.Generator, made: GaussianProblem, spread: float = 0.06) -> State:
    """Particles scattered about every part's place, all of one orientation."""
    nodes, count = made.mrf.nodes, made.particles
    particles = np.tile(poses.IDENTITY, (nodes, count, 1))
    particles[..., :3] = spread * rng.standard_normal((nodes, count, 3))
    particles[..., 0] += OFFSET * np.arange(nodes)[:, None]
    belief = Belief(
        poses=particles,
        log_weights=np.full((nodes, count), -np.log(count)),
        log_unary=np.zeros((nodes, count)),
        origin=Origin.of((nodes, count), START),
    )
    return State(iteration=0, belief=belief)


def measured(made: GaussianProblem, iterations: int, settle: int) -> tuple[Array, Array]:
    """Mean off its place and standard deviation along x (N,) of every part's belief, metres: averages over all
    iterations after the first `settle`."""
    state = start(np.random.default_rng([made.seed, 0]), made)
    means, variances = [], []
    for number in range(1, iterations + 1):
        state, report = belief_propagation.step(np.random.default_rng([made.seed, number]), state, made)
        if number > settle:
            weights = np.exp(report.belief.log_weights)
            along = report.belief.poses[..., 0] - OFFSET * np.arange(made.mrf.nodes)[:, None]
            mean = np.sum(weights * along, axis=1)
            means.append(mean)
            variances.append(np.sum(weights * (along - mean[:, None]) ** 2, axis=1))
    return np.mean(means, axis=0), np.sqrt(np.mean(variances, axis=0))


# Belief propagation alone, at its last and tightest settings, with no turning: what is left is one dimension.
ALONE = {
    "search_iterations": 0,
    "anneal_iterations": 0,
    "refine_iterations": 0,
    "object_estimate": False,
    "diffusion_rotation_start": 0.0,
    "diffusion_rotation_end": 0.0,
}


def variants() -> dict[str, Settings]:
    """Settings to compare, by name."""
    paper, robust = changed(preset("paper"), ALONE), changed(preset("robust"), ALONE)
    found = {"paper": paper}
    for diffusion in (0.001, 0.003, 0.03):
        found[f"paper, diffusion {diffusion * 1000:.0f} mm"] = changed(paper, {"diffusion_position_end": diffusion})
    found["paper, messages without phi"] = changed(paper, {"messages_keep_unary": False})
    found["paper, product"] = changed(paper, {"belief_product": "shared"})
    found["robust"] = robust
    found["robust, untempered"] = changed(robust, {"effective_share": 0.0})
    without_memory = changed(robust, {"joint_memory": 0.0})
    found["robust, joint_memory 0"] = without_memory
    found["robust, joint_memory 0, neighbour_proposals 0"] = changed(without_memory, {"neighbour_proposals": 0.0})
    return found


def main() -> None:
    """Print the table of docs/algorithm.md."""
    mean, std = exact(SHIFTS, SPREADS)
    print(f"exact: mean {np.round(mean * 1000, 1)} mm, std {np.round(std * 1000, 1)} mm")
    print("| settings | largest error of a mean (mm) | std / exact std, ends | std / exact std, middle |")
    print("| --- | --- | --- | --- |")
    for name, settings in variants().items():
        made = [gaussian_problem(settings, SHIFTS, SPREADS, 1000, seed) for seed in range(3)]
        found = [measured(each, 60, 30) for each in made]
        error = np.abs(np.mean([m for m, _ in found], axis=0) - mean).max()
        ratio = np.sqrt(np.mean([s**2 for _, s in found], axis=0)) / std
        print(f"| {name} | {error * 1000:.1f} | {ratio[[0, -1]].mean():.2f} | {ratio[1:-1].mean():.2f} |", flush=True)


if __name__ == "__main__":
    main()
