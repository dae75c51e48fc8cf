"""The score of one pixel, case by case, and the packed image in which the kernels look it up."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from pmpnbp.potentials.kernels import pixel_scores, reference
from pmpnbp.potentials.unary import PixelScore
from pmpnbp.scene import observation

TAU, FREE, OCCLUDED, SUPPORTED, GOING_ON, FIRM = 0.02, 1.0, 0.03, 0.1, 0.2, 6.0
SCORE = PixelScore("robust", TAU, FREE, OCCLUDED, SUPPORTED, GOING_ON, firm_cost=FIRM, firm_step=0.0)


def test_the_kernels_categories_are_those_of_the_observation() -> None:
    for name in ("NO_DEPTH", "OBJECT", "SUPPORT", "OUTSIDE", "CONTINUED"):
        assert getattr(pixel_scores, name) == getattr(observation, name)


@pytest.mark.parametrize(
    ("category", "difference", "expected"),
    [
        (observation.NO_DEPTH, 0.0, 0.0),
        (observation.NO_DEPTH, 0.5, 0.0),
        (observation.OBJECT, 0.0, 1.0),
        (observation.OBJECT, TAU / 2, 0.75),
        (observation.OBJECT, -TAU / 2, 0.75),
        (observation.OBJECT, 0.5, -FREE),
        (observation.OBJECT, -0.5, -OCCLUDED),
        (observation.SUPPORT, 0.0, SUPPORTED),
        (observation.SUPPORT, TAU / 2, 0.75 * SUPPORTED),
        (observation.SUPPORT, 0.5, -FREE),
        (observation.SUPPORT, -0.5, -FREE),
        (observation.OUTSIDE, 0.0, 0.0),
        (observation.OUTSIDE, 0.5, -FREE),
        (observation.OUTSIDE, -0.5, -OCCLUDED),
        (observation.CONTINUED, 0.0, GOING_ON),
        (observation.CONTINUED, TAU / 2, 0.75 * GOING_ON),
        (observation.CONTINUED, 0.5, -FREE),
        (observation.CONTINUED, -0.5, -OCCLUDED),
    ],
)
def test_robust_score_of_a_pixel(category: int, difference: float, expected: float) -> None:
    fast, slow = of_a_pixel(category, difference, SCORE.terms, firm=False)
    # where it is explained it covers what was measured, a little nearer or farther off
    weight = (1.0 + difference) ** 2 if abs(difference) < TAU else 1.0
    assert slow == pytest.approx(weight * expected, abs=1e-5)
    assert fast == pytest.approx(weight * expected, abs=1e-4)


@pytest.mark.parametrize("firm", [False, True])
@pytest.mark.parametrize(
    ("category", "difference", "expected"),
    [
        (observation.OBJECT, 0.99 * TAU, 0.0199),
        (observation.OBJECT, 1.2 * TAU, 0.0),
        (observation.OBJECT, 1.9 * TAU, 0.0),
        (observation.SUPPORT, 1.9 * TAU, 0.0),
        (observation.OUTSIDE, 1.9 * TAU, 0.0),
        (observation.OBJECT, 2.1 * TAU, -FREE),
        (observation.OBJECT, -1.2 * TAU, -OCCLUDED),
        (observation.SUPPORT, -1.2 * TAU, -FREE),
    ],
)
def test_a_pixel_that_noise_may_have_put_behind_is_not_seen_through(
    category: int, difference: float, expected: float, firm: bool
) -> None:
    """With noise of half a tolerance, four deviations of which are two of these."""
    score = pixel_score_of_noise(TAU / 2)
    if firm and expected == -FREE and difference > 0:
        expected *= 2.1**2 - 1
    fast, slow = of_a_pixel(category, difference, score.terms, firm)
    assert slow == pytest.approx(expected, abs=1e-3)
    assert fast == pytest.approx(expected, abs=1e-3)


def test_what_noise_may_do_is_within_a_loose_tolerance() -> None:
    for tolerance in (2 * TAU, 3 * TAU):
        loose = replace(pixel_score_of_noise(TAU / 2), tolerance=tolerance)
        np.testing.assert_array_equal(loose.terms, replace(loose, through_from=0.0).terms)


def pixel_score_of_noise(deviation: float) -> PixelScore:
    return replace(SCORE, through_from=4 * deviation)


def test_noise_puts_no_surface_farther_off_or_nearer(rng: np.random.Generator) -> None:
    """A plate before the camera, with its outline, whose depths have a deviation of half a tolerance: its score is
    highest where it is, but for 0.009 tolerances, as what is measured too far off weighs more. Of 400 pictures the mean
    has a standard error of 0.0019; that it is four of these farther off is a false alarm in 16,000. Where every pixel
    beyond the tolerance is seen through it is off by 0.06, and where the rendered depth weighs by 0.025."""
    side, width, depth, pictures = 21, 15, 0.8, 400
    across = np.abs(np.arange(side) - side // 2)
    from_middle, half = np.maximum.outer(across, across), width / 2 * depth
    tried = (depth + np.linspace(-1.0, 1.0, 81) * TAU)[:, None, None]
    terms = replace(pixel_score_of_noise(TAU / 2), unit_distance=depth).terms.astype(np.float64)
    category, covered, best = np.array(observation.OBJECT), from_middle * tried < half, []
    for _ in range(pictures):
        noise = rng.normal(0.0, TAU / 2, from_middle.shape)
        observed = np.where(from_middle * depth < half, depth + noise, 2.0)
        scores = np.sum(reference.robust_scores(observed, category, tried, terms) * covered, axis=(1, 2))
        best.append(np.mean(tried[scores == scores.max()]))
    assert abs(np.mean(best) - depth) < (0.009 + 4 * 0.0019) * TAU


def test_a_pixel_counts_by_what_it_covers_of_a_surface() -> None:
    """Twice as far away it covers four times as much, and of a surface there are a quarter as many."""
    terms = replace(SCORE, unit_distance=1.5).terms
    for rendered, weight in ((1.5, 1.0), (3.0, 4.0), (0.75, 0.25)):
        for difference, expected in ((0.0, 1.0), (0.5, -FREE), (-0.5, -OCCLUDED)):
            observed = np.float32(rendered + difference)
            word = pixel_scores.pack_view(np.array([[observed]]), np.array([[observation.OBJECT]], dtype=np.uint8))
            fast = pixel_scores.robust_pixel(word[1, 1], np.float32(rendered), tuple(terms))
            slow = reference.robust_scores(observed, np.array(observation.OBJECT), np.float32(rendered), terms)
            assert fast == pytest.approx(weight * expected, rel=1e-4)
            assert slow == pytest.approx(weight * expected, rel=1e-5)


@pytest.mark.parametrize(
    ("category", "difference", "times"),
    [
        (observation.OBJECT, 1.2 * TAU, 1.0),
        (observation.OBJECT, 2.0 * TAU, 3.0),
        (observation.OBJECT, 2.5 * TAU, 5.25),
        (observation.OBJECT, 3.0 * TAU, 6.0),
        (observation.OBJECT, 0.5, 6.0),
        (observation.OUTSIDE, 0.5, 6.0),
        (observation.CONTINUED, 0.5, 6.0),
        (observation.SUPPORT, 0.5, 6.0),
        (observation.SUPPORT, -2.0 * TAU, 3.0),
    ],
)
def test_a_firm_pixel_that_is_seen_through_costs_up_to_six_times_as_much(
    category: int, difference: float, times: float
) -> None:
    fast, slow = of_a_pixel(category, difference, SCORE.terms, firm=True)
    assert slow == pytest.approx(-times * FREE, abs=1e-4)
    assert fast == pytest.approx(-times * FREE, abs=1e-3)


@pytest.mark.parametrize(
    ("difference", "times"),
    [(1.2 * TAU, 1.0), (2.0 * TAU, 1.0), (3.0 * TAU, 1.003), (4.0 * TAU, 2.429), (5.0 * TAU, 4.165), (0.5, 6.0)],
)
def test_a_firm_pixel_behind_by_no_more_than_a_step_that_is_not_noticed_costs_once(
    difference: float, times: float
) -> None:
    """A step of 4 % of the depth is about two tolerances here; one that is less than the tolerance plays no part."""
    stepped, small = (replace(SCORE, firm_step=step).terms for step in (0.04, 0.9 * TAU / (1.0 + difference)))
    for found in of_a_pixel(observation.OBJECT, difference, stepped, firm=True):
        assert found == pytest.approx(-times * FREE, abs=2e-3)
    for found in of_a_pixel(observation.OBJECT, difference, stepped, firm=False):
        assert found == pytest.approx(-FREE, abs=1e-3)
    plain = of_a_pixel(observation.OBJECT, difference, SCORE.terms, firm=True)
    assert of_a_pixel(observation.OBJECT, difference, small, firm=True) == plain


@pytest.mark.parametrize(
    ("category", "difference", "expected"),
    [
        (observation.OBJECT, TAU / 2, 0.75),
        (observation.OBJECT, -0.5, -OCCLUDED),
        (observation.OUTSIDE, TAU / 2, 0.0),
        (observation.SUPPORT, TAU / 2, 0.75 * SUPPORTED),
    ],
)
def test_what_explains_or_hides_counts_the_same_of_a_firm_pixel(
    category: int, difference: float, expected: float
) -> None:
    fast, slow = of_a_pixel(category, difference, SCORE.terms, firm=True)
    weight = (1.0 + difference) ** 2 if abs(difference) < TAU else 1.0
    assert slow == pytest.approx(weight * expected, abs=1e-5)
    assert fast == pytest.approx(weight * expected, abs=1e-4)


@pytest.mark.parametrize("category", range(5))
@pytest.mark.parametrize("difference", [0.0, 0.6 * TAU, -0.6 * TAU, 2.5 * TAU, -2.5 * TAU])
def test_a_pixel_beside_an_edge_counts_its_share(category: int, difference: float) -> None:
    share = 0.3
    full, shared = SCORE.terms, replace(SCORE, edge_weight=share).terms
    pairs = zip(*(of_a_pixel(category, difference, terms, firm=False) for terms in (full, shared)), strict=True)
    for whole, part in pairs:
        assert part == pytest.approx(share * whole, rel=1e-5)
    assert of_a_pixel(category, difference, full, firm=True) == of_a_pixel(category, difference, shared, firm=True)


def of_a_pixel(category: int, difference: float, terms: NDArray[np.float32], firm: bool) -> tuple[float, float]:
    """Its score by the kernel, and by the reference."""
    observed, rendered = np.float32(1.0 + difference), np.float32(1.0)
    slow = reference.robust_scores(observed, np.array(category), rendered, terms, firm)
    word = pixel_scores.pack_view(np.array([[observed]]), np.array([[category]], dtype=np.uint8))[1, 1]
    if firm:
        word |= pixel_scores.FIRM_BIT
    return float(pixel_scores.robust_pixel(word, rendered, tuple(terms))), float(slow)


@pytest.mark.parametrize(
    ("category", "expected"),
    [
        (observation.NO_DEPTH, 0.0),
        (observation.OBJECT, -0.6),
        (observation.SUPPORT, -0.6),
        (observation.OUTSIDE, 0.0),
        (observation.CONTINUED, -0.6),
    ],
)
def test_distance_of_a_pixel_is_that_of_the_points_in_space(category: int, expected: float) -> None:
    observed, rendered, ray_length = np.float32(1.5), np.float32(1.0), np.float32(1.2)
    slow = reference.distance_scores(observed, np.array(category), rendered, ray_length)
    word = pixel_scores.pack_view(np.array([[observed]]), np.array([[category]], dtype=np.uint8))[1, 1]
    assert slow == pytest.approx(expected, abs=1e-6)
    assert pixel_scores.distance_pixel(word, rendered, ray_length) == pytest.approx(expected, abs=1e-5)
    firm = word | pixel_scores.FIRM_BIT
    assert pixel_scores.distance_pixel(firm, rendered, ray_length) == pytest.approx(expected, abs=1e-5)


def test_packing_keeps_the_depth_to_a_relative_8e_7_and_adds_a_border_without_depth(rng: np.random.Generator) -> None:
    depth = rng.uniform(0.1, 20.0, (7, 5)).astype(np.float32)
    category = rng.integers(1, 5, depth.shape).astype(np.uint8)
    packed = pixel_scores.pack_view(depth, category)
    assert packed.shape == (9, 7)
    assert not packed[[0, -1]].any() and not packed[:, [0, -1]].any()
    inner = np.ascontiguousarray(packed[1:-1, 1:-1])
    np.testing.assert_array_equal(inner & 7, category)
    np.testing.assert_allclose(inner.view(np.float32), depth, rtol=9e-7)
