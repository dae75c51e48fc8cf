"""A recording, opened to look at what an inference made."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType

from pmpnbp.errors import IterationError, RecordingError
from pmpnbp.files import is_file, quoted
from pmpnbp.inference.arrival import present
from pmpnbp.library.drawing import Drawing
from pmpnbp.library.estimate import Estimate
from pmpnbp.library.inputs import AnyPath
from pmpnbp.library.iteration import Iteration
from pmpnbp.readout.snapshot import Criteria, Snapshot
from pmpnbp.recording import IterationArchive, Recording
from pmpnbp.scene.articulated_object import ArticulatedObject
from pmpnbp.scene.observation import Scan
from pmpnbp.settings import checked_option


class Playback:
    """The iterations in a recording, which is not changed; a context manager. `playback[k]` is iteration k, and
    `playback[-1]` the newest; iterating gives those that are in the file, as some may have been thinned out.

    path : the recording; max_std : metres, up to which a link is certain; None for what it was recorded with. Raises
        RecordingError where it is none, or is damaged.
    """

    def __init__(self, path: AnyPath, *, max_std: float | None = None) -> None:
        self.path = Path(path)
        if not is_file(self.path, f"recording {quoted(self.path)}", RecordingError):
            raise RecordingError(f"recording {quoted(self.path)} is not there")
        # rows that it brings may be anybody's: all are made of its arrays
        self._archive = IterationArchive(self.path, f"recording '{self.path.name}'", foreign_row=_no_row)
        given = None if max_std is None else Criteria(max_std=checked_option("max_std", max_std))
        changes = self._archive.open(given)
        with Recording(self.path) as recording, TemporaryDirectory(prefix="recording-") as folder:
            self._scans = recording.restored_inputs(Path(folder), 0).scans
        self._came = [(one.after_iteration, one.scan, one.mode) for one in changes if one.scan is not None]

    def __len__(self) -> int:
        return self._archive.iteration + 1

    def __getitem__(self, number: int) -> Iteration:
        if not -len(self) <= number < len(self):
            raise IndexError(f"iteration {number} is not in the recording; it has 0 to {len(self) - 1}")
        return self._iteration(number % len(self))

    def __iter__(self) -> Iterator[Iteration]:
        with Recording(self.path) as recording:
            numbers = recording.iterations()
        return (self._iteration(number) for number in numbers if number < len(self))

    def estimate(self, iteration: int = -1) -> Estimate:
        """That of an iteration, the newest by default, see `Iteration.estimate`. Raises IterationError where it is not
        in the recording, or was thinned out."""
        try:
            found = self[iteration]
        except IndexError as error:
            raise IterationError(str(error)) from None
        return found.estimate()

    def close(self) -> None:
        """Let the file go. A second call does nothing."""
        self._archive.close()

    def __enter__(self) -> Playback:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<Playback of {self.path.name}: iterations 0 to {len(self) - 1}>"

    def _iteration(self, number: int) -> Iteration:
        found = self._archive.read(number)
        return Iteration(
            lambda: found, partial(self._estimate, self._scan(number)), found.problem, found.report, found.converged
        )

    def _estimate(self, scan: Scan, found: Snapshot) -> Estimate:
        found = found.read_out()
        return Estimate.from_dict(found.result, Drawing(found, scan, lambda _: self.path))

    def _scan(self, number: int) -> Scan:
        scans, _ = present(self._scans, self._came, number)
        return scans[0]


def open_recording(path: AnyPath, *, max_std: float | None = None) -> Playback:
    """The recording at `path`, as `Session`, `pmpnbp estimate --recording` and a server write it."""
    return Playback(path, max_std=max_std)


def _no_row(text: str, model: ArticulatedObject) -> None:
    return None
