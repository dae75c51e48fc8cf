"""What points does a cloud file hold? What the readers of PCD, PLY and XYZ share, and the one for XYZ.

A header's counts are compared with the bytes that follow before anything is allocated, so a file can neither ask for
memory it does not fill nor be read beyond its end. Fields other than x, y and z are skipped. Only ScanError is raised.
"""

from __future__ import annotations

import codecs
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pmpnbp.errors import ScanError
from pmpnbp.geometry.poses import IDENTITY, Array

# A 4k depth image has 8.3 million.
LARGEST_POINTS = 10_000_000
LONGEST_HEADER = 1 << 16
MOST_FIELDS = 256


@dataclass(frozen=True)
class Cloud:
    """Points as a file holds them.

    points : (H, W, 3) where the cloud is organised by rows and columns, else (N, 3), metres, NaN where invalid
    viewpoint : (7,) pose of the sensor in the points' frame; identity where the file names none
    """

    points: NDArray[np.floating]
    viewpoint: Array = field(default_factory=IDENTITY.copy)


def read_xyz(content: bytes, name: str) -> Cloud:
    """A loose cloud of text lines `x y z …`; columns are separated by spaces, tabs, commas or semicolons, further
    columns are skipped, and so are lines that start with # or //, and UTF-8's byte order mark. Raises ScanError."""
    if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise ScanError(f"scan '{name}' is UTF-16 text; expected UTF-8 or ASCII")
    content = content.removeprefix(codecs.BOM_UTF8)
    lines = text_lines(content.replace(b",", b" ").replace(b";", b" "), name)
    return Cloud(table([line for line in lines if not line.lstrip().startswith((b"#", b"//"))], [0, 1, 2], name))


def text_lines(content: bytes, name: str) -> list[bytes]:
    """The lines of `content` that are not blank; LF, CR LF and CR end a line."""
    content = content.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if content.count(b"\n") > LARGEST_POINTS:
        raise ScanError(f"scan '{name}' has more than {LARGEST_POINTS} lines")
    return [line for line in content.split(b"\n") if line.strip()]


def table(lines: list[bytes], columns: list[int], name: str) -> NDArray[np.float64]:
    """(N, 3): the given columns of text `lines`, each of which has to have them."""
    check_count(len(lines), name)
    try:
        return np.loadtxt(lines, dtype=np.float64, usecols=columns, ndmin=2, comments=None, encoding="latin1")
    except (ValueError, IndexError, OverflowError) as error:
        place = next((k for k, line in enumerate(lines) if not _are_numbers(line, columns)), 0)
        raise ScanError(
            f"line {place + 1} of the points in scan '{name}' is {lines[place][:60].decode('latin1')!r}; expected "
            f"numbers x, y and z in columns {', '.join(str(column + 1) for column in columns)}"
        ) from error


def _are_numbers(line: bytes, columns: list[int]) -> bool:
    words = line.split()
    try:
        for column in columns:
            float(words[column])
    except (ValueError, IndexError):
        return False
    return True


def stacked_columns(columns: list[NDArray[np.generic]]) -> NDArray[np.floating]:
    """(N, 3) float32, or float64 where a column is (float64 coordinates of a map lose millimetres in float32)."""
    wide = any(column.dtype.itemsize > 4 for column in columns)
    points = np.empty((len(columns[0]), 3), dtype=np.float64 if wide else np.float32)
    with np.errstate(invalid="ignore", over="ignore"):
        for k, column in enumerate(columns):
            points[:, k] = column
    return points


def strided_column(body: bytes, code: str, offset: int, stride: int, count: int) -> NDArray[np.generic]:
    """(count,) values of NumPy type `code` in `body`, the first at byte `offset`, each `stride` bytes on."""
    return np.ndarray((count,), dtype=code, buffer=body, offset=offset, strides=(stride,))


def check_count(count: int, name: str) -> None:
    """Raise ScanError where a file of `count` points has none or too many."""
    if count < 1:
        raise ScanError(f"scan '{name}' holds no points")
    if count > LARGEST_POINTS:
        raise ScanError(f"scan '{name}' says it holds {count} points; expected at most {LARGEST_POINTS}")


def check_length(count: int, record: int, present: int, name: str) -> None:
    """Raise ScanError where `count` points of `record` bytes are more than the `present` bytes."""
    if count * record > present:
        raise ScanError(
            f"scan '{name}' is cut short: {count} points of {record} bytes need {count * record} bytes, "
            f"and {present} are there"
        )


def whole_numbers(words: list[str], key: str, name: str) -> list[int]:
    """The header's `words` after `key` as numbers; ScanError where one is no whole number of at most 12 digits."""
    for word in words:
        if not (word.isascii() and word.isdigit() and len(word) <= 12):
            raise ScanError(f"the header of scan '{name}' says {key} '{word:.40}'; expected whole numbers")
    return [int(word) for word in words]
