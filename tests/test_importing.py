"""While modules are imported nobody collects garbage or is interrupted, and afterwards it is as it was."""

from __future__ import annotations

import gc
import signal
import threading

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


def test_an_interrupt_waits_for_the_last_module() -> None:
    """As trimesh takes any exception for a scipy that is not there."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    ended = False
    try:
        with pytest.raises(KeyboardInterrupt), many_modules():
            signal.raise_signal(signal.SIGINT)
            ended = True
        assert ended
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    finally:
        signal.signal(signal.SIGINT, before)


def test_signals_that_are_ignored_or_of_other_threads_are_left_so() -> None:
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    found = []

    def imports() -> None:
        with many_modules():
            found.append(signal.getsignal(signal.SIGINT))

    try:
        imports()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        thread = threading.Thread(target=imports)
        thread.start()
        thread.join()
    finally:
        signal.signal(signal.SIGINT, before)
    assert found == [signal.SIG_IGN, signal.default_int_handler]
