"""What lies on no surface is left out, and nothing else: an object's thin parts, steep floors and noise stay."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from numpy.typing import NDArray

from pmpnbp.scene.flying_pixels import APART, HELD, without_flying_pixels
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.observe import observe
from tests.inference import small_worlds as worlds

NEAR, FAR = 1.0, 2.0


def slow(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """The same, a pixel at a time."""
    found, height, width = depth.copy(), *depth.shape
    for row, column in product(range(height), range(width)):
        if depth[row, column] == 0:
            continue
        own, gaps = np.float32(1) / depth[row, column], []
        for down, right in product((-1, 0, 1), repeat=2):
            v, u = min(max(row + down, 0), height - 1), min(max(column + right, 0), width - 1)
            if (down or right) and depth[v, u] > 0:
                gaps.append(float(np.float32(1) / depth[v, u] - own))
        beside = sum(abs(gap) <= APART for gap in gaps)
        if max(gaps, default=0) > APART and min(gaps, default=0) < -APART and beside < HELD:
            found[row, column] = 0
    return found


def board(width: int = 8) -> NDArray[np.float32]:
    """A board, so many columns wide, before a wall."""
    depth = np.full((30, 40), FAR, dtype=np.float32)
    depth[:, 10 : 10 + width] = NEAR
    return depth


# an image's steps are well apart from APART, so that rounding decides nothing
@given(arrays.arrays(np.int64, (6, 7), elements=st.integers(0, 5)))
def test_as_a_pixel_at_a_time(steps: NDArray[np.int64]) -> None:
    depth = np.where(steps > 0, 1 / (1 - 0.6 * APART * steps), 0.0).astype(np.float32)
    np.testing.assert_array_equal(without_flying_pixels(depth), slow(depth))


def test_what_flies_between_a_board_and_its_wall_is_left_out(rng: np.random.Generator) -> None:
    depth = board()
    depth[::2, 9] = rng.uniform(1.1, 1.9, 15)
    found = without_flying_pixels(depth)
    assert (found[2:-2:2, 9] == 0).all()
    np.testing.assert_array_equal(found[1::2], board()[1::2])


@pytest.mark.parametrize("width", [1, 2, 8])
def test_an_outline_stays_however_thin_it_is(width: int) -> None:
    np.testing.assert_array_equal(without_flying_pixels(board(width)), board(width))


def test_a_thin_strip_between_two_others_stays() -> None:
    depth = board()
    depth[:, 9] = 1.5
    np.testing.assert_array_equal(without_flying_pixels(depth), depth)


@pytest.mark.parametrize("slope", [0.0, 0.004, 0.03])
def test_a_plane_stays_with_its_noise(rng: np.random.Generator, slope: float) -> None:
    """Its inverse depth falls by `slope` from row to row: by 0.03 it is seen at 4° or less from half a metre up."""
    inverse = 0.5 + slope * np.arange(30)[:, None] + rng.uniform(-0.45, 0.45, (30, 40)) * APART
    depth = (1 / inverse).astype(np.float32)
    np.testing.assert_array_equal(without_flying_pixels(depth), depth)


def test_an_image_without_anything_stays() -> None:
    for depth in (np.zeros((5, 6), dtype=np.float32), np.zeros((1, 1), dtype=np.float32), board()[:1, :1]):
        np.testing.assert_array_equal(without_flying_pixels(depth), depth)


def test_an_observation_has_few_points_between_surfaces(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = worlds.camera_at((0.0, 0.0, 1.2), (2.0, 0.0, 1.2), width=320, height=240)
    depth = np.full((240, 320), 2.5, dtype=np.float32)
    depth[60:180, 100:220] = 1.5
    outline = np.zeros(depth.shape, dtype=bool)
    outline[59:181, 99:221], outline[61:179, 101:219] = True, False
    flies = outline & (rng.random(depth.shape) < 0.6)
    depth[flies] = rng.uniform(1.55, 2.45, int(flies.sum()))

    def between() -> int:
        view = observe([Scan(camera, depth)], np.array([0.5, -1.0, 0.2, 2.4, 1.0, 2.2])).views[0]
        return int(np.count_nonzero((view.depth > 1.6) & (view.depth < 2.4)))

    few = between()
    monkeypatch.setattr("pmpnbp.scene.observe.without_flying_pixels", lambda same: same)
    assert few < between() / 5


def test_what_was_given_is_not_changed() -> None:
    depth = board()
    depth[5, 9] = 1.5
    before = depth.copy()
    assert without_flying_pixels(depth)[5, 9] == 0
    np.testing.assert_array_equal(depth, before)
