"""Damaged and hostile scan files: nothing but ScanError comes out, whatever the bytes."""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from pmpnbp.errors import ScanError
from pmpnbp.scene.scan_files import SUFFIXES, load_scan
from tests.scene.scan_writers import pcd, ply

CAMERA = '{"width": 6, "height": 5, "fx": 6.5, "fy": 6.5, "cx": 2.5, "cy": 2.0}'
DEPTH = np.linspace(0.5, 1.5, 30, dtype=np.float32).reshape(5, 6)
POINTS = np.random.default_rng(0).uniform([-1, -1, 1], [1, 1, 2], (30, 3)).astype(np.float32)
COLUMNS, ROWS = np.meshgrid(np.arange(6, dtype=np.float32), np.arange(5, dtype=np.float32))
ORGANISED = np.stack([(COLUMNS - 2.5) / 6.5 * DEPTH, (ROWS - 2) / 6.5 * DEPTH, DEPTH], axis=-1).astype(np.float32)


def saved(write: Callable[[io.BytesIO], object]) -> bytes:
    stream = io.BytesIO()
    write(stream)
    return stream.getvalue()


FILES: dict[str, bytes] = {
    "a.png": saved(lambda stream: Image.fromarray((DEPTH * 1000).astype(np.uint16)).save(stream, format="PNG")),
    "a.npy": saved(lambda stream: np.save(stream, DEPTH)),
    "b.npy": saved(lambda stream: np.save(stream, POINTS)),
    "a.npz": saved(lambda stream: np.savez_compressed(stream, depth=DEPTH)),
    "b.npz": saved(lambda stream: np.savez(stream, points=ORGANISED)),
    "a.pcd": pcd(POINTS, "ascii"),
    "b.pcd": pcd(ORGANISED, "binary"),
    "c.pcd": pcd(POINTS, "binary_compressed", fields=["x", "rgb", "y", "z"]),
    "a.ply": ply(POINTS, "ascii"),
    "b.ply": ply(POINTS, "binary_big_endian"),
    "a.xyz": b"\n".join(b"%f %f %f 3" % tuple(p) for p in POINTS.tolist()),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("rubbish")
    (folder / "camera.json").write_text(CAMERA)
    return folder


def load_or_scan_error(folder: Path, name: str, content: bytes) -> bool:
    """Whether `content` is a scan; anything but ScanError, and an error that is not one line, fails the test."""
    (folder / name).write_bytes(content)
    loaded = False
    for camera in (None, folder / "camera.json"):
        try:
            scan = load_scan(folder / name, camera)
        except ScanError as error:
            assert str(error) and "\n" not in str(error)
        else:
            loaded = True
            assert np.isfinite(scan.depth).all() and (scan.depth >= 0).all() and (scan.depth > 0).any()
            assert scan.depth.shape == (scan.camera.height, scan.camera.width)
    return loaded


@pytest.mark.parametrize("name", FILES)
def test_the_files_are_good_before_they_are_damaged(folder: Path, name: str) -> None:
    assert load_or_scan_error(folder, name, FILES[name])


@pytest.mark.parametrize("name", FILES)
def test_cut_short_anywhere(folder: Path, name: str) -> None:
    content = FILES[name]
    for length in {*range(0, min(len(content), 60)), *range(60, len(content), 17), len(content) - 1}:
        load_or_scan_error(folder, name, content[:length])


@pytest.mark.parametrize("name", FILES)
@given(data=st.data())
def test_bytes_changed_removed_and_put_in(folder: Path, name: str, data: st.DataObject) -> None:
    content = bytearray(FILES[name])
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        # half of the damage goes where the header is
        at = at % 200 if data.draw(st.booleans()) and len(content) > 200 else at
        content[at : at + data.draw(st.integers(0, 3))] = data.draw(
            st.one_of(st.binary(max_size=4), st.sampled_from([b"9" * 11, b"-1", b"nan", b"\0" * 8, b"\xff" * 8, b"\n"]))
        )
        if not content:
            break
    load_or_scan_error(folder, name, bytes(content))


@pytest.mark.parametrize("suffix", SUFFIXES)
@given(content=st.binary(max_size=300))
def test_any_bytes(folder: Path, suffix: str, content: bytes) -> None:
    load_or_scan_error(folder, "any" + suffix, content)


NUMBERS = st.sampled_from(["0", "1", "3", "5", "30", "100000", "4294967297", "-2", "1e3", "", "x"])


@given(st.lists(NUMBERS, min_size=8, max_size=8), st.sampled_from(["ascii", "binary", "binary_compressed"]))
def test_pcd_headers_with_any_numbers(folder: Path, numbers: list[str], data: str) -> None:
    a, b, c, d, width, height, total, count = numbers
    header = (
        f"VERSION .7\nFIELDS x y z w\nSIZE {a} {b} {c} {d}\nTYPE F F F U\nCOUNT 1 1 1 {count}\n"
        f"WIDTH {width}\nHEIGHT {height}\nPOINTS {total}\nDATA {data}\n"
    )
    load_or_scan_error(folder, "numbers.pcd", header.encode() + b"\1\0\0\0" * 20)


@given(st.lists(NUMBERS, min_size=2, max_size=2), st.sampled_from(["ascii", "binary_little_endian"]))
def test_ply_headers_with_any_numbers(folder: Path, numbers: list[str], encoding: str) -> None:
    header = (
        f"ply\nformat {encoding} 1.0\nelement other {numbers[0]}\nproperty int a\nelement vertex {numbers[1]}\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n"
    )
    load_or_scan_error(folder, "numbers.ply", header.encode() + b"1 2 3\n" * 20)


@given(
    st.sampled_from(["<f4", "|O", "<U4", "<c16", "<f16", "|V8", "(2,)<f4", "<M8[s]", "|b1", "bogus"]),
    st.sampled_from(
        ["(3,)", "()", "(0, 3)", "(-1, 3)", "(10**12, 3)", "(2**63, 2**63)", "(2, 3)", "(1, 2, 3)", "None"]
    ),
)
def test_npy_headers_of_any_type_and_shape(folder: Path, kind: str, shape: str) -> None:
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}\n".encode()
    content = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + b"\0\0\x80?" * 20
    load_or_scan_error(folder, "header.npy", content)
