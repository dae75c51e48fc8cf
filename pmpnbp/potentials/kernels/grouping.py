"""Which of many poses of several parts are one and the same, but for less than a given distance?"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmpnbp.potentials.kernels.compiling import kernel


@kernel
def group(
    marks: NDArray[np.float64], evidence: NDArray[np.float64], most: int, apart: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Greedy choice, from the first on, of at most `most` rows further than `apart` from each other: the chosen rows,
    and for each row the place of the chosen one it belongs to, the first that is near enough (-1: none).

    marks : (P, N, M, 3) points of N parts; evidence : (P, N) above zero, how much each part counts in a chosen row's
    distances: the root of the mean square over the marks, its mean over the parts by evidence
    """
    count, parts, points, _ = marks.shape
    member_of = np.full(count, -1, dtype=np.int64)
    chosen = np.empty(most, dtype=np.int64)
    leaders: Any = 0
    for row in range(count):
        if member_of[row] >= 0:
            continue
        if leaders == most:
            break
        limit = apart * apart * evidence[row].sum() * points
        for other in range(row, count):
            if member_of[other] >= 0:
                continue
            total = 0.0
            for part in range(parts):
                for point in range(points):
                    for axis in range(3):
                        offset = marks[other, part, point, axis] - marks[row, part, point, axis]
                        total += evidence[row, part] * offset * offset
                if total >= limit:
                    break
            if total < limit:
                member_of[other] = leaders
        chosen[leaders] = row
        leaders += 1
    return chosen[:leaders], member_of
