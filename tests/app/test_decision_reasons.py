"""Why a decision is to look again: the doubts that there are, and no others."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, get_args

import numpy as np
import pytest

from app.routes.decisions import _action
from pmpnbp.readout.posterior import Doubt

LINKS = ["base", "door", "knob"]


def looked(**doubts: list[str]) -> Any:
    """What a snapshot tells of LINKS, of which some are in doubt."""
    found = {one: np.isin(LINKS, doubts.get(one, [])) for one in get_args(Doubt)}
    return SimpleNamespace(
        placed=SimpleNamespace(
            posterior=SimpleNamespace(fit=SimpleNamespace(verdict="good", reason="fits")), doubts=lambda max_std: found
        ),
        problem=SimpleNamespace(mrf=SimpleNamespace(model=SimpleNamespace(links=LINKS))),
    )


@pytest.mark.parametrize(
    ("doubts", "reason"),
    [
        ({"std_xyz": ["door"]}, "door may be off by more than 2.5 mm"),
        (
            {"expected_add": ["door"], "turned": ["door", "knob"]},
            "door, knob may be off by more than 2.5 mm, or turned by more than 2°",
        ),
        ({"draws": LINKS}, "too few draws of the posterior count for anything to be certain"),
        ({"denied": ["knob"]}, "the scan sees through these, or what they hang on: knob"),
        ({"outside_region": ["knob"]}, "the region of interest leaves these out, or what they hang on: knob"),
        (
            {"std_xyz": ["base"], "denied": ["knob"], "draws": LINKS},
            "base may be off by more than 2.5 mm; the scan sees through these, or what they hang on: knob; too few "
            "draws of the posterior count for anything to be certain",
        ),
    ],
)
def test_a_reason_names_the_doubts(doubts: dict[str, list[str]], reason: str) -> None:
    assert _action(looked(**doubts), LINKS, 0.0025) == ("look", reason)
