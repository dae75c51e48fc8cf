"""What does a NumPy file hold? A depth image or points, from `.npy` or `.npz`, never a pickle.

`.npz`: an array `depth` (H, W) in metres, or `points` (N, 3) or (H, W, 3) in metres. `.npy`: the same, told by shape;
an array (N, 3) is a cloud, for no depth image is three pixels wide. Only ScanError is raised.
"""

from __future__ import annotations

import io
import math
import struct
import zipfile
import zlib

import numpy as np
from numpy.typing import NDArray

from pmpnbp.errors import ScanError
from pmpnbp.scene.point_cloud_files import LARGEST_POINTS, Cloud

_MAGIC = b"\x93NUMPY"


def read_npy(content: bytes, name: str) -> NDArray[np.float32] | Cloud:
    """Depth (H, W) float32, metres, or a Cloud, by the shape of the array in a `.npy` file."""
    return of_array(_array(content, f"scan '{name}'"), name)


def of_array(array: NDArray[np.generic], name: str) -> NDArray[np.float32] | Cloud:
    """The same of an array that is there; `name` is what errors call the scan."""
    _check(array.shape, array.dtype, f"scan '{name}'")
    return _cloud(array, name) if array.shape[-1] == 3 else _depth(array, name)


def read_npz(content: bytes, name: str) -> NDArray[np.float32] | Cloud:
    """Depth (H, W) float32, metres, or a Cloud, from the array `depth` or `points` of a `.npz` file."""
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = [info for info in archive.infolist() if info.filename in ("depth.npy", "points.npy")]
            if len(members) != 1:
                held = ", ".join(info.filename.removesuffix(".npy") for info in archive.infolist()[:8])
                raise ScanError(f"scan '{name}' holds the arrays '{held:.200}'; expected one of 'depth' and 'points'")
            member = members[0]
            if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) or member.flag_bits & 1:
                raise ScanError(f"scan '{name}' is compressed or encrypted in a way that NumPy does not write")
            if member.file_size > LARGEST_POINTS * 24 + 65536:
                raise ScanError(f"scan '{name}' unpacks to {member.file_size} bytes, more than a scan can have")
            with archive.open(member) as stream:
                plain = stream.read(member.file_size)
    except (zipfile.BadZipFile, zlib.error, OSError, EOFError, ValueError, NotImplementedError, struct.error) as error:
        raise ScanError(f"scan '{name}' is not an .npz archive that can be read, or is damaged") from error
    title = member.filename.removesuffix(".npy")
    array = _array(plain, f"array '{title}' of scan '{name}'")
    return _depth(array, name) if title == "depth" else _cloud(array, name)


def _array(content: bytes, name: str) -> NDArray[np.generic]:
    """The array of real numbers in the bytes of a `.npy` file."""
    if not content.startswith(_MAGIC):
        raise ScanError(f"{name} does not start as a NumPy file does")
    stream = io.BytesIO(content)
    try:
        version = np.lib.format.read_magic(stream)
        if version not in ((1, 0), (2, 0)):
            raise ValueError
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, fortran, dtype = read(stream)
    # The header is Python text that NumPy parses; what a hostile one can raise there is no closed list.
    except Exception as error:
        raise ScanError(f"{name} has a damaged NumPy header") from error
    _check(shape, dtype, name)
    count = math.prod(shape)
    start = stream.tell()
    if count * dtype.itemsize > len(content) - start:
        raise ScanError(
            f"{name} is cut short: shape {shape} of {dtype} needs {count * dtype.itemsize} bytes, and "
            f"{len(content) - start} are there"
        )
    flat = np.frombuffer(content, dtype=dtype, count=count, offset=start)
    return flat.reshape(shape, order="F" if fortran else "C")


def _check(shape: tuple[int, ...], dtype: np.dtype[np.generic], name: str) -> None:
    if dtype.kind not in "fiu" or dtype.itemsize > 8:
        raise ScanError(f"{name} holds {str(dtype)!r:.60}; expected real numbers of at most 64 bits")
    if len(shape) not in (2, 3) or min(shape) < 1:
        raise ScanError(f"{name} has the shape {shape!s:.60}; expected (H, W), (N, 3) or (H, W, 3)")
    if math.prod(shape) > 3 * LARGEST_POINTS:
        raise ScanError(f"{name} says it holds {math.prod(shape)} numbers; expected at most {3 * LARGEST_POINTS}")


def _depth(array: NDArray[np.generic], name: str) -> NDArray[np.float32]:
    if array.ndim != 2:
        raise ScanError(f"the depth image of scan '{name}' has the shape {array.shape}; expected (H, W)")
    if array.dtype.kind != "f":
        raise ScanError(
            f"the depth image of scan '{name}' holds {array.dtype}; expected floats in metres, where it is of "
            "millimetres divided by 1000"
        )
    with np.errstate(over="ignore"):
        return array.astype(np.float32)


def _cloud(array: NDArray[np.generic], name: str) -> Cloud:
    if array.shape[-1] != 3:
        raise ScanError(f"the points of scan '{name}' have the shape {array.shape}; expected (N, 3) or (H, W, 3)")
    return Cloud(array.astype(np.float64 if array.dtype.itemsize > 4 else np.float32))
