"""What points does a cloud file hold? PCD, PLY and XYZ, read by NumPy alone.

A header's counts are compared with the bytes that follow before anything is allocated, so a file can neither ask for
memory it does not fill nor be read beyond its end. Fields other than x, y and z are skipped. Only ScanError is raised.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pmpnbp.errors import ScanError
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import IDENTITY, Array
from pmpnbp.scene.lzf import lzf_decode

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
    columns are skipped, and so are lines that start with # or //."""
    text = content.translate(bytes.maketrans(b",;\r", b"  \n"))
    lines = [line for line in text.split(b"\n") if line.strip() and not line.lstrip().startswith((b"#", b"//"))]
    return Cloud(_table(lines, [0, 1, 2], name))


def read_pcd(content: bytes, name: str) -> Cloud:
    """A cloud of the Point Cloud Library: ascii, binary or binary_compressed; organised where HEIGHT is above 1."""
    header, body = _pcd_header(content, name)
    fields = header.get("FIELDS", [])
    sizes = _whole_numbers(header.get("SIZE", []), "SIZE", name)
    counts = _whole_numbers(header["COUNT"], "COUNT", name) if "COUNT" in header else [1] * len(fields)
    types = header.get("TYPE", [])
    if not 1 <= len(fields) <= MOST_FIELDS or not len(fields) == len(sizes) == len(counts) == len(types):
        raise ScanError(
            f"scan '{name}' names {len(fields)} FIELDS, {len(sizes)} SIZE, {len(types)} TYPE and {len(counts)} COUNT; "
            "expected as many of each"
        )
    width = _whole_number(header, "WIDTH", name)
    height = _whole_number(header, "HEIGHT", name)
    total = _whole_number(header, "POINTS", name) if "POINTS" in header else width * height
    if total != width * height:
        raise ScanError(f"scan '{name}' says POINTS {total}, but WIDTH x HEIGHT is {width} x {height}")
    _check_count(total, name)
    if any(not 1 <= count <= 100_000 for count in counts):
        raise ScanError(f"scan '{name}' has a COUNT of {min(counts)} to {max(counts)}; expected 1 to 100000")
    codes = [_pcd_type(kind, size, name) for kind, size in zip(types, sizes, strict=True)]
    places = [_axis(fields, counts, axis, name) for axis in "xyz"]
    encoding = header["DATA"][0].lower() if header["DATA"] else ""
    if encoding == "ascii":
        starts = np.concatenate([[0], np.cumsum(counts)])
        lines = [line for line in body.replace(b"\r", b"\n").split(b"\n") if line.strip()]
        if len(lines) != total:
            raise ScanError(f"scan '{name}' holds {len(lines)} lines of points; its header says {total}")
        points = _table(lines, [int(starts[place]) for place in places], name)
    elif encoding in ("binary", "binary_compressed"):
        widths = [size * count for size, count in zip(sizes, counts, strict=True)]
        record = sum(widths)
        starts = np.concatenate([[0], np.cumsum(widths)])
        if encoding == "binary":
            _check_length(total * record, len(body), total, record, name)
            offsets = [(int(starts[place]), record) for place in places]
        else:
            body = _pcd_decompress(body, total * record, name)
            # Compressed clouds are stored field by field: all x, then all y, …
            offsets = [(int(starts[place]) * total, sizes[place]) for place in places]
        columns = [
            _strided(body, codes[place], offset, stride, total)
            for place, (offset, stride) in zip(places, offsets, strict=True)
        ]
        points = _columns(columns)
    else:
        raise ScanError(f"scan '{name}' has DATA '{encoding:.40}'; expected ascii, binary or binary_compressed")
    if height > 1:
        points = points.reshape(height, width, 3)
    return Cloud(points, _pcd_viewpoint(header.get("VIEWPOINT"), name))


def read_ply(content: bytes, name: str) -> Cloud:
    """A loose cloud: the `vertex` element of a PLY file, ascii or binary of either byte order."""
    encoding, elements, body = _ply_header(content, name)
    lines = body.replace(b"\r", b"\n").split(b"\n") if encoding == "ascii" else []
    lines = [line for line in lines if line.strip()]
    skipped = 0
    for element in elements:
        if element.name == "vertex":
            return Cloud(_ply_vertices(element, encoding, body, lines, skipped, name))
        if encoding == "ascii":
            skipped += element.count
        elif element.lists:
            raise ScanError(f"scan '{name}' has a list in element '{element.name:.40}' before its vertices")
        else:
            skipped += element.count * sum(np.dtype(code).itemsize for _, code in element.properties)
    raise ScanError(f"scan '{name}' has no element 'vertex'; a point cloud's PLY holds one")


def _columns(columns: list[NDArray[np.generic]]) -> NDArray[np.floating]:
    """(N, 3) float32, or float64 where a column is (float64 coordinates of a map lose millimetres in float32)."""
    wide = any(column.dtype.itemsize > 4 for column in columns)
    points = np.empty((len(columns[0]), 3), dtype=np.float64 if wide else np.float32)
    with np.errstate(invalid="ignore", over="ignore"):
        for k, column in enumerate(columns):
            points[:, k] = column
    return points


def _strided(body: bytes, code: str, offset: int, stride: int, count: int) -> NDArray[np.generic]:
    return np.ndarray((count,), dtype=code, buffer=body, offset=offset, strides=(stride,))


def _table(lines: list[bytes], columns: list[int], name: str) -> NDArray[np.float64]:
    """(N, 3): the given columns of text `lines`, each of which has to have them."""
    _check_count(len(lines), name)
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


def _check_count(count: int, name: str) -> None:
    if count < 1:
        raise ScanError(f"scan '{name}' holds no points")
    if count > LARGEST_POINTS:
        raise ScanError(f"scan '{name}' says it holds {count} points; expected at most {LARGEST_POINTS}")


def _check_length(needed: int, present: int, count: int, record: int, name: str) -> None:
    if needed > present:
        raise ScanError(
            f"scan '{name}' is cut short: {count} points of {record} bytes need {needed} bytes, and {present} are there"
        )


def _whole_number(header: dict[str, list[str]], key: str, name: str) -> int:
    if key not in header:
        raise ScanError(f"the header of scan '{name}' has no {key}")
    numbers = _whole_numbers(header[key], key, name)
    if len(numbers) != 1:
        raise ScanError(f"the header of scan '{name}' has {len(numbers)} numbers after {key}; expected one")
    return numbers[0]


def _whole_numbers(words: list[str], key: str, name: str) -> list[int]:
    for word in words:
        if not (word.isascii() and word.isdigit() and len(word) <= 12):
            raise ScanError(f"the header of scan '{name}' says {key} '{word:.40}'; expected whole numbers")
    return [int(word) for word in words]


def _pcd_header(content: bytes, name: str) -> tuple[dict[str, list[str]], bytes]:
    """The header's entries by their first word, and the bytes after its DATA line."""
    header: dict[str, list[str]] = {}
    start = 0
    while True:
        end = content.find(b"\n", start, LONGEST_HEADER)
        if end < 0:
            raise ScanError(f"scan '{name}' has no PCD header that ends with a DATA line")
        words = content[start:end].decode("latin1").split()
        start = end + 1
        if not words or words[0].startswith("#"):
            continue
        header[words[0].upper()] = words[1:]
        if words[0].upper() == "DATA":
            return header, content[start:]


def _pcd_type(kind: str, size: int, name: str) -> str:
    sizes = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}.get(kind.upper(), ())
    if size not in sizes:
        raise ScanError(f"scan '{name}' has a field of TYPE {kind:.8} and SIZE {size}, which PCD does not have")
    return f"<{kind.lower()}{size}"


def _axis(fields: list[str], counts: list[int], axis: str, name: str) -> int:
    if fields.count(axis) != 1 or counts[fields.index(axis)] != 1:
        raise ScanError(f"scan '{name}' has FIELDS {' '.join(fields):.80}; expected x, y and z, each once and single")
    return fields.index(axis)


def _pcd_decompress(body: bytes, expected: int, name: str) -> bytes:
    if len(body) < 8:
        raise ScanError(f"scan '{name}' is cut short: its compressed data has no sizes")
    packed, unpacked = (int(number) for number in np.frombuffer(body, dtype="<u4", count=2))
    if unpacked != expected:
        raise ScanError(f"scan '{name}' says it unpacks to {unpacked} bytes; its points need {expected}")
    if packed > len(body) - 8:
        raise ScanError(f"scan '{name}' is cut short: {packed} compressed bytes were written, {len(body) - 8} are there")
    # No LZF code makes more than 264 bytes out of 3.
    if unpacked > 88 * packed + 264:
        raise ScanError(f"scan '{name}' cannot unpack {packed} bytes to {unpacked}")
    plain = lzf_decode(body[8 : 8 + packed], unpacked)
    if plain is None:
        raise ScanError(f"the compressed data of scan '{name}' is damaged")
    return plain


def _pcd_viewpoint(words: list[str] | None, name: str) -> Array:
    if words is None:
        return IDENTITY
    try:
        numbers = np.array([float(word) for word in words])
        if len(numbers) != 7 or np.abs(numbers).max() > 1e6:
            raise ValueError
        return poses.normalise(numbers)
    except ValueError as error:
        raise ScanError(
            f"scan '{name}' has VIEWPOINT {' '.join(words):.80}; expected seven numbers x y z qw qx qy qz, a pose"
        ) from error


@dataclass(frozen=True)
class _Element:
    """An element of a PLY header. properties : names and NumPy type codes; lists : whether it has a list property."""

    name: str
    count: int
    properties: list[tuple[str, str]]
    lists: bool


_PLY_TYPES = {
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
_PLY_ORDERS = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}


def _ply_header(content: bytes, name: str) -> tuple[str, list[_Element], bytes]:
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
            case ["format", order, _] if order in _PLY_ORDERS:
                encoding = order
            case ["element", title, number]:
                elements.append(_Element(title, _whole_numbers([number], "element", name)[0], [], False))
            case ["property", "list", count, item, _] if elements and count in _PLY_TYPES and item in _PLY_TYPES:
                last = elements[-1]
                elements[-1] = _Element(last.name, last.count, last.properties, True)
            case ["property", kind, title] if elements and kind in _PLY_TYPES:
                elements[-1].properties.append((title, _PLY_ORDERS.get(encoding, "<") + _PLY_TYPES[kind]))
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise ScanError(f"the header of scan '{name}' has the line {line[:60]!r}, which PLY does not know")
    if not encoding:
        raise ScanError(f"the header of scan '{name}' has no format; expected ascii or binary of either byte order")
    if sum(len(element.properties) for element in elements) > MOST_FIELDS or len(elements) > MOST_FIELDS:
        raise ScanError(f"the header of scan '{name}' names more than {MOST_FIELDS} properties")
    return encoding, elements, content[after:]


def _ply_vertices(
    element: _Element, encoding: str, body: bytes, lines: list[bytes], skipped: int, name: str
) -> NDArray[np.floating]:
    """(N, 3) of the vertex element, which starts after `skipped` lines (ascii) or bytes (binary)."""
    titles = [title for title, _ in element.properties]
    if element.lists or any(titles.count(axis) != 1 for axis in "xyz"):
        raise ScanError(f"the vertices of scan '{name}' need properties x, y and z, each once, and no list")
    _check_count(element.count, name)
    places = [titles.index(axis) for axis in "xyz"]
    if encoding == "ascii":
        if skipped + element.count > len(lines):
            raise ScanError(f"scan '{name}' holds {len(lines)} lines; its header says {skipped + element.count}")
        return _table(lines[skipped : skipped + element.count], places, name)
    widths = [np.dtype(code).itemsize for _, code in element.properties]
    record = sum(widths)
    starts = np.concatenate([[0], np.cumsum(widths)])
    _check_length(element.count * record, len(body) - skipped, element.count, record, name)
    codes = [code for _, code in element.properties]
    return _columns(
        [_strided(body, codes[place], skipped + int(starts[place]), record, element.count) for place in places]
    )
