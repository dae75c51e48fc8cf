"""What points does a PCD file hold? The Point Cloud Library's format: ascii, binary and binary_compressed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pmpnbp.errors import ScanError
from pmpnbp.geometry import poses
from pmpnbp.geometry.poses import IDENTITY, Array
from pmpnbp.scene.lzf import lzf_decode
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
from pmpnbp.scene.reach import FARTHEST

MOST_UNPACKED = 1 << 29


def read_pcd(content: bytes, name: str) -> Cloud:
    """A cloud of the Point Cloud Library: ascii, binary or binary_compressed; organised where HEIGHT is above 1."""
    header, body = _header(content, name)
    fields = header.get("FIELDS", [])
    sizes = whole_numbers(header.get("SIZE", []), "SIZE", name)
    counts = whole_numbers(header["COUNT"], "COUNT", name) if "COUNT" in header else [1] * len(fields)
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
    check_count(total, name)
    if any(not 1 <= count <= 100_000 for count in counts):
        raise ScanError(f"scan '{name}' has a COUNT of {min(counts)} to {max(counts)}; expected 1 to 100000")
    codes = [_type(kind, size, name) for kind, size in zip(types, sizes, strict=True)]
    places = [_axis(fields, counts, axis, name) for axis in "xyz"]
    encoding = header["DATA"][0].lower() if header["DATA"] else ""
    if encoding == "ascii":
        starts = np.concatenate([[0], np.cumsum(counts)])
        lines = text_lines(body, name)
        if len(lines) != total:
            raise ScanError(f"scan '{name}' holds {len(lines)} lines of points; its header says {total}")
        points: NDArray[np.floating] = table(lines, [int(starts[place]) for place in places], name)
    elif encoding in ("binary", "binary_compressed"):
        widths = [size * count for size, count in zip(sizes, counts, strict=True)]
        record = sum(widths)
        starts = np.concatenate([[0], np.cumsum(widths)])
        if encoding == "binary":
            check_length(total, record, len(body), name)
            offsets = [(int(starts[place]), record) for place in places]
        else:
            body = _decompress(body, total * record, name)
            # Compressed clouds are stored field by field: all x, then all y, …
            offsets = [(int(starts[place]) * total, sizes[place]) for place in places]
        columns = [
            strided_column(body, codes[place], offset, stride, total)
            for place, (offset, stride) in zip(places, offsets, strict=True)
        ]
        points = stacked_columns(columns)
    else:
        raise ScanError(f"scan '{name}' has DATA '{encoding:.40}'; expected ascii, binary or binary_compressed")
    if height > 1:
        points = points.reshape(height, width, 3)
    return Cloud(points, _viewpoint(header.get("VIEWPOINT"), name))


def _header(content: bytes, name: str) -> tuple[dict[str, list[str]], bytes]:
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


def _whole_number(header: dict[str, list[str]], key: str, name: str) -> int:
    if key not in header:
        raise ScanError(f"the header of scan '{name}' has no {key}")
    numbers = whole_numbers(header[key], key, name)
    if len(numbers) != 1:
        raise ScanError(f"the header of scan '{name}' has {len(numbers)} numbers after {key}; expected one")
    return numbers[0]


def _type(kind: str, size: int, name: str) -> str:
    sizes = {"F": (4, 8), "I": (1, 2, 4, 8), "U": (1, 2, 4, 8)}.get(kind.upper(), ())
    if size not in sizes:
        raise ScanError(f"scan '{name}' has a field of TYPE {kind:.8} and SIZE {size}, which PCD does not have")
    return f"<{kind.lower()}{size}"


def _axis(fields: list[str], counts: list[int], axis: str, name: str) -> int:
    if fields.count(axis) != 1 or counts[fields.index(axis)] != 1:
        raise ScanError(f"scan '{name}' has FIELDS {' '.join(fields):.80}; expected x, y and z, each once and single")
    return fields.index(axis)


def _decompress(body: bytes, expected: int, name: str) -> bytes:
    if len(body) < 8:
        raise ScanError(f"scan '{name}' is cut short: its compressed data has no sizes")
    packed, unpacked = (int(number) for number in np.frombuffer(body, dtype="<u4", count=2))
    if unpacked != expected:
        raise ScanError(f"scan '{name}' says it unpacks to {unpacked} bytes; its points need {expected}")
    if packed > len(body) - 8:
        raise ScanError(
            f"scan '{name}' is cut short: {packed} compressed bytes were written, {len(body) - 8} are there"
        )
    # No LZF code makes more than 264 bytes out of 3.
    if unpacked > min(88 * packed + 264, MOST_UNPACKED):
        raise ScanError(f"scan '{name}' cannot unpack {packed} bytes to {unpacked}")
    plain = lzf_decode(body[8 : 8 + packed], unpacked)
    if plain is None:
        raise ScanError(f"the compressed data of scan '{name}' is damaged")
    return plain


def _viewpoint(words: list[str] | None, name: str) -> Array:
    if words is None:
        return IDENTITY
    try:
        numbers = np.array([float(word) for word in words])
        if len(numbers) != 7 or not np.abs(numbers).max() <= FARTHEST:
            raise ValueError
        return poses.normalise(numbers)
    except ValueError as error:
        raise ScanError(
            f"scan '{name}' has VIEWPOINT {' '.join(words):.80}; expected seven numbers x y z qw qx qy qz, a pose "
            f"at most {FARTHEST:g} m from the world's origin along each axis"
        ) from error
