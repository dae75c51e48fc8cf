"""Which estimates are asked for? Reads a manifest: a CSV file with a header, JSON lines, or a folder of scene folders.

Every row is looked at before any estimate is made: what cannot be used is told with its place, all of it at once.
"""

from __future__ import annotations

import csv
import io
import re
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pmpnbp.batch.row import MEMBERS, Entry, Row, row_of
from pmpnbp.errors import ManifestError
from pmpnbp.files import quoted, read_file, status
from pmpnbp.json_text import read_json

# More than a million rows take.
LARGEST_FILE = 1 << 28
# How many of the rows that cannot be used are told.
TOLD = 5
# Between several scans, cameras or settings in a field of a CSV file.
SEVERAL = ";"
# Between the fields of a CSV file; what its header holds tells which.
DELIMITERS = (",", ";", "\t")


def read_manifest(path: Path, otherwise: Mapping[str, Any] | None = None) -> list[Row]:
    """The estimates that `path`, a file or folder, asks for, in its order.

    otherwise : by member, what holds for rows that do not say it, as JSON lines have it; files in it by absolute paths
    Raises ManifestError, of the first rows that cannot be used a sentence a line.
    """
    found = status(path, f"manifest {quoted(path)}", ManifestError)
    folder = found is not None and stat.S_ISDIR(found.st_mode)
    if folder:
        from pmpnbp.batch.scene_folders import scenes  # imported here: it brings what reads scans

        entries = scenes(path)
    else:
        entries = _entries(path)
    rows: list[Row] = []
    faults: list[str] = []
    names: dict[str, str] = {}
    for entry in entries:
        try:
            rows.append(row_of(entry, otherwise or {}, names))
        except ManifestError as error:
            faults.append(str(error))
    if faults:
        more = [f"and {len(faults) - TOLD} more rows cannot be used"] if len(faults) > TOLD else []
        raise ManifestError("\n".join([*faults[:TOLD], *more]))
    if not rows:
        expected = "a folder with a scan for each" if folder else "a row for each"
        raise ManifestError(f"'{path.name}' names no estimates; expected {expected}")
    return rows


def _entries(path: Path) -> Iterator[Entry]:
    text = _text(path)
    reader = _json_lines if text.lstrip()[:1] in ("{", "[") else _csv_rows
    for line, told in reader(text, path.name):
        where = f"manifest '{path.name}', line {line}"
        if isinstance(told, str):
            yield Entry(where=where, folder=path.parent, fault=told)
        else:
            yield Entry(where=where, folder=path.parent, members=told)


def _text(path: Path) -> str:
    name = f"manifest {quoted(path)}"
    if status(path, name, ManifestError) is None:
        raise ManifestError(f"{name} is not there; expected a CSV or JSON lines file, or a folder")
    try:
        return read_file(path, name, LARGEST_FILE, ManifestError, streams=True).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ManifestError(f"{name} is not UTF-8 text; expected CSV or JSON lines") from None


def _json_lines(text: str, name: str) -> Iterator[tuple[int, Mapping[str, Any] | str]]:
    # not splitlines: JSON may have U+2028 in its strings
    for number, line in enumerate(re.split(r"\r\n|\n|\r", text), start=1):
        if not line.strip():
            continue
        try:
            members = read_json(line)
        except UnicodeEncodeError:
            yield number, "it holds half of a surrogate pair, such as '\\ud800'; expected text"
        except ValueError as error:
            yield number, f"it is not JSON ({str(error)[:80]}); expected an object a line"
        else:
            told = f"it is {line.strip()[:60]!r}; expected an object {{…}}"
            yield number, members if isinstance(members, Mapping) else told


def _csv_rows(text: str, name: str) -> Iterator[tuple[int, Mapping[str, Any] | str]]:
    first = text.lstrip().partition("\n")[0]
    delimiter = max(DELIMITERS, key=first.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    header: list[str] = []
    while True:
        line = reader.line_num + 1
        try:
            fields = [one.strip() for one in next(reader)]
        except StopIteration:
            return
        except csv.Error as error:
            # where a quote is not closed, or a field has no end, nothing tells where the next row begins
            yield line, f"it is no row of a CSV file ({error})"
            return
        if not any(fields):
            continue
        if not header:
            header = _header(fields, name)
        elif len(fields) != len(header):
            yield line, f"it has {len(fields)} fields; expected {len(header)}, as the header has"
        else:
            told = [(title, one) for title, one in zip(header, fields, strict=True) if one]
            try:
                yield line, {title: _as_json(title, one) for title, one in told}
            except ManifestError as error:
                yield line, str(error)


def _header(fields: list[str], name: str) -> list[str]:
    """The names of the columns. Raises ManifestError: where one is wrong, every row is."""
    where = f"the header of manifest '{name}'"
    for number, title in enumerate(fields):
        if title and title not in MEMBERS:
            raise ManifestError(f"{where} has a column {title[:60]!r}; there are {', '.join(MEMBERS)}")
        if title and title in fields[:number]:
            raise ManifestError(f"{where} has the column {title!r} twice; expected it once")
    return fields


def _as_json(title: str, text: str) -> Any:
    """A field as JSON lines would have it."""
    if not title:
        raise ManifestError(f"{text[:60]!r} stands in a column without a name")
    if title == "scans" or (title == "camera" and SEVERAL in text):
        return [one.strip() for one in text.split(SEVERAL) if one.strip()]
    if title == "roi" and not text.lower().endswith(".json"):
        words = re.split(r"[\s,;]+", text.strip("[]() "))
        try:
            return [float(word) for word in words]
        except ValueError:
            raise ManifestError(
                f"'roi' is {text[:80]!r}; expected x0 y0 z0 x1 y1 z1, metres, or a .json file that holds them"
            ) from None
    if title == "config":
        return _settings(text)
    return text


def _settings(text: str) -> dict[str, str]:
    """`NAME=VALUE`, several with a semicolon between."""
    settings: dict[str, str] = {}
    for one in filter(str.strip, text.split(SEVERAL)):
        name, equals, value = (word.strip() for word in one.partition("="))
        if not equals or not name or name in settings:
            raise ManifestError(f"'config' is {text[:80]!r}; expected NAME=VALUE, each once, with semicolons between")
        settings[name] = value
    return settings
