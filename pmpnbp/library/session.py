"""An inference in this process, iteration by iteration."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmpnbp.errors import EstimateError, PriorError, RecordingError, ScanError, SettingError
from pmpnbp.inference import run
from pmpnbp.inference.arrival import SCAN_MODES, ScanMode, present
from pmpnbp.inference.belief import IterationReport
from pmpnbp.inference.problem import Problem
from pmpnbp.inference.run import Step
from pmpnbp.library.drawing import Drawing
from pmpnbp.library.estimate import Estimate
from pmpnbp.library.inputs import AnyPath, CameraSource, Model, load_model, members_or_path
from pmpnbp.library.iteration import Iteration
from pmpnbp.library.scan_sources import ScanSource, scan_of, scans_of
from pmpnbp.readout.checkpoint import Checkpoint, go_on
from pmpnbp.readout.mixture import read_out, rests_as
from pmpnbp.readout.posterior import Posterior
from pmpnbp.readout.snapshot import Criteria, Snapshot, snapshot
from pmpnbp.recording import Change, Inputs, RecordingWriter, prepare
from pmpnbp.scene.common_scene import check_views, one_frame
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.truth_file import check_truth, load_truth
from pmpnbp.settings import SessionOptions, changed, checked_option, preset


class Session:
    """An object that is looked for in one scene. Iteration 0, the start, is made with it; a context manager, for the
    recording.

        with Session(model, scan, roi=roi) as session:
            for iteration in session:
                print(iteration)
            print(session.estimate())

    model : a Model, or the path of a URDF or zip
    scans : one or several, of one scene: what `load_scan` gives or takes
    camera : camera.json, or its members, of the scans that are paths or arrays; or one for each
    roi : x0 y0 z0 x1 y1 z1 of a box that holds the object, metres, world; None: all that was seen
    prior : prior.json, or its members; None: upright, anywhere on the points seen
    method : "pmpnbp" or "particle_filter"; particles : of each part; iterations : at most, where it is iterated over
    seed : the same seed and input give the same numbers
    max_std : metres, up to which a link is certain
    truth : truth.json, with which the estimate tells its errors
    recording : where every iteration is recorded; an old recording there is replaced
    settings : by name, see `pmpnbp settings`; preset="paper" is the paper's algorithm

    Raises PmpnbpError for what cannot be used or does not fit together, with a sentence that says what.
    """

    def __init__(
        self,
        model: Model | AnyPath,
        scans: ScanSource | Sequence[ScanSource],
        *,
        camera: CameraSource | Sequence[CameraSource] | None = None,
        roi: Sequence[float] | NDArray[np.floating] | None = None,
        prior: AnyPath | Mapping[str, object] | None = None,
        method: str = SessionOptions.method,
        particles: int = SessionOptions.particles,
        iterations: int = SessionOptions.iterations,
        seed: int = SessionOptions.seed,
        max_std: float = SessionOptions.max_std,
        truth: AnyPath | None = None,
        recording: AnyPath | None = None,
        **settings: Any,
    ) -> None:
        asked = changed(preset("robust"), settings)
        loaded = model if isinstance(model, Model) else load_model(model, triangles=asked.triangles)
        problem, inputs = prepare(
            loaded.path,
            scans_of(scans, camera),
            None if roi is None else _box(roi),
            members_or_path(prior, "prior", PriorError),
            asked,
            particles=checked_option("particles", particles),
            seed=checked_option("seed", seed),
            method=checked_option("method", method),
            known_model=loaded.object if loaded.triangles == asked.triangles else None,
        )
        known = None if truth is None else load_truth(Path(truth))
        if known is not None:
            check_truth(known, problem.mrf.model)
        self.iterations: int = 0 if iterations == 0 else checked_option("iterations", iterations)
        self._begin(problem, inputs, Criteria(max_std=checked_option("max_std", max_std), truth=known), recording)

    def _begin(self, problem: Problem, inputs: Inputs, criteria: Criteria, recording: AnyPath | None) -> None:
        self._problem, self._criteria = problem, criteria
        self._first = self._inputs = inputs
        self._changes: list[Change] = []
        self._closed = False
        self._rest: Step | None = None
        self._read_out: tuple[IterationReport, Posterior | None] | None = None
        self._path = None if recording is None else Path(recording)
        self._writer = (
            None
            if self._path is None
            else RecordingWriter(self._path, inputs, problem.mrf.model, max_std=criteria.max_std)
        )
        self._elapsed = 0.0
        self._advance(lambda: run.first(problem))

    # Iterating

    @property
    def newest(self) -> Iteration:
        """The newest iteration."""
        return self._newest

    @property
    def converged(self) -> bool:
        """Whether the inference is at rest, and nothing was changed since."""
        return self._step.converged and not self._changed

    def step(self, iterations: int = 1) -> Iteration:
        """Make so many iterations; the last of them. Raises SettingError where they are no number, and RecordingError
        where one cannot be recorded."""
        if not isinstance(iterations, int | np.integer) or iterations < 0:
            raise SettingError(f"iterations to make are {iterations!r:.60}; expected a whole number, 0 or more")
        for _ in range(iterations):
            self._advance(self._following)
        return self._newest

    def __iter__(self) -> Iterator[Iteration]:
        """Makes iterations, up to the session's own number of them, or until it is at rest."""
        while self._newest.number < self.iterations and not self.converged:
            yield self.step()

    def change(self, **settings: Any) -> None:
        """Other settings from the next iteration on, by name. Raises SettingError; nothing is changed then."""
        self._apply(Change(self._newest.number, settings=changed(self._inputs.settings, settings)))

    def add_scan(self, scan: ScanSource, camera: CameraSource | None = None, mode: ScanMode = "joins") -> None:
        """Another scan from the next iteration on: a further view of the same scene, or, with mode "replaces", of a
        scene that has moved on. Raises ScanError; nothing is changed then."""
        if mode not in SCAN_MODES:
            raise SettingError(f"mode is {mode!r:.60}; it can be {' or '.join(SCAN_MODES)}")
        found = scan_of(scan, camera)
        one_frame((self._problem.observation.frame_id, found.frame_id))
        self._apply(Change(self._newest.number, scan=found, mode=mode))

    # Reading

    def estimate(self, *, posterior: bool = True, checkpoint: Checkpoint = go_on) -> Estimate:
        """The newest iteration's, see `Iteration.estimate`. Without `posterior` nothing tells how sure it is.

        checkpoint : called now and then while the posterior is read out, which ends with what it raises
        """
        found, checked = self._newest.snapshot, checkpoint if posterior else None
        told = self._estimate(found, self._inputs.scans, self._told_from(self._step), checked)
        return replace(told, outdated=self._changed)

    def close(self) -> None:
        """Finish the recording; no iteration is made any more. Raises RecordingError. A second call does nothing."""
        self._closed = True
        if self._writer is not None:
            self._writer.close()

    def __enter__(self) -> Session:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
            return
        with suppress(RecordingError):  # what went wrong first is what the caller has to hear
            self.close()

    def __repr__(self) -> str:
        return f"<Session of {self._problem.mrf.model.name} at {self._newest!r}>"

    @property
    def _changed(self) -> bool:
        """Whether the next iteration is made with other settings or scans than the newest was."""
        return any(change.after_iteration >= self._newest.number for change in self._changes)

    def _following(self) -> Step:
        step = self._step
        if self._changed:  # whether it is at rest is decided anew
            step = run.resumed(step.state, [step.report], self._problem)
        return run.following(step, self._problem)

    def _advance(self, make: Callable[[], Step]) -> None:
        if self._closed:
            raise EstimateError("the session is closed, and makes no iteration any more")
        began = time.perf_counter()
        step = make()
        if self._writer is not None:
            self._writer.write(step.report, step.state)
        self._elapsed += time.perf_counter() - began
        self._step, scans = step, self._inputs.scans
        if not (step.converged and self._rest and rests_as(self._problem, self._rest.report, step.report)):
            self._rest = step if step.converged else None
        self._newest = Iteration(
            partial(self._snapshot, step, self._problem, self._elapsed),
            partial(self._estimate, scans=scans, told_from=self._told_from(step), checkpoint=go_on),
            self._problem,
            step.report,
            step.converged,
        )

    def _snapshot(self, step: Step, problem: Problem, elapsed: float) -> Snapshot:
        return snapshot(problem, step.report, self._criteria, converged=step.converged, elapsed=elapsed)

    def _told_from(self, step: Step) -> IterationReport:
        """What the newest step's posterior is read out from: where it came to rest, as long as it stays there."""
        return (self._rest or step).report

    def _estimate(
        self, found: Snapshot, scans: Sequence[Scan], told_from: IterationReport, checkpoint: Checkpoint | None
    ) -> Estimate:
        if checkpoint is not None:
            found = found.told(self._posterior(found.problem, told_from, checkpoint))
        return Estimate.from_dict(found.result, Drawing(found, scans[0], partial(self._recorded, found.iteration)))

    def _posterior(self, problem: Problem, report: IterationReport, checkpoint: Checkpoint) -> Posterior | None:
        """The last one that was read out is kept."""
        if self._read_out is None or self._read_out[0] is not report:
            posterior = read_out(problem, report, checkpoint)
            if posterior is not None and self._writer is not None and not self._closed:
                self._writer.keep(posterior)
            self._read_out = report, posterior
        return self._read_out[1]

    # Changes

    def _apply(self, change: Change) -> None:
        if self._closed:
            raise EstimateError("the session is closed, and nothing of it can be changed any more")
        inputs = self._inputs
        if change.settings is not None:
            inputs = replace(inputs, settings=change.settings)
        changes = [*self._changes, change]
        came = [(one.after_iteration, one.scan, one.mode) for one in changes if one.scan is not None]
        scans, arrival = present(self._first.scans, came)
        check_views(scans)
        inputs = replace(inputs, scans=scans, arrival=arrival)
        same = inputs.settings.triangles == self._inputs.settings.triangles
        problem = inputs.problem(self._problem.mrf.model if same else None)
        if self._writer is not None:
            self._writer.change(change)
        self._problem, self._inputs, self._changes = problem, inputs, changes

    # The page

    def _recorded(self, iteration: int, path: Path) -> Path:
        """Where the recording is; where there is none, one that is made again at `path`, to the same numbers."""
        if self._path is not None:
            if self._writer is not None and not self._closed:
                self._writer.flush()
            return self._path
        again = Session.__new__(Session)
        again._begin(self._first.problem(), self._first, self._criteria, path)
        with again:
            for change in self._changes:
                again.step(min(change.after_iteration, iteration) - again.newest.number)
                if change.after_iteration < iteration:
                    again._apply(change)
            again.step(iteration - again.newest.number)
            again.estimate()
        return path


def estimate(
    model: Model | AnyPath,
    scans: ScanSource | Sequence[ScanSource],
    *,
    camera: CameraSource | Sequence[CameraSource] | None = None,
    roi: Sequence[float] | NDArray[np.floating] | None = None,
    prior: AnyPath | Mapping[str, object] | None = None,
    method: str = SessionOptions.method,
    particles: int = SessionOptions.particles,
    iterations: int = SessionOptions.iterations,
    seed: int = SessionOptions.seed,
    max_std: float = SessionOptions.max_std,
    truth: AnyPath | None = None,
    recording: AnyPath | None = None,
    **settings: Any,
) -> Estimate:
    """Where is the object, and how sure is that? Iterates until it is at rest, or made `iterations` iterations. The
    arguments, and what is raised for those that are of no use, are those of `Session`."""
    with Session(
        model,
        scans,
        camera=camera,
        roi=roi,
        prior=prior,
        method=method,
        particles=particles,
        iterations=iterations,
        seed=seed,
        max_std=max_std,
        truth=truth,
        recording=recording,
        **settings,
    ) as session:
        for _ in session:
            pass
        return session.estimate()


def _box(roi: Sequence[float] | NDArray[np.floating]) -> list[float]:
    """Raises ScanError for what is no box."""
    try:
        box = [float(number) for number in roi]
    except (TypeError, ValueError):
        box = []
    if len(box) != 6 or not all(map(math.isfinite, box)):
        raise ScanError(f"roi is {roi!r:.80}; expected x0 y0 z0 x1 y1 z1, metres")
    return box
