"""Damage valid uploads in every way we can think of, and see what a server makes of them.

`mutations(rng)` yields uploads made of a valid URDF, zip, PNG, PCD, PLY, XYZ, NPY, NPZ, camera, recording or form by
one to three changes: bytes flipped, cut, repeated or put in, numbers in text replaced, checksums set right again behind
a lie, and the tricks that archives and recordings can play. `upload_attack` sends them to a server.
"""

from __future__ import annotations

import io
import json
import random
import re
import stat
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from PIL import Image

from tests.app import recording_mutations
from tests.scene.scan_writers import pcd, ply

URDF = """<?xml version="1.0"?>
<robot name="box_and_tray">
  <link name="body"><visual><geometry><box size="0.4 0.3 0.5"/></geometry></visual></link>
  <link name="tray"><visual><origin xyz="0 0 0.1" rpy="0 0 0.2"/>
    <geometry><mesh filename="package://thing/meshes/tray.obj" scale="1 1 1"/></geometry></visual></link>
  <link name="knob"><visual><geometry><cylinder radius="0.04" length="0.1"/></geometry></visual></link>
  <joint name="slide" type="prismatic"><parent link="body"/><child link="tray"/><origin xyz="0.1 0 0.1"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.3" effort="1" velocity="1"/></joint>
  <joint name="turn" type="revolute"><parent link="tray"/><child link="knob"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1.5" effort="1" velocity="1"/><mimic joint="slide" multiplier="2" offset="0.1"/></joint>
</robot>
"""
TRAY = "o tray\nv 0 0 0\nv 0.3 0 0\nv 0.3 0.2 0\nv 0 0.2 0.05\nf 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n"
NUMBERS = (
    "0",
    "-1",
    "1e308",
    "-1e308",
    "nan",
    "inf",
    "-inf",
    "1e-320",
    "4294967295",
    "4294967296",
    "2147483648",
    "9223372036854775808",
    "99999999999999999999",
    "0x10",
    "1_000",
    "",
    "a",
    "1.5",
    "१२",
)
TRICKS = (b"\0", b"\xff" * 8, b"%s%n", b"../../../../etc/passwd", b"\r\n", "\ud800".encode("utf-8", "surrogatepass"))


@dataclass(frozen=True)
class Sample:
    """An upload. kind : folder of the REST interface that takes it; camera : text of the form's field, or None."""

    kind: str
    file_name: str
    content: bytes
    camera: str | None = None
    done: tuple[str, ...] = ()


def samples() -> list[Sample]:
    """A small valid upload of every format."""
    rows, columns = np.mgrid[0:48, 0:64]
    depth = (1.0 + 0.002 * columns + 0.001 * rows).astype(np.float32)
    points = np.stack([(columns - 31.5) / 60 * depth, (rows - 23.5) / 60 * depth, depth], axis=-1).astype(np.float32)
    loose = points.reshape(-1, 3)[::3]
    camera = json.dumps({"width": 64, "height": 48, "fx": 60.0, "fy": 60.0, "cx": 31.5, "cy": 23.5})
    npy, npz, png = io.BytesIO(), io.BytesIO(), io.BytesIO()
    np.save(npy, points)
    np.savez_compressed(npz, depth=depth)
    Image.fromarray((depth * 1000).astype(np.uint16)).save(png, "PNG")
    plain_urdf = re.sub(r"<mesh[^>]*>", '<sphere radius="0.1"/>', URDF)
    return [
        Sample("models", "thing.urdf", plain_urdf.encode()),
        Sample("models", "thing.zip", archive({"thing/a.urdf": URDF.encode(), "thing/meshes/tray.obj": TRAY.encode()})),
        Sample("scans", "scan.png", png.getvalue(), camera),
        Sample("scans", "ascii.pcd", pcd(loose[:200], "ascii")),
        Sample("scans", "binary.pcd", pcd(points, "binary")),
        Sample("scans", "compressed.pcd", pcd(points[::2, ::2], "binary_compressed")),
        Sample("scans", "ascii.ply", ply(loose[:200])),
        Sample("scans", "binary.ply", ply(loose, "binary_little_endian")),
        Sample("scans", "loose.xyz", b"".join(b"%f %f %f\n" % tuple(point) for point in loose[:200])),
        Sample("scans", "points.npy", npy.getvalue()),
        Sample("scans", "depth.npz", npz.getvalue(), camera),
        Sample("recordings", "run.sqlite", recording_mutations.recording()),
    ]


def archive(entries: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    """A zip of `entries`."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as file:
        for name, content in entries.items():
            file.writestr(name, content)
    return buffer.getvalue()


def mutations(rng: random.Random) -> Iterator[Sample]:
    """Damaged uploads without end, each format in turn, recordings oftener."""
    whole = samples()
    oftener = [sample for sample in whole if sample.kind == "recordings"] * 4
    while True:
        for sample in (*whole, *oftener):
            changed = sample
            for _ in range(rng.choice((1, 1, 1, 2, 3))):
                change = rng.choice(_changes(changed))
                changed = replace(change(rng, changed), done=(*changed.done, change.__name__))
            yield changed


def _changes(sample: Sample) -> list[Callable[[random.Random, Sample], Sample]]:
    found = [flip, flip_early, cut, repeat, put_in, take_out, numbers_in_text, trick, rename]
    if sample.camera is not None:
        found.append(camera_text)
    ending = sample.file_name.rpartition(".")[2]
    return (
        found
        + {"png": [png_header] * 3, "zip": [zip_trick] * 4, "npz": [zip_lie] * 2}.get(ending, [])
        + ([numbers_in_text, numbers_in_text] if ending in ("urdf", "pcd", "ply", "xyz") else [])
        + ([npy_header] * 3 if ending in ("npy", "npz") else [])
        + ([_of_recording(change) for change in recording_mutations.CHANGES * 4] if sample.kind == "recordings" else [])
    )


def flip(rng: random.Random, sample: Sample) -> Sample:
    content = bytearray(sample.content)
    for _ in range(rng.choice((1, 4, 64)) if content else 0):
        content[rng.randrange(len(content))] = rng.randrange(256)
    return replace(sample, content=bytes(content))


def flip_early(rng: random.Random, sample: Sample) -> Sample:
    head = flip(rng, replace(sample, content=sample.content[:256]))
    return replace(sample, content=head.content + sample.content[256:])


def cut(rng: random.Random, sample: Sample) -> Sample:
    return replace(sample, content=sample.content[: rng.randrange(len(sample.content) + 1)])


def repeat(rng: random.Random, sample: Sample) -> Sample:
    start, end = _span(rng, sample)
    again = sample.content[start:end] * rng.choice((1, 2, 50))
    return replace(sample, content=sample.content[:end] + again + sample.content[end:])


def put_in(rng: random.Random, sample: Sample) -> Sample:
    at = rng.randrange(len(sample.content) + 1)
    return replace(sample, content=sample.content[:at] + rng.randbytes(rng.choice((1, 16, 500))) + sample.content[at:])


def take_out(rng: random.Random, sample: Sample) -> Sample:
    start, end = _span(rng, sample)
    return replace(sample, content=sample.content[:start] + sample.content[end:])


def trick(rng: random.Random, sample: Sample) -> Sample:
    start, end = _span(rng, sample)
    return replace(sample, content=sample.content[:start] + rng.choice(TRICKS) + sample.content[end:])


def numbers_in_text(rng: random.Random, sample: Sample) -> Sample:
    places = list(re.finditer(rb"[-+]?\d+(\.\d+)?(e[-+]?\d+)?", sample.content[:4096]))
    if not places:
        return flip(rng, sample)
    place = rng.choice(places)
    number = rng.choice(NUMBERS).encode()
    return replace(sample, content=sample.content[: place.start()] + number + sample.content[place.end() :])


def rename(rng: random.Random, sample: Sample) -> Sample:
    names = (
        "",
        ".",
        "..",
        "x",
        "a/../b.pcd",
        "..\\c.png",
        "camera.json",
        "scan.npz",
        "d" * 300 + ".ply",
        ".urdf",
        "é\u202e.npy",
        "x.PCD",
        "x.png",
        "x.zip",
        "x.xacro",
        "model.json",
        "a\nb.txt",
        'q";.pcd',
    )
    return replace(sample, file_name=rng.choice(names))


def camera_text(rng: random.Random, sample: Sample) -> Sample:
    text = replace(sample, content=(sample.camera or "").encode())
    damaged = rng.choice((flip, cut, put_in, numbers_in_text, repeat))(rng, text).content
    return replace(sample, camera=damaged.decode("latin-1"))


def png_header(rng: random.Random, sample: Sample) -> Sample:
    """Another size, depth or colour type, with a checksum that fits."""
    content = bytearray(sample.content)
    if len(content) < 33:
        return sample
    if rng.random() < 0.5:
        struct.pack_into(
            ">I", content, rng.choice((16, 20)), rng.choice((0, 1, 63, 65535, 1 << 20, 2**31 - 1, 2**32 - 1))
        )
    else:
        content[rng.randrange(24, 29)] = rng.randrange(20)
    struct.pack_into(">I", content, 29, zlib.crc32(bytes(content[12:29])))
    return replace(sample, content=bytes(content))


def npy_header(rng: random.Random, sample: Sample) -> Sample:
    """An array that says it has another shape or type than it has."""
    shape = rng.choice(
        ("(48, 64)", "(0, 3)", "(-1, 3)", "(1000000000, 3)", "(2, 2, 2, 2)", "(9,)", "()", "(3.5, 2)", "(10**9,)")
    )
    kind = rng.choice(("<f4", "<f8", ">f4", "|O", "<U9", "|V12", "<c16", "<f2", "<i8", "|b1", "<M8[s]", "<f4" * 99))
    header = f"{{'descr': '{kind}', 'fortran_order': {rng.choice(('True', 'False', '0'))}, 'shape': {shape}, }}"
    if rng.random() < 0.2:
        header = rng.choice(("(" * 5000, "{}", "[1]*10**9", "__import__('os')", "{'descr': []}"))
    data = (
        b"\x93NUMPY\x01\0" + struct.pack("<H", len(header) + 1) + header.encode() + b"\n" + rng.randbytes(4 * 48 * 64)
    )
    if sample.file_name.endswith("npz"):
        data = archive({rng.choice(("depth.npy", "points.npy", "x.npy")): data})
    return replace(sample, content=data)


def _of_recording(change: Callable[[random.Random, bytes], bytes]) -> Callable[[random.Random, Sample], Sample]:
    def changed(rng: random.Random, sample: Sample) -> Sample:
        return replace(sample, content=change(rng, sample.content))

    changed.__name__ = change.__name__
    return changed


def zip_lie(rng: random.Random, sample: Sample) -> Sample:
    """Sizes, methods and offsets in the directory that are not those of the entries."""
    content = bytearray(sample.content)
    places = [place.start() for place in re.finditer(b"PK\x01\x02|PK\x03\x04|PK\x05\x06", sample.content)]
    for _ in range(rng.choice((1, 2, 5)) if places else 0):
        at = rng.choice(places) + rng.randrange(4, 46)
        if at + 4 <= len(content):
            struct.pack_into(
                "<I", content, at, rng.choice((0, 1, 8, 12, 14, 99, 0xFFFF, 0xFFFFFFFF, rng.getrandbits(32)))
            )
    return replace(sample, content=bytes(content))


def zip_trick(rng: random.Random, sample: Sample) -> Sample:
    """What archives are known for: ways out of the folder, links, bombs, entries without number, two of a name."""
    way = rng.randrange(8)
    urdf = {"thing.urdf": URDF.encode(), "meshes/tray.obj": TRAY.encode()}
    if way == 0:
        name = rng.choice(
            ("../out.urdf", "/srv/out.urdf", "a/../../out.obj", "C:\\out.urdf", "..\\out", "a\0b.urdf", "/" * 300)
        )
        return replace(sample, content=archive(urdf | {name: b"x"}))
    if way == 1:
        link = zipfile.ZipInfo("meshes")
        link.external_attr = (stat.S_IFLNK | 0o777) << 16
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w") as file:
            file.writestr("thing.urdf", URDF)
            file.writestr(link, "/etc")
        return replace(sample, content=buffer.getvalue())
    if way == 2:
        return replace(sample, content=archive(urdf | {"meshes/tray.obj": b"v 0 0 0\n" * (8 << 17)}))
    if way == 3:
        return replace(sample, content=archive({f"{k}.urdf": b"" for k in range(rng.choice((2, 6000)))}))
    if way == 4:
        return replace(sample, content=archive(urdf, rng.choice((zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA))))
    if way == 5:
        suffix = rng.choice(("stl", "dae", "obj", "ply", "glb", "exe", "STL"))
        text = URDF.replace("tray.obj", f"tray.{suffix}")
        mesh = rng.choice(
            (TRAY.encode(), rng.randbytes(500), b"solid x\n", b"\0" * 80 + b"\xff" * 4, b"<COLLADA/>", b"")
        )
        return replace(sample, content=archive({"thing.urdf": text.encode(), f"meshes/tray.{suffix}": mesh}))
    if way == 6:
        text = numbers_in_text(rng, replace(sample, content=rng.choice((URDF, TRAY)).encode())).content
        return replace(
            sample, content=archive(urdf | {("thing.urdf" if b"robot" in text else "meshes/tray.obj"): text})
        )
    return zip_lie(rng, sample)


def _span(rng: random.Random, sample: Sample) -> tuple[int, int]:
    start = rng.randrange(len(sample.content) + 1)
    return start, min(len(sample.content), start + rng.choice((1, 4, 40, 400)))
