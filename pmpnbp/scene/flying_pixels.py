"""Which measurements lie on no surface? Between the two sides of an outline a camera's pixel sees both, and a
time-of-flight or a stereo camera reports a depth that is somewhere between them: a flying pixel. Enough of them make an
object's edges lie farther back than they are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Neighbours are apart where their inverse depths differ by more, 1 / metres: a centimetre at a metre, nine at three,
# more than noise and steep surfaces do. What flies has fewer neighbours that are not.
APART, HELD = 0.01, 2
# Rows and columns to the eight pixels around one.
NEIGHBOURS = np.array([(row, column) for row in (-1, 0, 1) for column in (-1, 0, 1) if row or column])


def without_flying_pixels(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """The depths (h, w), metres, with 0 where a pixel flies: one of its eight neighbours lies before it, another
    behind it, and next to none beside it. What nothing lies before is part of an object, however thin."""
    measured = depth > 0
    inverse = np.divide(1.0, depth, out=np.zeros_like(depth), where=measured)
    before = _around(np.maximum, inverse) > inverse + APART
    behind = _around(np.minimum, np.where(measured, inverse, np.float32(np.inf))) < inverse - APART
    row, column = np.nonzero(measured & before & behind)
    # what goes on beyond the picture is taken to go on as it is
    padded = np.pad(inverse, 1, mode="edge")
    beside = padded[row[:, None] + 1 + NEIGHBOURS[:, 0], column[:, None] + 1 + NEIGHBOURS[:, 1]]
    near = np.abs(beside - inverse[row, column, None]) <= APART
    flies = np.count_nonzero(near & (beside > 0), axis=1) < HELD
    found = depth.copy()
    found[row[flies], column[flies]] = 0.0
    return found


def _around(extreme: np.ufunc, values: NDArray[np.float32]) -> NDArray[np.float32]:
    """(h, w): the maximum or minimum of each pixel's and its eight neighbours' values (h, w). Shifted images take a
    tenth of the time of a filter that goes from pixel to pixel."""
    for _ in range(2):
        found = values.copy(order="K")
        extreme(found[1:], values[:-1], out=found[1:])
        extreme(found[:-1], values[1:], out=found[:-1])
        values = found.T
    return values
