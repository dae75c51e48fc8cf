"""How is a scan kept in a recording? Its depth image to the bit, with camera, frame and stamp."""

from __future__ import annotations

import json
import sqlite3
from dataclasses import asdict

import numpy as np

from pmpnbp.geometry.camera import Camera
from pmpnbp.recording.schema import pack, unpack
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
        members = json.loads(camera)
        depth = unpack(dtype, shape, data).astype(np.float32, copy=False)
        depth.setflags(write=False)
        pose = np.array(members.pop("pose_world_camera"))
        found.append(Scan(Camera(**members, pose_world_camera=pose), depth, frame_id, stamp))
    return tuple(found)
