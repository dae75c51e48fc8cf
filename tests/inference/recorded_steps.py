"""Steps of belief propagation on a tiny problem, with all their random draws kept for a slow twin to use again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pytest

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import belief_propagation
from pmpnbp.inference.belief import START, Belief, IterationReport, Origin, State
from pmpnbp.inference.belief_propagation import Samples
from pmpnbp.inference.problem import Problem
from pmpnbp.potentials.pairwise import log_potential
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.settings import schedule
from tests.inference.slow_boxes import SlowBoxes


@dataclass(frozen=True)
class Recorded:
    """A step and what was drawn in it: samples of every slot, and joint draws (E, M, D, K) of every message."""

    state: State
    report: IterationReport
    samples: Samples
    axes: Array


def scattered_state(
    rng: np.random.Generator, problem: Problem, spread: float = 0.05, iteration: int = 0, count: int | None = None
) -> State:
    """A state whose particles lie about a random configuration of the object, with random weights."""
    model, count = problem.mrf.model, count or problem.particles
    root = poses.from_xyz_rpy(rng.uniform(-0.5, 0.5, 3), rng.uniform(-1, 1, 3))
    middle = model.part_poses(root, rng.uniform(model.lower, model.upper))
    shape = (len(model.parts), count)
    noise = spread * rng.standard_normal((2, *shape, 3))
    weights = rng.dirichlet(np.ones(count), size=shape[0])
    belief = Belief(
        poses=poses.perturb(middle[:, None], noise[0], noise[1]),
        log_weights=np.log(weights),
        log_unary=np.zeros(shape),
        origin=Origin.of(shape, START),
    )
    return State(iteration=iteration, belief=belief)


def recorded_steps(
    monkeypatch: pytest.MonkeyPatch, problem: Problem, state: State, steps: int, seed: int = 3
) -> Iterator[Recorded]:
    """`steps` steps from `state` on."""
    kept: list[tuple[Samples, list[Array]]] = []
    draw, draw_axes = belief_propagation.draw, belief_propagation.draw_axes

    def recording_draw(*arguments: object) -> Samples:
        samples = draw(*arguments)  # type: ignore[arg-type]
        kept.append((samples, []))
        return samples

    def recording_axes(*arguments: object) -> Array:
        axes = draw_axes(*arguments)  # type: ignore[arg-type]
        if kept:
            kept[-1][1].append(axes)
        return axes

    monkeypatch.setattr(belief_propagation, "draw", recording_draw)
    monkeypatch.setattr(belief_propagation, "draw_axes", recording_axes)
    for _ in range(steps):
        kept.clear()
        rng = np.random.default_rng([seed, state.iteration + 1])
        state, report = belief_propagation.step(rng, state, problem)
        # draw() itself asks for joint draws too, before it returns and is kept; what follows is the messages'
        yield Recorded(state, report, kept[-1][0], kept[-1][1][-1])


def slow_twin(problem: Problem, model: ArticulatedObject, iteration: int) -> SlowBoxes:
    """The boxes for a problem, its potentials as functions of single poses; sigmas of the iteration's schedule."""
    plan = schedule(problem.settings, iteration)
    between = {}
    for edge in model.edges:
        between[edge.parent, edge.child] = between[edge.child, edge.parent] = edge

    def phi(node: int, pose: Array) -> float:
        score = problem.unary(np.array([node], dtype=np.int32), pose[None], plan.tolerance, problem.settings.renderer)
        return float(np.exp(score[0]))

    def psi(t: int, s: int, pose_t: Array, pose_s: Array) -> float:
        edge = between[t, s]
        parent, child = (pose_t, pose_s) if t == edge.parent else (pose_s, pose_t)
        log_psi = log_potential(
            edge,
            parent,
            child,
            form=problem.settings.pairwise_form,
            sigma_position=plan.sigma_position,
            sigma_orientation=plan.sigma_orientation,
        )
        return float(np.exp(log_psi))

    def sample(t: int, s: int, pose_s: Array, draw: Array) -> Array:
        edge = between[t, s]
        pose_parent_child = edge.pose_parent_child(draw[: len(edge.axes)])
        return poses.multiply(pose_s, poses.inverse(pose_parent_child) if t == edge.parent else pose_parent_child)

    neighbours: dict[int, list[int]] = {node: [] for node in range(len(model.parts))}
    for edge in model.edges:
        neighbours[edge.parent].append(edge.child)
        neighbours[edge.child].append(edge.parent)
    return SlowBoxes(neighbours, phi, psi, sample)
