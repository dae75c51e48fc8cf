"""Parts can be told apart by their colours, also by readers who see fewer of them."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

from pmpnbp.pictures.palette import PART_COLOURS, part_colour, part_colours

Array = NDArray[np.float64]

# Linear sRGB as seen with a colour vision deficiency of full severity (Machado, Oliveira and Fernandes, 2009).
VISION = {
    "usual": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}


def lab(colour: tuple[int, int, int], vision: str) -> Array:
    """CIE L*a*b*, white point D65, of an sRGB colour as it is seen."""
    share = np.array(colour) / 255
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    seen = np.clip(VISION[vision] @ linear, 0, 1)
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ seen
    x, y, z = np.cbrt(xyz / np.array([0.9505, 1.0, 1.089]))
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


@pytest.mark.parametrize("vision", VISION)
def test_hues_stay_apart(vision: str) -> None:
    """By 20 units of L*a*b*, of which about 2 can just be seen side by side."""
    seen = [lab(part_colour(part), vision) for part in range(len(PART_COLOURS))]
    assert min(np.linalg.norm(one - other) for one, other in combinations(seen, 2)) > 20


@pytest.mark.parametrize("vision", VISION)
def test_a_hue_used_again_is_another_colour(vision: str) -> None:
    for hue in range(len(PART_COLOURS)):
        seen = [lab(part_colour(hue + use * len(PART_COLOURS)), vision) for use in range(3)]
        assert min(np.linalg.norm(one - other) for one, other in combinations(seen, 2)) > 10


def test_as_many_as_asked_for() -> None:
    assert part_colours(0) == ()
    colours = part_colours(40)
    assert len(colours) == 40
    assert len(set(colours)) == 18
    assert all(0 <= value <= 255 for colour in colours for value in colour)
    assert colours[0] == (0x4A, 0x72, 0xCF)
