"""Is a run judged as it stood at rest, and by the parts that are seen?"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.reproduce import outcomes, reports
from pmpnbp.runs.run_log import RunLog

ASKED = [{"seed": 0}, {"seed": 1}]


@pytest.fixture
def run_log(tmp_path: Path) -> RunLog:
    """The first run is at rest in iteration 1 and goes on, worse; the second never is. The third part is hidden."""
    made = RunLog(tmp_path, "robot")
    shared = {"parts": ["base", "arm", "hand"], "judged": [True, True, False], "shares": [0.9, 0.5, 0.05]}
    first = [[0.1, 0.1, 0.1], [0.01, 0.03, 0.2], [0.5, 0.5, 0.5]]
    second = [[0.1, 0.1, 0.1], [0.01, 0.06, 0.001]]
    for asked, add, at_rest in zip(ASKED, (first, second), (1, None), strict=True):
        seconds = [1.0 + k for k in range(len(add))]
        made.add(
            asked, shared | {"add": add, "std": (0.1 * np.array(add)).tolist(), "seconds": seconds, "at_rest": at_rest}
        )
    return made


def test_a_run_is_judged_at_rest_by_the_parts_that_are_seen(run_log: RunLog) -> None:
    some = outcomes.of_runs(ASKED, run_log)
    np.testing.assert_allclose(some.add, [[0.01, 0.03, 0.2], [0.01, 0.06, 0.001]])
    assert some.seconds.tolist() == [2.0, 2.0] and some.at_rest == (1, None)
    assert [some.found(limit) for limit in (0.02, 0.05, 0.1)] == [0, 1, 2]
    assert some.certain(0.0025).tolist() == [[True, False, False], [True, False, True]]


def test_a_run_that_ended_stays_as_it_was(run_log: RunLog) -> None:
    errors = outcomes.over_iterations(run_log.results(ASKED), "add")
    assert errors.shape == (2, 3, 3)
    np.testing.assert_array_equal(errors[1, 2], errors[1, 1])


def test_a_run_that_was_not_made_is_told(run_log: RunLog) -> None:
    with pytest.raises(KeyError, match="1 of 3 runs have not been made"):
        run_log.results([*ASKED, {"seed": 2}])


@pytest.mark.parametrize(
    ("held", "verdict"),
    [(10, reports.HOLDS), (9, reports.HOLDS), (8, reports.IN_PART), (1, reports.IN_PART), (0, reports.NOT)],
)
def test_a_verdict_follows_from_the_share_of_runs(held: int, verdict: str) -> None:
    assert reports.verdict_of_runs(held, 10) == verdict
