"""What does the scan not tell at all? Joints that may stand almost anywhere, and parts that may be turned as they like.

A round plate looks the same however it is turned, and a round foot takes the first joint's angle with it: no look from
anywhere would tell. A drawer that cannot be seen may stand where it likes, until somebody looks from elsewhere.
"""

from __future__ import annotations

import numpy as np

from pmpnbp.inference.problem import Problem
from pmpnbp.readout.posterior import Spread

# A joint may stand anywhere where its central interval has this share of its range; a turn is any where the mean of
# its draws, as points on the unit circle, is nearer to the middle than this.
ANYWHERE, EVEN = 0.75, 0.3


def unknown(problem: Problem, told: Spread) -> tuple[str, ...]:
    """A sentence for each joint coordinate, and for each round part, of which nothing is known."""
    model = problem.mrf.model
    found = []
    for coordinate, name in enumerate(model.coordinate_names):
        turns, (low, high) = problem.joint_turns[coordinate], told.joint_intervals[:, coordinate]
        span = 2 * np.pi if model.wraps[coordinate] else model.upper[coordinate] - model.lower[coordinate]
        if 0 < span < np.inf and high - low > ANYWHERE * span:
            ends = f"{np.degrees(low):.0f}° to {np.degrees(high):.0f}°" if turns else f"{low:.2f} m to {high:.2f} m"
            found.append(f"joint '{name}' may be anywhere from {ends}")
    for part, evenness in zip(model.parts, told.round_turns, strict=True):
        if evenness < EVEN:
            found.append(f"'{part.name}' is round, and may be turned by any angle about its axis")
    return tuple(found)
