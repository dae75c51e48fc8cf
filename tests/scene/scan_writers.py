"""Writes points as the files that a scan may come in: the mirror image of the readers, independent of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray


def lzf_encode(plain: bytes) -> bytes:
    """LZF code of `plain`: greedy, with a table of the last place of every three bytes."""
    places: dict[bytes, int] = {}
    code, literals, at = bytearray(), bytearray(), 0

    def flush() -> None:
        for start in range(0, len(literals), 32):
            piece = literals[start : start + 32]
            code.append(len(piece) - 1)
            code.extend(piece)
        literals.clear()

    while at < len(plain):
        key = plain[at : at + 3]
        before = places.get(key, -1)
        places[key] = at
        back = at - before - 1
        if len(key) < 3 or before < 0 or back >= 1 << 13:
            literals.append(plain[at])
            at += 1
            continue
        length = 3
        while length < 264 and at + length < len(plain) and plain[before + length] == plain[at + length]:
            length += 1
        flush()
        if length - 2 < 7:
            code.append((length - 2) << 5 | back >> 8)
        else:
            code.append(7 << 5 | back >> 8)
            code.append(length - 9)
        code.append(back & 255)
        at += length
    flush()
    return bytes(code)


def pcd(
    points: NDArray[np.floating],
    data: str = "binary",
    *,
    fields: Sequence[str] = ("x", "y", "z"),
    kind: str = "f4",
    viewpoint: str = "0 0 0 1 0 0 0",
    newline: str = "\n",
) -> bytes:
    """A PCD of `points` (N, 3) or (H, W, 3); a field besides x, y and z is a number 7, or with `name:n` n of them."""
    height, width = (1, len(points)) if points.ndim == 2 else points.shape[:2]
    flat = points.reshape(-1, 3)
    names = [field.split(":")[0] for field in fields]
    counts = [int(field.split(":")[1]) if ":" in field else 1 for field in fields]
    columns = []
    for name, count in zip(names, counts, strict=True):
        if name in "xyz":
            columns.append(flat[:, ["xyz".index(name)]].astype("<" + kind))
        else:
            columns.append(np.full((len(flat), count), 7, dtype="<u4"))
    header = newline.join(
        [
            "# .PCD v0.7 - Point Cloud Data file format",
            "VERSION 0.7",
            "FIELDS " + " ".join(names),
            "SIZE " + " ".join(str(column.dtype.itemsize) for column in columns),
            "TYPE " + " ".join("F" if column.dtype.kind == "f" else "U" for column in columns),
            "COUNT " + " ".join(str(count) for count in counts),
            f"WIDTH {width}",
            f"HEIGHT {height}",
            f"VIEWPOINT {viewpoint}",
            f"POINTS {len(flat)}",
            f"DATA {data}",
            "",
        ]
    ).encode()
    if data == "ascii":
        rows = [" ".join(repr(value.item()) for column in columns for value in column[k]) for k in range(len(flat))]
        return header + newline.join([*rows, ""]).encode()
    if data == "binary":
        return header + b"".join(b"".join(column[k].tobytes() for column in columns) for k in range(len(flat)))
    # field by field, and each entry of a field with several for all points before the next point
    plain = b"".join(column.tobytes() for column in columns)
    code = lzf_encode(plain)
    return header + np.array([len(code), len(plain)], dtype="<u4").tobytes() + code


def ply(points: NDArray[np.floating], encoding: str = "ascii", *, kind: str = "float", newline: str = "\n") -> bytes:
    """A PLY of `points` (N, 3) whose vertices have a colour before and a normal after the position, with another
    element before them and faces after them."""
    order = ">" if encoding == "binary_big_endian" else "<"
    code = {"float": "f4", "double": "f8"}[kind]
    vertex = np.zeros(
        len(points), dtype=[("red", "u1"), *((axis, order + code) for axis in "xyz"), ("nx", order + "f4")]
    )
    for k, axis in enumerate("xyz"):
        vertex[axis] = points[:, k]
    vertex["red"], vertex["nx"] = 200, 0.5
    header = newline.join(
        [
            "ply",
            f"format {encoding} 1.0",
            "comment end of the line",
            "element sensor 2",
            "property short gain",
            f"element vertex {len(points)}",
            "property uchar red",
            *(f"property {kind} {axis}" for axis in "xyz"),
            "property float nx",
            "element face 1",
            "property list uchar int vertex_indices",
            "end_header",
            "",
        ]
    ).encode()
    if encoding == "ascii":
        rows = ["3", "4", *(f"200 {p[0]!r} {p[1]!r} {p[2]!r} 0.5" for p in points.tolist()), "3 0 1 2", ""]
        return header + newline.join(rows).encode()
    sensor = np.array([3, 4], dtype=order + "i2").tobytes()
    face = b"\x03" + np.array([0, 1, 2], dtype=order + "i4").tobytes()
    return header + sensor + vertex.tobytes() + face
