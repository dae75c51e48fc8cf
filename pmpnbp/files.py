"""A path that a user gives may be anything: nothing, a link, a pipe, a device, a text that no path can be.

What stands there, what is in it, and how a file comes to be written whole, each with errors fit for a user.
"""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from uuid import uuid4

from pmpnbp.errors import PmpnbpError

MEBIBYTE = 1 << 20
# More characters than the name of a file can have.
LONGEST_NAME = 255


def quoted(path: Path) -> str:
    """The name of a file as a sentence tells it: on one line, and cut where it is longer than a name can be."""
    return repr(path.name if len(path.name) <= LONGEST_NAME else f"{path.name[:60]}…")


def status(path: Path, what: str, failure: type[PmpnbpError], *, done: str = "read") -> os.stat_result | None:
    """What stands at `path`, links followed; None where nothing does.

    what : as errors call it; done : what it is wanted for, read or written
    Raises `failure` where nothing tells: in a folder that may not be looked into, or where it can be no path.
    """
    try:
        return path.stat()
    except (FileNotFoundError, NotADirectoryError):
        return None
    except (OSError, ValueError) as error:
        raise failure(f"{what} cannot be {done}: {_reason(error)}") from None


def is_file(path: Path, what: str, failure: type[PmpnbpError]) -> bool:
    """Whether a file stands at `path`: no folder, pipe or device. what, Raises : as of `status`"""
    found = status(path, what, failure)
    return found is not None and stat.S_ISREG(found.st_mode)


def read_file(
    path: Path, what: str, limit: int, failure: type[PmpnbpError], *, beyond: str = "", streams: bool = False
) -> bytes:
    """All that is in the file at `path`, which `what` calls it in errors.

    limit : bytes; no more are read, whatever the system says of the file's size
    beyond : how the limit is told, where not in MiB
    streams : whether it may be a pipe or a device, too, which can be read only once
    Raises `failure` where it cannot be read or is larger.
    """
    found = status(path, what, failure)
    if found is not None and not streams and not stat.S_ISREG(found.st_mode) and not stat.S_ISDIR(found.st_mode):
        raise failure(f"{what} is a pipe or a device; expected a file")
    pieces: list[bytes] = []
    left = limit + 1
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            # all at once, as a rule; a device says that it has no byte
            while left and (piece := file.read(min(left, max(size + 1, MEBIBYTE)))):
                pieces.append(piece)
                left -= len(piece)
    except OSError as error:
        raise failure(f"{what} cannot be read: {_reason(error)}") from error
    if not left:
        raise failure(f"{what} is larger than {beyond or f'{limit / MEBIBYTE:g} MiB'}")
    return b"".join(pieces)


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """The name under which to write what is to be in the file at `path`. When the context ends it is there, whole and
    on the disk; where an error ends it, what was there before still is.

    A link stays, and what it leads to is replaced; a pipe or a device is written into. Raises OSError.
    """
    if path.exists() and not path.is_file() and not path.is_dir():
        with TemporaryDirectory(prefix="written-") as folder:
            yield Path(folder) / "whole"
            with (Path(folder) / "whole").open("rb") as source, path.open("wb") as target:
                shutil.copyfileobj(source, target)
        return
    place = path.resolve()
    partial = place.with_name(f".{uuid4().hex}.part")  # short: the name itself may be as long as one can be
    try:
        yield partial
        with partial.open("rb") as file:
            os.fsync(file.fileno())
        os.replace(partial, place)
    finally:
        with suppress(OSError):  # gone already, as a rule; what went wrong first is what has to be heard
            partial.unlink()


def _reason(error: OSError | ValueError) -> str:
    return (error.strerror or str(error)) if isinstance(error, OSError) else "its path has a NUL in it"
