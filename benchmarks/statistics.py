"""How much do some runs say? Intervals for rates, means and their differences.

For a rate Wilson's, which holds near 0 % and 100 % too: E. B. Wilson, Probable inference, the law of succession, and
statistical inference, JASA 22 (1927). For means Student's and Welch's.
"""

from __future__ import annotations

import math

import numpy as np
from scipy import stats

from pmpnbp.geometry.poses import Array

# Standard normal quantile of a two-sided 95 % interval.
QUANTILE = 1.959964
LEVEL = 0.95


def wilson(successes: int, trials: int, quantile: float = QUANTILE) -> tuple[float, float]:
    """Lower and upper end, 0 to 1, of the interval for the rate behind `successes` of `trials` independent trials; 0
    and 1 without trials. Raises ValueError where there are fewer trials than successes."""
    if not 0 <= successes <= trials:
        raise ValueError(f"{successes} successes of {trials} trials: expected 0 to the number of trials")
    if trials == 0:
        return 0.0, 1.0
    rate, spread = successes / trials, quantile**2 / trials
    middle = rate + spread / 2
    reach = quantile * math.sqrt(rate * (1 - rate) / trials + spread / (4 * trials))
    low, high = (middle - reach) / (1 + spread), (middle + reach) / (1 + spread)
    # the ends at 0 and n successes are exactly 0 and 1, which the roots miss by rounding
    return (0.0 if successes == 0 else low), (1.0 if successes == trials else high)


def mean_interval(values: Array, level: float = LEVEL) -> Array:
    """(3, …): mean of independent runs (R, …), and the ends of its interval by Student's t; NaN ends for one run."""
    count, mean = len(values), values.mean(axis=0)
    if count < 2:
        return np.stack([mean, np.full_like(mean, np.nan), np.full_like(mean, np.nan)])
    reach = stats.t.ppf((1 + level) / 2, count - 1) * values.std(axis=0, ddof=1) / np.sqrt(count)
    return np.stack([mean, mean - reach, mean + reach])


def difference_interval(one: Array, other: Array, level: float = LEVEL) -> tuple[float, float, float]:
    """Mean of `one` (R,) minus that of `other` (S,), independent runs, and the ends of its interval (Welch 1947); NaN
    ends where either is a single run."""
    if min(len(one), len(other)) < 2 or (np.ptp(one) == 0 and np.ptp(other) == 0):
        ends = (float("nan"),) * 2 if min(len(one), len(other)) < 2 else (float(one.mean() - other.mean()),) * 2
        return float(one.mean() - other.mean()), *ends
    found = stats.ttest_ind(one, other, equal_var=False).confidence_interval(level)
    return float(one.mean() - other.mean()), float(found.low), float(found.high)


def at_times(seconds: Array, values: Array, times: Array) -> Array:
    """(K, …) of `values` (I, …), each of which holds from its `seconds` (I,) on, at `times` (K,); the first before."""
    return values[np.clip(np.searchsorted(seconds, times, side="right") - 1, 0, None)]
