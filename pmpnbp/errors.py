"""The errors a user can cause. Each message is one sentence: what came, what was expected, where."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager


class PmpnbpError(Exception):
    """Base of every error that bad input can cause; its text is fit to be shown to a user as it stands."""


class ModelError(PmpnbpError):
    """A URDF, or a mesh it names, cannot be used."""


class ScanError(PmpnbpError):
    """A scan, or its camera file, cannot be used."""


class PriorError(PmpnbpError):
    """A prior cannot be used with the model it was given for."""


class SettingError(PmpnbpError):
    """A setting's name or value is not one of those `settings.py` lists."""


class RecordingError(PmpnbpError):
    """A recording cannot be read or written."""


class IterationError(RecordingError):
    """An iteration cannot be had: there are not so many, it was thinned out, or it is damaged."""


class DamageError(RecordingError):
    """Nothing of a recording can be had, as it is damaged."""


class DiskFullError(RecordingError):
    """There is no room left on the disk of the data directory."""

    def __init__(self) -> None:
        super().__init__("the disk of the data directory is full; nothing was changed")


@contextmanager
def full_disk_told() -> Iterator[None]:
    """Turns the "no space left" of the system, of SQLite and of a recording's writer into DiskFullError."""
    try:
        yield
    except Exception as error:
        full = isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)
        if full or "disk is full" in str(error):
            raise DiskFullError from error
        raise
