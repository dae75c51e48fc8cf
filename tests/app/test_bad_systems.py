"""A clock that jumps back, and files that may not grow; those that mount are in `tests.app.bad_systems` alone."""

from __future__ import annotations

import pytest

from tests.app.bad_systems import CONDITIONS, stand


@pytest.mark.parametrize("name", ["clock", "file-size"])
def test_the_server_stands(name: str) -> None:
    outcome = stand(CONDITIONS[name])
    assert not outcome.broken, str(outcome)
