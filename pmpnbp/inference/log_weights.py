"""Weights in the log domain: normalising, effective sample size, tempering, resampling."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry.poses import Array


def log_sum_exp(values: Array, axis: int = -1) -> Array:
    """log Σ exp along `axis`; -inf where every entry is -inf."""
    top = np.max(values, axis=axis, keepdims=True)
    top = np.where(np.isfinite(top), top, 0.0)
    with np.errstate(divide="ignore"):
        return np.log(np.sum(np.exp(values - top), axis=axis)) + np.squeeze(top, axis=axis)


def normalise(log_weights: Array) -> Array:
    """Log weights (..., T) whose exponentials sum to one.

    Where every weight of a row is zero nothing is known about it, and the row becomes uniform.
    """
    total = log_sum_exp(log_weights)[..., None]
    uniform = -np.log(log_weights.shape[-1])
    return np.where(np.isfinite(total), log_weights - np.where(np.isfinite(total), total, 0.0), uniform)


def effective_sample_size(log_weights: Array) -> Array:
    """1 / Σ w² of normalised log weights (..., T), between 1 and T (Kong 1992)."""
    return np.exp(-log_sum_exp(2.0 * log_weights))


def tempering(log_potential: Array, share: float, steps: int = 16) -> Array:
    """The factor λ ≤ 1 (...,) for which weights exp(λ log_potential) (..., T) keep an effective sample size of
    `share` of T: 1 where they keep it as they are, found by bisection in log λ otherwise."""
    finite = np.where(np.isfinite(log_potential), log_potential, -1e30)
    centred = finite - finite.max(axis=-1, keepdims=True)
    target = share * log_potential.shape[-1]
    low = np.full(centred.shape[:-1], -16.0)
    high = np.zeros(centred.shape[:-1])
    for _ in range(steps):
        middle = (low + high) / 2
        weights = np.exp(np.exp(middle)[..., None] * centred)
        total = weights.sum(axis=-1)
        enough = total * total >= target * np.einsum("...t,...t->...", weights, weights)
        low, high = np.where(enough, middle, low), np.where(enough, high, middle)
    return np.where(high == 0.0, 1.0, np.exp(low))


def systematic(rng: np.random.Generator, log_weights: Array, count: int) -> NDArray[np.int64]:
    """Indices (..., count) drawn from normalised log weights (..., T) by systematic resampling (Kitagawa 1996).

    Unbiased: particle i is drawn count * w_i times on average, and never less than its floor. One uniform number a row.
    The order is by particle; shuffle where neighbours in the order must be independent.
    """
    cumulative = np.cumsum(np.exp(log_weights), axis=-1)
    cumulative /= cumulative[..., -1:]
    rows = cumulative.reshape(-1, cumulative.shape[-1])
    points = (np.arange(count) + rng.random((len(rows), 1))) / count
    drawn = np.stack([np.searchsorted(row, point, side="right") for row, point in zip(rows, points, strict=True)])
    return np.minimum(drawn, log_weights.shape[-1] - 1).reshape(*log_weights.shape[:-1], count)
