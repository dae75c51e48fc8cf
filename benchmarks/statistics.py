"""How much does a count of successes say? Wilson's interval for a rate, which holds near 0 % and 100 % too.

E. B. Wilson, Probable inference, the law of succession, and statistical inference, JASA 22 (1927).
"""

from __future__ import annotations

import math

# Standard normal quantile of a two-sided 95 % interval.
QUANTILE = 1.959964


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
