"""How sure is a belief? Covariances, separate hypotheses and joint spreads of weighted particles.

All of these describe the particles as they are. The particles' spread follows the diffusion of the algorithm and is no
error bar; `object_posterior` has one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import Array
from pmpnbp.inference import log_weights as lw
from pmpnbp.inference.belief import Belief
from pmpnbp.inference.joint_draws import short_way_round
from pmpnbp.potentials.joint_projection import project
from pmpnbp.scene.articulated_object import ArticulatedObject, Edge

# Particles nearer than this to a hypothesis' heaviest one belong to it.
MODE_DISTANCE = 0.05
MODE_ANGLE = np.radians(20.0)
MODES = 5
# Clusters looked at before the heaviest are chosen, and the weight below which one is no hypothesis.
CLUSTERS = 50
LEAST_WEIGHT = 0.01


@dataclass(frozen=True)
class Mode:
    """One hypothesis. weight : its particles' sum; members : (T,) bool, which they are."""

    weight: float
    members: NDArray[np.bool_]


def covariance(estimate: Array, particles: Array, weights: Array) -> Array:
    """(..., 6, 6): weighted second moments of poses (T, ..., 7) about the poses `estimate` (..., 7), weights (T,) not
    all zero.

    ROS's order: x, y, z, then the rotation about axes through the estimate's origin parallel to the world's X, Y, Z.
    Square metres, metre-radians, square radians.
    """
    offset = particles[..., :3] - estimate[..., :3]
    turn = poses.quaternion_multiply(particles[..., 3:], poses.quaternion_conjugate(estimate[..., 3:]))
    deviation = np.moveaxis(np.concatenate([offset, poses.to_rotation_vector(turn)], axis=-1), 0, -2)
    moment = np.swapaxes(deviation, -1, -2) @ ((weights / weights.sum())[:, None] * deviation)
    return (moment + np.swapaxes(moment, -1, -2)) / 2


def std_xyz(covariances: Array) -> Array:
    """(..., 3) standard deviations of the position along the world's axes, metres, of covariances (..., 6, 6)."""
    variances = np.diagonal(covariances, axis1=-2, axis2=-1)[..., :3]
    return np.sqrt(np.maximum(variances, 0.0))


def modes(particles: Array, weights: Array, centre: Array) -> list[Mode]:
    """At most five hypotheses in the particles (T, 7) of a part, heaviest first.

    Greedy: the heaviest particle not yet taken, and all that are within 5 cm of it at the part's `centre` (3,) and
    within 20°, are one. Those under a hundredth of the weight are left out, but for the heaviest.
    """
    weights = weights / weights.sum()
    middle = poses.transform_points(particles, centre)
    left = weights > 0
    found: list[Mode] = []
    # none of what is left can be kept where all of it together weighs too little
    while left.any() and len(found) < CLUSTERS and not (found and weights[left].sum() < LEAST_WEIGHT / 2):
        seed = int(np.where(left, weights, -1.0).argmax())
        near = np.linalg.norm(middle - middle[seed], axis=1) < MODE_DISTANCE
        near &= poses.rotation_angle(particles[:, 3:], particles[seed, 3:]) < MODE_ANGLE
        near[seed] = True
        near &= left
        found.append(Mode(float(weights[near].sum()), near))
        left &= ~near
    found.sort(key=lambda mode: -mode.weight)
    return found[:1] + [mode for mode in found[1:MODES] if mode.weight >= LEAST_WEIGHT]


def joint_stds(rng: np.random.Generator, model: ArticulatedObject, belief: Belief, estimate: Array) -> Array:
    """Standard deviations (D,) of the joint vector about its `estimate` (D,), metres or radians, never negative.

    Where a belief's particles are whole objects, those of their joint positions. Else pairs of particles of the two
    parts a joint connects are drawn, each from its own belief and independently of the other, and brought to the
    joint: as the beliefs of two neighbours move together, that is more rather than less than the joint's own spread. A
    coordinate that no edge between two parts has (nothing of it can be seen) has that of its whole range, however near
    to each other resampling has brought the particles in it.
    """
    found = np.full(model.dof, np.inf)
    if belief.joint_positions is not None:
        seen = np.array([c for edge in model.edges for c in edge.coordinates[edge.multiplier != 0]], dtype=np.int64)
        offset = short_way_round(belief.joint_positions - estimate, model.wraps)
        weights = np.exp(belief.log_weights[0])
        found[seen] = np.sqrt(np.einsum("t,td->d", weights / weights.sum(), offset**2))[seen]
    else:
        for edge in model.edges:
            spread = _edge_spread(rng, edge, belief, edge.axis_positions(estimate))
            for axis, coordinate in enumerate(edge.coordinates):
                if edge.multiplier[axis] != 0:
                    found[coordinate] = min(found[coordinate], spread[axis] / abs(edge.multiplier[axis]))
    return np.where(np.isfinite(found), found, (model.upper - model.lower) / np.sqrt(12.0))


def joint_draws(rng: np.random.Generator, edge: Edge, belief: Belief) -> Array:
    """(T, K), at most 400 of equal weight: axis positions of an edge at pairs of particles of the two parts that it
    connects, each drawn from its own belief, independently of the other."""
    ends = [edge.parent, edge.child]
    count = min(belief.log_weights.shape[1], 400)
    taken = rng.permuted(lw.systematic(rng, belief.log_weights[ends], count), axis=1)
    parent, child = (belief.poses[end, rows] for end, rows in zip(ends, taken, strict=True))
    axes, _, _ = project(edge, poses.multiply(poses.inverse(parent), child))
    return axes


def _edge_spread(rng: np.random.Generator, edge: Edge, belief: Belief, estimate: Array) -> Array:
    return np.sqrt(np.mean(short_way_round(joint_draws(rng, edge, belief) - estimate, edge.wraps) ** 2, axis=0))
