"""What points does a PLY file hold? The vertices, in ascii or binary of either byte order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pmpnbp.errors import ScanError
from pmpnbp.scene.point_cloud_files import (
    LONGEST_HEADER,
    MOST_FIELDS,
    Cloud,
    check_count,
    check_length,
    stacked_columns,
    strided_column,
    table,
    text_lines,
    whole_numbers,
)

_TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}


@dataclass(frozen=True)
class _Element:
    """An element of a PLY header. properties : names and NumPy type codes; lists : whether it has a list property."""

    name: str
    count: int
    properties: list[tuple[str, str]]
    lists: bool


def read_ply(content: bytes, name: str) -> Cloud:
    """A loose cloud: the `vertex` element of a PLY file, ascii or binary of either byte order."""
    encoding, elements, body = _header(content, name)
    lines = text_lines(body, name) if encoding == "ascii" else []
    skipped = 0
    for element in elements:
        if element.name == "vertex":
            return Cloud(_vertices(element, encoding, body, lines, skipped, name))
        if encoding == "ascii":
            skipped += element.count
        elif element.lists:
            raise ScanError(f"scan '{name}' has a list in element '{element.name:.40}' before its vertices")
        else:
            skipped += element.count * sum(np.dtype(code).itemsize for _, code in element.properties)
    raise ScanError(f"scan '{name}' has no element 'vertex'; a point cloud's PLY holds one")


def _header(content: bytes, name: str) -> tuple[str, list[_Element], bytes]:
    """The encoding, the elements in their order, and the bytes after the header."""
    end = content.find(b"end_header", 0, LONGEST_HEADER)
    if not content.startswith(b"ply") or end < 0:
        raise ScanError(f"scan '{name}' has no PLY header from 'ply' to 'end_header'")
    after = end + len(b"end_header")
    # The line ends as the file's lines do: LF, CR LF or CR.
    after += 2 if content[after : after + 2] == b"\r\n" else 1
    encoding = ""
    elements: list[_Element] = []
    for line in content[:end].decode("latin1").splitlines()[1:]:
        words = line.split()
        match words:
            case ["format", order, _] if order in _ORDERS:
                encoding = order
            case ["element", title, number]:
                elements.append(_Element(title, whole_numbers([number], "element", name)[0], [], False))
            case ["property", "list", count, item, _] if elements and count in _TYPES and item in _TYPES:
                last = elements[-1]
                elements[-1] = _Element(last.name, last.count, last.properties, True)
            case ["property", kind, title] if elements and kind in _TYPES:
                elements[-1].properties.append((title, _ORDERS.get(encoding, "<") + _TYPES[kind]))
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise ScanError(f"the header of scan '{name}' has the line {line[:60]!r}, which PLY does not know")
    if not encoding:
        raise ScanError(f"the header of scan '{name}' has no format; expected ascii or binary of either byte order")
    if sum(len(element.properties) for element in elements) > MOST_FIELDS or len(elements) > MOST_FIELDS:
        raise ScanError(f"the header of scan '{name}' names more than {MOST_FIELDS} properties")
    return encoding, elements, content[after:]


def _vertices(
    element: _Element, encoding: str, body: bytes, lines: list[bytes], skipped: int, name: str
) -> NDArray[np.floating]:
    """(N, 3) of the vertex element, which starts after `skipped` lines (ascii) or bytes (binary)."""
    titles = [title for title, _ in element.properties]
    if element.lists or any(titles.count(axis) != 1 for axis in "xyz"):
        raise ScanError(f"the vertices of scan '{name}' need properties x, y and z, each once, and no list")
    check_count(element.count, name)
    places = [titles.index(axis) for axis in "xyz"]
    if encoding == "ascii":
        if skipped + element.count > len(lines):
            raise ScanError(f"scan '{name}' holds {len(lines)} lines; its header says {skipped + element.count}")
        return table(lines[skipped : skipped + element.count], places, name)
    widths = [np.dtype(code).itemsize for _, code in element.properties]
    record = sum(widths)
    starts = np.concatenate([[0], np.cumsum(widths)])
    check_length(element.count, record, len(body) - skipped, name)
    codes = [code for _, code in element.properties]
    return stacked_columns(
        [strided_column(body, codes[place], skipped + int(starts[place]), record, element.count) for place in places]
    )
