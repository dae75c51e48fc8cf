"""Standard output and error, which may be closed, or lead to where no more can be written.

What cannot be said on standard error is dropped: no result is to be lost by it. What standard output does not take is
an error, and no bad input.
"""

from __future__ import annotations

import errno
import io
import os
import sys
from pathlib import Path
from typing import Any, TextIO

OUTPUT, ERROR = 1, 2  # their descriptors


class StandardOutputError(Exception):
    """Standard output does not take what a command has to say; the text is a sentence."""


def hold() -> None:
    """Give this process streams that do so, whatever it was started with."""
    # else a file that is opened next, a recording, would be taken for the stream that is closed
    while (descriptor := os.open(os.devnull, os.O_RDONLY)) <= ERROR:
        pass
    os.close(descriptor)
    sys.stdout = _text(_Output(OUTPUT, "w", closefd=False), sys.stdout)
    sys.stderr = _text(_Error(ERROR, "w", closefd=False), sys.stderr)


def check_output() -> None:
    """Raise StandardOutputError where standard output is closed: better before a run than after it."""
    try:
        os.write(OUTPUT, b"")
    except OSError as error:
        raise _failure(error) from None


def leads_to_output(path: Path) -> bool:
    """Whether what stands at `path` is what standard output leads to, as /dev/stdout is."""
    try:
        return os.path.samestat(path.stat(), os.fstat(OUTPUT))
    except OSError:
        return False


def drop_output() -> None:
    """Give up what standard output has not taken: Python would try once more as it ends, and complain."""
    try:
        sys.stdout.flush()
    except (OSError, StandardOutputError):
        os.dup2(os.open(os.devnull, os.O_WRONLY), OUTPUT)


class _Output(io.FileIO):
    """Standard output, whose failures are sentences; that its reader has gone stays a BrokenPipeError."""

    def write(self, content: Any) -> int:
        try:
            return super().write(content)
        except BrokenPipeError:
            raise
        except OSError as error:
            raise _failure(error) from None


class _Error(io.FileIO):
    """Standard error, which takes everything, whether it can be written or not."""

    def write(self, content: Any) -> int:
        try:
            return super().write(content)
        except OSError:
            return len(content)


def _failure(error: OSError) -> StandardOutputError:
    reason = "it is closed" if error.errno == errno.EBADF else error.strerror
    return StandardOutputError(f"standard output cannot be written: {reason}")


def _text(raw: io.FileIO, like: TextIO | None) -> io.TextIOWrapper:
    """A stream of text into `raw`, in the manner of another, None where that is closed."""
    if not isinstance(like, io.TextIOWrapper):
        return io.TextIOWrapper(io.BufferedWriter(raw), encoding="utf-8")
    return io.TextIOWrapper(
        io.BufferedWriter(raw),
        encoding=like.encoding,
        errors=like.errors,
        line_buffering=like.line_buffering,
        write_through=like.write_through,
    )
