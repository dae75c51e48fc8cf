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


class EstimateError(PmpnbpError):
    """An estimate does not hold what is asked of it."""


class RunError(PmpnbpError):
    """Runs of an experiment or a batch cannot be made, or gone on with."""


class ManifestError(PmpnbpError):
    """A manifest names estimates that cannot be made."""


class ServerError(PmpnbpError):
    """A server refused a call, or did not answer. `status` is that of HTTP, None where nothing came."""

    def __init__(self, message: str, status: int | None = None) -> None:
        super().__init__(message)
        self.status = status


class RecordingError(PmpnbpError):
    """A recording cannot be read or written."""


class IterationError(RecordingError):
    """An iteration cannot be had: there are not so many, it was thinned out, or it is damaged."""


class DamageError(RecordingError):
    """Nothing of a recording can be had, as it is damaged."""


class StorageError(RecordingError):
    """A file cannot be written, and whoever gave the input is not to blame for it."""


_FULL = "its disk is full"
_TOO_LARGE = "a file would grow beyond what the system lets this process write (ulimit -f)"
_REASONS_OF_THE_SYSTEM = {
    errno.ENOSPC: _FULL,
    errno.EDQUOT: _FULL,
    errno.EROFS: "it is read-only",
    errno.EACCES: "the user that this process runs as may not write there",
    errno.EPERM: "the user that this process runs as may not write there",
    errno.EFBIG: _TOO_LARGE,
    errno.EIO: "its disk fails",
}
# By SQLite's primary result codes, which its interface fixes; the module that names them takes long to import. SQLite
# does not tell a file that may not grow from a disk that fails.
_SQLITE_READONLY, _SQLITE_IOERR, _SQLITE_FULL, _SQLITE_CANTOPEN = 8, 10, 13, 14
_REASONS_OF_SQLITE = {
    _SQLITE_READONLY: "it is read-only",
    _SQLITE_IOERR: f"its disk fails, or {_TOO_LARGE}",
    _SQLITE_FULL: _FULL,
    _SQLITE_CANTOPEN: "a file cannot be opened to be written",
}


def why_not_written(error: Exception) -> str | None:
    """What `error` of the system or of SQLite says of the place that was written to; None where it is another error."""
    if isinstance(error, OSError):
        return _REASONS_OF_THE_SYSTEM.get(error.errno or 0)
    return _REASONS_OF_SQLITE.get(getattr(error, "sqlite_errorcode", 0) & 0xFF)


def data_directory_error(reason: str = _FULL) -> StorageError:
    """The data directory takes no more; `reason` as `why_not_written` gives it."""
    return StorageError(f"the data directory cannot be written: {reason}; nothing was changed")


@contextmanager
def storage_told() -> Iterator[None]:
    """Around what writes into the data directory: turns the errors of the system and of SQLite into StorageError."""
    try:
        yield
    except Exception as error:
        reason = why_not_written(error)
        if reason is not None:
            raise data_directory_error(reason) from error
        raise
