"""Gaussian mixtures over poses, and draws from the product of several by Gibbs sampling (Sudderth et al. 2003).

The product of d mixtures of M Gaussians is a mixture of M^d. The sampler holds one label per mixture and redraws
them in turn, each from its M conditional weights given the others, which are in closed form; after κ sweeps a pose is
drawn from the product of the d Gaussians that the labels name. One draw costs d κ M terms. All Gaussians of a mixture
have the same standard deviations along x, y and theta, as in a kernel density. An angle's Gaussian is taken at its
nearest wrap, which is exact while standard deviations stay well under half a turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks.reproduce.planar.pattern import wrap
from pmpnbp.geometry.poses import Array

_FARTHEST = 40.0  # minus log of the ratio to the likeliest label at which a label is left out, as in pull.py


@dataclass(frozen=True)
class Mixture:
    """Σ_i w_i N(means_i, diag(spread²)) of eq. 2: means (M, 3), pixels and radians, normalised log weights (M,),
    standard deviations (3,)."""

    means: Array
    log_weights: Array
    spread: Array


def rule_of_thumb(poses: Array, log_weights: Array, least: Array, most: Array) -> Array:
    """Standard deviations (3,) of the kernels of a density from weighted poses (M, 3), in `least`..`most`.

    0.9 min(standard deviation, interquartile range / 1.34) M^(-1/(4+d)) with d = 3 and the effective M (Silverman 1986,
    eq. 3.31 carried to d dimensions). The range keeps a density of few narrow modes from being smeared over all that
    lies between them; angles are measured from their mean direction.
    """
    weights = np.exp(log_weights)
    mean_turn = np.angle(np.sum(weights * np.exp(1j * poses[:, 2])))
    centred = np.column_stack([poses[:, :2], wrap(poses[:, 2] - mean_turn)])
    centred = centred - weights @ centred
    deviation = np.sqrt(weights @ centred**2)
    order = np.argsort(centred, axis=0)
    below = np.cumsum(weights[order], axis=0)
    quartiles = [
        np.array([centred[order[min(int(np.searchsorted(below[:, k], q)), len(poses) - 1), k], k] for k in range(3)])
        for q in (0.25, 0.75)
    ]
    scale = np.minimum(deviation, (quartiles[1] - quartiles[0]) / 1.34)
    effective = 1.0 / np.sum(weights**2)
    return np.clip(0.9 * scale * effective ** (-1 / 7), least, most)


@njit(cache=True, nogil=True)
def _gibbs(means, costs, precisions, uniforms, labels):  # type: ignore[no-untyped-def]
    """Redraws labels (K, d) in place; means (d, M, 3), costs (d, M) minus log weights, uniforms (K, sweeps, d)."""
    draws, factors = labels.shape
    components = means.shape[1]
    turn = 2 * np.pi
    cost = np.empty(components)
    for k in range(draws):
        for sweep in range(uniforms.shape[1]):
            for i in range(factors):
                # the product of the other labels' Gaussians
                px, py, pt = 0.0, 0.0, 0.0
                x, y, theta = 0.0, 0.0, 0.0
                around = means[(i + 1) % factors, labels[k, (i + 1) % factors], 2]
                for j in range(factors):
                    if j != i:
                        label = labels[k, j]
                        px += precisions[j, 0]
                        py += precisions[j, 1]
                        pt += precisions[j, 2]
                        x += precisions[j, 0] * means[j, label, 0]
                        y += precisions[j, 1] * means[j, label, 1]
                        apart = means[j, label, 2] - around
                        theta += precisions[j, 2] * (apart - turn * np.rint(apart / turn))
                x, y, theta = x / px, y / py, around + theta / pt
                bx = 0.5 / (1 / px + 1 / precisions[i, 0])
                by = 0.5 / (1 / py + 1 / precisions[i, 1])
                bt = 0.5 / (1 / pt + 1 / precisions[i, 2])
                least = np.inf
                for m in range(components):
                    dx, dy, dt = means[i, m, 0] - x, means[i, m, 1] - y, means[i, m, 2] - theta
                    dt -= turn * np.rint(dt / turn)
                    c = costs[i, m] + bx * dx * dx + by * dy * dy + bt * dt * dt
                    cost[m] = c
                    least = min(least, c)
                total = 0.0
                for m in range(components):
                    above = cost[m] - least
                    if above < _FARTHEST:
                        total += np.exp(-above)
                    cost[m] = total
                wanted = uniforms[k, sweep, i] * total
                labels[k, i] = min(np.searchsorted(cost, wanted, side="right"), components - 1)


def draw_product(
    rng: np.random.Generator, mixtures: Sequence[Mixture], tilt: Sequence[Array], count: int, sweeps: int
) -> tuple[Array, NDArray[np.int64]]:
    """Poses (count, 3) from the product of d mixtures, and the labels (count, d) that they were drawn from.

    `tilt` holds for every mixture log factors (M,) on its weights, so that another function's values at the means can
    steer the labels; zeros give the product itself.
    """
    means = np.stack([mixture.means for mixture in mixtures])
    log_weights = np.stack([mixture.log_weights + log for mixture, log in zip(mixtures, tilt, strict=True)])
    precisions = np.stack([mixture.spread for mixture in mixtures]) ** -2.0
    factors = len(mixtures)
    cumulative = np.cumsum(np.exp(log_weights - log_weights.max(axis=1, keepdims=True)), axis=1)
    first = rng.random((factors, count)) * cumulative[:, -1:]
    labels = np.stack([np.searchsorted(row, u, side="right") for row, u in zip(cumulative, first, strict=True)], axis=1)
    labels = np.minimum(labels, means.shape[1] - 1).astype(np.int64)
    if factors > 1:
        _gibbs(means, -log_weights, precisions, rng.random((count, sweeps, factors)), labels)
    chosen = means[np.arange(factors), labels]  # (count, d, 3)
    around = chosen[:, :1, 2]
    chosen = np.concatenate([chosen[..., :2], (around + wrap(chosen[..., 2] - around))[..., None]], axis=-1)
    total = precisions.sum(axis=0)
    poses = np.sum(precisions * chosen, axis=1) / total + rng.standard_normal((count, 3)) / np.sqrt(total)
    poses[:, 2] = wrap(poses[:, 2])
    return poses, labels
