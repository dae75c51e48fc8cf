"""Is an honest belief called so, and another one caught? Runs whose posterior is exact, or too narrow, by construction.

An objection comes at 99 %, to the ranks of all coordinates together and to each coverage beyond what is tolerated: of
40 honest calibrations half of one is objected to on average, and three or more with a chance below 2 %. The seeds are
fixed.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from benchmarks.calibrate import judgement
from benchmarks.calibrate.findings import Found, Rate, gathered, rate_of, uniformities
from benchmarks.calibrate.judgement import BIASED, CAUTIOUS, HONEST, OVERCONFIDENT, judged
from benchmarks.calibrate.ranks import ranks
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.urdf import load_model
from tests.calibrate import objects

RUNS, DRAWS, MAX_STD = 160, 100, 0.0025
NO_FALSE_FINDS = Rate(0, 40, 40, 0.0, 0.14)


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> ArticulatedObject:
    return load_model(objects.slider(tmp_path_factory.mktemp("model")))


def toy(rng: np.random.Generator, width: float, lean: float) -> dict[str, Any]:
    """A run in which positions and the joint are off by a millimetre's deviation, and the draws are `width` times as
    wide, off by `lean` of it."""
    errors, slid = 1e-3 * rng.standard_normal((2, 3)), 1e-3 * rng.standard_normal(1)
    drawn = 1e-3 * (width * rng.standard_normal((DRAWS, 2, 3)) + lean)
    slides = 1e-3 * (width * rng.standard_normal((DRAWS, 1)) + lean)
    even = np.ones(DRAWS)
    add = np.linalg.norm(errors, axis=1)
    return {
        "verdict": "good",
        "effective": 100.0,
        "shares": [0.8, 0.4 if rng.random() < 0.7 else 0.05],
        "errors": errors,
        "stds": np.full((2, 3), width * 1e-3),
        "offsets": errors + drawn.mean(axis=0),
        "turned": [0.0, 0.0],
        "add": add,
        "expected_add": [1.6e-3 * width] * 2,
        "certain": [True, True],
        "position_ranks": ranks(rng, drawn, -errors, even),
        "ellipsoid_ranks": ranks(rng, np.linalg.norm(drawn, axis=2), add, even),
        "joint_offsets": slid + slides.mean(axis=0),
        "joint_ranks": ranks(rng, slides, -slid, even),
    }


def found(model: ArticulatedObject, seed: int, width: float = 1.0, lean: float = 0.0, runs: int = RUNS) -> Found:
    rng = np.random.default_rng([9, seed])
    return gathered(model, [{"seed": k} for k in range(runs)], [toy(rng, width, lean) for _ in range(runs)])


def word(some: Found, false_finds: Rate = NO_FALSE_FINDS) -> str | None:
    return judged(some, uniformities(some), false_finds, MAX_STD).word


def test_an_honest_belief_is_called_so(model: ArticulatedObject) -> None:
    words = [word(found(model, seed)) for seed in range(40)]
    assert words.count(HONEST) >= 38


@pytest.mark.parametrize(
    ("width", "lean", "told"),
    [(0.5, 0.0, OVERCONFIDENT), (1.0, 0.7, BIASED), (1.0, -0.7, BIASED), (2.0, 0.0, CAUTIOUS)],
)
def test_another_one_is_caught(model: ArticulatedObject, width: float, lean: float, told: str) -> None:
    some = found(model, 1, width, lean)
    verdict = judged(some, uniformities(some), NO_FALSE_FINDS, MAX_STD)
    # a lean of 0.7 deviations moves truths out of their regions, too
    assert verdict.word == told or (told == BIASED and verdict.word == OVERCONFIDENT)
    assert verdict.sentence("'slider'", RUNS).startswith(
        f"The belief is {verdict.word} for 'slider' and this camera, as "
    )


def test_how_far_a_belief_leans_is_told(model: ArticulatedObject) -> None:
    some = found(model, 2)
    some.offsets[..., 2] += 0.002
    some.position_ranks[..., 2] *= 0.3
    verdict = judged(some, uniformities(some), NO_FALSE_FINDS, MAX_STD)
    assert verdict.word == BIASED
    assert "box z (draws too high by 2 mm in the median)" in verdict.because[0]


def test_a_lean_of_no_account_is_told_and_not_objected_to(model: ArticulatedObject) -> None:
    some = found(model, 2)
    some.offsets[..., 2] *= 0.1
    some.offsets[..., 2] += 0.0001
    some.position_ranks[..., 2] *= 0.5
    verdict = judged(some, uniformities(some), NO_FALSE_FINDS, MAX_STD)
    assert verdict.word == HONEST
    assert "the draws lean by less than 10 % of 2.5 mm: box z (draws too high by 0.1" in verdict.because[-1]


def test_certain_links_that_are_wrong_and_absent_objects_that_are_found_are_objected_to(
    model: ArticulatedObject,
) -> None:
    some = found(model, 0)
    assert word(some, Rate(20, 40, 40, 0.31, 0.69)) == OVERCONFIDENT
    some.turned[: RUNS // 8] = 0.5
    verdict = judged(some, uniformities(some), NO_FALSE_FINDS, MAX_STD)
    assert verdict.word == OVERCONFIDENT
    assert "of links said to be certain are not within 1 cm and 2°" in verdict.because[0]


def test_few_runs_tell_nothing(model: ArticulatedObject) -> None:
    some = found(model, 0, runs=judgement.FEWEST - 1)
    verdict = judged(some, uniformities(some), NO_FALSE_FINDS, MAX_STD)
    assert verdict.word is None
    assert "cannot be told: 30 runs with a good fit are needed, and there are 29" in verdict.sentence("'slider'", 29)


def test_links_of_one_run_count_as_one_witness() -> None:
    held = np.array([[True, True], [True, True], [False, False], [True, True]])
    rate = rate_of(held, np.ones_like(held))
    assert (rate.count, rate.cases, rate.runs) == (6, 8, 4)
    # Wilson's for 3 of 4, not for 6 of 8
    assert (rate.low, rate.high) == pytest.approx((0.3006, 0.9544), abs=1e-4)


def test_runs_whose_scan_was_refused_have_no_ranks(model: ArticulatedObject) -> None:
    some = gathered(model, [{"seed": 0}], [{"verdict": "refused", "reason": "nothing there"}])
    assert len(some.seeds) == 0 and word(some) is None


def test_a_hidden_links_joint_is_hidden(model: ArticulatedObject) -> None:
    some = found(model, 0)
    np.testing.assert_array_equal(some.joints_seen[:, 0], some.shares[:, 1] >= 0.1)
    assert some.good.shares.shape == some.shares.shape
