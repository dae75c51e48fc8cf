"""The kinds of pixels are the cases of the robust score: each kind's pixels are worth what its name says."""

from __future__ import annotations

import numpy as np
import pytest

from pmpnbp.potentials.kernels.reference import robust_scores
from pmpnbp.potentials.pixel_kinds import PixelKind, in_front, pixel_kinds
from pmpnbp.scene.observation import CONTINUED, NO_DEPTH, OBJECT, OUTSIDE, SUPPORT

TOLERANCE, FREE, OCCLUDED, SUPPORTED, GOING_ON = 0.02, 1.0, 0.03, 0.1, 0.2


@pytest.mark.parametrize(
    ("observed", "category", "rendered", "kind"),
    [
        (1.0, OBJECT, 1.01, PixelKind.EXPLAINED),
        (1.0, SUPPORT, 1.01, PixelKind.ON_SUPPORT),
        (1.0, OUTSIDE, 1.01, PixelKind.OUTSIDE_ROI),
        (1.0, CONTINUED, 1.01, PixelKind.GOES_ON),
        (1.2, OBJECT, 1.0, PixelKind.SEEN_THROUGH),
        (1.2, SUPPORT, 1.0, PixelKind.SEEN_THROUGH),
        (0.8, OBJECT, 1.0, PixelKind.IN_FRONT),
        (0.8, OUTSIDE, 1.0, PixelKind.IN_FRONT),
        (0.8, CONTINUED, 1.0, PixelKind.IN_FRONT),
        (0.8, SUPPORT, 1.0, PixelKind.SEEN_THROUGH),  # the part stands behind a floor or wall
        (0.0, NO_DEPTH, 1.0, PixelKind.NO_DEPTH),
        (1.0, OBJECT, 0.0, PixelKind.NOT_COVERED),
        (0.0, NO_DEPTH, 0.0, PixelKind.NOT_COVERED),
    ],
)
def test_every_kind_by_hand(observed: float, category: int, rendered: float, kind: PixelKind) -> None:
    depth, shown = np.array([observed], np.float32), np.array([rendered], np.float32)
    assert pixel_kinds(depth, np.array([category], np.uint8), shown, TOLERANCE).tolist() == [kind]


def test_each_kind_is_worth_what_the_score_says(rng: np.random.Generator) -> None:
    category = rng.integers(0, 5, 20_000).astype(np.uint8)
    rendered = rng.uniform(0.5, 2.0, 20_000).astype(np.float32)
    observed = (rendered + rng.uniform(-2, 2, 20_000) * TOLERANCE).astype(np.float32)
    observed[category == NO_DEPTH] = 0
    kinds = pixel_kinds(observed, category, rendered, TOLERANCE)
    terms = np.array([TOLERANCE, FREE, OCCLUDED, SUPPORTED, GOING_ON, 1.0, 6.0, 0.0, 1.0, 1.0])
    distance = rendered.astype(np.float64)
    weight = np.where(np.abs(observed - rendered) < TOLERANCE, observed, distance) ** 2
    worth = robust_scores(observed, category, distance, terms)
    of = {kind: (worth / weight)[kinds == kind] for kind in PixelKind}
    assert all(len(of[kind]) > 1000 for kind in PixelKind if kind != PixelKind.NOT_COVERED)
    assert np.all(of[PixelKind.EXPLAINED] >= 0) and of[PixelKind.EXPLAINED].max() > 0.99
    for kind, most in ((PixelKind.ON_SUPPORT, SUPPORTED), (PixelKind.GOES_ON, GOING_ON)):
        assert np.all((worth >= 0) & (worth <= most * weight) | (kinds != kind))
    np.testing.assert_allclose(of[PixelKind.SEEN_THROUGH], -FREE)
    np.testing.assert_allclose(of[PixelKind.IN_FRONT], -OCCLUDED)
    assert not np.any(of[PixelKind.NO_DEPTH]) and not np.any(of[PixelKind.OUTSIDE_ROI])


def test_what_is_in_front_hides_the_surface_whatever_it_is(rng: np.random.Generator) -> None:
    """A support plane too, which counts as free space violated; nothing that is within the tolerance, or not there."""
    rendered = np.ones(6, np.float32)
    observed = np.array([0.9, 0.9, 0.99, 1.1, 0.0, 0.9], np.float32)
    category = np.array([OBJECT, SUPPORT, OBJECT, OBJECT, NO_DEPTH, OUTSIDE], np.uint8)
    hidden = in_front(observed, rendered, TOLERANCE)
    assert hidden.tolist() == [True, True, False, False, False, True]
    kinds = pixel_kinds(observed, category, rendered, TOLERANCE)
    assert kinds[hidden].tolist() == [PixelKind.IN_FRONT, PixelKind.SEEN_THROUGH, PixelKind.IN_FRONT]
