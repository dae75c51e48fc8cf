"""How does a folder of files come to be, whole or not at all, whenever the power goes?

It is prepared under a name that nobody reads, its bytes and its entries are forced to the disk, and one rename puts it
in its place. What a kill leaves behind lies in the folder of the unfinished, which is emptied at the next start.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from pmpnbp.errors import PmpnbpError, storage_told
from pmpnbp.json_text import read_json as parsed


def there(folder: Path) -> Path:
    """`folder`, made again where a program that clears old folders away has taken it, as it does empty ones."""
    with storage_told():
        folder.mkdir(parents=True, exist_ok=True)
    return folder


def create_folder(
    partial: Path, place: Path, files: Mapping[str, Path], documents: Mapping[str, Mapping[str, Any]]
) -> int:
    """Make the folder `place` of `files` (name in it: file to move there) and `documents` (name in it: what it holds as
    JSON); its size in bytes.

    partial : a folder that does not exist, on the same file system; gone afterwards, also after an error
    """
    try:
        with storage_told():
            partial.mkdir()
            for name, source in files.items():
                os.replace(source, partial / name)
            return land_folder(partial, place, documents)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def land_folder(partial: Path, place: Path, documents: Mapping[str, Mapping[str, Any]]) -> int:
    """Put the folder `partial` at `place`, with `documents` in it as JSON; its size in bytes. An error leaves it where
    it is."""
    with storage_told():
        for path in sorted(partial.iterdir()):
            sync(path)
        for name, document in documents.items():
            write_json(partial / name, document)
        sync(partial)
        size = sum(path.stat().st_size for path in partial.iterdir())
        os.rename(partial, there(place.parent) / place.name)
        sync(place.parent)
        return size


def replace_json(partial: Path, place: Path, document: Mapping[str, Any]) -> None:
    """Make the file `place` hold `document`, by way of the file `partial`: at any instant it holds the old or the new
    one."""
    try:
        with storage_told():
            write_json(partial, document)
            os.replace(partial, place)
            sync(place.parent)
    finally:
        partial.unlink(missing_ok=True)


def remove_folder(partial: Path, place: Path) -> None:
    """Take the folder `place` away in one step, by way of the name `partial`."""
    with suppress(FileNotFoundError):  # somebody else has
        os.rename(place, partial)
    sync(place.parent)
    shutil.rmtree(partial, ignore_errors=True)


def write_json(path: Path, document: Mapping[str, Any]) -> None:
    """Write and sync `document` to the disk. Raises PmpnbpError where it holds what nobody can tell."""
    try:
        content = json.dumps(document, ensure_ascii=False, allow_nan=False, indent=1).encode()
    except UnicodeEncodeError:
        raise PmpnbpError("the entry holds half of a surrogate pair, such as '\\ud800'; expected text") from None
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def read_json(path: Path) -> dict[str, Any] | None:
    """The object in a JSON file, or None where there is no whole one."""
    try:
        document = parsed(path.read_bytes().decode())
    except (OSError, ValueError):
        return None
    return document if isinstance(document, dict) else None


def sync(path: Path) -> None:
    """Wait until a file's bytes, or a folder's entries, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
