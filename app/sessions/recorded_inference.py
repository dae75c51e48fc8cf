"""An inference whose iterations are recorded before anybody hears of them, and which goes on from its recording."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

from app.sessions.long_read_out import GaveWay, LongReadOut
from pmpnbp.inference import run as engine
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.run import Step
from pmpnbp.readout.mixture import at_rest
from pmpnbp.readout.snapshot import Criteria, Snapshot, snapshot
from pmpnbp.recording import Inputs, IterationArchive


class RecordedInference:
    """One thread at a time calls this. Between two iterations it stands where its archive ends.

    number : a number for the event of the next iteration
    announce : told of each iteration once it is in the recording, by another thread, except for iteration 0
    long_read_out : what the read-out of an iteration at rest gives way to
    """

    def __init__(
        self,
        archive: IterationArchive,
        number: Callable[[], int],
        announce: Callable[[Snapshot], None],
        long_read_out: LongReadOut,
    ) -> None:
        self._archive = archive
        self._number = number
        self._announce = announce
        self._long_read_out = long_read_out
        self._step: Step | None = None
        self._newest: Snapshot | None = None
        # seconds of wall time that making, reading out and handing over all iterations took
        self._elapsed = 0.0

    def begin(self, problem: Problem, inputs: Inputs, criteria: Criteria) -> None:
        """Make iteration 0 and a recording that begins with it."""
        began = time.perf_counter()
        step = engine.first(problem)
        start = self._read_out(step, problem, criteria, time.perf_counter() - began, None)
        self._archive.begin(inputs, step, start)
        self._elapsed = time.perf_counter() - began
        self._step, self._newest = step, start
        self._announce(start)

    @property
    def newest(self) -> Snapshot:
        """The newest iteration, though it may not be in the recording yet. HttpProblem 409."""
        if self._newest is None:
            self._newest = self._archive.read()
            self._elapsed = self._newest.row["elapsed"]
        return self._newest

    @property
    def iteration(self) -> int:
        """The newest iteration's number."""
        return self._archive.iteration if self._newest is None else self._newest.iteration

    def advance(self, last: int | None = None) -> bool:
        """Make the next iteration, with what is in force now, and hand it to the recording; its posterior is read out
        where it is at rest, or the `last` one. False where its read-out gave way: then it was not made, and the next
        call makes it anew, to the same numbers."""
        began, before = time.perf_counter(), self.newest
        step = self._step or self._archive.resume()
        problem = self._archive.problem(step.iteration + 1)
        if problem is not before.problem:
            step = engine.resumed(step.state, [step.report], problem)  # whether it is at rest is decided anew
        self._step = step
        following = engine.following(step, problem)
        made = time.perf_counter() - began
        try:
            newest = self._read_out(following, problem, before.criteria, self._elapsed + made, before, last)
        except GaveWay:
            return False
        self._step, self._newest = following, newest
        if before.asked.is_set():
            _ = self._newest.result_text  # who asked for the one before will ask for this one, and need not wait
        self._archive.add(self._step, self._newest, partial(self._announce, self._newest))
        self._elapsed += time.perf_counter() - began
        return True

    def forget(self) -> None:
        """Go on from the recording: what was not written was not made."""
        self._step = self._newest = None

    def _read_out(
        self,
        step: Step,
        problem: Problem,
        criteria: Criteria,
        elapsed: float,
        before: Snapshot | None,
        last: int | None = None,
    ) -> Snapshot:
        posterior = None
        if step.converged or step.iteration == last:
            known = before.placed.posterior if before is not None and before.problem is problem else None
            with self._long_read_out.begun() as checkpoint:
                posterior = at_rest(problem, step.report, known, checkpoint)
        return snapshot(
            problem,
            step.report,
            criteria,
            converged=step.converged,
            elapsed=elapsed,
            event=self._number(),
            posterior=posterior,
            before=before,
        )
