"""How is a scan kept in a recording? Its depth image to the bit, with camera, frame and stamp."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pmpnbp.geometry.camera import Camera
from pmpnbp.json_text import read_json
from pmpnbp.recording.schema import pack, unpack
from pmpnbp.scene.camera_file import LARGEST_SIDE
from pmpnbp.scene.json_files import finite_number
from pmpnbp.scene.observation import Scan


def store_scan(connection: sqlite3.Connection, scan: Scan) -> int:
    """Write a scan behind those there are; its number, counted from 0."""
    number = int(connection.execute("SELECT coalesce(max(number) + 1, 0) FROM scans").fetchone()[0])
    camera = asdict(scan.camera) | {"pose_world_camera": scan.camera.pose_world_camera.tolist()}
    connection.execute(
        "INSERT INTO scans VALUES (?, ?, ?, ?, ?, ?, ?)",
        (number, json.dumps(camera), scan.frame_id, scan.stamp, *pack(scan.depth)),
    )
    return number


def scans(connection: sqlite3.Connection, count: int | None = None) -> tuple[Scan, ...]:
    """The first `count` scans as they were read, or all, in the order of their numbers."""
    found = []
    query = "SELECT camera, frame_id, stamp, dtype, shape, depth FROM scans ORDER BY number LIMIT ?"
    rows = connection.execute(query, (-1 if count is None else count,))
    for camera, frame_id, stamp, dtype, shape, data in rows:
        known = _camera(read_json(camera))
        depth = unpack(dtype, shape, data, 8 * known.width * known.height).astype(np.float32, copy=False)
        depth.setflags(write=False)
        if depth.shape != (known.height, known.width) or not isinstance(frame_id, str):
            raise ValueError("a depth image of another size than its camera's, or a frame without a name")
        if stamp is not None and finite_number(stamp) is None:
            raise ValueError("a stamp that is no number")
        found.append(Scan(known, depth, frame_id, stamp))
    return tuple(found)


def _camera(members: Mapping[str, Any]) -> Camera:
    """Raises ValueError where it is none that a scan can have been taken with."""
    sides, lengths = (members["width"], members["height"]), (members["fx"], members["fy"])
    numbers = [finite_number(number) for number in (*lengths, members["cx"], members["cy"])]
    pose = np.array(members["pose_world_camera"], dtype=np.float64)
    if not all(type(side) is int and 1 <= side <= LARGEST_SIDE for side in sides):
        raise ValueError("no size of an image")
    if None in numbers or min(lengths) <= 0 or not _is_pose(pose):
        raise ValueError("no camera")
    return Camera(**{**members, "pose_world_camera": pose})


def _is_pose(pose: NDArray[np.float64]) -> bool:
    return pose.shape == (7,) and bool(np.isfinite(pose).all()) and abs(float(np.linalg.norm(pose[3:])) - 1) < 1e-3
