"""Which scans is an iteration made with, after some joined and some replaced those before?"""

from __future__ import annotations

import numpy as np
import pytest

from pmpnbp.geometry.poses import IDENTITY
from pmpnbp.inference import problem
from pmpnbp.inference.arrival import Arrival, ScanMode, present
from pmpnbp.inference.problem import Problem
from pmpnbp.scene.prior import GaussianPrior
from tests.inference import small_worlds as worlds

CAME: list[tuple[int, str, ScanMode]] = [
    (3, "b", "joins"),
    (3, "c", "joins"),
    (5, "d", "replaces"),
    (5, "e", "joins"),
    (8, "f", "joins"),
    (9, "g", "replaces"),
]


@pytest.mark.parametrize(
    ("iteration", "scans", "arrival"),
    [
        (3, "a", None),
        (4, "abc", Arrival(3, 1)),
        (5, "abc", Arrival(3, 1)),
        (6, "de", Arrival(5, 0, 1)),
        (9, "def", Arrival(8, 2, 1)),
        (10, "g", Arrival(9, 0, 2)),
        (None, "g", Arrival(9, 0, 2)),
    ],
)
def test_scans_join_or_replace(iteration: int | None, scans: str, arrival: Arrival | None) -> None:
    assert present("a", CAME, iteration) == (tuple(scans), arrival)


def test_without_later_scans_nothing_arrives() -> None:
    assert present("ab", []) == (("a", "b"), None)


def test_a_prior_is_wider_once_the_scene_has_moved_on() -> None:
    """Variances of the prior and of each motion add up; a joint's motion is a share of its range."""
    model, observation = worlds.cupboard(), worlds.seen(worlds.cupboard(), *worlds.cupboard_truth())
    slide = model.joints[0]
    known = GaussianPrior("link0", IDENTITY.copy(), np.full(3, 0.03), np.full(3, 0.1), {slide.name: (0.1, 0.02)})
    settings = worlds.settings(moved_std_xyz=0.04, moved_std_rpy=0.2, moved_joint_share=0.1)

    def built(arrival: Arrival | None) -> Problem:
        return problem.build(model, observation, known, settings, arrival=arrival)

    for same in (built(None), built(Arrival(4, 1))):
        assert isinstance(same.prior, GaussianPrior)
        np.testing.assert_array_equal(same.prior.std_xyz, known.std_xyz)
    twice = built(Arrival(4, 0, 2))
    assert isinstance(twice.prior, GaussianPrior)
    np.testing.assert_allclose(twice.prior.std_xyz**2, 0.03**2 + 2 * 0.04**2)
    np.testing.assert_allclose(twice.prior.std_rpy**2, 0.1**2 + 2 * 0.2**2)
    ((position, std),) = twice.joint_prior.values()
    assert position == 0.1
    assert std**2 == pytest.approx(0.02**2 + 2 * (0.1 * (slide.upper - slide.lower)) ** 2)
