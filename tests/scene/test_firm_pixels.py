"""Firm is what lies amid a smooth surface, however steep; what is beside a step, a hole or an edge is not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from pmpnbp.scene.firm_pixels import STEP, firm_pixels


def slow(depth: NDArray[np.float32]) -> NDArray[np.bool_]:
    """The same, a pixel at a time."""
    found = depth > 0
    for row, column in np.argwhere(found).tolist():
        z = float(depth[row, column])
        for down, across in ((0, 1), (1, 0), (1, 1), (1, -1)):
            pair = [(row + sign * down, column + sign * across) for sign in (1, -1)]
            if all(0 <= at[0] < depth.shape[0] and 0 <= at[1] < depth.shape[1] for at in pair):
                one, other = float(depth[pair[0]]), float(depth[pair[1]])
                found[row, column] &= min(one, other) > 0 and abs(2 / z - 1 / one - 1 / other) * z < STEP
    return found


def plane(down: float = 0.0, across: float = 0.0) -> NDArray[np.float32]:
    """A plane about a metre away, whose inverse depth grows by so much a pixel."""
    row, column = np.mgrid[:20, :30]
    return (1.0 / (1.0 + down * row + across * column)).astype(np.float32)


# an image's steps are well apart from STEP, so that rounding decides nothing
@given(arrays.arrays(np.int64, st.tuples(st.integers(0, 7), st.integers(0, 7)), elements=st.integers(0, 9)))
def test_as_a_pixel_at_a_time(steps: NDArray[np.int64]) -> None:
    depth = np.where(steps > 0, 1.0 / (1.0 - 0.37 * STEP * steps), 0.0).astype(np.float32)
    np.testing.assert_array_equal(firm_pixels(depth), slow(depth))


@pytest.mark.parametrize(("down", "across"), [(0.0, 0.0), (0.03, 0.0), (0.0, 0.03), (0.02, 0.03)])
def test_a_plane_is_firm_up_to_the_pictures_border(down: float, across: float) -> None:
    assert firm_pixels(plane(down, across)).all()


def test_both_sides_of_a_step_are_not_firm_and_all_else_is() -> None:
    depth = plane()
    depth[:, 12:] = 1.05
    firm = firm_pixels(depth)
    assert not firm[:, 11:13].any()
    assert firm[:, :11].all() and firm[:, 13:].all()


def test_what_is_beside_a_hole_is_not_firm_nor_is_the_hole() -> None:
    depth = plane()
    depth[8, 9] = 0.0
    firm = firm_pixels(depth)
    assert not firm[7:10, 8:11].any()
    assert np.count_nonzero(firm) == depth.size - 9


def test_a_thin_thing_is_not_firm_nor_is_what_it_stands_before() -> None:
    depth = plane()
    depth[5:15, 14] = 0.9
    firm = firm_pixels(depth)
    assert not firm[4:16, 13:16].any()
    assert firm[:, :13].all() and firm[:, 16:].all()


def test_it_is_the_same_at_any_scale(rng: np.random.Generator) -> None:
    depth = (plane(0.01, 0.02) * rng.uniform(0.99, 1.01, (20, 30))).astype(np.float32)
    firm = firm_pixels(depth)
    assert 0.02 < firm.mean() < 0.98
    np.testing.assert_array_equal(firm_pixels(4.0 * depth), firm)
