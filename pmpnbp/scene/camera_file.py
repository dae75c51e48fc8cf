"""Which camera took a scan? Reads camera.json: image size, intrinsics, and where the camera stood.

The file says `{"width","height","fx","fy","cx","cy"}` in pixels, and may say `"T_world_camera"` (16 numbers, row-major,
the optical frame in world), `"frame_id"` and `"stamp"` (seconds). Members beside these are left alone, but for those
that may be meant for the pose: without it, all that is found would be told in another frame.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

import numpy as np

from pmpnbp.errors import ScanError
from pmpnbp.geometry import poses
from pmpnbp.geometry.camera import Camera
from pmpnbp.geometry.poses import IDENTITY, Array
from pmpnbp.names import name_fault
from pmpnbp.scene.json_files import finite_number, parse_object, read_object
from pmpnbp.scene.reach import FARTHEST, WIDEST_RAY

# More than any depth camera gives; keeps a hostile header from asking for gigabytes.
LARGEST_SIDE = 8192
# Share that a member's name has of the pose's, as difflib counts it, from which on that may be meant: T_camera_world's
# is 0.57, camera_name's 0.48.
ALIKE = 0.55
# Seconds or pixels; a stamp in nanoseconds is beyond it.
LARGEST_NUMBER = 1e12


@dataclass(frozen=True)
class CameraFile:
    """What camera.json says. camera : intrinsics and pose (identity where none was given); frame_id : the name of the
    world frame; stamp : seconds, or None."""

    camera: Camera
    frame_id: str = "world"
    stamp: float | None = None


def load_camera(source: Path | str | Mapping[str, object]) -> CameraFile:
    """The camera of a camera.json: `source` is its path, as a `str` its text, or its members.

    Raises ScanError where the file is missing, is not JSON, or a member is missing or has a value it cannot have.
    """
    if isinstance(source, Mapping):
        return _camera(source, "the camera")
    if isinstance(source, str):
        return _camera(parse_object(source, "the camera text", ScanError), "the camera text")
    return _camera(read_object(source, "camera file", ScanError), f"camera file '{source.name}'")


def _camera(members: Mapping[str, object], name: str) -> CameraFile:
    camera = Camera(
        width=_pixels(members, "width", name),
        height=_pixels(members, "height", name),
        fx=_focal_length(members, "fx", name),
        fy=_focal_length(members, "fy", name),
        cx=_member(members, "cx", name),
        cy=_member(members, "cy", name),
        pose_world_camera=_pose(members, name),
    )
    if camera.widest_ray > WIDEST_RAY:
        raise ScanError(
            f"{name} has a pixel that looks {camera.widest_ray:.4g} m to the side at a depth of 1 m; expected "
            f"'fx', 'fy', 'cx' and 'cy' in pixels, with which it is at most {WIDEST_RAY:g} m"
        )
    frame_id = members.get("frame_id", "world")
    if not isinstance(frame_id, str) or not frame_id:
        raise ScanError(f"'frame_id' of {name} is {frame_id!r:.80}; expected the name of a frame")
    if fault := name_fault(frame_id):
        raise ScanError(f"'frame_id' of {name} {fault}")
    stamp = None if members.get("stamp") is None else _member(members, "stamp", name)
    return CameraFile(camera, frame_id, stamp)


def _member(members: Mapping[str, object], key: str, name: str) -> float:
    if key not in members:
        raise ScanError(f"{name} has no '{key}'; expected width, height, fx, fy, cx, cy")
    number = finite_number(members[key])
    if number is None:
        raise ScanError(f"'{key}' of {name} is {members[key]!r:.80}; expected a finite number")
    if abs(number) > LARGEST_NUMBER:
        unit = "seconds" if key == "stamp" else "pixels"
        raise ScanError(f"'{key}' of {name} is {members[key]!r:.80}; expected {unit}, at most {LARGEST_NUMBER:g}")
    return number


def _pixels(members: Mapping[str, object], key: str, name: str) -> int:
    number = _member(members, key, name)
    if number != int(number) or not 1 <= number <= LARGEST_SIDE:
        raise ScanError(f"'{key}' of {name} is {members[key]!r:.80}; expected whole pixels from 1 to {LARGEST_SIDE}")
    return int(number)


def _focal_length(members: Mapping[str, object], key: str, name: str) -> float:
    number = _member(members, key, name)
    if number < 1e-3:
        raise ScanError(f"'{key}' of {name} is {members[key]!r:.80}; expected a focal length in pixels, above zero")
    return number


def _pose(members: Mapping[str, object], name: str) -> Array:
    rows = members.get("T_world_camera")
    if rows is None:
        others = [key for key, value in members.items() if key != "T_world_camera" and isinstance(value, list)]
        if meant := get_close_matches("T_world_camera", others, 1, ALIKE):
            raise ScanError(
                f"{name} has a member '{meant[0]:.60}', but no 'T_world_camera'; expected the camera's pose in world "
                "by that name, or none"
            )
        return IDENTITY
    numbers = [finite_number(value) for value in rows] if isinstance(rows, list) else []
    if len(numbers) != 16 or None in numbers:
        raise ScanError(f"'T_world_camera' of {name} is not a list of 16 finite numbers (a 4x4 matrix, row by row)")
    matrix = np.array(numbers, dtype=np.float64).reshape(4, 4)
    if (largest := np.abs(matrix).max()) > FARTHEST:
        raise ScanError(
            f"'T_world_camera' of {name} holds a number of the size {largest:g}; expected metres, at most {FARTHEST:g} "
            "from the world's origin along each axis"
        )
    if np.abs(matrix[3] - [0.0, 0.0, 0.0, 1.0]).max() > 1e-6:
        raise ScanError(f"'T_world_camera' of {name} does not end with the row 0 0 0 1; expected row-major order")
    try:
        return poses.from_matrix(matrix)
    except ValueError as error:
        raise ScanError(f"'T_world_camera' of {name} is no pose: {error}") from error
