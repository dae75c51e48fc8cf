"""A report from elsewhere is taken only where its arrays fit the model; shapes are tried over REST in test_recorded."""

from __future__ import annotations

from dataclasses import replace

import pytest

from pmpnbp.errors import RecordingError
from pmpnbp.recording.report_check import check_fits
from tests.readout.test_particle_terms import PARTICLES, iterations


@pytest.mark.parametrize("product", ["shared", "pooled"])
def test_reports_fit_their_own_problem(product: str) -> None:
    problem, reports = iterations("gaussian", product)
    for report in reports:
        check_fits(problem, report)


def test_a_share_of_a_sample_that_its_message_has_not_does_not_fit() -> None:
    problem, reports = iterations("gaussian", "pooled")
    shares = reports[4].log_message_shares.copy()
    shares[0, PARTICLES, 0] = 0.0  # a sample of the second message
    with pytest.raises(RecordingError, match="iteration 4 does not fit the model"):
        check_fits(problem, replace(reports[4], log_message_shares=shares))


@pytest.mark.parametrize("name", ["inverse_temperature", "effective_sample_size"])
@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_what_is_told_of_each_part_is_a_number(name: str, number: float) -> None:
    problem, reports = iterations("gaussian", "shared")
    numbers = getattr(reports[4], name).copy()
    numbers[1] = number
    with pytest.raises(RecordingError, match="iteration 4 does not fit the model"):
        check_fits(problem, replace(reports[4], **{name: numbers}))
