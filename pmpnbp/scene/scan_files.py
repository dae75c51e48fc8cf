"""What did the sensor measure? Reads a scan file of any format the project takes into a depth image with its camera.

| file | holds | camera file |
| --- | --- | --- |
| `.png` | depth, 16 bit, millimetres | needed |
| `.npy`, `.npz` | `depth` (H, W), metres | needed |
| `.npy`, `.npz` | `points` (H, W, 3) or (N, 3), metres | as for clouds |
| `.pcd`, `.ply`, `.xyz`, `.txt` | a cloud, metres, organised (PCD) or loose | may be given |

Points are in the camera frame. An organised cloud's camera is fitted to it, a loose cloud is looked at through a
virtual camera (`cloud_cameras`); a camera file gives the pose, and the pixels. NaN and zero depth mean "not measured".
Nothing but ScanError comes out of a damaged or hostile file, and no array is allocated that the file could not fill.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from pmpnbp.errors import ScanError
from pmpnbp.files import quoted, read_file
from pmpnbp.scene.array_files import of_array, read_npy, read_npz
from pmpnbp.scene.camera_file import CameraFile, load_camera
from pmpnbp.scene.cloud_cameras import check_camera, fit_camera, look_at_loose_cloud
from pmpnbp.scene.observation import Scan
from pmpnbp.scene.pcd_files import read_pcd
from pmpnbp.scene.ply_files import read_ply
from pmpnbp.scene.point_cloud_files import LARGEST_POINTS, Cloud, read_xyz

LARGEST_FILE = 1 << 29
# Beyond it a value is no measurement in metres (a file in millimetres, a damaged one), and squares would overflow.
LARGEST_DEPTH = 1000.0
_READERS = {".npy": read_npy, ".npz": read_npz, ".pcd": read_pcd, ".ply": read_ply, ".xyz": read_xyz, ".txt": read_xyz}
SUFFIXES = (".png", *_READERS)


def load_scan(path: Path, camera: Path | Mapping[str, object] | None = None) -> Scan:
    """The scan in the file `path`, whose suffix tells the format, with the camera of a camera.json, or its members,
    where one is given.

    Raises ScanError where a file cannot be read, is damaged or too large, has no valid point, needs a camera and has
    none, or has another size than its camera.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise ScanError(f"scan '{path.name}' has the suffix '{suffix}'; expected one of {', '.join(SUFFIXES)}")
    content = read_file(path, f"scan {quoted(path)}", LARGEST_FILE, ScanError)
    given = None if camera is None else load_camera(camera)
    if suffix == ".png":
        return _depth_scan(read_png(content, path.name), given, path.name)
    cloud = _READERS[suffix](content, path.name)
    if isinstance(cloud, Cloud):
        return _cloud_scan(cloud, given, path.name)
    return _depth_scan(cloud, given, path.name)


def scan_of(values: NDArray[np.generic], camera: Path | Mapping[str, object] | None = None) -> Scan:
    """The scan that an array is: depth (H, W), floats, metres, or points (N, 3) or (H, W, 3), metres, camera frame.
    Raises ScanError as `load_scan` does."""
    given = None if camera is None else load_camera(camera)
    found = of_array(values, "the array")
    if isinstance(found, Cloud):
        return _cloud_scan(found, given, "the array")
    return _depth_scan(found, given, "the array")


def read_png(content: bytes, name: str) -> NDArray[np.float32]:
    """Depth (H, W) float32, metres, of a 16-bit greyscale PNG in millimetres."""
    try:
        with Image.open(io.BytesIO(content), formats=["PNG"]) as image:
            width, height = image.size
            if width * height > LARGEST_POINTS:
                raise ScanError(f"scan '{name}' has {width}x{height} pixels; expected at most {LARGEST_POINTS}")
            if image.mode not in ("I;16", "I;16B", "I"):
                raise ScanError(f"scan '{name}' is a PNG of mode {image.mode}; expected 16-bit greyscale, millimetres")
            millimetres = np.asarray(image)
    except ScanError:
        raise
    except Exception as error:  # Pillow promises no closed list of what a damaged file raises
        raise ScanError(f"scan '{name}' is not a PNG that can be read, or is cut short") from error
    return millimetres.astype(np.float32) * np.float32(0.001)


def _depth_scan(depth: NDArray[np.float32], given: CameraFile | None, name: str) -> Scan:
    if given is None:
        raise ScanError(f"scan '{name}' is a depth image and needs a camera file; none was given")
    _check_size(depth.shape, given, name)
    return _scan(depth, given, name)


def _cloud_scan(cloud: Cloud, given: CameraFile | None, name: str) -> Scan:
    points = cloud.points
    with np.errstate(invalid="ignore"):
        usable = (np.abs(points) <= LARGEST_DEPTH).all(axis=-1)
    if points.ndim == 2:
        known = None if given is None else given.camera
        camera, depth = look_at_loose_cloud(points[usable], cloud.viewpoint, known, name)
        return _scan(depth, CameraFile(camera) if given is None else replace(given, camera=camera), name)
    if given is None:
        camera, points = fit_camera(points, cloud.viewpoint, name)
        given = CameraFile(camera)
    else:
        _check_size(points.shape, given, name)
        check_camera(points, usable & (points[..., 2] > 0), given.camera, name)
    return _scan(points[..., 2], given, name)


def _check_size(shape: tuple[int, ...], given: CameraFile, name: str) -> None:
    height, width = shape[:2]
    if (width, height) != (given.camera.width, given.camera.height):
        raise ScanError(
            f"scan '{name}' is {width}x{height} pixels, but its camera file says "
            f"{given.camera.width}x{given.camera.height}"
        )


def _scan(depth: NDArray[np.floating], given: CameraFile, name: str) -> Scan:
    with np.errstate(invalid="ignore", over="ignore"):
        valid = (depth > 1e-6) & (depth <= LARGEST_DEPTH)
        depth = np.where(valid, depth, 0.0).astype(np.float32)
    if not valid.any():
        raise ScanError(f"scan '{name}' has no valid point: every depth is zero, negative, not a number or not metres")
    depth.setflags(write=False)
    return Scan(given.camera, depth, given.frame_id, given.stamp)
