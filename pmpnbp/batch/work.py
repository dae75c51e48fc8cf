"""What does one row ask of the process that makes its estimate, and what does that give? Bytes both ways.

Model, scans and all else travel with the row, so that a machine which makes estimates needs no disk of ours. There they
become files again, and the estimate is what `pmpnbp.estimate` makes of them.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields
from functools import cached_property, lru_cache
from hashlib import sha256
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeAlias

from pmpnbp.batch.row import OPTIONS, Row, Source
from pmpnbp.errors import ManifestError, PmpnbpError
from pmpnbp.library.inputs import Model, load_model
from pmpnbp.library.session import estimate
from pmpnbp.recording.inputs import model_zip
from pmpnbp.settings import SessionOptions, changed, preset

# Of the picture beside a result, pixels.
PICTURE_WIDTH = 480


@dataclass(frozen=True)
class File:
    """What is in a file of this name."""

    name: str
    content: bytes


Carried: TypeAlias = File | Mapping[str, object]


@dataclass(frozen=True, kw_only=True)
class Work:
    """A row with all that its files hold."""

    name: str
    model: File
    scans: tuple[File, ...]
    cameras: tuple[Carried, ...]
    roi: tuple[float, ...] | None
    prior: Carried | None
    options: Mapping[str, Any]
    settings: Mapping[str, Any]

    @cached_property
    def digest(self) -> str:
        """What changes with anything that the result may depend on. The name is not among it, nor are files' names."""
        defaults = {entry.name: entry.default for entry in fields(SessionOptions) if entry.name in OPTIONS}
        prior = None if self.prior is None else _digest(self.prior)
        told = {
            "model": _digest(self.model),
            # a scan's suffix tells its format
            "scans": [(Path(scan.name).suffix.lower(), _digest(scan)) for scan in self.scans],
            "cameras": [_digest(camera) for camera in self.cameras],
            "roi": self.roi,
            "prior": prior,
            "options": {**defaults, **self.options},
            "settings": str(changed(preset("robust"), self.settings)),
        }
        return sha256(json.dumps(told, sort_keys=True).encode()).hexdigest()[:32]


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """result : the members of result.json, and picture : PNG, or None where it cannot be drawn; or error : a sentence
    that says why there is no result"""

    result: Mapping[str, Any] | None = None
    picture: bytes | None = None
    error: str | None = None


def pack(row: Row, archive: Callable[[Path], bytes] = model_zip) -> Work:
    """Read the row's files. archive : gives a model as a zip. Raises ManifestError where one cannot be read."""
    try:
        model = File(f"{row.model.stem}.zip", archive(row.model))
    except Exception:  # of a model that cannot be used it is told, by the file's own name, where it is loaded
        model = _file(row.model)
    return Work(
        name=row.name,
        model=model,
        scans=tuple(map(_file, row.scans)),
        cameras=tuple(map(_carried, row.cameras)),
        roi=row.roi,
        prior=None if row.prior is None else _carried(row.prior),
        options=row.options,
        settings=row.settings,
    )


def perform(work: Work) -> Outcome:
    """Make the estimate, as `pmpnbp estimate` does. Whatever goes wrong is told in the outcome: the others go on."""
    try:
        with TemporaryDirectory(prefix="batch-") as folder:
            return _made(work, Path(folder))
    except PmpnbpError as error:
        return Outcome(error=str(error))
    except MemoryError:
        return Outcome(error="it takes more memory than there is")
    except Exception as error:
        return Outcome(error=f"pmpnbp fails on it, which it never should ({type(error).__name__}: {str(error)[:200]})")


def killed(work: Work) -> Outcome:
    """What comes of a row whose process was killed each time."""
    return Outcome(error="the process that makes it was killed each time, for want of memory maybe")


def _made(work: Work, folder: Path) -> Outcome:
    found = estimate(
        _model(work.model, changed(preset("robust"), work.settings).triangles),
        [_placed(scan, folder / f"scan_{number}") for number, scan in enumerate(work.scans)],
        camera=[_placed_if(camera, folder / f"camera_{number}") for number, camera in enumerate(work.cameras)] or None,
        roi=work.roi,
        prior=None if work.prior is None else _placed_if(work.prior, folder / "prior"),
        **work.options,
        **work.settings,
    )
    picture = None
    with suppress(Exception):  # the result counts, whether or not this machine can draw
        picture = found.picture(PICTURE_WIDTH)
    return Outcome(result=found.to_dict(), picture=picture)


@lru_cache(maxsize=4)
def _model(file: File, triangles: int) -> Model:
    """Kept, because a thousand scans may be of one model."""
    with TemporaryDirectory(prefix="batch-model-") as folder:
        return load_model(_placed(file, Path(folder) / "model"), triangles=triangles)


def _placed(file: File, folder: Path) -> Path:
    """A file of its name, in a folder of its own: two views may both be called depth.png."""
    folder.mkdir()
    path = folder / file.name
    path.write_bytes(file.content)
    return path


def _placed_if(carried: Carried, folder: Path) -> Path | Mapping[str, object]:
    return _placed(carried, folder) if isinstance(carried, File) else carried


def _file(path: Path) -> File:
    try:
        return File(path.name, path.read_bytes())
    except OSError as error:
        raise ManifestError(f"'{path.name}' cannot be read: {error.strerror}") from None


def _carried(source: Source) -> Carried:
    return _file(source) if isinstance(source, Path) else source


def _digest(carried: Carried) -> str:
    content = carried.content if isinstance(carried, File) else json.dumps(carried, sort_keys=True).encode()
    return sha256(content).hexdigest()
