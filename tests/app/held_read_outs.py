"""Read-outs for tests that last as long as a test wants them to."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.problem import Problem
from pmpnbp.readout import mixture
from pmpnbp.readout.checkpoint import Checkpoint, go_on
from pmpnbp.readout.posterior import Posterior
from tests.app.small_sessions import PATIENCE


class Held:
    """Read-outs that go on until they are let go, as long as their checkpoint has it.

    begun : of which iterations; ended : how many of them by their checkpoint
    """

    def __init__(self) -> None:
        self._of_estimate = mixture.of_estimate
        self._released = threading.Event()
        self.changed = threading.Condition()
        self.begun: list[int] = []
        self.ended = 0

    def of_estimate(self, problem: Problem, report: IterationReport, checkpoint: Checkpoint = go_on) -> Posterior:
        """In the place of the function of that name."""
        with self.changed:
            self.begun.append(report.iteration)
            self.changed.notify_all()
        try:
            while not self._released.is_set():
                checkpoint()
                time.sleep(PATIENCE)
            return self._of_estimate(problem, report, checkpoint)
        except Exception:
            with self.changed:
                self.ended += 1
                self.changed.notify_all()
            raise

    def until(self, reached: Callable[[], bool]) -> None:
        """Return once that is so."""
        with self.changed:
            self.changed.wait_for(reached)

    def release(self) -> None:
        self._released.set()


@contextmanager
def holding() -> Iterator[Held]:
    """Every read-out that begins within is held up, and let go on leaving."""
    found = Held()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(mixture, "of_estimate", found.of_estimate)
        yield found
    found.release()
