"""While modules are imported nobody collects garbage, and afterwards it is as it was."""

from __future__ import annotations

import gc

import pytest

from pmpnbp.importing import many_modules


def test_the_collector_waits_and_goes_on_whatever_happens() -> None:
    assert gc.isenabled()
    with pytest.raises(ImportError), many_modules():
        assert not gc.isenabled()
        raise ImportError
    assert gc.isenabled()


def test_one_that_does_not_collect_is_left_so() -> None:
    gc.disable()
    try:
        with many_modules():
            pass
        assert not gc.isenabled()
    finally:
        gc.enable()
