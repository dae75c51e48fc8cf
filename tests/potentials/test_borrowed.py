"""Arrays lent to a kernel are the caller's own memory, however they are packed, and stay the caller's."""

from __future__ import annotations

import sys
from typing import Any

import numba
import numpy as np

from pmpnbp.potentials.kernels.compiling import borrowed


@numba.njit
def _doubled(held: Any) -> Any:
    """The sum of what is held in two arrays, which are doubled, times a number that is held beside them."""
    (first, (second, number)), last = borrowed(held)
    total = 0.0
    for row in range(len(second)):
        line = second[row]
        total += line.sum() + first[row]
        line *= 2.0
    first *= 2.0
    return total * number + last.sum()


def test_what_is_borrowed_is_the_same_memory_and_given_back(rng: np.random.Generator) -> None:
    first, second, last = rng.normal(size=5), rng.normal(size=(5, 3))[:, ::2], np.arange(4)
    expected = (first.sum() + second.sum()) * 7 + 6
    doubled = 2 * first, 2 * second
    counts = [sys.getrefcount(array) for array in (first, second, last)]
    for _ in range(3):
        kept = first.copy(), second.copy()
        np.testing.assert_allclose(_doubled(((first, (second, 7)), last)), expected)
        np.testing.assert_array_equal(first, doubled[0])
        np.testing.assert_array_equal(second, doubled[1])
        first[:], second[:] = kept
    assert [sys.getrefcount(array) for array in (first, second, last)] == counts
